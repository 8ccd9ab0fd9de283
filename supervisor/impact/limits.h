// Room: supervisor/impact. What a harmonic drive stands, and what follows for the mode of its joint.
// May touch common/. Allocates nothing, throws nothing.
#pragma once

#include <cstdint>

#include "supervisor/impact/external.h"

namespace mrr::sup {

/// Impulse that a pulse of peak `torque_nm` carries in `contact_s`, Nm s: T t (58), or (2/pi) T t for a half-sine.
[[nodiscard]] double impulse_limit_nm_s(double torque_nm, double contact_s,
                                        PulseShape shape = PulseShape::half_sine) noexcept;

struct ImpulseLimits {
  double rated_nm_s = 0.0;
  double repeated_nm_s = 0.0;   ///< repeated peak
  double momentary_nm_s = 0.0;  ///< momentary peak
};
[[nodiscard]] ImpulseLimits impulse_limits(const TransmissionDescription& drive, double contact_s,
                                           PulseShape shape = PulseShape::half_sine) noexcept;

/// N of (56): how many blows above the momentary peak the drive stands at this motor speed; no gear ratio in it.
[[nodiscard]] double impact_count(double motor_rpm, double contact_s) noexcept;
/// Joint speed at impact, rad/s, for `count` blows of `contact_s`, (59): 1e4 pi / (N t_s gamma).
[[nodiscard]] double impact_speed_limit_rad_s(double gear_ratio, double contact_s, double count) noexcept;
/// The smaller of (59) and the motor's top speed over gamma, rad/s.
[[nodiscard]] double joint_speed_limit_rad_s(const JointDescription& joint, double contact_s, double count) noexcept;

/// Table 4's columns: motor speeds, rpm. Link rpm is this over gamma.
inline constexpr double kSafestMotorRpm = 600.0;
inline constexpr double kAverageMotorRpm = 859.4366926962349;  ///< 90 rad/s
inline constexpr double kMaxMotorRpm = 2000.0;
[[nodiscard]] constexpr double link_rpm(double motor_rpm, double gear_ratio) noexcept { return motor_rpm / gear_ratio; }

enum class ModeDecision : std::uint8_t {
  active,   ///< stays in position control
  passive,  ///< goes passive for the impact
  refuse,   ///< not to be executed: slow down or choose another pose
};
/// `held_nm_s`, `free_nm_s`: the joint's axis impulse predicted with it held and with it free (sign ignored).
/// Held at most rated: active; else free at most repeated peak: passive; else, or with NaN anywhere, refuse.
[[nodiscard]] ModeDecision decide_mode(double held_nm_s, double free_nm_s, const ImpulseLimits& limits) noexcept;

}  // namespace mrr::sup
