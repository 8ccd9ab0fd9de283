// Room: module_fw/targets/cortex_m. The bare-metal shell: an interrupt every control period, which steps the module.
// May touch module_fw, can_protocol. No heap, no operating system.
#include <cstdint>
#include <span>

#include "module_fw/module.h"
#include "module_fw/targets/cortex_m/board.h"
#include "module_fw/targets/cortex_m/joint_table.h"

namespace {

using namespace mrr;

constexpr std::size_t kReceiveCapacity = 32;

fw::Module module(fw::kJointTable);
can::TransmitQueue transmit_queue;
StaticVector<can::ReceivedFrame, kReceiveCapacity> received;
Time now;

fw::FlashStore& parameter_store() {
  static fw::FlashStore store(fw::board::parameter_flash());
  return store;
}

volatile std::uint32_t& reg(std::uintptr_t address) { return *reinterpret_cast<volatile std::uint32_t*>(address); }

void start_tick(std::uint32_t core_clock_hz) {
  constexpr std::uintptr_t kControl = 0xE000E010U;
  constexpr std::uintptr_t kReload = 0xE000E014U;
  constexpr std::uintptr_t kValue = 0xE000E018U;
  const auto tick_us = static_cast<std::uint32_t>(fw::kJointTable.tick / microseconds(1));
  reg(kReload) = core_clock_hz / 1'000'000U * tick_us - 1U;
  reg(kValue) = 0;
  reg(kControl) = 7;  // core clock, interrupt, on
}

}  // namespace

extern "C" void SysTick_Handler() {
  now += fw::kJointTable.tick;
  received.clear();
  can::ReceivedFrame frame;
  while (!received.full() && fw::board::receive(frame)) static_cast<void>(received.push_back(frame));
  transmit_queue.clear();
  fw::ActuatorCommand actuator;
  module.step(now, fw::board::read_sensors(), std::span<const can::ReceivedFrame>(received.data(), received.size()),
              actuator, transmit_queue);
  fw::board::actuate(actuator);
  for (const can::Frame& f : transmit_queue) fw::board::transmit(f);
}

int main() {
  const std::uint32_t core_clock_hz = fw::board::start();
  module.load_parameters(parameter_store());
  start_tick(core_clock_hz);
  for (;;) asm volatile("wfi");
}
