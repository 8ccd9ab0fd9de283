#include "module_fw/control/passive_law.h"

namespace mrr::fw {

PassiveLaw::PassiveLaw(const PassiveConfig& config, float dt_s) noexcept
    : config_(config),
      inverse_velocity_span_(1.0F / (config.moving_velocity_rad_s - config.still_velocity_rad_s)),
      inverse_torque_span_(1.0F / (config.torque_full_trend_nm - config.torque_dead_band_nm)),
      max_change_(config.trend_rate_1_s * dt_s) {}

float PassiveLaw::wanted_trend(const Evidence& evidence) const noexcept {
  // Why the dead zone: friction compensated in proportion to a small velocity is negative damping. Without it a
  // simulated base joint walked 30 mrad in 3 s on a push of 1.3 Nm, a twenty-fifth of its friction.
  const float speed = absolute(evidence.velocity_rad_s);
  const float seen = limit((speed - config_.still_velocity_rad_s) * inverse_velocity_span_, 0.0F, 1.0F);
  const float moving = seen * sign(evidence.velocity_rad_s);
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
