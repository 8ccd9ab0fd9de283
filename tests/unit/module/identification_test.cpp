// The identification on the emulated joints: what it finds against what is true, through the bus.
#include <gtest/gtest.h>

#include <cmath>

#include "tests/bench/module/control_quality.h"

namespace mrr::fw {
namespace {

using namespace test;  // NOLINT: all of this file is about it
using State = FrictionIdentification::State;

State state_of(const PlantBench& b) { return static_cast<State>(b.module.objects().identification_state); }

/// Mode -2, start, until it is over.
void identify(PlantBench& b, double timeout_s = 200.0) {
  b.set_mode(-2);
  b.run(0.05);
  b.command(0x1F);
  b.run(0.05);
  b.run_until([&] { return state_of(b) != State::running; }, timeout_s);
}

JointSetup wrong_by(int joint, double friction, double torque_constant) {
  JointSetup s;
  s.joint = joint;
  // What the module believes is wrong; the plant is as it is.
  s.module_robot = [=](RobotDescription& robot) {
    JointDescription& j = robot.joints[static_cast<std::size_t>(joint)];
    for (double* x : {&j.friction.coulomb_nm, &j.friction.static_nm, &j.friction.viscous_nm_s_rad}) *x *= friction;
    j.motor.torque_constant_positive_nm_a *= torque_constant;
    j.motor.torque_constant_negative_nm_a *= torque_constant;
  };
  return s;
}

class Identification : public testing::TestWithParam<int> {};
INSTANTIATE_TEST_SUITE_P(Joints, Identification, testing::Values(0, 2));

TEST_P(Identification, FindsTheTrueParametersWithinATenth) {
  const int joint = GetParam();
  for (const auto& [friction, constant] : {std::pair{1.0, 1.0}, {0.7, 0.9}, {1.3, 1.1}}) {
    PlantBench b(wrong_by(joint, friction, constant));
    ASSERT_TRUE(b.enable());
    identify(b);
    const auto& od = b.module.objects();
    ASSERT_EQ(state_of(b), State::done) << "friction x " << friction << ", residual " << od.identified_residual_nm;
    const sim::JointTruth& truth = b.joint.plant().actual_description().joints[static_cast<std::size_t>(joint)];
    for (const std::size_t way : {0U, 1U}) {
      const auto& found = way == 0 ? od.identified_positive : od.identified_negative;
      const auto near = [&](const char* what, double x, double wanted) {
        EXPECT_NEAR(x, wanted, 0.1 * wanted) << what << ", direction " << way << ", friction x " << friction;
      };
      near("f_c", double{found[0]}, truth.friction.coulomb_nm[way]);
      near("f_s", double{found[1]}, truth.friction.static_nm[way]);
      near("f_tau", double{found[2]}, truth.friction.stribeck_decay_s2_rad2);
      near("b", double{found[3]}, truth.friction.viscous_nm_s_rad);
    }
    const auto constant_near = [&](float x, double wanted) { EXPECT_NEAR(double{x}, wanted, 0.1 * wanted); };
    constant_near(od.identified_torque_constant_positive_nm_a, truth.drive.torque_constant_nm_a[0]);
    constant_near(od.identified_torque_constant_negative_nm_a, truth.drive.torque_constant_nm_a[1]);
    EXPECT_LT(od.identified_residual_nm, 0.05 * truth.friction.coulomb_nm[0]);
    EXPECT_GT(od.identified_samples, 30);
    EXPECT_NE(od.statusword & kStatusFollowing, 0);
    EXPECT_EQ(b.status().fault, can::Emergency::none);
  }
}

TEST(Identification, IsHeldUpByHaltAndNeverStartsWithoutRoom) {
  PlantBench b(wrong_by(2, 1.0, 1.0));
  ASSERT_TRUE(b.enable());
  b.set_mode(-2);
  b.run(0.05);
  EXPECT_EQ(state_of(b), State::none) << "the mode alone does not start it";
  const double here = b.joint.motor_q();
  b.command(0x1F);
  b.run(0.5);
  EXPECT_EQ(state_of(b), State::running);
  EXPECT_EQ(b.status().authority, Authority::calibration);
  EXPECT_EQ(b.status().limit, can::LimitCode::calibration);
  b.command(0x11F);  // halt
  b.run(0.5);
  EXPECT_EQ(state_of(b), State::interrupted);
  EXPECT_LT(std::abs(b.joint.motor_v()), 1e-3);
  EXPECT_LT(std::abs(b.joint.motor_q() - here), 0.05);

  JointSetup tight = wrong_by(2, 1.0, 1.0);
  tight.config = [](ModuleConfig& c) { c.limits.upper_rad = 0.05F; };
  PlantBench n(tight);
  ASSERT_TRUE(n.enable());
  n.set_mode(-2);
  n.run(0.05);
  n.command(0x1F);
  n.run(0.1);
  EXPECT_EQ(state_of(n), State::no_room);
  EXPECT_NE(n.module.objects().statusword & kStatusFollowingError, 0);
  EXPECT_LT(std::abs(n.joint.motor_v()), 1e-3);
}

TEST(Identification, WithoutATorqueSensorItTakesTheTorqueConstantsAsTheyAre) {
  JointSetup s = wrong_by(0, 0.7, 1.0);  // about a vertical axis: no load but inertia
  s.config = [](ModuleConfig& c) { c.sensing.torque_sensor = false; };
  PlantBench b(s);
  ASSERT_TRUE(b.enable());
  identify(b);
  const auto& od = b.module.objects();
  ASSERT_EQ(state_of(b), State::done) << od.identified_residual_nm;
  const sim::JointTruth& truth = b.joint.plant().actual_description().joints[0];
  EXPECT_NEAR(od.identified_positive[0], truth.friction.coulomb_nm[0], 0.1 * truth.friction.coulomb_nm[0]);
  EXPECT_NEAR(od.identified_negative[1], truth.friction.static_nm[1], 0.1 * truth.friction.static_nm[1]);
  EXPECT_EQ(od.identified_torque_constant_positive_nm_a, b.config.drive.torque_constant_positive_nm_a);
}

// 13.7 Nm of gravity, as much as the friction itself, and nobody who tells of it.
TEST(Identification, WithoutATorqueSensorGravityIsToldFromFriction) {
  for (const double friction : {1.0, 0.7, 1.3}) {
    JointSetup s = wrong_by(1, friction, 1.0);
    s.pose_rad = {0.0, 0.6, 0.0};
    s.config = [](ModuleConfig& c) { c.sensing.torque_sensor = false; };
    PlantBench b(s);
    ASSERT_TRUE(b.enable());
    identify(b);
    const auto& od = b.module.objects();
    ASSERT_EQ(state_of(b), State::done) << "friction x " << friction << ", residual " << od.identified_residual_nm;
    const sim::JointTruth& truth = b.joint.plant().actual_description().joints[1];
    for (const auto& found : {od.identified_positive, od.identified_negative}) {
      const auto near = [&](const char* what, double x, double wanted) {
        EXPECT_NEAR(x, wanted, 0.1 * wanted) << what << ", friction x " << friction;
      };
      near("f_c", double{found[0]}, truth.friction.coulomb_nm[0]);
      near("f_s", double{found[1]}, truth.friction.static_nm[0]);
      near("f_tau", double{found[2]}, truth.friction.stribeck_decay_s2_rad2);
      near("b", double{found[3]}, truth.friction.viscous_nm_s_rad);
    }
    EXPECT_LT(od.identified_residual_nm, 0.05F * od.identified_positive[0]);
  }
}

TEST(Identification, StaysWithinTravelAndLimits) {
  PlantBench b(wrong_by(2, 1.0, 1.0));
  ASSERT_TRUE(b.enable());
  const double here = b.joint.motor_q();
  double farthest = 0.0;
  b.each_tick = [&](const ModuleStatus& s) { farthest = std::max(farthest, std::abs(double{s.position_rad} - here)); };
  identify(b);
  EXPECT_EQ(state_of(b), State::done);
  EXPECT_LE(farthest, double{b.module.objects().identification_travel_rad} + 0.02);
}

}  // namespace
}  // namespace mrr::fw
