// The reference's hammering experiment (Tables 6, 7, 8) on the emulator, with ideal joint controllers: one parameter
// set for all swings, one free number per swing, how far the reference reaches past the nail's head.
#include "tests/unit/plant/hammering.h"

#include <gtest/gtest.h>

#include <cstdio>
#include <filesystem>

namespace mrr::sim::test {
namespace {

const std::filesystem::path kRobots = std::filesystem::path(MRR_SOURCE_DIR) / "robots";

constexpr std::array<MeasuredSwing, 8> kStyrofoam{{
    {"1-1", 22.0, 150.0, 1.02, 40.0, 24.5},
    {"1-2", 4.0, 85.0, 0.53, 18.0, 5.6},
    {"1-3", 3.0, 90.0, 0.49, 14.0, 4.9},
    {"1-4", 11.0, 120.0, 1.05, 11.0, 15.0},
    {"2-1", 20.0, 140.0, 0.95, 40.0, 22.2},
    {"2-2", 13.0, 130.0, 1.08, 20.0, 17.0},
    {"2-3", 5.0, 90.0, 0.67, 7.0, 7.4},
    {"2-4", 2.0, 90.0, 0.76, 2.0, 5.2},
}};

/// The model torques of the reference swing fed forward, PD on the motor: what the reference's joint 2 did.
ExperimentController controller() {
  ExperimentController control;
  control.inertia_feedforward_kg_m2 = 1.15925 + 0.1713768;  // M + B of joint 2 in the home pose
  control.coulomb_feedforward = 1.0;
  return control;
}

class Hammering : public testing::Test {
 protected:
  RobotDescription robot_ = load_robot(kRobots / "mrr3");
  PlantDescription foam_ = load_plant(robot_, kRobots / "boards" / "styrofoam.yaml");
  PlantDescription wood_ = load_plant(robot_, kRobots / "boards" / "hardwood.yaml");
};

TEST_F(Hammering, AllStyrofoamSwingsAreReproduced) {
  for (const MeasuredSwing& measured : kStyrofoam) {
    Swing swing;
    swing.past_head_m = 1e-3 * measured.past_head_mm;
    swing.head_height_m = 1e-3 * measured.head_height_mm;
    const SwingResult result = run_swing(robot_, foam_, swing, controller());
    const ContactRecord& blow = result.blow;
    const double duration_ms = 1e3 * blow.duration().seconds();
    const double penetration_mm = 1e3 * blow.penetration_m;
    std::printf("%s past %5.2f mm: %5.1f/%3.0f ms  %.3f/%.2f N s  %5.2f/%2.0f mm\n", measured.name,
                measured.past_head_mm, duration_ms, measured.duration_ms, blow.impulse_n_s, measured.impulse_n_s,
                penetration_mm, measured.penetration_mm);
    EXPECT_EQ(result.contacts, 1U) << measured.name;
    EXPECT_NEAR(duration_ms / measured.duration_ms, 1.0, 0.15) << measured.name;
    EXPECT_NEAR(blow.impulse_n_s / measured.impulse_n_s, 1.0, 0.25) << measured.name;
    EXPECT_NEAR(penetration_mm, measured.penetration_mm, std::max(0.5, 0.1 * measured.penetration_mm)) << measured.name;
  }
}

TEST_F(Hammering, HardwoodSwingsAreWithinTheMeasuredRange) {
  for (const double past_mm : {7.0, 7.5, 8.0}) {
    Swing swing;
    swing.time_s = 0.452;
    swing.past_head_m = 1e-3 * past_mm;
    const SwingResult result = run_swing(robot_, wood_, swing, controller());
    const ContactRecord& blow = result.blow;
    const double duration_ms = 1e3 * blow.duration().seconds();
    std::printf("hardwood past %.1f mm: %.1f ms  %.3f N s  joint 2 %.2f -> %.2f rad/s  joint 3 %.2f -> %.2f rad/s\n",
                past_mm, duration_ms, blow.impulse_n_s, blow.motor_velocity_before_rad_s[1],
                blow.motor_velocity_after_rad_s[1], blow.motor_velocity_before_rad_s[2],
                blow.motor_velocity_after_rad_s[2]);
    EXPECT_EQ(result.contacts, 1U);
    EXPECT_GE(duration_ms, 70.0);
    EXPECT_LE(duration_ms, 85.0);
    EXPECT_GE(blow.impulse_n_s, 1.26);
    EXPECT_LE(blow.impulse_n_s, 1.42);
    EXPECT_EQ(blow.penetration_m, 0.0);
  }
}

// What a robot does not know exactly must not decide the result: other seeds stay near.
TEST_F(Hammering, SeedsStayNearTheNominalSwing) {
  Swing swing;
  swing.past_head_m = 0.017;
  swing.head_height_m = 0.02;
  const ContactRecord nominal = run_swing(robot_, foam_, swing, controller()).blow;
  for (std::uint64_t seed = 1; seed <= 20; ++seed) {
    const ContactRecord blow = run_swing(robot_, foam_, swing, controller(), seed).blow;
    EXPECT_NEAR(blow.duration().seconds() / nominal.duration().seconds(), 1.0, 0.25) << seed;
    EXPECT_NEAR(blow.impulse_n_s / nominal.impulse_n_s, 1.0, 0.25) << seed;
    EXPECT_NEAR(blow.penetration_m / nominal.penetration_m, 1.0, 0.25) << seed;
  }
}

// A deeper reference drives the nail deeper, with a longer contact and a larger impulse: the reference's own finding.
TEST_F(Hammering, DeeperReferenceDrivesDeeper) {
  ContactRecord last;
  for (const double past_mm : {6.0, 12.0, 18.0, 24.0}) {
    Swing swing;
    swing.past_head_m = 1e-3 * past_mm;
    const ContactRecord blow = run_swing(robot_, foam_, swing, controller()).blow;
    EXPECT_GT(blow.penetration_m, last.penetration_m);
    EXPECT_GT(blow.duration(), last.duration());
    EXPECT_GT(blow.impulse_n_s, last.impulse_n_s);
    last = blow;
  }
}

// The passive joint 3 yields instead of twisting its drive: its transmission carries less than with the joint held.
TEST_F(Hammering, PassiveJointCarriesLess) {
  Swing swing;
  swing.time_s = 0.452;
  swing.past_head_m = 0.0075;
  ExperimentController held = controller();
  held.passive_gap_m = -1.0;
  const ContactRecord passive = run_swing(robot_, wood_, swing, controller()).blow;
  const ContactRecord active = run_swing(robot_, wood_, swing, held).blow;
  std::printf("joint 3 transmission: passive %.2f Nm, held %.2f Nm\n", passive.peak_transmission_torque_nm[2],
              active.peak_transmission_torque_nm[2]);
  EXPECT_LT(passive.peak_transmission_torque_nm[2], 0.8 * active.peak_transmission_torque_nm[2]);
}

}  // namespace
}  // namespace mrr::sim::test
