// Room: module_fw/control. Passive law (7), (20): part of the friction is compensated, the joint is moved by the world.
// May touch module_fw/config.h. Freestanding.
#pragma once

#include "module_fw/config.h"
#include "module_fw/control/scalar_math.h"

namespace mrr::fw {

/// tau_p = f_m trend, |trend| <= 1. f_m falls from a share of the static friction at rest to the same share of the
/// Coulomb friction in motion, as friction itself does: it is below it everywhere, so the law alone never moves the
/// joint.
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
  void begin(const Evidence& evidence) noexcept;
  /// The trend follows the evidence, at a bounded rate.
  void update(const Evidence& evidence) noexcept;
  /// From now on the compensation fades to nothing, until the next begin(): `fade_ticks` from full to none.
  void take_back(float fade_ticks) noexcept { fade_ = 1.0F / fade_ticks; }
  [[nodiscard]] bool taken_back() const noexcept { return fade_ > 0.0F; }

  [[nodiscard]] float torque_nm() const noexcept { return compensation_nm_ * trend_; }
  [[nodiscard]] float trend() const noexcept { return trend_; }

 private:
  /// In [-1, 1]: motion when moving; sensed torque, then prediction, at rest.
  [[nodiscard]] float wanted_trend(const Evidence& evidence) noexcept;

  PassiveConfig config_;
  float inverse_velocity_span_;
  float max_change_;
  float max_change_at_rest_;
  float torque_gain_;
  float trend_ = 0.0F;
  float pull_nm_ = 0.0F;  ///< sensed torque as the motor feels it, filtered
  float seen_ = 0.0F;     ///< 0 at rest .. 1 in motion
  float pulled_ = 0.0F;   ///< direction in which the sensed torque pulls the motor: -1, 0, 1
  float compensation_nm_ = 0.0F;
  float share_ = 1.0F;  ///< left of the compensation
  float fade_ = 0.0F;   ///< of the share, per tick
};

/// Watches that a passive joint gains no energy: what its rotor has, plus what its transmission gave the link, can only
/// fall while friction takes more than the compensation gives. Sensor and observer lag alike, so both terms are of one
/// instant.
class PassivityGuard {
 public:
  PassivityGuard(float inertia_kg_m2, float dt_s) noexcept : half_inertia_(0.5F * inertia_kg_m2), dt_s_(dt_s) {}

  void begin(float velocity_rad_s, float joint_torque_nm) noexcept;
  /// One tick. @returns the energy gained since it was lowest, J.
  float update(float velocity_rad_s, float joint_torque_nm) noexcept;
  [[nodiscard]] float largest_gain_j() const noexcept { return largest_j_; }

 private:
  float half_inertia_;
  float dt_s_;
  float gain_j_ = 0.0F;
  float largest_j_ = 0.0F;
  float kinetic_j_ = 0.0F;
  float power_w_ = 0.0F;
};

}  // namespace mrr::fw
