// Room: can_protocol. How long a frame holds the wire, to the bit: stuffing, CRC, both bit rates; and worst cases for
// planning. Freestanding, header only; uses common/core and frame.h.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>

#include "can_protocol/frame.h"
#include "common/core/containers.h"
#include "common/core/time.h"

namespace mrr::can {

/// Recessive bits that must follow every frame before the next may start (ISO 11898-1, intermission).
inline constexpr int kIntermissionBits = 3;

/// Bits per second. `data` is used by FD frames with `bit_rate_switch` only.
struct BitRates {
  std::int64_t nominal = 1'000'000;
  std::int64_t data = 5'000'000;
};

/// A number of bits, split by the rate at which they are sent.
struct WireBits {
  int nominal = 0;
  int data = 0;

  [[nodiscard]] constexpr int total() const noexcept { return nominal + data; }
  /// Rounded to the nearest nanosecond, each part on its own. Precondition: rates > 0.
  [[nodiscard]] constexpr Duration time(const BitRates& rates) const noexcept {
    const auto part = [](std::int64_t bits, std::int64_t rate) { return (bits * 1'000'000'000 + rate / 2) / rate; };
    return {part(nominal, rates.nominal) + (data != 0 ? part(data, rates.data) : 0)};
  }
  friend constexpr bool operator==(WireBits, WireBits) noexcept = default;
};

/// The data length code that announces `length` bytes, or -1 when no code does.
constexpr int length_code(int length, bool fd) noexcept {
  if (length >= 0 && length <= 8) return length;
  if (!fd) return -1;
  constexpr std::array<int, 7> kLong{12, 16, 20, 24, 32, 48, 64};
  for (std::size_t i = 0; i < kLong.size(); ++i) {
    if (kLong[i] == length) return 9 + static_cast<int>(i);
  }
  return -1;
}

/// Whether the frame exists on a wire: id in range, length with a code, no FD remote, bit rate switch in FD only.
constexpr bool well_formed(const Frame& frame) noexcept {
  return frame.id <= (frame.extended ? 0x1FFF'FFFFU : 0x7FFU) && length_code(frame.length, frame.fd) >= 0 &&
         !(frame.fd && frame.remote) && !(frame.bit_rate_switch && !frame.fd);
}

/// Orders frames as the wire's arbitration does: the smaller key wins. Equal keys cannot be told apart by arbitration.
/// The key is the arbitration field as sent: base id, RTR or SRR, IDE, and when extended: id extension, RTR; last FDF.
constexpr std::uint64_t arbitration_key(const Frame& frame) noexcept {
  const std::uint64_t remote = frame.remote ? 1 : 0;
  const std::uint64_t fdf = frame.fd ? 1 : 0;
  if (!frame.extended) return (((std::uint64_t{frame.id} << 1U) | remote) << 21U) | (fdf << 19U);
  const std::uint64_t base = frame.id >> 18U;
  const std::uint64_t extension = frame.id & 0x3FFFFU;
  return (((base << 2U) | 3U) << 20U) | (extension << 2U) | (remote << 1U) | fdf;
}

/// Exact bits of a well-formed frame from start of frame to the last bit of end of frame, stuff bits included,
/// intermission excluded. The rate switches at the sample points of BRS and of the CRC delimiter; with the same sample
/// point in both phases that equals BRS at the nominal and the CRC delimiter at the data rate, which is how they are
/// counted.
constexpr WireBits wire_bits(const Frame& frame) noexcept;

/// Time from start to end of frame; the receivers have it then.
constexpr Duration frame_time(const Frame& frame, const BitRates& rates) noexcept {
  return wire_bits(frame).time(rates);
}

/// Time from start of frame until another may start: frame_time plus intermission.
constexpr Duration occupied_time(const Frame& frame, const BitRates& rates) noexcept {
  WireBits bits = wire_bits(frame);
  bits.nominal += kIntermissionBits;
  return bits.time(rates);
}

inline constexpr std::size_t kMaxFrameBits = 768;
/// One element a bit: 0 dominant, 1 recessive.
using BitSequence = StaticVector<std::uint8_t, kMaxFrameBits>;

/// The bits themselves, start to end of frame, stuffed, as an oscilloscope would show an acknowledged frame. Slow: for
/// tests and for drawing. wire_bits() counts the same bits by tables.
constexpr BitSequence encode(const Frame& frame) noexcept;

/// A frame that is sent periodically, for planning. `length` in bytes, `rate_hz` in frames per second.
struct PeriodicFrame {
  std::uint32_t id = 0;
  std::uint8_t length = 0;
  double rate_hz = 0.0;
  bool extended = false;
  bool fd = false;
  bool bit_rate_switch = false;
};

/// No frame of this shape takes more bits, intermission included. Classic: 47 + 8 n + floor((33 + 8 n) / 4) for n bytes
/// and a standard id, 67 + 8 n + floor((53 + 8 n) / 4) for an extended one; FD: the like. It is what the stuffing rule
/// could do to free bits; the fixed control bits keep real frames a few bits below.
constexpr WireBits worst_case_bits(const PeriodicFrame& frame) noexcept {
  const int payload = 8 * static_cast<int>(frame.length);
  if (!frame.fd) {
    const int stuffed_region = (frame.extended ? 54 : 34) + payload;  // SOF .. CRC
    return {stuffed_region + (stuffed_region - 1) / 4 + 10 + kIntermissionBits, 0};
  }
  const int arbitration = frame.extended ? 36 : 17;    // SOF .. BRS
  const int control = 5;                               // ESI, DLC
  const int crc_field = frame.length <= 16 ? 27 : 32;  // stuff count, CRC, fixed stuff bits
  const int dynamic = (arbitration + control + payload - 2) / 4;
  const int dynamic_arbitration = (arbitration - 1) / 4 - 1;  // its last bits are FDF, res, BRS: no run ends there
  const int nominal = arbitration + dynamic_arbitration + 9 + kIntermissionBits;
  const int data = control + payload + (dynamic - dynamic_arbitration) + crc_field + 1;
  return frame.bit_rate_switch ? WireBits{nominal, data} : WireBits{nominal + data, 0};
}

/// Share of the wire's time that these frames take with worst-case stuffing; 1 is a full bus. No error frames.
constexpr double worst_case_load(std::span<const PeriodicFrame> frames, const BitRates& rates) noexcept {
  double load = 0.0;
  for (const PeriodicFrame& frame : frames) load += frame.rate_hz * worst_case_bits(frame).time(rates).seconds();
  return load;
}

// ---------------------------------------------------------------------------------------------------------------------

namespace bits {

inline constexpr unsigned kCrc15 = 0x4599;  // ISO 11898-1: x^15+x^14+x^10+x^8+x^7+x^4+x^3+1
inline constexpr unsigned kCrc17 = 0x1685B;
inline constexpr unsigned kCrc21 = 0x102899;

/// One more message bit through a CRC register of `width` bits.
constexpr unsigned crc_bit(unsigned crc, unsigned bit, unsigned polynomial, unsigned width) noexcept {
  const unsigned top = (crc >> (width - 1)) & 1U;
  crc = (crc << 1U) & ((1U << width) - 1U);
  return (top ^ bit) != 0 ? crc ^ (polynomial & ((1U << width) - 1U)) : crc;
}

/// State of the stuffing machine: value of the last bit (bit 2) and how many equal ones, 1-4, less one (bits 1, 0).
constexpr std::uint8_t kAfterStart = 0;  // one dominant bit was sent: start of frame

/// Next state in bits 2-0, stuff bits inserted from bit 3 on.
constexpr std::uint8_t stuff_bit(std::uint8_t state, unsigned bit) noexcept {
  const unsigned last = state >> 2U;
  const unsigned run = state & 3U;
  if (bit != last) return static_cast<std::uint8_t>(bit << 2U);
  if (run < 3U) return static_cast<std::uint8_t>((last << 2U) | (run + 1U));
  return static_cast<std::uint8_t>(8U | ((bit ^ 1U) << 2U));  // the fifth: its complement follows and starts a new run
}

inline constexpr auto kStuffTable = [] {
  std::array<std::array<std::uint8_t, 256>, 8> table{};
  for (unsigned state = 0; state < 8; ++state) {
    for (unsigned byte = 0; byte < 256; ++byte) {
      auto now = static_cast<std::uint8_t>(state);
      unsigned inserted = 0;
      for (unsigned i = 8; i-- > 0;) {
        const std::uint8_t next = stuff_bit(now, (byte >> i) & 1U);
        inserted += next >> 3U;
        now = next & 7U;
      }
      table[state][byte] = static_cast<std::uint8_t>((inserted << 3U) | now);
    }
  }
  return table;
}();

inline constexpr auto kCrc15Table = [] {
  std::array<std::uint16_t, 256> table{};
  for (unsigned byte = 0; byte < 256; ++byte) {
    unsigned crc = 0;
    for (unsigned i = 8; i-- > 0;) crc = crc_bit(crc, (byte >> i) & 1U, kCrc15, 15);
    table[byte] = static_cast<std::uint16_t>(crc);
  }
  return table;
}();

/// Counts stuff bits.
struct Stuffer {
  std::uint8_t state = kAfterStart;
  int inserted = 0;

  constexpr void byte(unsigned value) noexcept {
    const std::uint8_t next = kStuffTable[state][value];
    inserted += next >> 3U;
    state = next & 7U;
  }
  /// The low `count` bits of `value`, most significant first.
  constexpr void feed(std::uint64_t value, int count) noexcept {
    while (count % 8 != 0) {
      --count;
      const std::uint8_t next = stuff_bit(state, static_cast<unsigned>(value >> static_cast<unsigned>(count)) & 1U);
      inserted += next >> 3U;
      state = next & 7U;
    }
    while (count > 0) {
      count -= 8;
      byte(static_cast<unsigned>(value >> static_cast<unsigned>(count)) & 0xFFU);
    }
  }
  [[nodiscard]] constexpr unsigned last_sent() const noexcept { return state >> 2U; }
};

/// The bits after start of frame, up to and without the data.
struct Header {
  std::uint64_t value = 0;
  int count = 0;

  constexpr void add(std::uint64_t bits, int n) noexcept {
    value = (value << static_cast<unsigned>(n)) | bits;
    count += n;
  }
};

/// Id and the flags after it: classic up to r0, FD up to BRS.
constexpr Header arbitration_header(const Frame& frame) noexcept {
  Header h;
  const unsigned remote = frame.remote ? 1 : 0;
  if (frame.extended) {
    h.add(frame.id >> 18U, 11);
    h.add(3, 2);  // SRR, IDE
    h.add(frame.id & 0x3FFFFU, 18);
    h.add(remote, 1);
    if (!frame.fd) h.add(0, 2);  // r1, r0
  } else {
    h.add(frame.id, 11);
    h.add(remote, 1);
    h.add(0, frame.fd ? 1 : 2);  // IDE and, classic, r0
  }
  if (frame.fd) {
    h.add(2, 2);  // FDF, res
    h.add(frame.bit_rate_switch ? 1 : 0, 1);
  }
  return h;
}

constexpr unsigned length_bits(const Frame& frame) noexcept {
  return static_cast<unsigned>(length_code(frame.length, frame.fd));
}

/// FD: how many dynamic stuff bits were sent modulo 8, Gray coded, and a bit for even parity (ISO
/// 11898-1:2015, 10.4.2.6).
constexpr unsigned stuff_count_field(int dynamic) noexcept {
  const unsigned n = static_cast<unsigned>(dynamic) & 7U;
  const unsigned gray = n ^ (n >> 1U);
  return (gray << 1U) | ((gray ^ (gray >> 1U) ^ (gray >> 2U)) & 1U);
}

}  // namespace bits

constexpr WireBits wire_bits(const Frame& frame) noexcept {
  bits::Header header = bits::arbitration_header(frame);
  const int payload_bytes = frame.remote ? 0 : static_cast<int>(frame.length);
  bits::Stuffer stuffer;
  if (!frame.fd) {
    header.add(bits::length_bits(frame), 4);
    stuffer.feed(header.value, header.count);
    // The register starts at zero, so leading zeros, start of frame among them, change nothing.
    unsigned crc = 0;
    const auto crc_byte = [&crc](unsigned byte) {
      crc = ((crc << 8U) & 0x7FFFU) ^ bits::kCrc15Table[((crc >> 7U) ^ byte) & 0xFFU];
    };
    for (unsigned shift = header.count > 24 ? 40 : 24; shift > 0;) {
      shift -= 8;
      crc_byte(static_cast<unsigned>(header.value >> shift) & 0xFFU);
    }
    for (int i = 0; i < payload_bytes; ++i) {
      const unsigned byte = frame.data[static_cast<std::size_t>(i)];
      stuffer.byte(byte);
      crc_byte(byte);
    }
    stuffer.feed(crc, 15);
    // CRC delimiter, acknowledge slot and delimiter, 7 bits of end of frame.
    return {1 + header.count + 8 * payload_bytes + 15 + stuffer.inserted + 10, 0};
  }

  stuffer.feed(header.value, header.count);
  const int arbitration = 1 + header.count + stuffer.inserted;  // no stuff bit can follow BRS = 1: res before it is 0
  const int stuffed_before = stuffer.inserted;
  stuffer.feed(bits::length_bits(frame), 5);  // ESI = 0: error active
  unsigned last = bits::length_bits(frame) & 1U;
  for (int i = 0; i < payload_bytes; ++i) {
    stuffer.byte(frame.data[static_cast<std::size_t>(i)]);
    last = frame.data[static_cast<std::size_t>(i)] & 1U;
  }
  // A run that ends with the data is broken by the first fixed stuff bit instead.
  const int dynamic = stuffer.inserted - (stuffer.last_sent() != last ? 1 : 0);
  const int crc_field = payload_bytes <= 16 ? 4 + 17 + 6 : 4 + 21 + 7;
  const int fast = 5 + 8 * payload_bytes + (dynamic - stuffed_before) + crc_field + 1;
  const int slow = arbitration + 9;
  return frame.bit_rate_switch ? WireBits{slow, fast} : WireBits{slow + fast, 0};
}

constexpr BitSequence encode(const Frame& frame) noexcept {
  BitSequence out;
  const auto send = [&out](unsigned bit) { (void)out.push_back(static_cast<std::uint8_t>(bit)); };

  // What is stuffed dynamically, before stuffing.
  BitSequence plain;
  const auto add = [&plain](std::uint64_t value, int count) {
    while (count-- > 0) (void)plain.push_back(static_cast<std::uint8_t>((value >> static_cast<unsigned>(count)) & 1U));
  };
  const bits::Header header = bits::arbitration_header(frame);
  add(0, 1);
  add(header.value, header.count);
  add(bits::length_bits(frame), frame.fd ? 5 : 4);
  for (std::size_t i = 0; i < frame.length && !frame.remote; ++i) add(frame.data[i], 8);
  if (!frame.fd) {
    unsigned crc = 0;
    for (const std::uint8_t bit : plain) crc = bits::crc_bit(crc, bit, bits::kCrc15, 15);
    add(crc, 15);
  }

  int dynamic = 0;
  unsigned run = 0;
  unsigned last = 2;
  for (std::size_t i = 0; i < plain.size(); ++i) {
    run = plain[i] == last ? run + 1 : 1;
    last = plain[i];
    send(last);
    if (run == 5 && !(frame.fd && i + 1 == plain.size())) {
      last ^= 1U;
      send(last);
      run = 1;
      ++dynamic;
    }
  }

  if (frame.fd) {
    const unsigned width = frame.length <= 16 ? 17 : 21;
    const unsigned polynomial = width == 17 ? bits::kCrc17 : bits::kCrc21;
    const unsigned count = bits::stuff_count_field(dynamic);
    unsigned crc = 1U << (width - 1);  // dynamic stuff bits and the stuff count are covered, fixed stuff bits are not
    for (const std::uint8_t bit : out) crc = bits::crc_bit(crc, bit, polynomial, width);
    for (unsigned i = 4; i-- > 0;) crc = bits::crc_bit(crc, (count >> i) & 1U, polynomial, width);
    const unsigned field = (count << width) | crc;
    for (unsigned i = 0; i < width + 4; ++i) {
      if (i % 4 == 0) send(out.back() ^ 1U);
      send((field >> (width + 3 - i)) & 1U);
    }
  }
  send(1);                              // CRC delimiter
  send(0);                              // acknowledge slot
  for (int i = 0; i < 8; ++i) send(1);  // acknowledge delimiter, end of frame
  return out;
}

}  // namespace mrr::can
