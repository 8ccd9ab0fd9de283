// Tests of the wire: random well-formed frames of every kind.
#pragma once

#include <array>

#include "can_protocol/frame.h"
#include "common/core/random.h"

namespace mrr::test {

inline can::Frame random_frame(Random& random) {
  can::Frame frame;
  frame.extended = random.below(3) == 0;
  frame.id = static_cast<std::uint32_t>(random.below(frame.extended ? 0x2000'0000U : 0x800U));
  frame.fd = random.below(3) == 0;
  frame.remote = !frame.fd && random.below(8) == 0;
  frame.bit_rate_switch = frame.fd && random.below(2) == 0;
  constexpr std::array<std::uint8_t, 16> kLengths{0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64};
  frame.length = kLengths[random.below(frame.fd ? 16 : 9)];
  if (frame.remote) return frame;
  // Constant and random bytes in turn, so that long runs are common.
  for (std::size_t i = 0; i < frame.length; ++i) {
    const std::uint64_t kind = random.below(4);
    frame.data[i] = static_cast<std::uint8_t>(kind == 0 ? 0x00 : kind == 1 ? 0xFF : random.below(256));
  }
  return frame;
}

}  // namespace mrr::test
