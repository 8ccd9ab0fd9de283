// Room: module_fw/faults. Sensors and power stage against each other: what cannot be true together. May touch
// module_fw/sensing, config.h and the table of faults. Freestanding.
#pragma once

#include <cstdint>

#include "module_fw/config.h"
#include "module_fw/faults/fault_monitor.h"
#include "module_fw/sensing/sensing.h"

namespace mrr::fw {

class SensorWatch {
 public:
  explicit SensorWatch(const ModuleConfig& config) noexcept;
  /// New friction and current limit.
  void configure(const ModuleConfig& config) noexcept;

  struct Inputs {
    bool free = false;         ///< brake open, power stage on: torque moves the joint
    float commanded_a = 0.0F;  ///< of the last tick
    float model_nm = 0.0F;     ///< what the joint carries by the supervisor's model, when the sensor does not say
    bool model_known = false;
  };
  /// One tick: tells `faults` what is found.
  void update(const RawSensors& raw, const Sensing& sensing, const Inputs& in, FaultMonitor& faults) noexcept;

  /// The torque reading may be used.
  [[nodiscard]] bool torque_trusted() const noexcept { return torque_trouble_ == can::Fault::none && !torque_at_end_; }
  /// Why not: torque_sensor_range, _stuck or _drift; none, or not for long enough to be a fault.
  [[nodiscard]] can::Fault torque_trouble() const noexcept { return torque_trouble_; }
  /// Faults were reset: all is believed again.
  void reset() noexcept;

 private:
  void watch_encoder(const RawSensors& raw, const Sensing& sensing, const Inputs& in, FaultMonitor& faults) noexcept;
  void watch_current(const Sensing& sensing, const Inputs& in, FaultMonitor& faults) noexcept;
  void watch_torque(const RawSensors& raw, const Sensing& sensing, const Inputs& in) noexcept;

  float nm_per_a_positive_;
  float nm_per_a_negative_;
  float over_current_a_ = 0.0F;
  float mismatch_a_ = 0.0F;
  float static_nm_ = 0.0F;
  float viscous_nm_s_rad_ = 0.0F;
  float explained_at_rest_nm_ = 0.0F;  ///< how far motor torque and sensor may differ, whatever the velocity
  float radians_s_per_count_;
  std::int16_t torque_end_;
  float drift_nm_;
  float drift_filter_;
  bool torque_sensor_;

  std::int32_t last_count_ = 0;
  float last_step_rad_s_ = 0.0F;  ///< before the count froze
  std::uint16_t frozen_ticks_ = 0;
  std::uint16_t pushed_ticks_ = 0;
  std::uint16_t stuck_limit_ticks_;
  std::uint32_t implausible_ = 0;
  std::uint16_t jumps_ = 0;  ///< leaky

  float motor_torque_nm_ = 0.0F;
  std::int16_t last_torque_ = 0;
  Persistence at_end_, frozen_, drifting_;
  bool torque_at_end_ = false;
  float torque_froze_at_nm_ = 0.0F;  ///< motor torque when the reading froze
  float disagreement_nm_ = 0.0F;     ///< motor torque less sensor, slow
  float effort_nm_ = 0.0F;           ///< |motor torque|, slow
  can::Fault torque_trouble_ = can::Fault::none;
};

}  // namespace mrr::fw
