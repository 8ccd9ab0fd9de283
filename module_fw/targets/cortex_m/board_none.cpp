// Room: module_fw/targets/cortex_m. A bare core without peripherals: every sensor is silent, the bus is not connected.
// A module on it stays without torque, brake engaged. It exists so that the image links and its size and speed can be
// measured.
#include "module_fw/targets/cortex_m/board.h"

namespace mrr::fw::board {

namespace {

constexpr std::uint32_t kClockHz = 170'000'000;
volatile std::int16_t duty;  // where a power stage's register would be
volatile bool stage_enabled;
volatile bool brake_release;

}  // namespace

std::uint32_t start() noexcept { return kClockHz; }

RawSensors read_sensors() noexcept { return {}; }

void actuate(const ActuatorCommand& command) noexcept {
  duty = command.current_duty;
  stage_enabled = command.power_stage_enabled;
  brake_release = command.brake_release;
}

bool receive(can::ReceivedFrame&) noexcept { return false; }

bool transmit(const can::Frame&) noexcept { return false; }

}  // namespace mrr::fw::board
