// What a strict reading of CiA 402 asks of a module, beyond the walk through its states.
#include <gtest/gtest.h>

#include "tests/unit/module/module_bench.h"

namespace mrr::fw {
namespace {

using Bench = test::ModuleBench;

Bench make_bench() {
  ModuleConfig config = test::module_config(test::hammer_joint());
  config.test_faults = true;
  return Bench(test::hammer_joint(), config);
}

int state_bits(const Bench& b) { return b.module.objects().statusword & 0x6F; }
constexpr int kReady = 0x21;
constexpr int kOn = 0x23;
constexpr int kEnabled = 0x27;
int fault_or_disabled(const Bench& b) { return b.module.objects().statusword & 0x4F; }
constexpr int kDisabled = 0x40;
constexpr int kFault = 0x08;

TEST(Cia402, EachControlWordHasItsTurnHoweverCloseTheyCome) {
  Bench b = make_bench();
  b.run(0.05);
  b.receive(can::nmt_frame(can::NmtCommand::start, b.config.node_id));
  b.run(0.1);
  for (const int word : {0x06, 0x07, 0x0F}) b.command(static_cast<std::uint16_t>(word));
  b.tick();
  EXPECT_EQ(state_bits(b), kEnabled);
  for (const int word : {0x00, 0x06}) b.command(static_cast<std::uint16_t>(word));
  b.tick();
  EXPECT_EQ(state_bits(b), kReady);
}

TEST(Cia402, AFaultResetIsAnEdgeEvenWithinATick) {
  Bench b = make_bench();
  ASSERT_TRUE(b.enable());
  b.write(0x2F00, 0, 0x5400, 2);
  b.run(0.2);
  ASSERT_EQ(fault_or_disabled(b), kFault);
  b.command(0x80);
  b.tick();
  ASSERT_EQ(fault_or_disabled(b), kDisabled);
  b.write(0x2F00, 0, 0x5400, 2);
  b.run(0.2);
  ASSERT_EQ(fault_or_disabled(b), kFault) << "bit 7 that stands is no edge";
  for (const int word : {0x00, 0x80}) b.command(static_cast<std::uint16_t>(word));
  b.tick();
  EXPECT_EQ(fault_or_disabled(b), kDisabled);
}

TEST(Cia402, StartingTheNodeDoesNotEnableTheJointByAnOldCommand) {
  Bench b = make_bench();
  ASSERT_TRUE(b.enable());
  b.receive(can::nmt_frame(can::NmtCommand::enter_pre_operational, b.config.node_id));
  b.run(0.5);
  EXPECT_NE(state_bits(b), kEnabled);
  b.write(0x6040, 0, 0x0F, 2);
  b.run(0.05);
  b.receive(can::nmt_frame(can::NmtCommand::start, b.config.node_id));
  b.run(0.3);
  EXPECT_EQ(state_bits(b), kOn);
  EXPECT_FALSE(b.status().brake_released);
  b.command(0x0F);
  b.tick();
  EXPECT_EQ(state_bits(b), kEnabled);
}

TEST(Cia402, ResetNodeStartsAnewAndAFaultThatIsStillThereIsToldAgain) {
  Bench b = make_bench();
  b.sync = false;  // its counter would be an error after a reset
  b.run(0.05);
  b.write(0x2F00, 0, 0x5400, 2);
  b.run(0.2);
  ASSERT_EQ(fault_or_disabled(b), kFault);
  b.receive(can::nmt_frame(can::NmtCommand::reset_communication, b.config.node_id));
  b.run(0.05);
  EXPECT_EQ(fault_or_disabled(b), kFault) << "communication alone";
  EXPECT_NE(b.module.objects().error_register, 0);
  b.receive(can::nmt_frame(can::NmtCommand::reset_node, b.config.node_id));
  b.run(0.05);
  EXPECT_EQ(fault_or_disabled(b), kDisabled);
  EXPECT_EQ(b.module.objects().error_register, 0);
  EXPECT_EQ(b.module.objects().error_code, 0);
  EXPECT_EQ(b.module.objects().error_or_limit, 0);

  b.spoil = [](RawSensors& raw) { raw.inputs |= kInputPowerStageFault; };
  b.run(0.2);
  ASSERT_EQ(fault_or_disabled(b), kFault);
  b.receive(can::nmt_frame(can::NmtCommand::reset_node, b.config.node_id));
  b.run(0.05);
  EXPECT_EQ(fault_or_disabled(b), kFault);
  EXPECT_EQ(b.module.objects().error_code, 0x5400);
  EXPECT_NE(b.module.objects().error_register, 0);
  EXPECT_EQ(b.module.objects().error_history_count, 1);
}

TEST(Cia402, InterpolationTimeIsTheKnotPeriodInAnotherForm) {
  Bench b = make_bench();
  b.run(0.01);
  const auto& od = b.module.objects();
  EXPECT_EQ(od.interpolation_time_value, 4);
  EXPECT_EQ(od.interpolation_time_exponent, -3);
  b.write(0x60C2, 1, 25, 1);
  EXPECT_EQ(b.module.objects().knot_period_us, 25'000U);
  b.write(0x60C2, 2, 0xFC, 1);  // -4
  EXPECT_EQ(b.module.objects().knot_period_us, 2'500U);
  b.write(0x60C2, 1, 2, 1);  // 200 us cannot be
  EXPECT_EQ(b.module.objects().knot_period_us, 2'500U);
  b.write(0x60C2, 2, 0xFD, 1);  // -3
  EXPECT_EQ(b.module.objects().knot_period_us, 2'000U);
  b.write(0x2003, 0, 10'000, 4);
  EXPECT_EQ(b.module.objects().interpolation_time_value, 10);
  EXPECT_EQ(b.module.objects().interpolation_time_exponent, -3);

  // The loop locks to it.
  b.write(0x60C2, 1, 8, 1);
  b.sync_every_ticks = 8;
  ASSERT_TRUE(b.enable());
  EXPECT_TRUE(b.follow_here());
  b.write(0x60C2, 1, 4, 1);
  EXPECT_EQ(b.module.objects().knot_period_us, 8'000U) << "not while the joint is led";
}

TEST(Cia402, AModuleWithoutMemorySaysThatItDoesNotStore) {
  Bench b = make_bench();
  b.run(0.01);
  EXPECT_EQ(b.module.objects().store_all, 0U);
  EXPECT_EQ(b.module.objects().restore_all, 0U);
}

}  // namespace
}  // namespace mrr::fw
