#include "module_fw/drive/drive.h"

namespace mrr::fw {

namespace {

constexpr float kDerateFrom = 0.8F;
constexpr float kDutyFullScale = 32767.0F;

}  // namespace

ThermalModel::ThermalModel(const DriveConfig& config, float dt_s) noexcept
    : peak_a_(config.peak_current_a),
      continuous_a_(config.continuous_current_a),
      inverse_continuous_(1.0F / config.continuous_current_a),
      gain_(dt_s / config.thermal_time_constant_s) {}

void ThermalModel::update(float current_a) noexcept {
  const float x = current_a * inverse_continuous_;
  load_ += gain_ * (x * x - load_);
}

float ThermalModel::allowed_current_a() const noexcept {
  if (load_ <= kDerateFrom) return peak_a_;
  constexpr float kInverseSpan = 1.0F / (1.0F - kDerateFrom);
  const float share = limit((1.0F - load_) * kInverseSpan, 0.0F, 1.0F);
  return continuous_a_ + share * (peak_a_ - continuous_a_);
}

Drive::Drive(const DriveConfig& drive, const SensingConfig& sensing, const LimitsConfig& limits, float dt_s) noexcept
    : config_(drive),
      thermal_(drive, dt_s),
      amperes_per_nm_positive_(1.0F / (drive.gear_ratio * drive.torque_constant_positive_nm_a)),
      amperes_per_nm_negative_(1.0F / (drive.gear_ratio * drive.torque_constant_negative_nm_a)),
      counts_per_ampere_(kDutyFullScale / sensing.current_full_scale_a),
      amperes_per_degree_(drive.peak_current_a / drive.temperature_derating_c),
      torque_limit_nm_(limits.torque_nm) {}

void Drive::configure(const DriveConfig& drive, const LimitsConfig& limits) noexcept {
  config_ = drive;
  amperes_per_degree_ = drive.peak_current_a / drive.temperature_derating_c;
  torque_limit_nm_ = limits.torque_nm;
  thermal_.set_peak_current(drive.peak_current_a);
}

void Drive::idle() noexcept {
  commanded_a_ = 0.0F;
  thermal_.update(0.0F);
}

Drive::Output Drive::command(float torque_nm, const Reading& current, const Reading& winding,
                             float max_torque_nm) noexcept {
  thermal_.update(current.valid ? current.value : commanded_a_);
  Output out;
  if (!is_finite(torque_nm)) {
    out.finite = false;
    commanded_a_ = 0.0F;
    return out;
  }
  const float bound = max_torque_nm < torque_limit_nm_ ? max_torque_nm : torque_limit_nm_;
  float tau = limit(torque_nm, bound);
  if (tau != torque_nm) out.limit = DriveLimit::torque;

  float allowed = thermal_.allowed_current_a();
  bool thermal = allowed < config_.peak_current_a;
  if (winding.valid) {
    const float room = (config_.max_winding_temperature_c - winding.value) * amperes_per_degree_;
    const float by_temperature = limit(room, 0.0F, config_.peak_current_a);
    if (by_temperature < allowed) {
      allowed = by_temperature;
      thermal = true;
    }
  }
  const float amperes_per_nm = tau >= 0.0F ? amperes_per_nm_positive_ : amperes_per_nm_negative_;
  const float wanted = tau * amperes_per_nm;
  const float amperes = limit(wanted, allowed);
  if (amperes != wanted) {
    out.limit = thermal ? DriveLimit::current_thermal : DriveLimit::current_peak;
    tau = amperes / amperes_per_nm;
  }
  commanded_a_ = amperes;
  out.torque_nm = tau;
  out.duty = static_cast<std::int16_t>(round_to_int(limit(amperes * counts_per_ampere_, kDutyFullScale)));
  return out;
}

}  // namespace mrr::fw
