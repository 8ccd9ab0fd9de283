// Room: module_fw/control. Passive law (7), (20): part of the friction is compensated, the joint is moved by the world.
// May touch module_fw/config.h. Freestanding.
#pragma once

#include "module_fw/config.h"
#include "module_fw/control/scalar_math.h"

namespace mrr::fw {

/// tau_p = f_m trend, |trend| <= 1. f_m is below the Coulomb friction, so the law alone never moves the joint.
class PassiveLaw {
 public:
  PassiveLaw(const PassiveConfig& config, float dt_s) noexcept;

  /// What tells where the joint is going.
  struct Evidence {
    float velocity_rad_s = 0.0F;
    bool torque_valid = false;
    float joint_torque_nm = 0.0F;      ///< tau_s: torque the transmission gives the link; the motor feels its opposite
    float predicted_direction = 0.0F;  ///< sign of the predicted delta q', 0: none
  };

  /// The law comes into force: the trend is what the evidence says at this instant.
  void begin(const Evidence& evidence) noexcept { trend_ = wanted_trend(evidence); }
  /// The trend follows the evidence, at a bounded rate.
  void update(const Evidence& evidence) noexcept;
  [[nodiscard]] float torque_nm() const noexcept { return config_.compensation_nm * trend_; }
  [[nodiscard]] float trend() const noexcept { return trend_; }

 private:
  /// In [-1, 1], continuous in all its arguments: motion when moving; sensed torque, then prediction, at rest.
  [[nodiscard]] float wanted_trend(const Evidence& evidence) const noexcept;

  PassiveConfig config_;
  float inverse_velocity_span_;
  float inverse_torque_span_;
  float max_change_;
  float trend_ = 0.0F;
};

}  // namespace mrr::fw
