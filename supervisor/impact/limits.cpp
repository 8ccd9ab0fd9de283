#include "supervisor/impact/limits.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace mrr::sup {
namespace {

/// Momentary-peak events that a drive stands in its life: once per two turns of the wave generator is the worst, (56).
constexpr double kEventBudget = 1e4;

}  // namespace

double impulse_limit_nm_s(double torque_nm, double contact_s, PulseShape shape) noexcept {
  const double square = torque_nm * contact_s;
  return shape == PulseShape::square ? square : 2.0 / std::numbers::pi * square;
}

ImpulseLimits impulse_limits(const TransmissionDescription& drive, double contact_s, PulseShape shape) noexcept {
  return {.rated_nm_s = impulse_limit_nm_s(drive.rated_nm, contact_s, shape),
          .repeated_nm_s = impulse_limit_nm_s(drive.repeated_peak_nm, contact_s, shape),
          .momentary_nm_s = impulse_limit_nm_s(drive.momentary_peak_nm, contact_s, shape)};
}

double impact_count(double motor_rpm, double contact_s) noexcept {
  return kEventBudget / (2.0 * (motor_rpm / 60.0) * contact_s);
}

double impact_speed_limit_rad_s(double gear_ratio, double contact_s, double count) noexcept {
  return kEventBudget * std::numbers::pi / (count * contact_s * gear_ratio);
}

double joint_speed_limit_rad_s(const JointDescription& joint, double contact_s, double count) noexcept {
  const double gear = joint.transmission.gear_ratio;
  return std::min(impact_speed_limit_rad_s(gear, contact_s, count), joint.motor.max_velocity_rad_s / gear);
}

ModeDecision decide_mode(double held_nm_s, double free_nm_s, const ImpulseLimits& limits) noexcept {
  if (!std::isfinite(free_nm_s) || std::isnan(held_nm_s)) return ModeDecision::refuse;
  if (std::abs(held_nm_s) <= limits.rated_nm_s) return ModeDecision::active;
  if (std::abs(free_nm_s) <= limits.repeated_nm_s) return ModeDecision::passive;
  return ModeDecision::refuse;
}

}  // namespace mrr::sup
