// Room: can_protocol. A CAN frame as a value. Freestanding.
#pragma once

#include <array>
#include <cstdint>

#include "common/core/containers.h"
#include "common/core/time.h"

namespace mrr::can {

inline constexpr std::size_t kMaxPayload = 64;

/// One classic or FD data or remote frame. `length` is the number of payload bytes (0-8 classic; FD: 0-8, 12, 16, 20,
/// 24, 32, 48, 64).
struct Frame {
  std::uint32_t id = 0;  ///< 11 bit, or 29 bit when `extended`
  bool extended = false;
  bool remote = false;
  bool fd = false;
  bool bit_rate_switch = false;  ///< FD only: payload at the data bit rate
  std::uint8_t length = 0;
  std::array<std::uint8_t, kMaxPayload> data{};

  friend bool operator==(const Frame&, const Frame&) = default;
};

/// A frame with the time its last bit was received, on the receiver's own clock (hardware timestamp).
struct ReceivedFrame {
  Frame frame;
  Time at;
};

/// Frames a core wants sent, oldest first. Small on purpose: nothing stale may pile up.
inline constexpr std::size_t kTransmitCapacity = 64;
using TransmitQueue = StaticVector<Frame, kTransmitCapacity>;

}  // namespace mrr::can
