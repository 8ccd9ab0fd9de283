#include "module_fw/control/active_law.h"

namespace mrr::fw {

ActiveLaw::ActiveLaw(const ControlConfig& control, const FrictionConfig& friction, float dt_s) noexcept
    : control_(control), friction_(friction) {
  const CompensatorConfig& c = control.compensator;
  for (std::size_t k = 0; k < 4; ++k) {
    integral_step_[k] = c.integral_gain[k] * dt_s;
    integral_limit_[k] = c.integral_limit[k];
    robust_gain_[k] = c.robust_gain[k];
    inverse_width_[k] = c.robust_width[k] > 0.0F ? 1.0F / c.robust_width[k] : 0.0F;
  }
  inverse_position_width_ = c.position_width_rad_s > 0.0F ? 1.0F / c.position_width_rad_s : 0.0F;
}

ActiveLaw::Four ActiveLaw::limited(Four x, Four magnitude) noexcept {
  const Four below = magnitude < x ? magnitude : x;
  return -magnitude > below ? -magnitude : below;
}

ActiveLawOutput ActiveLaw::step(float error_rad, float velocity_rad_s, const MotionState& reference,
                                float load_torque_nm, bool learn) noexcept {
  const float velocity_error = velocity_rad_s - reference.velocity_rad_s;
  const float s = motion_direction(velocity_rad_s, reference.velocity_rad_s, control_);
  const FrictionRegressor Y = friction_regressor(friction_, velocity_rad_s, s);

  ActiveLawOutput out;
  const CompensatorConfig& c = control_.compensator;
  if (c.enabled) {
    const float r = velocity_error + control_.lambda_1_s * error_rad;
    const Four y{Y.viscous, Y.coulomb, Y.stat, Y.stribeck};
    const Four zeta = y * r;
    // Integral action with projection onto the known bound of the parameter error.
    if (learn) integral_ = limited(integral_ - integral_step_ * zeta, integral_limit_);
    constexpr Four kOne{1.0F, 1.0F, 1.0F, 1.0F};
    const Four u = y * (integral_ - robust_gain_ * limited(zeta * inverse_width_, kOne));
    out.compensator_nm = ((u[0] + u[1]) + (u[2] + u[3])) - c.position_gain_nm * sat(r * inverse_position_width_);
  }
  out.torque_nm = control_.inertia_kg_m2 * reference.acceleration_rad_s2 -
                  control_.velocity_gain_nm_s_rad * velocity_error - control_.position_gain_nm_rad * error_rad +
                  load_torque_nm + control_.friction_feedforward * friction_torque(friction_, Y) + out.compensator_nm;
  return out;
}

}  // namespace mrr::fw
