// Under gravity the joint never drops: on the way up, on the way down, when its supervisor vanishes, when the power
// stage does.
#include <gtest/gtest.h>

#include "common/core/random.h"
#include "tests/bench/module/plant_joint.h"
#include "tests/unit/module/seeds.h"

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

// At any instant of opening, holding and closing: power stage gone, supervisor gone, or the node stopped.
TEST(Brake, HoldsTheJointWheneverSomethingVanishes) {
  for (const std::uint64_t seed : mrr::test::seeds(24)) {
    Random random(seed);
    JointSetup setup = stretched();
    setup.seed = seed;
    PlantBench b(setup);
    Watch w(b);
    b.run(0.01);
    b.write(0x1019, 0, 240, 1);
    b.receive(can::nmt_frame(can::NmtCommand::start, b.config.node_id));
    b.run(0.15);
    b.receive(can::heartbeat_frame(1, can::NmtState::operational));
    b.command(0x06);
    b.run(0.005);
    b.command(0x07);
    b.run(0.005);
    b.command(0x0F);
    const bool closing = random.uniform() < 0.3;
    if (closing) {
      b.run(0.4);
      b.command(0x07);
    }
    // Torque is confirmed within 10 ms or so, the brake opens within 50, closes within 30.
    b.run(random.uniform(0.0, closing ? 0.08 : 0.12) + (random.uniform() < 0.2 ? 0.3 : 0.0));
    const auto what = random.below(3);
    if (what == 0) b.spoil = [](RawSensors& raw) { raw.inputs |= kInputPowerStageFault; };
    if (what == 1) b.sync = false;
    if (what == 2) b.receive(can::nmt_frame(can::NmtCommand::stop, b.config.node_id));
    b.run(1.2);
    EXPECT_FALSE(b.actuator.power_stage_enabled) << "seed " << seed;
    EXPECT_FALSE(b.joint.truth.brake_released[1]) << "seed " << seed;
    EXPECT_LT(w.worst, kDrop) << "seed " << seed << ", what " << what << ", closing " << closing;
    EXPECT_TRUE(w.order) << "seed " << seed;
    EXPECT_TRUE(w.held || what == 0) << "seed " << seed;
  }
}

}  // namespace
}  // namespace mrr::fw
