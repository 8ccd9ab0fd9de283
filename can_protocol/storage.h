// Room: can_protocol. What 1010h keeps, as bytes for a file or a flash page, and back. Freestanding.
// Layout: magic u32; per stored object index u16, sub u8, size u8, bytes; CRC-32 (IEEE) of all before it.
#pragma once

#include <span>

#include "can_protocol/codec.h"
#include "can_protocol/object_access.h"

namespace mrr::can {

inline constexpr std::uint32_t kParametersMagic = 0x3150524D;  // "MRP1"

/// Bytes that save_parameters() needs at most.
inline constexpr std::size_t kMaxParameterBytes = [] {
  std::size_t n = 8;
  for (const Entry& e : kEntries) n += (e.flags & kStored) ? 4U + e.size : 0U;
  return n;
}();

inline std::uint32_t crc32(std::span<const std::uint8_t> bytes) noexcept {
  std::uint32_t crc = 0xFFFFFFFFU;
  for (const std::uint8_t b : bytes) {
    crc ^= b;
    for (int k = 0; k < 8; ++k) crc = (crc >> 1U) ^ ((crc & 1U) ? 0xEDB88320U : 0U);
  }
  return ~crc;
}

/// Number of bytes written; 0 if `out` is too small.
inline std::size_t save_parameters(const ObjectDictionary& od, std::span<std::uint8_t> out) noexcept {
  if (out.size() < kMaxParameterBytes) return 0;
  std::size_t at = 4;
  put<std::uint32_t>(out.data(), kParametersMagic);
  for (const Entry& e : kEntries) {
    if (!(e.flags & kStored)) continue;
    const Value v = read_value(od, e);
    put<std::uint16_t>(out.data() + at, e.index);
    out[at + 2] = e.sub;
    out[at + 3] = v.size;
    std::copy_n(v.bytes.begin(), v.size, out.begin() + static_cast<std::ptrdiff_t>(at + 4));
    at += 4U + v.size;
  }
  put<std::uint32_t>(out.data() + at, crc32(out.first(at)));
  return at + 4;
}

/// All or nothing: false, and `od` untouched, if magic, CRC, an object or a value is not as it should be.
inline bool load_parameters(ObjectDictionary& od, std::span<const std::uint8_t> in) noexcept {
  if (in.size() < 8 || get<std::uint32_t>(in.data()) != kParametersMagic) return false;
  const std::size_t end = in.size() - 4;
  if (get<std::uint32_t>(in.data() + end) != crc32(in.first(end))) return false;
  for (const bool apply : {false, true}) {
    for (std::size_t at = 4; at < end;) {
      if (end - at < 4) return false;
      const Entry* e = find_entry(get<std::uint16_t>(in.data() + at), in[at + 2]);
      Value v;
      v.size = in[at + 3];
      at += 4;
      if (!e || !(e->flags & kStored) || v.size > kMaxObjectSize || v.size > end - at) return false;
      std::copy_n(in.begin() + static_cast<std::ptrdiff_t>(at), v.size, v.bytes.begin());
      if (check_value(*e, v) != Abort::none) return false;
      if (apply) write_value(od, *e, v);
      at += v.size;
    }
  }
  return true;
}

}  // namespace mrr::can
