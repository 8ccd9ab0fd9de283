// Room: can_protocol. SI values <-> the scaled integers on the wire. Freestanding; works in float or in double.
// Out of range saturates; NaN gives nothing, because no count may stand for "unknown".
#pragma once

#include <concepts>
#include <cstdint>
#include <limits>
#include <optional>

namespace mrr::can {

/// value * counts_per_unit, rounded to nearest (half away from zero), saturated to T's range. Nothing for NaN.
template <std::integral T, std::floating_point R>
constexpr std::optional<T> to_counts(R value, R counts_per_unit) noexcept {
  const R x = value * counts_per_unit;
  // The range's ends as reals may round up past the integer's: hence >= and <=.
  constexpr auto kLow = static_cast<R>(std::numeric_limits<T>::min());
  constexpr auto kHigh = static_cast<R>(std::numeric_limits<T>::max());
  if (!(x == x)) return std::nullopt;  // NOLINT(misc-redundant-expression): NaN, without <cmath>
  if (x >= kHigh) return std::numeric_limits<T>::max();
  if (x <= kLow) return std::numeric_limits<T>::min();
  const T whole = static_cast<T>(x);  // towards zero
  const R rest = x - static_cast<R>(whole);
  if (rest >= R(0.5) && whole < std::numeric_limits<T>::max()) return static_cast<T>(whole + 1);
  if (rest <= R(-0.5) && whole > std::numeric_limits<T>::min()) return static_cast<T>(whole - 1);
  return whole;
}

template <std::floating_point R>
constexpr std::optional<std::int32_t> urad_from_rad(R rad) noexcept {
  return to_counts<std::int32_t>(rad, R(1e6));
}
template <std::floating_point R>
constexpr std::optional<std::int32_t> urad_s_from_rad_s(R rad_s) noexcept {
  return to_counts<std::int32_t>(rad_s, R(1e6));
}
template <std::floating_point R>
constexpr std::optional<std::int32_t> mrad_s2_from_rad_s2(R rad_s2) noexcept {
  return to_counts<std::int32_t>(rad_s2, R(1e3));
}
/// Share of the rated torque (6076h, mNm) in thousandths. Nothing if NaN or if the rated torque is 0.
template <std::floating_point R>
constexpr std::optional<std::int16_t> permille_from_nm(R torque_nm, std::uint32_t rated_mnm) noexcept {
  if (rated_mnm == 0) return std::nullopt;
  return to_counts<std::int16_t>(torque_nm, R(1e6) / static_cast<R>(rated_mnm));
}

template <std::floating_point R = double>
constexpr R rad_from_urad(std::int32_t urad) noexcept {
  return static_cast<R>(urad) * R(1e-6);
}
template <std::floating_point R = double>
constexpr R rad_s_from_urad_s(std::int32_t urad_s) noexcept {
  return static_cast<R>(urad_s) * R(1e-6);
}
template <std::floating_point R = double>
constexpr R rad_s2_from_mrad_s2(std::int32_t mrad_s2) noexcept {
  return static_cast<R>(mrad_s2) * R(1e-3);
}
template <std::floating_point R = double>
constexpr R nm_from_permille(std::int16_t permille, std::uint32_t rated_mnm) noexcept {
  return static_cast<R>(permille) * static_cast<R>(rated_mnm) * R(1e-6);
}

}  // namespace mrr::can
