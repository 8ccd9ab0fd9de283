// What CiA 402 lets a client choose about stopping (605Ah to 605Eh), on a joint of the emulated arm that swings under
// gravity: which ramp, when the brake, in which state it ends.
#include <gtest/gtest.h>

#include <optional>

#include "tests/bench/module/plant_joint.h"

namespace mrr::fw {
namespace {

using test::JointSetup;
using test::PlantBench;

enum class Way : std::uint8_t { slow_ramp, quick_ramp, at_once, torque_off };

struct Choice {
  const char* name;
  std::uint16_t object;
  std::uint32_t code;
  std::uint16_t word;  ///< controlword that asks for it; 0xFFFF: a fault does
  Way way;
  DriveState ends;
};

constexpr std::uint16_t kFault = 0xFFFF;
using enum DriveState;
const std::vector<Choice> kChoices{
    {"QuickStop0", 0x605A, 0, 0x02, Way::at_once, switch_on_disabled},
    {"QuickStop1", 0x605A, 1, 0x02, Way::slow_ramp, switch_on_disabled},
    {"QuickStop2", 0x605A, 2, 0x02, Way::quick_ramp, switch_on_disabled},
    {"QuickStop5", 0x605A, 5, 0x02, Way::slow_ramp, quick_stop_active},
    {"QuickStop6", 0x605A, 6, 0x02, Way::quick_ramp, quick_stop_active},
    {"Shutdown0", 0x605B, 0, 0x06, Way::at_once, ready_to_switch_on},
    {"Shutdown1", 0x605B, 1, 0x06, Way::slow_ramp, ready_to_switch_on},
    {"DisableOperation0", 0x605C, 0, 0x07, Way::at_once, switched_on},
    {"DisableOperation1", 0x605C, 1, 0x07, Way::slow_ramp, switched_on},
    {"DisableVoltage", 0x605C, 1, 0x00, Way::at_once, switch_on_disabled},
    {"Halt1", 0x605D, 1, 0x10F, Way::slow_ramp, operation_enabled},
    {"Halt2", 0x605D, 2, 0x10F, Way::quick_ramp, operation_enabled},
    {"FaultReaction0", 0x605E, 0, kFault, Way::torque_off, fault},
    {"FaultReaction1", 0x605E, 1, kFault, Way::slow_ramp, fault},
    {"FaultReaction2", 0x605E, 2, kFault, Way::quick_ramp, fault},
};

class OptionCode : public testing::TestWithParam<Choice> {};

TEST_P(OptionCode, SaysHowTheJointStops) {
  const Choice& choice = GetParam();
  JointSetup setup;
  setup.joint = 1;
  PlantBench b(setup);
  b.run(0.01);
  b.write(choice.object, 0, choice.code, 2);
  ASSERT_TRUE(b.enable());
  ASSERT_TRUE(b.follow_here());
  swing(b);
  b.run(0.5);
  ASSERT_GT(b.status().velocity_rad_s, 0.4F);

  float steepest = 0.0F;
  std::optional<double> brake_s, off_s;
  bool held_when_off = true;
  const double asked_s = b.seconds_now();
  b.each_tick = [&](const ModuleStatus& s) {
    const double t = b.seconds_now() - asked_s;
    // The reference while it brakes; when the joint is caught otherwise it says nothing.
    if (t > 0.003 && !brake_s) steepest = std::max(steepest, std::abs(s.reference_acceleration_rad_s2));
    if (!b.actuator.brake_release && !brake_s) brake_s = t;
    if (!b.actuator.power_stage_enabled && !off_s) {
      off_s = t;
      held_when_off = !b.joint.truth.brake_released[1];
    }
  };
  if (choice.word == kFault) {
    b.spoil = [](RawSensors& raw) { raw.bus_voltage_adc = 9000; };
  } else {
    b.command(choice.word);
  }
  b.run(1.0);
  EXPECT_EQ(b.status().state, choice.ends);
  EXPECT_LT(std::abs(b.joint.motor_v()), 0.01);
  const bool stays = choice.ends == operation_enabled || choice.ends == quick_stop_active;
  EXPECT_EQ(b.actuator.power_stage_enabled, stays);
  EXPECT_EQ(b.actuator.brake_release, stays);
  switch (choice.way) {
    case Way::slow_ramp:
      EXPECT_NEAR(steepest, b.config.reference.stop_deceleration_rad_s2, 1e-3);
      break;
    case Way::quick_ramp:
      EXPECT_NEAR(steepest, b.config.reference.quick_stop_deceleration_rad_s2, 1e-3);
      break;
    case Way::at_once:
      ASSERT_TRUE(brake_s && off_s);
      EXPECT_LT(*brake_s, 0.004) << "the brake waits for a ramp";
      EXPECT_TRUE(held_when_off) << "the joint would fall";
      EXPECT_GE(*off_s - *brake_s, b.config.brake.engage.seconds());
      break;
    case Way::torque_off:
      ASSERT_TRUE(brake_s && off_s);
      EXPECT_LT(*off_s, 0.006);
      EXPECT_LT(*brake_s, 0.006);
      break;
  }
  if (!stays && choice.way != Way::torque_off) {
    EXPECT_TRUE(held_when_off);
  }
}

INSTANTIATE_TEST_SUITE_P(CiA402, OptionCode, testing::ValuesIn(kChoices),
                         [](const auto& choice) { return std::string(choice.param.name); });

TEST(Stops, AQuickStopDoesNotWaitForAHaltThatIsGentler) {
  JointSetup setup;
  setup.joint = 1;
  PlantBench b(setup);
  b.run(0.01);
  b.write(0x605D, 0, 1, 2);
  ASSERT_TRUE(b.enable());
  ASSERT_TRUE(b.follow_here());
  const double start = b.seconds_now();
  const double here = double{b.status().reference_position_rad};
  b.trajectory = [=](double t) {
    const double x = 3.2 * (t - start);
    return MotionState{static_cast<float>(here + 0.15 * (1.0 - std::cos(x))), static_cast<float>(0.48 * std::sin(x)),
                       static_cast<float>(1.536 * std::cos(x))};
  };
  b.run(0.5);
  b.command(0x10F);
  b.run(0.006);
  EXPECT_NEAR(b.status().reference_acceleration_rad_s2, -b.config.reference.stop_deceleration_rad_s2, 1e-3);
  b.command(0x10B);
  b.run(0.004);
  EXPECT_NEAR(b.status().reference_acceleration_rad_s2, -b.config.reference.quick_stop_deceleration_rad_s2, 1e-3);
}

}  // namespace
}  // namespace mrr::fw
