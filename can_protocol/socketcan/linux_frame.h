// Room: can_protocol/socketcan. Our frames <-> Linux's can_frame and canfd_frame, as values. Host only, no I/O.
#pragma once

#include <linux/can.h>

#include <algorithm>
#include <cstring>
#include <optional>

#include "can_protocol/frame.h"

namespace mrr::can {

constexpr bool is_fd_length(std::size_t n) noexcept {
  return n <= 8 || n == 12 || n == 16 || n == 20 || n == 24 || n == 32 || n == 48 || n == 64;
}

/// `size`: what the kernel delivered, CAN_MTU or CANFD_MTU. Empty: not a data or remote frame of CAN.
inline std::optional<Frame> from_linux(const canfd_frame& in, std::size_t size) noexcept {
  const bool fd = size == CANFD_MTU;
  if (!(fd || size == CAN_MTU)) return std::nullopt;
  if ((in.can_id & CAN_ERR_FLAG) != 0) return std::nullopt;
  if (fd ? !is_fd_length(in.len) : in.len > CAN_MAX_DLEN) return std::nullopt;
  Frame f;
  f.extended = (in.can_id & CAN_EFF_FLAG) != 0;
  f.remote = !fd && (in.can_id & CAN_RTR_FLAG) != 0;
  f.id = in.can_id & (f.extended ? CAN_EFF_MASK : CAN_SFF_MASK);
  f.fd = fd;
  f.bit_rate_switch = fd && (in.flags & CANFD_BRS) != 0;
  f.length = in.len;
  if (!f.remote) std::copy_n(in.data, in.len, f.data.begin());
  return f;
}

/// Returns how many bytes to write, or 0 if the frame cannot be sent: length, identifier.
inline std::size_t to_linux(const Frame& f, canfd_frame& out) noexcept {
  if (f.fd ? !is_fd_length(f.length) : f.length > CAN_MAX_DLEN) return 0;
  if (f.id > (f.extended ? CAN_EFF_MASK : CAN_SFF_MASK)) return 0;
  std::memset(&out, 0, sizeof out);
  out.can_id = f.id | (f.extended ? CAN_EFF_FLAG : 0U) | (f.remote && !f.fd ? CAN_RTR_FLAG : 0U);
  out.len = f.length;
  if (f.fd && f.bit_rate_switch) out.flags = CANFD_BRS;
  if (!f.remote) std::copy_n(f.data.begin(), f.length, out.data);
  return f.fd ? CANFD_MTU : CAN_MTU;
}

}  // namespace mrr::can
