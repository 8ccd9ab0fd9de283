// Room: common/core. Time as an integer count of nanoseconds, with its own types. Freestanding: runs on the
// microcontroller. Nobody in a core reads a clock; time is handed in.
#pragma once

#include <compare>
#include <cstdint>

namespace mrr {

/// A span of time, integer nanoseconds. +-292 years.
struct Duration {
  std::int64_t ns = 0;

  friend constexpr auto operator<=>(Duration, Duration) noexcept = default;
  friend constexpr Duration operator+(Duration a, Duration b) noexcept { return {a.ns + b.ns}; }
  friend constexpr Duration operator-(Duration a, Duration b) noexcept { return {a.ns - b.ns}; }
  friend constexpr Duration operator-(Duration a) noexcept { return {-a.ns}; }
  friend constexpr Duration operator*(Duration a, std::int64_t k) noexcept { return {a.ns * k}; }
  friend constexpr Duration operator*(std::int64_t k, Duration a) noexcept { return {a.ns * k}; }
  friend constexpr Duration operator/(Duration a, std::int64_t k) noexcept { return {a.ns / k}; }
  friend constexpr std::int64_t operator/(Duration a, Duration b) noexcept { return a.ns / b.ns; }
  friend constexpr Duration operator%(Duration a, Duration b) noexcept { return {a.ns % b.ns}; }
  constexpr Duration& operator+=(Duration d) noexcept {
    ns += d.ns;
    return *this;
  }
  constexpr Duration& operator-=(Duration d) noexcept {
    ns -= d.ns;
    return *this;
  }

  /// Seconds as double (host) or float (microcontroller: no double arithmetic in hardware there).
  [[nodiscard]] constexpr double seconds() const noexcept { return static_cast<double>(ns) * 1e-9; }
  [[nodiscard]] constexpr float seconds_f() const noexcept { return static_cast<float>(ns) * 1e-9F; }
};

/// A point in time on some actor's own clock; the epoch is that actor's start.
struct Time {
  std::int64_t ns = 0;

  friend constexpr auto operator<=>(Time, Time) noexcept = default;
  friend constexpr Time operator+(Time t, Duration d) noexcept { return {t.ns + d.ns}; }
  friend constexpr Time operator-(Time t, Duration d) noexcept { return {t.ns - d.ns}; }
  friend constexpr Duration operator-(Time a, Time b) noexcept { return {a.ns - b.ns}; }
  constexpr Time& operator+=(Duration d) noexcept {
    ns += d.ns;
    return *this;
  }
  [[nodiscard]] constexpr double seconds() const noexcept { return static_cast<double>(ns) * 1e-9; }
};

constexpr Duration nanoseconds(std::int64_t v) noexcept { return {v}; }
constexpr Duration microseconds(std::int64_t v) noexcept { return {v * 1'000}; }
constexpr Duration milliseconds(std::int64_t v) noexcept { return {v * 1'000'000}; }
/// Rounds to the nearest nanosecond.
constexpr Duration seconds(double v) noexcept { return {static_cast<std::int64_t>(v * 1e9 + (v >= 0 ? 0.5 : -0.5))}; }

}  // namespace mrr
