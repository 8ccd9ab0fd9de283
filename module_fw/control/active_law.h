// Room: module_fw/control. Active law (14)-(18) with the decomposition-based robust compensator.
// May touch module_fw/config.h. Freestanding.
#pragma once

#include <array>

#include "module_fw/config.h"
#include "module_fw/control/friction.h"

namespace mrr::fw {

/// Where the joint shall be: rad, rad/s, rad/s^2.
struct MotionState {
  float position_rad = 0.0F;
  float velocity_rad_s = 0.0F;
  float acceleration_rad_s2 = 0.0F;
};

struct ActiveLawOutput {
  float torque_nm = 0.0F;       ///< tau_a, joint side, not limited
  float compensator_nm = 0.0F;  ///< Y (u_c + u_b) + u_q, contained in torque_nm
};

/// tau_a = J q_d'' - K_D e' - K_P e + tau_s^ + tau_f^ + Y (u_c + u_b) + u_q.
class ActiveLaw {
 public:
  ActiveLaw(const ControlConfig& control, const FrictionConfig& friction, float dt_s) noexcept;

  /// Forgets what the compensator has learnt. Call when the law comes (back) into force.
  void reset() noexcept { integral_ = Four{}; }

  /// One tick. q is the difference to the reference, taken by the caller where it can be taken exactly.
  /// @param error_rad       e = q - q_d
  /// @param velocity_rad_s  q'
  /// @param reference       q_d and its derivatives
  /// @param load_torque_nm  tau_s^: torque the transmission gives the link (sensor or model)
  /// @param learn           false freezes the integral part (torque saturated)
  ActiveLawOutput step(float error_rad, float velocity_rad_s, const MotionState& reference, float load_torque_nm,
                       bool learn) noexcept;

 private:
  ControlConfig control_;
  FrictionConfig friction_;
  /// One value per friction parameter; arithmetic is by element.
  using Four [[gnu::vector_size(16)]] = float;
  [[nodiscard]] static Four limited(Four x, Four magnitude) noexcept;

  Four integral_{};       ///< u_c
  Four integral_step_{};  ///< K_i dt
  Four integral_limit_{};
  Four robust_gain_{};
  Four inverse_width_{};  ///< 1 / eps
  float inverse_position_width_ = 0.0F;
};

}  // namespace mrr::fw
