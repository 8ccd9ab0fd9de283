// Under gravity the joint never drops: on the way up, on the way down, when its supervisor vanishes, when the power
// stage does.
#include <gtest/gtest.h>

#include "tests/bench/module/plant_joint.h"

namespace mrr::fw {
namespace {

using test::JointSetup;
using test::PlantBench;

constexpr double kDrop = 2e-3;  // rad

/// Stretched out: 13.7 Nm of gravity on joint 2.
JointSetup stretched() {
  JointSetup setup;
  setup.joint = 1;
  setup.pose_rad = {0.0, 0.05, 0.0};
  return setup;
}

/// Watches the link from its construction on.
struct Watch {
  explicit Watch(PlantBench& b) : from(b.joint.link_q()) {
    b.each_tick = [this, &b](const ModuleStatus&) {
      worst = std::max(worst, std::abs(b.joint.link_q() - from));
      if (b.actuator.brake_release && !b.actuator.power_stage_enabled) order = false;
      if (b.joint.truth.brake_released[1] && !b.actuator.power_stage_enabled) held = false;
    };
  }
  double from;
  double worst = 0.0;
  bool order = true;  ///< never released without power
  bool held = true;   ///< never without power before the brake holds
};

TEST(Brake, OpensUnderTorqueAndTheJointStays) {
  PlantBench b(stretched());
  Watch w(b);
  ASSERT_TRUE(b.enable());
  b.run(0.5);
  EXPECT_GT(std::abs(b.joint.motor_torque_nm()), 8.0) << "the torque must carry the arm";
  EXPECT_LT(w.worst, kDrop);
  EXPECT_TRUE(w.order && w.held);
}

TEST(Brake, ClosesBeforeTheTorqueGoes) {
  for (const std::uint16_t word : std::array<std::uint16_t, 4>{0x07, 0x06, 0x00, 0x02}) {
    PlantBench b(stretched());
    ASSERT_TRUE(b.enable());
    ASSERT_TRUE(b.follow_here());
    b.run(0.3);
    Watch w(b);
    if (word == 0x02) b.write(0x605A, 0, 2, 2);  // quick stop, then disabled
    b.command(word);
    b.run(1.0);
    EXPECT_FALSE(b.actuator.power_stage_enabled) << word;
    EXPECT_LT(w.worst, kDrop) << word;
    EXPECT_TRUE(w.order && w.held) << word;
  }
}

TEST(Brake, HoldsWhenTheSupervisorVanishes) {
  for (const bool sync_too : {false, true}) {
    PlantBench b(stretched());
    ASSERT_TRUE(b.enable());
    ASSERT_TRUE(b.follow_here());
    b.receive(can::heartbeat_frame(1, can::NmtState::operational));
    b.run(0.3);
    Watch w(b);
    b.trajectory = nullptr;
    b.sync = !sync_too;
    b.run(1.5);
    EXPECT_EQ(b.status().state, DriveState::fault);
    EXPECT_FALSE(b.actuator.power_stage_enabled);
    EXPECT_TRUE(w.order && w.held);
    EXPECT_LT(w.worst, kDrop) << (sync_too ? "with SYNC" : "heartbeat alone");
  }
}

TEST(Brake, CatchesTheJointWhenThePowerStageVanishes) {
  PlantBench b(stretched());
  ASSERT_TRUE(b.enable());
  ASSERT_TRUE(b.follow_here());
  b.run(0.3);
  Watch w(b);
  b.spoil = [](RawSensors& raw) { raw.inputs |= kInputPowerStageFault; };
  b.run(1.0);
  EXPECT_EQ(b.status().state, DriveState::fault);
  EXPECT_LT(w.worst, kDrop);
}

}  // namespace
}  // namespace mrr::fw
