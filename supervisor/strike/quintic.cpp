#include "supervisor/strike/quintic.h"

#include <algorithm>
#include <cmath>
#include <cstddef>

namespace mrr::sup {
namespace {

/// A polynomial of degree at most 5 in s = t/T, 0..1, ascending coefficients.
struct Polynomial {
  std::array<double, 6> c{};
  int degree = 0;

  [[nodiscard]] double operator()(double s) const noexcept {
    double value = 0.0;
    for (int k = degree; k >= 0; --k) value = value * s + c[static_cast<std::size_t>(k)];
    return value;
  }
  [[nodiscard]] Polynomial derivative() const noexcept {
    Polynomial d;
    d.degree = std::max(degree - 1, 0);
    for (int k = 1; k <= degree; ++k) d.c[static_cast<std::size_t>(k - 1)] = k * c[static_cast<std::size_t>(k)];
    return d;
  }
};

struct Roots {
  std::array<double, 6> s{};
  int count = 0;
};

/// Roots in (0, 1) at which the sign changes, ascending. `turns`: those of the derivative; between neighbouring ones
/// the polynomial is monotone, so Newton's steps kept within a shrinking bracket find them all.
Roots roots_between(const Polynomial& p, const Roots& turns) noexcept {
  const Polynomial slope = p.derivative();
  Roots found;
  double low = 0.0;
  double at_low = p(0.0);
  for (int k = 0; k <= turns.count; ++k) {
    const double high = k < turns.count ? turns.s[static_cast<std::size_t>(k)] : 1.0;
    const double at_high = p(high);
    if ((at_low < 0.0) != (at_high < 0.0)) {
      double a = low;
      double b = high;
      double s = a + (b - a) * at_low / (at_low - at_high);
      for (int i = 0; i < 60; ++i) {
        const double value = p(s);
        ((value < 0.0) == (at_low < 0.0) ? a : b) = s;
        const double newton = s - value / slope(s);
        const double next = newton > a && newton < b ? newton : 0.5 * (a + b);  // NaN: the middle
        const bool done = std::abs(next - s) <= 1e-15;
        s = next;
        if (done) break;
      }
      found.s[static_cast<std::size_t>(found.count++)] = s;
    }
    low = high;
    at_low = at_high;
  }
  return found;
}

Range range_of(const Polynomial& p, const Roots& turns) noexcept {
  const double first = p(0.0);
  const double last = p(1.0);
  Range range{std::min(first, last), std::max(first, last)};
  for (int k = 0; k < turns.count; ++k) {
    const double value = p(turns.s[static_cast<std::size_t>(k)]);
    range.low = std::min(range.low, value);
    range.high = std::max(range.high, value);
  }
  return range;
}

/// The quintic in s = t/T: all coefficients are of the size of the motion, whatever T.
Polynomial normalised(const std::array<double, 6>& c, double T) noexcept {
  Polynomial p;
  p.degree = 5;
  double power = 1.0;
  for (std::size_t k = 0; k < 6; ++k) {
    p.c[k] = c[k] * power;
    power *= T;
  }
  return p;
}

Range scaled(Range range, double factor) noexcept { return {range.low * factor, range.high * factor}; }

}  // namespace

Quintic Quintic::between(const QuinticState& start, const QuinticState& end, double T) noexcept {
  // In s = t/T, from Hermite's conditions at both ends.
  const double p0 = start.position;
  const double v0 = start.velocity * T;
  const double a0 = start.acceleration * T * T;
  const double d = end.position - p0;
  const double v1 = end.velocity * T;
  const double a1 = end.acceleration * T * T;
  const double c3 = 10.0 * d - 6.0 * v0 - 4.0 * v1 - 1.5 * a0 + 0.5 * a1;
  const double c4 = -15.0 * d + 8.0 * v0 + 7.0 * v1 + 1.5 * a0 - a1;
  const double c5 = 6.0 * d - 3.0 * v0 - 3.0 * v1 - 0.5 * a0 + 0.5 * a1;
  Quintic q;
  q.duration_s_ = T;
  const double T3 = T * T * T;
  q.c_ = {p0, start.velocity, 0.5 * start.acceleration, c3 / T3, c4 / (T3 * T), c5 / (T3 * T * T)};
  return q;
}

QuinticState Quintic::sample(double t) const noexcept {
  const auto& c = c_;
  return {((((c[5] * t + c[4]) * t + c[3]) * t + c[2]) * t + c[1]) * t + c[0],
          (((5.0 * c[5] * t + 4.0 * c[4]) * t + 3.0 * c[3]) * t + 2.0 * c[2]) * t + c[1],
          ((20.0 * c[5] * t + 12.0 * c[4]) * t + 6.0 * c[3]) * t + 2.0 * c[2]};
}

QuinticExtremes Quintic::extremes() const noexcept {
  const Polynomial position = normalised(c_, duration_s_);
  const Polynomial velocity = position.derivative();
  const Polynomial acceleration = velocity.derivative();
  const Polynomial jerk = acceleration.derivative();
  const Polynomial snap = jerk.derivative();
  const Roots of_snap = roots_between(snap, {});
  const Roots of_jerk = roots_between(jerk, of_snap);
  const Roots of_acceleration = roots_between(acceleration, of_jerk);
  const Roots of_velocity = roots_between(velocity, of_acceleration);
  const double rate = 1.0 / duration_s_;
  return {range_of(position, of_velocity), scaled(range_of(velocity, of_acceleration), rate),
          scaled(range_of(acceleration, of_jerk), rate * rate), scaled(range_of(jerk, of_snap), rate * rate * rate)};
}

}  // namespace mrr::sup
