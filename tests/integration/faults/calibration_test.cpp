// Torque zero, brake test and limit recovery on a joint of the emulated arm under gravity.
#include <gtest/gtest.h>

#include "tests/bench/module/plant_joint.h"

namespace mrr::fw {
namespace {

using test::JointSetup;
using test::PlantBench;

JointSetup joint_2(std::function<void(ModuleConfig&)> config = nullptr,
                   std::function<void(RobotDescription&, sim::PlantDescription&)> plant = nullptr) {
  JointSetup setup;
  setup.joint = 1;
  setup.config = std::move(config);
  setup.plant = std::move(plant);
  return setup;
}
std::uint32_t real(float x) { return std::bit_cast<std::uint32_t>(x); }

/// Starts the action of `mode` and waits until it has ended.
ActionState run_action(PlantBench& b, std::int8_t mode) {
  b.set_mode(mode);
  b.run(0.01);
  b.command(0x1F);
  b.run(0.005);
  b.run_until([&] { return b.module.objects().action_state != static_cast<int>(ActionState::running); }, 15.0);
  return static_cast<ActionState>(b.module.objects().action_state);
}
bool done(const PlantBench& b) {
  const unsigned word = b.module.objects().statusword;
  return (word & kStatusFollowing) != 0 && (word & kStatusFollowingError) == 0;
}
bool failed(const PlantBench& b) {
  const unsigned word = b.module.objects().statusword;
  return (word & kStatusFollowing) == 0 && (word & kStatusFollowingError) != 0;
}

TEST(TorqueZero, FindsTheOffsetOfTheSensor) {
  PlantBench b(joint_2(nullptr, [](RobotDescription&, sim::PlantDescription& p) {
    p.joints[1].sensor.torque_offset_nm = 2.0;
    p.joints[1].sensor.torque_drift_nm = 0.0;
  }));
  ASSERT_TRUE(b.enable());
  b.run(0.3);
  // What it really carries is known here.
  double sum = 0.0;
  int n = 0;
  b.each_tick = [&](const ModuleStatus&) {
    sum += b.joint.truth.transmission_torque_nm[1];
    ++n;
  };
  b.run(1.0);
  b.each_tick = nullptr;
  b.write(0x2180, 5, real(static_cast<float>(sum / n)), 4);
  EXPECT_EQ(run_action(b, -3), ActionState::done);
  EXPECT_TRUE(done(b));
  EXPECT_NEAR(b.module.objects().torque_sensor_offset_nm, 2.0, 0.05);
  b.run(0.5);
  EXPECT_NEAR(b.status().joint_torque_nm, b.joint.truth.transmission_torque_nm[1], 0.4);
  EXPECT_NEAR(b.status().velocity_rad_s, 0.0, 0.01);
}

TEST(TorqueZero, RefusesAnOffsetThatIsTooLargeAndAJointThatIsShaken) {
  PlantBench b(joint_2());
  ASSERT_TRUE(b.enable());
  b.run(0.3);
  EXPECT_EQ(run_action(b, -3), ActionState::torque_cap) << "it carries 12 Nm and was told 0";
  EXPECT_TRUE(failed(b));
  EXPECT_EQ(b.module.objects().torque_sensor_offset_nm, 0.0F);
  b.command(0x0F);
  b.run(0.1);
  b.each_tick = [&](const ModuleStatus&) { b.joint.external_nm = 6.0 * std::sin(30.0 * b.seconds_now()); };
  EXPECT_EQ(run_action(b, -3), ActionState::sensor);
}

TEST(BrakeTest, ABrakeThatHoldsPassesAndTheJointDoesNotDrop) {
  PlantBench b(joint_2());
  ASSERT_TRUE(b.enable());
  b.run(0.3);
  const double link = b.joint.link_q();
  EXPECT_EQ(run_action(b, -4), ActionState::done);
  EXPECT_TRUE(done(b));
  EXPECT_LT(b.module.objects().brake_test_slip_rad, 0.002F);
  b.run(0.3);
  EXPECT_TRUE(b.status().brake_released);
  EXPECT_NEAR(b.joint.link_q(), link, 2e-3);
  EXPECT_EQ(b.status().fault, can::Emergency::none);
}

TEST(BrakeTest, ABrakeThatSlipsFailsAndTheTorqueHoldsTheJoint) {
  PlantBench b(
      joint_2(nullptr, [](RobotDescription&, sim::PlantDescription& p) { p.joints[1].drive.brake_torque_nm = 8.0; }));
  ASSERT_TRUE(b.enable());
  b.run(0.3);
  const double link = b.joint.link_q();
  EXPECT_EQ(run_action(b, -4), ActionState::slipped);
  EXPECT_TRUE(failed(b));
  EXPECT_GT(b.module.objects().brake_test_slip_rad, 0.005F);
  b.run(0.5);
  EXPECT_EQ(b.status().state, DriveState::operation_enabled);
  EXPECT_NEAR(b.joint.link_q(), link, 0.05);
  EXPECT_NEAR(b.status().velocity_rad_s, 0.0, 0.01);
}

TEST(BrakeTest, HaltEndsItAndTheBrakeOpensUnderTorque) {
  PlantBench b(joint_2());
  ASSERT_TRUE(b.enable());
  b.run(0.3);
  const double link = b.joint.link_q();
  b.set_mode(-4);
  b.run(0.01);
  b.command(0x1F);
  b.run(0.55);
  ASSERT_FALSE(b.actuator.brake_release);
  b.command(0x11F);
  b.run(0.5);
  EXPECT_EQ(b.module.objects().action_state, static_cast<int>(ActionState::interrupted));
  EXPECT_TRUE(b.status().brake_released);
  EXPECT_NEAR(b.joint.link_q(), link, 4e-3);
}

TEST(LimitRecovery, BringsTheJointBackIntoItsLimits) {
  for (const double side : {-1.0, 1.0}) {
    PlantBench b(joint_2([side](ModuleConfig& c) {
      // It stands at 0.5 rad, 0.15 rad outside.
      (side > 0 ? c.limits.upper_rad : c.limits.lower_rad) = static_cast<float>(0.5 - side * 0.15);
    }));
    ASSERT_TRUE(b.enable());
    EXPECT_EQ(run_action(b, -5), ActionState::done);
    b.run(0.3);
    EXPECT_TRUE(done(b));
    EXPECT_NEAR(b.status().position_rad, 0.5 - side * 0.17, 0.005);
    EXPECT_NEAR(b.status().velocity_rad_s, 0.0, 0.01);
    b.command(0x0F);
    b.set_mode(8);
    b.run(0.02);
    EXPECT_TRUE(b.follow_here());
  }
}

TEST(LimitRecovery, HasCapsOnTravelTorqueAndTime) {
  const auto outside = [](ModuleConfig& c) { c.limits.upper_rad = 0.2F; };
  {
    PlantBench b(joint_2(outside));
    ASSERT_TRUE(b.enable());
    b.write(0x2180, 11, real(0.1F), 4);
    EXPECT_EQ(run_action(b, -5), ActionState::travel_cap);
    b.run(0.2);
    EXPECT_NEAR(b.status().position_rad, 0.4, 0.01);
  }
  {
    PlantBench b(joint_2(outside));
    ASSERT_TRUE(b.enable());
    b.write(0x2180, 12, real(3.0F), 4);  // less than friction
    EXPECT_EQ(run_action(b, -5), ActionState::torque_cap);
    EXPECT_NEAR(b.status().position_rad, 0.5, 0.02);
  }
  {
    PlantBench b(joint_2(outside));
    ASSERT_TRUE(b.enable());
    b.write(0x2180, 2, 500, 4);
    EXPECT_EQ(run_action(b, -5), ActionState::timed_out);
  }
  PlantBench b(joint_2());
  ASSERT_TRUE(b.enable());
  EXPECT_EQ(run_action(b, -5), ActionState::nothing_to_do);
  EXPECT_TRUE(failed(b));
}

/// Where joint 2 thinks it is, less where it is, after homing with a switch that is off by `switch_error_rad`.
double error_after_homing(bool index, double switch_error_rad) {
  PlantBench b(joint_2(
      [index](ModuleConfig& c) {
        c.sensing.encoder_absolute = false;
        c.homing.switch_position_rad = 0.45F;
        c.homing.index = index;
        c.homing.index_position_rad = 0.40F;
      },
      [switch_error_rad](RobotDescription& r, sim::PlantDescription& p) {
        r.joints[1].homing.switch_position_rad = 0.45;
        p.joints[1].sensor.home_switch_offset_rad = switch_error_rad;
      }));
  EXPECT_TRUE(b.enable());
  b.set_mode(6);
  b.run(0.01);
  b.command(0x1F);
  EXPECT_TRUE(b.run_until([&] { return (b.module.objects().statusword & kStatusFollowing) != 0; }, 20.0));
  b.run(0.3);
  EXPECT_TRUE(b.status().homed);
  return double{b.status().position_rad} - b.joint.motor_q();
}

TEST(Homing, TheIndexPulseDoesNotCareWhereInItsTurnTheSwitchIs) {
  const double switch_moves = error_after_homing(false, 0.003) - error_after_homing(false, 0.0);
  // The switch sits on the link, which rings on its spring as it passes: some of the 3 mrad is lost in that.
  EXPECT_GT(std::abs(switch_moves), 0.002) << "the switch alone: its error is the joint's";
  const double index_moves = error_after_homing(true, 0.003) - error_after_homing(true, 0.0);
  EXPECT_NEAR(index_moves, 0.0, 5e-5);
}

TEST(HomingCaps, EndASearchThatGoesTooFarOrTooHard) {
  for (const bool torque : {false, true}) {
    PlantBench b(joint_2([torque](ModuleConfig& c) {
      c.homing.max_travel_rad = torque ? 0.0F : 0.1F;
      c.homing.max_torque_nm = torque ? 2.0F : 0.0F;  // less than friction
    }));
    ASSERT_TRUE(b.enable());
    b.set_mode(6);
    b.run(0.01);
    b.command(0x1F);
    ASSERT_TRUE(b.run_until([&] { return (b.module.objects().statusword & kStatusFollowingError) != 0; }, 2.0));
    b.run(0.2);
    EXPECT_EQ(b.module.objects().error_code, static_cast<int>(can::Emergency::homing_failed));
    EXPECT_NEAR(b.status().position_rad, torque ? 0.5 : 0.6, 0.03);
    EXPECT_NEAR(b.status().velocity_rad_s, 0.0, 0.01);
  }
}

}  // namespace
}  // namespace mrr::fw
