// Room: module_fw/sensing. Raw readings -> SI with validity. A reading that is not fresh is not a reading.
// May touch module_fw/config.h, joint_io.h. Freestanding.
#pragma once

#include <cstdint>

#include "module_fw/config.h"
#include "module_fw/control/scalar_math.h"
#include "module_fw/joint_io.h"

namespace mrr::fw {

/// A value which may be unknown.
struct Reading {
  float value = 0.0F;
  bool valid = false;
};

/// Position and velocity from counts: second-order tracking observer, double pole at exp(-bandwidth dt).
/// The counts stay integer, so a tenth turn at the motor counts the same at zero and far away.
class VelocityObserver {
 public:
  VelocityObserver(float bandwidth_rad_s, float dt_s) noexcept;
  void start(std::int32_t count) noexcept;
  /// A new count.
  void update(std::int32_t count) noexcept;
  /// No new count this tick: carry on at the last velocity.
  void coast() noexcept;
  /// Filtered velocity, counts per second.
  [[nodiscard]] float velocity_counts_s() const noexcept { return velocity_ * inverse_dt_; }

 private:
  float inverse_dt_;
  float position_gain_;
  float velocity_gain_;
  std::int32_t count_ = 0;
  float residual_ = 0.0F;  ///< observed position - count_
  float velocity_ = 0.0F;  ///< counts per tick
};

class Sensing {
 public:
  Sensing(const SensingConfig& config, const DriveConfig& drive, float dt_s) noexcept;

  void update(Time now, const RawSensors& raw) noexcept;

  /// Joint position (motor side through the gear), rad. Only meaningful while position_valid().
  [[nodiscard]] float position_rad() const noexcept { return position_rad_; }
  [[nodiscard]] float velocity_rad_s() const noexcept { return velocity_rad_s_; }
  [[nodiscard]] bool position_valid() const noexcept { return position_valid_; }
  /// Torque the transmission gives the link, Nm.
  [[nodiscard]] const Reading& joint_torque_nm() const noexcept { return joint_torque_; }
  /// The same, meaningful while that is valid: what the joint carries now, with the lag of a slow sensor taken out.
  /// Load that is carried late pumps the link on its spring.
  [[nodiscard]] float carried_torque_nm() const noexcept {
    return sharpened_ ? carried_torque_nm_ : joint_torque_.value;
  }
  [[nodiscard]] const Reading& current_a() const noexcept { return current_; }
  [[nodiscard]] const Reading& winding_c() const noexcept { return winding_; }
  [[nodiscard]] const Reading& drive_c() const noexcept { return drive_temperature_; }
  [[nodiscard]] const Reading& bus_voltage_v() const noexcept { return bus_voltage_; }
  /// InputBit
  [[nodiscard]] std::uint8_t inputs() const noexcept { return inputs_; }
  [[nodiscard]] bool input(InputBit bit) const noexcept { return (inputs_ & bit) != 0; }
  /// Every sensor was seen at least once since start.
  [[nodiscard]] bool complete() const noexcept { return complete_; }
  /// Readings thrown away because no joint moves like that.
  [[nodiscard]] std::uint32_t implausible_counts() const noexcept { return implausible_; }

  /// Subtracted from the torque sensor, Nm.
  void set_torque_offset(float offset_nm) noexcept { torque_offset_nm_ = offset_nm; }
  /// In this tick the torque reading is not to be used.
  void distrust_torque() noexcept { joint_torque_.valid = false; }

  /// Homing: from now on the joint reads `position_rad` here. Returns the change of the reading.
  float set_position(float position_rad) noexcept;

 private:
  void sharpen_torque(const RawSensors& raw) noexcept;

  const SensingConfig config_;
  VelocityObserver observer_;
  float radians_per_count_;
  float torque_scale_;
  float torque_offset_nm_ = 0.0F;
  bool sharpened_;      ///< the sensor is slower than what is carried may be
  float torque_pole_;   ///< of the sensor, per tick
  float carried_pole_;  ///< of what is carried
  float carried_gain_;
  float carried_torque_nm_ = 0.0F;
  float current_scale_;
  float max_counts_per_tick_;
  float dt_s_;

  std::int32_t zero_count_;
  std::int32_t last_count_ = 0;
  bool started_ = false;
  bool complete_ = false;
  std::int32_t ticks_since_count_ = 0;
  std::uint32_t implausible_ = 0;
  float position_rad_ = 0.0F;
  float velocity_rad_s_ = 0.0F;
  float fine_offset_rad_ = 0.0F;
  bool position_valid_ = false;
  Reading joint_torque_, current_, winding_, drive_temperature_, bus_voltage_;
  Time count_at_, torque_at_, current_at_, temperature_at_, voltage_at_;
  std::uint8_t seen_ = 0;
  std::uint8_t inputs_ = 0;
};

}  // namespace mrr::fw
