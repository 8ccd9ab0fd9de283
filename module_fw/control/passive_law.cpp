#include "module_fw/control/passive_law.h"

namespace mrr::fw {

PassiveLaw::PassiveLaw(const PassiveConfig& config, float dt_s) noexcept
    : config_(config),
      inverse_moving_velocity_(1.0F / config.moving_velocity_rad_s),
      inverse_torque_span_(1.0F / (config.torque_full_trend_nm - config.torque_dead_band_nm)),
      max_change_(config.trend_rate_1_s * dt_s) {}

float PassiveLaw::wanted_trend(const Evidence& evidence) const noexcept {
  const float moving = sat(evidence.velocity_rad_s * inverse_moving_velocity_);
  float at_rest = sign(evidence.predicted_direction);
  if (evidence.torque_valid) {
    const float beyond = (absolute(evidence.joint_torque_nm) - config_.torque_dead_band_nm) * inverse_torque_span_;
    const float certainty = limit(beyond, 0.0F, 1.0F);
    at_rest = (1.0F - certainty) * at_rest - certainty * sign(evidence.joint_torque_nm);
  }
  return moving + (1.0F - absolute(moving)) * at_rest;
}

void PassiveLaw::update(const Evidence& evidence) noexcept {
  trend_ += limit(wanted_trend(evidence) - trend_, max_change_);
}

}  // namespace mrr::fw
