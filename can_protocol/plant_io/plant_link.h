// Room: can_protocol/plant_io. A participant's end of the plant bus: announce, wait for a tick, take from the robot's
// bus what belongs to it, answer. For modules and for the supervisor. Host only; may touch socketcan/.
#pragma once

#include <algorithm>
#include <cstdint>
#include <optional>
#include <span>
#include <string>

#include "can_protocol/plant_io/plant_frames.h"
#include "can_protocol/socketcan/can_socket.h"
#include "common/core/containers.h"

namespace mrr::plant_io {

/// Frames of the robot's bus, cut at ticks: whatever was received up to a tick belongs to it, the rest to the next
/// one. So what is sent in tick k is seen by everybody in tick k+1, however the processes were scheduled. Apart from
/// I/O: tests feed it.
class TickInbox {
 public:
  static constexpr std::size_t kCapacity = 512;

  /// Frames in order of arrival. False: full, this one was not taken.
  [[nodiscard]] bool push(const can::ReceivedFrame& frame) noexcept { return waiting_.push(frame); }
  /// True when a frame waits that arrived after `limit`: reading on brings nothing for this tick.
  [[nodiscard]] bool reaches_beyond(Time limit) const noexcept {
    return !waiting_.empty() && waiting_[waiting_.size() - 1].at > limit;
  }
  [[nodiscard]] std::size_t size() const noexcept { return waiting_.size(); }
  /// What arrived up to `limit`, in the order in which a wire would have arbitrated it (by identifier, else as it
  /// came), all stamped `at`. Valid until the next call. `now`, of the clock of `limit`: what claims to have arrived
  /// later still was stamped before that clock was set back, and is taken.
  [[nodiscard]] std::span<const can::ReceivedFrame> take(Time limit, Time at, Time now = Time{INT64_MAX}) noexcept;
  /// The same in order of arrival, with their own times of arrival: for free-running.
  [[nodiscard]] std::span<const can::ReceivedFrame> take_as_received(Time limit) noexcept;
  /// Forgets what waits.
  void clear() noexcept { waiting_.clear(); }
  /// Reads `robot` until it is empty, or a frame beyond `limit` is there, or there is no room (the rest waits in the
  /// kernel).
  void fill(can::CanSocket& robot, Time limit) noexcept;

 private:
  RingBuffer<can::ReceivedFrame, kCapacity> waiting_;
  StaticVector<can::ReceivedFrame, kCapacity> taken_;
};

/// A tick as one participant sees it.
struct OwnTick {
  /// Lockstep: simulated time, moved forward when the plant was restarted so that it never runs backwards.
  /// Free-running: the instant on CLOCK_MONOTONIC at which it was due, however late it comes.
  Time now;
  Duration since_last;  ///< of the own clock; 0 in the first tick
  bool lockstep = false;
  bool ending = false;  ///< the plant stops after this one
  std::uint32_t number = 0;
  Block sensors{};  ///< of this joint; zero for the supervisor
  Time arrived;     ///< the kernel's stamp, CLOCK_REALTIME
};

struct PlantLinkStatistics {
  std::int64_t ticks = 0;
  std::int64_t skipped = 0;  ///< ticks that asked this participant but were overtaken by a later one
  std::int64_t malformed = 0;
};

class PlantLink {
 public:
  /// Throws can::CanError. `configuration_hash`: see Announcement.
  PlantLink(const std::string& interface, Participant self, std::uint32_t configuration_hash = 0);

  /// Waits up to `timeout` (wall clock) for a tick that asks this participant; announces it meanwhile. Empty: none
  /// came, or a signal did. Of several that wait, the last.
  [[nodiscard]] std::optional<OwnTick> wait(Duration timeout) noexcept;
  /// The same without waiting, for a participant with a clock of its own (free-running).
  [[nodiscard]] std::optional<OwnTick> poll() noexcept { return wait({}); }

  /// Lockstep: the frames of the robot's bus that belong to this tick, stamped with the own time of the tick before.
  /// Valid until the next call.
  [[nodiscard]] std::span<const can::ReceivedFrame> robot_frames(can::CanSocket& robot, const OwnTick& tick) noexcept;

  /// Drops what the robot's bus brought up to this tick: it was for whoever was here before. What came later stays.
  void discard_up_to(can::CanSocket& robot, const OwnTick& tick) noexcept;

  /// To be called after the frames of the tick were sent on the robot's bus. `leaving`: the plant shall go on without
  /// this participant.
  void answer(const OwnTick& tick, const AnswerPayload& payload, bool leaving = false) noexcept;

  /// Leaves without a tick to answer, if the plant counts on this participant.
  void leave() noexcept;

  /// The own clock went on without the plant and is now here: later ticks come after it.
  void advance_clock(Time own_now) noexcept;

  /// True from the first tick that asked this participant until wait() times out, the plant drops it, or forget().
  [[nodiscard]] bool joined() const noexcept { return joined_; }
  /// The plant is taken for lost: announce again. Frames of the robot's bus that wait for its ticks are dropped.
  void forget() noexcept;

  [[nodiscard]] int fd() const noexcept { return socket_.fd(); }
  [[nodiscard]] const PlantLinkStatistics& statistics() const noexcept { return statistics_; }

 private:
  void announce() noexcept;
  void take(const can::ReceivedFrame& received, std::optional<OwnTick>& out) noexcept;

  Participant self_;
  std::uint32_t configuration_hash_;
  can::CanSocket socket_;
  TickInbox inbox_;
  Block block_{};  ///< of the group's own frame, until the go
  std::uint32_t block_number_ = 0;
  bool joined_ = false;
  bool started_ = false;
  bool left_ = false;
  Time announced_{};
  Time own_now_{};
  Duration clock_shift_{};
  Time instant_{};  ///< free-running: of the last tick
  PlantLinkStatistics statistics_;
};

}  // namespace mrr::plant_io
