#include "module_fw/control/passive_law.h"

namespace mrr::fw {

PassiveLaw::PassiveLaw(const PassiveConfig& config, float dt_s) noexcept
    : config_(config),
      inverse_velocity_span_(1.0F / (config.moving_velocity_rad_s - config.still_velocity_rad_s)),
      max_change_(config.trend_rate_1_s * dt_s),
      max_change_at_rest_(config.rest_trend_rate_1_s * dt_s),
      torque_gain_(1.0F - exp_negative(config.torque_filter_rad_s * dt_s)) {}

float PassiveLaw::wanted_trend(const Evidence& evidence) noexcept {
  // Why the dead zone: friction compensated in proportion to a small velocity is negative damping. Without it a
  // simulated base joint walked 30 mrad in 3 s on a push of 1.3 Nm, a twenty-fifth of its friction.
  const float speed = absolute(evidence.velocity_rad_s);
  seen_ = limit((speed - config_.still_velocity_rad_s) * inverse_velocity_span_, 0.0F, 1.0F);
  compensation_nm_ =
      share_ * (config_.static_compensation_nm + seen_ * (config_.compensation_nm - config_.static_compensation_nm));

  // At rest whole or nothing, and with a hysteresis: in proportion to the sensed torque, torque and trend would chase
  // each other, or the joint would not break loose before it carries half its friction.
  if (absolute(pull_nm_) >= config_.torque_trend_nm) {
    pulled_ = sign(pull_nm_);
  } else if (!(pull_nm_ * pulled_ > config_.torque_dead_band_nm)) {
    pulled_ = 0.0F;
  }
  const float at_rest = pulled_ != 0.0F ? pulled_ : sign(evidence.predicted_direction);
  return seen_ * sign(evidence.velocity_rad_s) + (1.0F - seen_) * at_rest;
}

void PassiveLaw::begin(const Evidence& evidence) noexcept {
  share_ = 1.0F;
  fade_ = 0.0F;
  pulled_ = 0.0F;
  pull_nm_ = evidence.torque_valid ? -evidence.joint_torque_nm : 0.0F;
  trend_ = wanted_trend(evidence);
}

void PassiveLaw::update(const Evidence& evidence) noexcept {
  share_ = limit(share_ - fade_, 0.0F, 1.0F);
  // What friction could not hold anyway (a blow) needs no caution.
  const float pull_nm = evidence.torque_valid ? -evidence.joint_torque_nm : 0.0F;
  const bool strong = absolute(pull_nm) > config_.torque_trend_nm + config_.static_compensation_nm;
  pull_nm_ = strong ? pull_nm : pull_nm_ + torque_gain_ * (pull_nm - pull_nm_);
  const float missing = wanted_trend(evidence) - trend_;
  // A joint that turns round must be rid of the old trend; only building up at rest has to be slow.
  const bool turned = seen_ > 0.0F && missing * trend_ < 0.0F;
  const float slow = max_change_at_rest_ + seen_ * (max_change_ - max_change_at_rest_);
  trend_ += limit(missing, strong || turned ? max_change_ : slow);
}

void PassivityGuard::begin(float velocity_rad_s, float joint_torque_nm) noexcept {
  gain_j_ = largest_j_ = 0.0F;
  kinetic_j_ = half_inertia_ * velocity_rad_s * velocity_rad_s;
  power_w_ = joint_torque_nm * velocity_rad_s;
}

float PassivityGuard::update(float velocity_rad_s, float joint_torque_nm) noexcept {
  const float kinetic_j = half_inertia_ * velocity_rad_s * velocity_rad_s;
  const float power_w = joint_torque_nm * velocity_rad_s;
  const float gain_j = gain_j_ + (kinetic_j - kinetic_j_) + 0.5F * (power_w + power_w_) * dt_s_;
  gain_j_ = gain_j > 0.0F ? gain_j : 0.0F;
  kinetic_j_ = kinetic_j;
  power_w_ = power_w;
  if (gain_j_ > largest_j_) largest_j_ = gain_j_;
  return gain_j_;
}

}  // namespace mrr::fw
