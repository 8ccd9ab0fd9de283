// Room: module_fw/control. The few scalar functions the laws need: float only, no libm, bit-equal on PC and
// microcontroller. May touch nothing. Freestanding.
#pragma once

#include <bit>
#include <cstdint>

namespace mrr::fw {

inline constexpr float kPi = 3.14159265358979F;

/// False for NaN and infinities.
constexpr bool is_finite(float x) noexcept { return (std::bit_cast<std::uint32_t>(x) & 0x7F80'0000U) != 0x7F80'0000U; }

constexpr float absolute(float x) noexcept { return __builtin_fabsf(x); }

/// x limited to [low, high]; a NaN stays a NaN (the drive refuses it), it never turns into a limit.
/// Written so that each line is one minimum or maximum instruction.
constexpr float limit(float x, float low, float high) noexcept {
  const float below = high < x ? high : x;
  return low > below ? low : below;
}
constexpr float limit(float x, float magnitude) noexcept { return limit(x, -magnitude, magnitude); }

/// Saturation: x limited to [-1, 1].
constexpr float sat(float x) noexcept { return limit(x, -1.0F, 1.0F); }

constexpr float sign(float x) noexcept { return x > 0.0F ? 1.0F : (x < 0.0F ? -1.0F : 0.0F); }

/// exp(-x) for x >= 0, relative error below 4e-6 (5e-7 for x < 5); 0 beyond x = 80; NaN and x < 0 give 1.
/// 2^-(n + f) with f in [0, 1): the power of two by its exponent bits, 2^-f by a polynomial (Taylor about f = 1/2).
constexpr float exp_negative(float x) noexcept {
  if (!(x > 0.0F)) return 1.0F;
  if (x >= 80.0F) return 0.0F;
  const float z = x * 1.44269504F;  // 1 / ln 2
  const auto n = static_cast<std::int32_t>(z);
  const float u = (static_cast<float>(n) + 0.5F - z) * 0.693147181F;  // in (-0.347, 0.347]
  const float p =
      1.0F +
      u * (1.0F + u * (0.5F + u * (0.166666667F + u * (0.0416666667F + u * (0.00833333333F + u * 0.00138888889F)))));
  const float scale = std::bit_cast<float>(static_cast<std::uint32_t>(127 - n) << 23U);  // 2^-n
  return p * scale * 0.707106781F;
}

/// Nearest integer, halves away from zero; |x| < 2^31.
constexpr std::int32_t round_to_int(float x) noexcept {
  return static_cast<std::int32_t>(x + __builtin_copysignf(0.5F, x));
}

/// x as a count for the wire: nearest integer, saturated; 0 for NaN.
constexpr std::int32_t to_count(float x) noexcept {
  constexpr float kMax = 2147483520.0F;  // the largest float below 2^31
  return x == x ? round_to_int(limit(x, kMax)) : 0;
}
constexpr std::int16_t to_count16(float x) noexcept {
  return static_cast<std::int16_t>(x == x ? round_to_int(limit(x, 32767.0F)) : 0);
}

/// A duration as float seconds. Meant for short spans: exact to 2^-24 of the span. Spans beyond +-2 s saturate,
/// so that no 64-bit conversion is needed.
constexpr float short_seconds(std::int64_t ns) noexcept {
  if (ns > 2'000'000'000) return 2.0F;
  if (ns < -2'000'000'000) return -2.0F;
  return static_cast<float>(static_cast<std::int32_t>(ns)) * 1e-9F;
}

}  // namespace mrr::fw
