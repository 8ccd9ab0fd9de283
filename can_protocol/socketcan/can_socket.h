// Room: can_protocol/socketcan. The only place that opens a CAN socket: frames to and from a Linux interface.
// Host only (Linux). May touch can_protocol/frame.h and common/core; no CANopen, no threads.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <stdexcept>
#include <string>

#include "can_protocol/frame.h"
#include "common/core/time.h"

namespace mrr::can {

/// The interface cannot be used. `what()` is one sentence for the user, with the remedy.
class CanError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// A frame with a standard identifier passes if (its id & mask) == (id & mask). Remote frames pass too: whoever asked
/// for an identifier sees everything that comes under it. Extended frames never pass a filter.
struct CanFilter {
  std::uint32_t id = 0;
  std::uint32_t mask = 0x7FF;
};

struct CanSocketOptions {
  /// Enforced by the kernel. Empty: every frame, extended ones included.
  std::span<const CanFilter> filters{};
  /// FD frames may be sent and are received. Without it the kernel keeps them from this socket.
  bool fd = false;
  /// Wanted size of the kernel's queues; the kernel may grant less. 1 MiB is about 1,300 frames.
  int buffer_bytes = 1 << 20;
};

/// Since open().
struct CanSocketStatistics {
  std::int64_t received = 0;
  std::int64_t sent = 0;
  std::int64_t send_dropped = 0;      ///< not taken by the kernel at once (ENOBUFS, EAGAIN, interface down)
  std::int64_t receive_overflow = 0;  ///< lost because this process did not read in time (SO_RXQ_OVFL)
  std::int64_t malformed = 0;         ///< of a size or length that no CAN frame has
  std::int64_t error_frames = 0;      ///< reports of the controller's errors
  std::int64_t transmit_timeouts = 0;
  std::int64_t bus_off_events = 0;
};

/// One raw CAN socket; no call but receive(timeout) ever waits. Everything is allocated by open(); nothing afterwards.
/// An interface that is removed (an adapter unplugged) and comes back under its name is found again by receive() and
/// send(), ten times a second.
///
/// Arrival times are the kernel's (SO_TIMESTAMPNS, CLOCK_REALTIME), converted to CLOCK_MONOTONIC with an offset that is
/// measured at open(), by measure_clock_offset(), and as soon as a batch of frames shows that the system's time was
/// stepped. None is later than now.
class CanSocket {
 public:
  static constexpr std::size_t kBatch = 64;  ///< frames per system call

  /// Throws CanError: no CAN in the kernel, no such interface, interface down, FD asked for but not set up.
  [[nodiscard]] static CanSocket open(const std::string& interface, const CanSocketOptions& options = {});
  CanSocket(CanSocket&&) noexcept;
  CanSocket& operator=(CanSocket&&) noexcept;
  ~CanSocket();

  /// What has arrived, oldest first, at most kBatch frames; never waits. Empty: nothing is left. Valid until the next
  /// call. `at` is CLOCK_MONOTONIC, or as use_kernel_times() says.
  [[nodiscard]] std::span<const ReceivedFrame> receive() noexcept;
  /// As receive(), but waits up to `timeout`, in steps of the kernel's tick, for the first frame (cheapest when it is
  /// always the same); longer, at most twice as long, when the controller reports errors meanwhile. Returns
  /// earlier, empty, when a signal comes.
  [[nodiscard]] std::span<const ReceivedFrame> receive(Duration timeout) noexcept;

  /// Until frames wait to be received, `timeout` has passed (to the accuracy of the kernel's timers), or a signal
  /// comes.
  void wait(Duration timeout) const noexcept;

  /// Hands frames to the kernel. What it does not take at once is dropped and counted, never kept: nothing stale may
  /// ever move the robot. Returns how many it took.
  std::size_t send(std::span<const Frame> frames) noexcept;
  std::size_t send(const Frame& frame) noexcept { return send(std::span(&frame, 1)); }

  /// Replaces the kernel's filters. False: refused, the old ones stay. At most kMaxFilters; none: every frame passes.
  [[nodiscard]] bool set_filters(std::span<const CanFilter> filters) noexcept;
  static constexpr std::size_t kMaxFilters = 64;

  /// Drops everything that waits to be received.
  void discard_received() noexcept;
  void measure_clock_offset() noexcept;
  /// `at` stays the kernel's stamp, CLOCK_REALTIME: for comparing frames of two sockets, exact to the nanosecond. After
  /// the system's time was set back it may be later than now.
  void use_kernel_times(bool on) noexcept;

  /// For poll: readable when frames wait.
  [[nodiscard]] int fd() const noexcept;
  [[nodiscard]] const std::string& interface() const noexcept;
  /// The controller reported bus-off and has not come back.
  [[nodiscard]] bool bus_off() const noexcept;
  /// The controller reported that it is error-passive: it sees and makes errors, and may soon be bus-off. False again
  /// when it reports to be active or restarted. Error frames alone say so: a virtual interface never does by itself.
  [[nodiscard]] bool error_passive() const noexcept;
  /// The interface went down or away while in use; false again once a frame passes.
  [[nodiscard]] bool link_down() const noexcept;
  [[nodiscard]] const CanSocketStatistics& statistics() const noexcept;

 private:
  struct Impl;
  explicit CanSocket(std::unique_ptr<Impl> impl) noexcept;
  std::unique_ptr<Impl> impl_;
};

/// CLOCK_MONOTONIC.
[[nodiscard]] Time monotonic_now() noexcept;
/// CLOCK_REALTIME, which the kernel stamps frames with; may be stepped.
[[nodiscard]] Time kernel_now() noexcept;

}  // namespace mrr::can
