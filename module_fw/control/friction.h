// Room: module_fw/control. Friction model (5) and its regressor.
// May touch module_fw/config.h. Freestanding.
#pragma once

#include "module_fw/config.h"
#include "module_fw/control/scalar_math.h"

namespace mrr::fw {

/// Y = d tau_f / d(b, f_c, f_s, f_tau) at the nominal parameters.
struct FrictionRegressor {
  float viscous = 0.0F;   ///< q'
  float coulomb = 0.0F;   ///< (1 - E) s
  float stat = 0.0F;      ///< E s
  float stribeck = 0.0F;  ///< -(f_s - f_c) q'^2 E s
};

/// @param velocity_rad_s  joint velocity
/// @param direction       s: the sign of motion, or something in [-1, 1] near standstill
inline FrictionRegressor friction_regressor(const FrictionConfig& f, float velocity_rad_s, float direction) noexcept {
  const float v2 = velocity_rad_s * velocity_rad_s;
  const float Es = exp_negative(f.stribeck_decay_s2_rad2 * v2) * direction;
  return {velocity_rad_s, direction - Es, Es, -(f.static_nm - f.coulomb_nm) * v2 * Es};
}

/// Equation (5): [f_c + (f_s - f_c) exp(-f_tau q'^2)] s + b q', Nm at the joint.
inline float friction_torque(const FrictionConfig& f, const FrictionRegressor& Y) noexcept {
  return f.viscous_nm_s_rad * Y.viscous + f.coulomb_nm * Y.coulomb + f.static_nm * Y.stat;
}

/// Direction in which friction is compensated, in [-1, 1], continuous: nothing while the reference rests; when it
/// moves, that of the motion where the encoder can tell it, below that of the reference. Why nothing at rest: following
/// the sign of the measured motion there takes away the very friction that damps the elastic drive. A simulated joint
/// (4.6 Nm friction, 8400 Nm/rad) then swung at 24 Hz with 10 Nm, and on one encoder count the torque rattled by 5 Nm.
inline float motion_direction(float velocity, float reference_velocity, const ControlConfig& c) noexcept {
  const float r = sat(reference_velocity / c.reference_still_rad_s);
  const float beyond =
      (absolute(velocity) - c.still_velocity_rad_s) / (c.moving_velocity_rad_s - c.still_velocity_rad_s);
  const float seen = limit(beyond, 0.0F, 1.0F);
  return absolute(r) * seen * sign(velocity) + (1.0F - seen) * r;
}

}  // namespace mrr::fw
