#include "module_fw/sensing/sensing.h"

namespace mrr::fw {

namespace {

constexpr float kAdcFullScale = 32767.0F;
// 200 Hz. A slower sensor's reading is sharpened to it; its noise grows by as much.
constexpr float kCarriedBandwidth = 1256.0F;

// Difference of free-running counters, right across the wrap.
constexpr std::int32_t count_difference(std::int32_t a, std::int32_t b) noexcept {
  return static_cast<std::int32_t>(static_cast<std::uint32_t>(a) - static_cast<std::uint32_t>(b));
}

}  // namespace

VelocityObserver::VelocityObserver(float bandwidth_rad_s, float dt_s) noexcept : inverse_dt_(1.0F / dt_s) {
  const float pole = exp_negative(bandwidth_rad_s * dt_s);
  position_gain_ = 1.0F - pole * pole;
  velocity_gain_ = (1.0F - pole) * (1.0F - pole);
}

void VelocityObserver::start(std::int32_t count) noexcept {
  count_ = count;
  residual_ = 0.0F;
  velocity_ = 0.0F;
}

void VelocityObserver::coast() noexcept { residual_ += velocity_; }

void VelocityObserver::update(std::int32_t count) noexcept {
  const float predicted = residual_ + velocity_ - static_cast<float>(count_difference(count, count_));
  count_ = count;
  residual_ = predicted - position_gain_ * predicted;
  velocity_ -= velocity_gain_ * predicted;
}

Sensing::Sensing(const SensingConfig& config, const DriveConfig& drive, float dt_s) noexcept
    : config_(config),
      observer_(config.velocity_bandwidth_rad_s, dt_s),
      radians_per_count_(2.0F * kPi / (static_cast<float>(config.encoder_counts_per_turn) * drive.gear_ratio)),
      torque_scale_(config.torque_full_scale_nm / kAdcFullScale),
      sharpened_(config.torque_bandwidth_rad_s > 0.0F && config.torque_bandwidth_rad_s < kCarriedBandwidth),
      torque_pole_(sharpened_ ? exp_negative(config.torque_bandwidth_rad_s * dt_s) : 0.0F),
      carried_pole_(exp_negative(kCarriedBandwidth * dt_s)),
      carried_gain_((1.0F - carried_pole_) / (1.0F - torque_pole_)),
      current_scale_(config.current_full_scale_a / kAdcFullScale),
      max_counts_per_tick_(config.max_plausible_velocity_rad_s * dt_s / radians_per_count_),
      dt_s_(dt_s),
      zero_count_(config.encoder_zero_count) {}

float Sensing::set_position(float position_rad) noexcept {
  const float change = position_rad - position_rad_;
  const std::int32_t counts = round_to_int(position_rad / radians_per_count_);
  zero_count_ = count_difference(last_count_, counts);
  fine_offset_rad_ = position_rad - static_cast<float>(counts) * radians_per_count_;
  position_rad_ = position_rad;
  return change;
}

// The inverse of the sensor's lag, followed by the lag that may be.
void Sensing::sharpen_torque(const RawSensors& raw) noexcept {
  const Reading& last = joint_torque_;
  const float now_nm = static_cast<float>(raw.torque_adc) * torque_scale_ - torque_offset_nm_;
  carried_torque_nm_ =
      last.valid ? carried_pole_ * carried_torque_nm_ + carried_gain_ * (now_nm - torque_pole_ * last.value) : now_nm;
}

void Sensing::update(Time now, const RawSensors& raw) noexcept {
  inputs_ = raw.inputs;
  const std::uint8_t fresh = raw.fresh;

  bool accepted = false;
  ++ticks_since_count_;
  if ((fresh & kFreshEncoder) != 0) {
    if (!started_) {
      started_ = accepted = true;
      observer_.start(raw.encoder_count);
    } else {
      const auto step = static_cast<float>(count_difference(raw.encoder_count, last_count_));
      accepted = absolute(step) <= max_counts_per_tick_ * static_cast<float>(ticks_since_count_);
      if (accepted) {
        observer_.update(raw.encoder_count);
      } else {
        ++implausible_;
      }
    }
  }
  if (accepted) {
    last_count_ = raw.encoder_count;
    count_at_ = now;
    ticks_since_count_ = 0;
    position_rad_ =
        static_cast<float>(count_difference(raw.encoder_count, zero_count_)) * radians_per_count_ + fine_offset_rad_;
  } else if (started_) {
    observer_.coast();
    position_rad_ += velocity_rad_s_ * dt_s_;
  }
  velocity_rad_s_ = observer_.velocity_counts_s() * radians_per_count_;
  position_valid_ = started_ && now - count_at_ <= config_.encoder_timeout;

  const auto take = [&](std::uint8_t bit, float value, Duration timeout, Reading& reading, Time& at) {
    if ((fresh & bit) != 0) {
      reading = {value, true};
      at = now;
    } else {
      reading.valid = reading.valid && now - at <= timeout;
    }
  };
  seen_ |= fresh;
  if (sharpened_ && (fresh & kFreshTorque) != 0) [[unlikely]]
    sharpen_torque(raw);
  take(kFreshTorque, static_cast<float>(raw.torque_adc) * torque_scale_ - torque_offset_nm_, config_.torque_timeout,
       joint_torque_, torque_at_);
  take(kFreshCurrent, static_cast<float>(raw.current_adc) * current_scale_, config_.current_timeout, current_,
       current_at_);
  take(kFreshTemperature, static_cast<float>(raw.winding_temperature_adc) * 0.1F, config_.slow_timeout, winding_,
       temperature_at_);
  take(kFreshTemperature, static_cast<float>(raw.drive_temperature_adc) * 0.1F, config_.slow_timeout,
       drive_temperature_, temperature_at_);
  take(kFreshBusVoltage, static_cast<float>(raw.bus_voltage_adc) * 0.01F, config_.slow_timeout, bus_voltage_,
       voltage_at_);
  if (!complete_) {
    std::uint8_t needed = kFreshEncoder | kFreshCurrent | kFreshTemperature | kFreshBusVoltage;
    if (config_.torque_sensor) needed |= kFreshTorque;
    complete_ = (seen_ & needed) == needed;
  }
}

}  // namespace mrr::fw
