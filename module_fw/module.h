// Room: module_fw. One joint's firmware as an object that is stepped: communication -> decision -> action -> execution.
// May touch common/core and can_protocol. Freestanding: no heap, no exceptions, no clock, fixed memory.
#pragma once

#include <cstdint>
#include <span>

#include "can_protocol/frame.h"
#include "common/core/time.h"
#include "module_fw/config.h"
#include "module_fw/joint_io.h"
#include "module_fw/status.h"

namespace mrr::fw {

class Module {
 public:
  explicit Module(const ModuleConfig& config) noexcept;

  /// One control tick. Call it every `config.tick` of the module's own clock.
  /// @param now       own clock, increasing
  /// @param sensors   raw readings; only those whose fresh bit is set are used
  /// @param received  frames since the last tick, in order, with arrival times on the same clock as `now`
  /// @param actuator  out: what the power stage shall do until the next tick
  /// @param tx        out: frames to send are appended, oldest first
  void step(Time now, const RawSensors& sensors, std::span<const can::ReceivedFrame> received,
            ActuatorCommand& actuator, can::TransmitQueue& tx) noexcept;

  /// For tests and telemetry only: nothing on the robot's bus depends on it.
  [[nodiscard]] const ModuleStatus& status() const noexcept { return status_; }

 private:
  ModuleConfig config_;
  ModuleStatus status_;
};

}  // namespace mrr::fw
