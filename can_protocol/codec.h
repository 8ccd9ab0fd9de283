// Room: can_protocol. Little-endian bytes <-> integers. Freestanding.
#pragma once

#include <bit>
#include <cstddef>
#include <cstdint>
#include <type_traits>

namespace mrr::can {

/// Writes sizeof(T) bytes, least significant first.
template <typename T>
constexpr void put(std::uint8_t* to, std::type_identity_t<T> value) noexcept {
  static_assert(std::is_integral_v<T>);
  const auto bits = static_cast<std::make_unsigned_t<T>>(value);
  for (std::size_t i = 0; i < sizeof(T); ++i) to[i] = static_cast<std::uint8_t>(bits >> (8U * i));
}

/// Reads sizeof(T) bytes, least significant first.
template <typename T>
constexpr T get(const std::uint8_t* from) noexcept {
  static_assert(std::is_integral_v<T>);
  std::uint64_t bits = 0;
  for (std::size_t i = 0; i < sizeof(T); ++i) bits |= static_cast<std::uint64_t>(from[i]) << (8U * i);
  return static_cast<T>(static_cast<std::make_unsigned_t<T>>(bits));
}

}  // namespace mrr::can
