// A tick never touches the heap: operator new and malloc count while the guard is up.
#include <gtest/gtest.h>

#include <cstdlib>
#include <new>

#include "tests/unit/module/module_bench.h"

namespace {

bool guard_up = false;
int allocations = 0;

void* counted(std::size_t size) {
  if (guard_up) ++allocations;
  return std::malloc(size == 0 ? 1 : size);
}

}  // namespace

void* operator new(std::size_t size) { return counted(size); }
void* operator new[](std::size_t size) { return counted(size); }
void operator delete(void* p) noexcept { std::free(p); }
void operator delete[](void* p) noexcept { std::free(p); }
void operator delete(void* p, std::size_t) noexcept { std::free(p); }
void operator delete[](void* p, std::size_t) noexcept { std::free(p); }

namespace mrr::fw {
namespace {

TEST(ModuleHeap, TheGuardCounts) {
  guard_up = true;
  auto* p = new int(1);
  guard_up = false;
  delete p;
  EXPECT_EQ(allocations, 1);
  allocations = 0;
}

TEST(ModuleHeap, AStepNeverAllocates) {
  allocations = 0;
  auto c = test::module_config(test::hammer_joint());
  Module module(c);
  test::Joint joint(test::hammer_joint(), c, 1);
  std::array<can::ReceivedFrame, 8> frames{};
  std::uint16_t sequence = 0;
  std::uint8_t counter = 0;
  ActuatorCommand actuator;
  bool was_enabled = false;
  bool was_passive = false;
  bool was_faulted = false;
  for (int i = 0; i < 3000; ++i) {
    const Time now = Time{} + milliseconds(i);
    std::size_t n = 0;
    const auto add = [&](const can::Frame& f) { frames[n++] = {f, now}; };
    if (i == 5) add(can::nmt_frame(can::NmtCommand::start, c.node_id));
    if (i == 200) add(can::pack_rpdo1(c.node_id, {0x06, 8}));
    if (i == 210) add(can::pack_rpdo1(c.node_id, {0x0F, 8}));
    if (i == 1000) add(can::pack_rpdo4({0, 0, 0, can::selection_byte(1, can::SelectionAction::now)}));
    if (i % 4 == 0) {
      const auto here = *can::urad_from_rad(module.status().reference_position_rad);
      add(can::pack_rpdo2(c.node_id, {here, 0}));
      add(can::pack_rpdo3(c.node_id, {0, 0, ++sequence}));
      counter = static_cast<std::uint8_t>(counter % 240U + 1U);
      add(can::sync_frame(std::nullopt));
    }
    RawSensors raw = joint.sample();
    if (i > 2500) raw.fresh = 0;
    can::TransmitQueue tx;
    guard_up = true;
    module.step(now, raw, std::span<const can::ReceivedFrame>(frames.data(), n), actuator, tx);
    guard_up = false;
    joint.step(1e-3, actuator);
    was_enabled = was_enabled || module.status().following_knots;
    was_passive = was_passive || module.status().law == Law::passive;
    was_faulted = was_faulted || module.status().state == DriveState::fault;
  }
  EXPECT_EQ(allocations, 0);
  EXPECT_TRUE(was_enabled);
  EXPECT_TRUE(was_passive);
  EXPECT_TRUE(was_faulted);
}

}  // namespace
}  // namespace mrr::fw
