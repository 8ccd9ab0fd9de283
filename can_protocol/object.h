// Room: can_protocol. What the generated object dictionary is made of: types, access, entries, values. Freestanding.
// May touch nothing but the standard library's freestanding part.
#pragma once

#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <cstring>

namespace mrr::can {

enum class Type : std::uint8_t { u8, u16, u32, u64, i8, i16, i32, i64, f32, string };

/// Bits of Entry::flags.
enum EntryFlag : std::uint8_t {
  kReadable = 1U << 0U,
  kWritable = 1U << 1U,
  kRpdoMappable = 1U << 2U,
  kTpdoMappable = 1U << 3U,
  kStored = 1U << 4U,      ///< kept by 1010h
  kTestOnly = 1U << 5U,    ///< exists only in a node made with NodeConfig::test_objects
  kAddsNodeId = 1U << 6U,  ///< the node id is added to the default
};

/// Accepted range of an integer. `allowed` has a bit per value from `low` up to 63 above it; further values follow the
/// range alone.
struct IntegerLimits {
  std::int64_t low;
  std::int64_t high;
  std::uint64_t allowed;
};

/// Accepted range of a real; a NaN is never accepted, limits or not.
struct RealLimits {
  float low;
  float high;
};

inline constexpr std::uint8_t kNoLimits = 0xFF;

/// One sub-index of the object dictionary. Where it lives: `size` bytes at `offset` in struct ObjectDictionary.
struct Entry {
  std::uint16_t index;
  std::uint8_t sub;
  Type type;
  std::uint8_t flags;   ///< EntryFlag
  std::uint8_t limits;  ///< place in kIntegerLimits or kRealLimits by type, or kNoLimits
  std::uint16_t offset;
  std::uint16_t size;  ///< bytes; a string's capacity
};

/// Largest object, in bytes.
inline constexpr std::size_t kMaxObjectSize = 32;

/// Communication parameters of a PDO (1400h.. and 1800h..).
struct PdoCommunication {
  std::uint32_t cob_id = 0;  ///< bit 31: not valid; bit 30: no remote request
  std::uint16_t inhibit_time_100us = 0;
  std::uint16_t event_timer_ms = 0;  ///< TPDO: largest time between two; RPDO: deadline
  std::uint8_t highest_sub = 0;
  std::uint8_t transmission_type = 0;
  std::uint8_t sync_start_value = 0;
};

inline constexpr std::size_t kMaxMappedObjects = 8;

/// Mapping parameters of a PDO (1600h.. and 1A00h..): index << 16 | sub << 8 | bits.
struct PdoMapping {
  std::array<std::uint32_t, kMaxMappedObjects> entries{};
  std::uint8_t count = 0;
};

/// SDO abort codes (CiA 301, table 22).
enum class Abort : std::uint32_t {
  none = 0,
  toggle = 0x05030000,
  timeout = 0x05040000,
  unknown_command = 0x05040001,
  unsupported_access = 0x06010000,
  write_only = 0x06010001,
  read_only = 0x06010002,
  no_object = 0x06020000,
  not_mappable = 0x06040041,
  mapping_length = 0x06040042,
  incompatible_parameter = 0x06040043,
  hardware = 0x06060000,
  length = 0x06070010,
  too_long = 0x06070012,
  too_short = 0x06070013,
  no_sub_index = 0x06090011,
  value = 0x06090030,
  value_high = 0x06090031,
  value_low = 0x06090032,
  general = 0x08000000,
  cannot_store = 0x08000020,
  local_control = 0x08000021,
  state = 0x08000022,
  no_data = 0x08000024,
};

/// A value on its way into an object: little-endian bytes as on the wire, `size` of them.
struct Value {
  std::array<std::uint8_t, kMaxObjectSize> bytes{};
  std::uint8_t size = 0;

  /// The first bytes as an unsigned integer.
  [[nodiscard]] constexpr std::uint64_t as_unsigned() const noexcept {
    std::uint64_t v = 0;
    for (std::size_t i = 0; i < size && i < 8; ++i) v |= static_cast<std::uint64_t>(bytes[i]) << (8 * i);
    return v;
  }
  /// The same, sign-extended from `size`.
  [[nodiscard]] constexpr std::int64_t as_signed() const noexcept {
    if (size == 0 || size >= 8) return static_cast<std::int64_t>(as_unsigned());
    const std::uint64_t sign = 1ULL << (8U * size - 1U);
    return static_cast<std::int64_t>((as_unsigned() ^ sign) - sign);
  }
  /// Precondition: four bytes of type f32.
  [[nodiscard]] constexpr float as_real() const noexcept {
    return std::bit_cast<float>(static_cast<std::uint32_t>(as_unsigned()));
  }
};

}  // namespace mrr::can
