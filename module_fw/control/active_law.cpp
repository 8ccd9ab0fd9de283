#include "module_fw/control/active_law.h"

namespace mrr::fw {

ActiveLaw::ActiveLaw(const ControlConfig& control, const FrictionConfig& friction, float dt_s) noexcept
    : control_(control), friction_(friction), dt_s_(dt_s) {
  const CompensatorConfig& c = control.compensator;
  for (std::size_t k = 0; k < 4; ++k) inverse_width_[k] = c.robust_width[k] > 0.0F ? 1.0F / c.robust_width[k] : 0.0F;
  inverse_position_width_ = c.position_width_rad_s > 0.0F ? 1.0F / c.position_width_rad_s : 0.0F;
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
    const std::array<float, 4> y{Y.viscous, Y.coulomb, Y.stat, Y.stribeck};
    float sum = -c.position_gain_nm * sat(r * inverse_position_width_);  // u_q
    for (std::size_t k = 0; k < 4; ++k) {
      const float zeta = y[k] * r;
      // Integral action with projection onto the known bound of the parameter error.
      if (learn) integral_[k] = limit(integral_[k] - c.integral_gain[k] * dt_s_ * zeta, c.integral_limit[k]);
      sum += y[k] * (integral_[k] - c.robust_gain[k] * sat(zeta * inverse_width_[k]));
    }
    out.compensator_nm = sum;
  }
  out.torque_nm = control_.inertia_kg_m2 * reference.acceleration_rad_s2 -
                  control_.velocity_gain_nm_s_rad * velocity_error - control_.position_gain_nm_rad * error_rad +
                  load_torque_nm + control_.friction_feedforward * friction_torque(friction_, Y) + out.compensator_nm;
  return out;
}

}  // namespace mrr::fw
