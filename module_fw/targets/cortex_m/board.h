// Room: module_fw/targets/cortex_m. What a board gives the firmware: sensors, a power stage, a CAN controller, a tick.
// May touch module_fw/joint_io.h, flash_store.h, can_protocol/frame.h. A board is one source file that defines these
// functions.
#pragma once

#include <cstdint>

#include "can_protocol/frame.h"
#include "module_fw/joint_io.h"
#include "module_fw/targets/cortex_m/flash_store.h"

namespace mrr::fw::board {

/// Core clock, Hz, after start().
[[nodiscard]] std::uint32_t start() noexcept;
[[nodiscard]] RawSensors read_sensors() noexcept;
void actuate(const ActuatorCommand& command) noexcept;
/// Takes the oldest received frame. False: there is none.
[[nodiscard]] bool receive(can::ReceivedFrame& frame) noexcept;
/// False: the controller has no room; the frame is dropped, nothing stale piles up.
bool transmit(const can::Frame& frame) noexcept;
/// Where 1010h keeps the parameters.
[[nodiscard]] Flash& parameter_flash() noexcept;

}  // namespace mrr::fw::board
