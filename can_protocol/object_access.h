// Room: can_protocol. Finding, reading, checking and writing objects of the dictionary. Freestanding.
#pragma once

#include <algorithm>

#include "can_protocol/object_dictionary.h"

namespace mrr::can {

static_assert(std::endian::native == std::endian::little, "objects are copied to the wire as they lie in memory");

constexpr const Entry& entry_of(ObjectId id) noexcept { return kEntries[static_cast<std::size_t>(id)]; }
constexpr ObjectId id_of(const Entry& entry) noexcept { return static_cast<ObjectId>(&entry - kEntries.data()); }

/// The entry, or nullptr.
constexpr const Entry* find_entry(std::uint16_t index, std::uint8_t sub) noexcept {
  const auto key = [](const Entry& e) { return static_cast<std::uint32_t>(e.index) << 8U | e.sub; };
  const std::uint32_t wanted = static_cast<std::uint32_t>(index) << 8U | sub;
  const auto* e = std::lower_bound(kEntries.begin(), kEntries.end(), wanted,
                                   [&](const Entry& a, std::uint32_t k) { return key(a) < k; });
  return e != kEntries.end() && key(*e) == wanted ? e : nullptr;
}

/// Is there any sub-index of this object?
constexpr bool has_index(std::uint16_t index) noexcept {
  const auto* e = std::lower_bound(kEntries.begin(), kEntries.end(), index,
                                   [](const Entry& a, std::uint16_t i) { return a.index < i; });
  return e != kEntries.end() && e->index == index;
}

/// The object's value as on the wire; a string without its trailing NULs.
inline Value read_value(const ObjectDictionary& od, const Entry& entry) noexcept {
  Value v;
  v.size = static_cast<std::uint8_t>(entry.size);
  std::memcpy(v.bytes.data(), reinterpret_cast<const unsigned char*>(&od) + entry.offset, entry.size);
  if (entry.type == Type::string) {
    while (v.size > 0 && v.bytes[v.size - 1U] == 0) --v.size;
  }
  return v;
}

/// Precondition: check_value() found nothing.
inline void write_value(ObjectDictionary& od, const Entry& entry, const Value& v) noexcept {
  auto* to = reinterpret_cast<unsigned char*>(&od) + entry.offset;
  std::memcpy(to, v.bytes.data(), v.size);
  if (entry.type == Type::string) std::memset(to + v.size, 0, static_cast<std::size_t>(entry.size - v.size));
}

constexpr bool is_signed(Type t) noexcept {
  return t == Type::i8 || t == Type::i16 || t == Type::i32 || t == Type::i64;
}

/// Length and limits, as the schema has them. A NaN or an infinity is never accepted.
constexpr Abort check_value(const Entry& entry, const Value& v) noexcept {
  if (v.size > entry.size) return Abort::too_long;
  if (entry.type == Type::string) return Abort::none;
  if (v.size < entry.size) return Abort::too_short;
  if (entry.type == Type::f32) {
    const float x = v.as_real();
    constexpr float kMax = 3.402823466e38F;
    if (!(x >= -kMax && x <= kMax)) return Abort::value;
    if (entry.limits == kNoLimits) return Abort::none;
    const RealLimits& range = kRealLimits[entry.limits];
    if (!(x >= range.low)) return Abort::value_low;
    if (!(x <= range.high)) return Abort::value_high;
    return Abort::none;
  }
  if (entry.limits == kNoLimits) return Abort::none;
  const IntegerLimits& range = kIntegerLimits[entry.limits];
  // No u64 object has limits (the generator sees to it), so int64 holds them all.
  const std::int64_t x = is_signed(entry.type) ? v.as_signed() : static_cast<std::int64_t>(v.as_unsigned());
  if (!(x >= range.low)) return Abort::value_low;
  if (!(x <= range.high)) return Abort::value_high;
  const std::int64_t place = x - range.low;
  if (place < 64 && !((range.allowed >> place) & 1U)) return Abort::value;
  return Abort::none;
}

}  // namespace mrr::can
