// Room: supervisor/strike. One quintic polynomial of time between two states, and its exact extremes.
// May touch nothing but the standard library. Allocates nothing, throws nothing.
#pragma once

#include <array>

namespace mrr::sup {

/// Position, velocity and acceleration of one joint; rad, rad/s, rad/s^2.
struct QuinticState {
  double position = 0.0;
  double velocity = 0.0;
  double acceleration = 0.0;
};

/// Smallest and largest value of something over a whole segment.
struct Range {
  double low = 0.0;
  double high = 0.0;
  /// Largest magnitude.
  [[nodiscard]] double magnitude() const noexcept { return high > -low ? high : -low; }
};

/// rad, rad/s, rad/s^2, rad/s^3.
struct QuinticExtremes {
  Range position;
  Range velocity;
  Range acceleration;
  Range jerk;
};

/// p(t) = sum c_k t^k, k = 0..5, for 0 <= t <= duration.
class Quintic {
 public:
  Quintic() = default;
  /// The only quintic with these two end states; Hermite conditions, closed form. Precondition: duration_s > 0.
  [[nodiscard]] static Quintic between(const QuinticState& start, const QuinticState& end, double duration_s) noexcept;

  /// State at t, s. Outside 0..duration the polynomial goes on: the caller clamps.
  [[nodiscard]] QuinticState sample(double t_s) const noexcept;

  /// Exact, over the whole duration: at its ends and at the roots of each derivative.
  [[nodiscard]] QuinticExtremes extremes() const noexcept;
  [[nodiscard]] Range position_range() const noexcept { return extremes().position; }
  [[nodiscard]] Range velocity_range() const noexcept { return extremes().velocity; }
  [[nodiscard]] Range acceleration_range() const noexcept { return extremes().acceleration; }

  /// c_0..c_5.
  [[nodiscard]] const std::array<double, 6>& coefficients() const noexcept { return c_; }
  [[nodiscard]] double duration_s() const noexcept { return duration_s_; }

 private:
  std::array<double, 6> c_{};
  double duration_s_ = 0.0;
};

}  // namespace mrr::sup
