// Room: sim_vcan/wire. A simulated CAN wire on virtual time: arbitration, bit-accurate frame times, finite transmit
// queues, error counters and bus-off. Uses common/core and can_protocol; no I/O, no clock, no heap after construction.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "can_protocol/bit_timing.h"
#include "can_protocol/frame.h"
#include "common/core/containers.h"
#include "common/core/random.h"
#include "common/core/time.h"

namespace mrr::sim {

/// Ports are numbered 0 .. ports-1.
inline constexpr int kMaxPorts = 32;

struct BusConfig {
  int ports = 2;  ///< 1 .. kMaxPorts
  can::BitRates bit_rates{};
  int queue_capacity = 16;         ///< frames waiting per port, the one on the wire included
  double error_probability = 0.0;  ///< that any one transmission is hit by a disturbance all nodes see
  std::uint64_t seed = 1;          ///< for disturbances only
};

/// A frame that reached the end of its last bit.
struct Delivery {
  int from = 0;
  can::Frame frame;
  Time at;                      ///< end of frame
  std::uint32_t receivers = 0;  ///< bit i: port i has received it

  [[nodiscard]] bool reaches(int port) const noexcept { return ((receivers >> static_cast<unsigned>(port)) & 1U) != 0; }
};

/// Fault confinement of ISO 11898-1.
enum class ErrorState : std::uint8_t { kActive, kPassive, kBusOff };

struct PortStatus {
  int transmit_errors = 0;  ///< TEC
  int receive_errors = 0;   ///< REC
  ErrorState state = ErrorState::kActive;
  bool connected = true;
  int queued = 0;
  std::int64_t sent = 0;  ///< frames that reached end of frame
  std::int64_t received = 0;
  std::int64_t overflows = 0;  ///< send() refused: queue full (ENOBUFS)
  std::int64_t refused = 0;    ///< send() refused: bus-off, disconnected or malformed
  std::int64_t discarded = 0;  ///< queued frames thrown away by bus-off, disconnection or clear_queue()
};

struct IdStatistics {
  std::int64_t frames = 0;
  std::int64_t bits = 0;       ///< intermission included
  Duration worst_queue_delay;  ///< from send() to the start of the transmission that succeeded
};

struct BusStatistics {
  std::int64_t frames = 0;
  std::int64_t error_frames = 0;
  std::int64_t overflows = 0;
  std::int64_t identifier_conflicts = 0;  ///< two ports started the same arbitration field at once
  Duration busy;                          ///< wire not free: frames, intermission, error frames
  Duration elapsed;
  Duration worst_queue_delay;

  /// Share of the time in which the wire was not free, 0 .. 1.
  [[nodiscard]] double load() const noexcept { return elapsed.ns > 0 ? busy.seconds() / elapsed.seconds() : 0.0; }
};

/// What a fault does to the next transmissions of an identifier.
enum class WireFault : std::uint8_t {
  kCorrupt,  ///< seen by all: error frame, counters, retransmission
  kDrop,  ///< the chosen receivers lose it without noticing (an overrun in their controller); the sender sees success
};

/// All nodes on one wire. The caller owns time: send() at the current instant, advance() to a later one.
///
/// A frame whose start falls exactly on `until` is not started by that advance(): others may still send at this instant
/// and must take part in its arbitration. Frames of one port leave in the order of send(). Two ports that start the
/// same arbitration field at once would destroy each other's frame on a real wire; here the lower port goes first and
/// it is counted.
class Bus {
 public:
  explicit Bus(const BusConfig& config);

  /// Queues a frame at `now`, which must not be before the last advance() (it is moved up to it).
  /// False: not queued; the reason is in status(port).
  [[nodiscard]] bool send(int port, const can::Frame& frame, Time now) noexcept;

  /// No frame is delivered before this time unless more is sent. Empty: nothing is on its way.
  [[nodiscard]] std::optional<Time> next_event() const noexcept;

  /// Runs the wire up to and including `until`; sink(const Delivery&) is called for each frame in order of time. The
  /// sink may call send() with the delivery's time.
  template <typename Sink>
  void advance(Time until, Sink&& sink) {
    while (run_until(until)) sink(static_cast<const Delivery&>(delivery_));
  }

  /// Throws away what a port has queued and not yet begun to send: nothing stale goes out later.
  void clear_queue(int port) noexcept;
  /// A disconnected port hears nothing, acknowledges nothing, and loses its queue and what it is sending.
  void connect(int port, bool connected) noexcept;
  /// Leaves bus-off after 128 x 11 recessive bit times (taken as if the wire were idle), counters at zero.
  void restart(int port, Time now) noexcept;

  /// The next `count` transmissions of this identifier suffer the fault. `receivers` matters for kDrop.
  /// False: too many faults are pending (kMaxFaults).
  bool inject(WireFault fault, std::uint32_t id, bool extended = false, int count = 1,
              std::uint32_t receivers = 0xFFFF'FFFFU) noexcept;
  void set_error_probability(double probability) noexcept { config_.error_probability = probability; }

  [[nodiscard]] int ports() const noexcept { return config_.ports; }
  [[nodiscard]] const PortStatus& status(int port) const noexcept { return at(port).status; }
  /// Since construction or reset_statistics().
  [[nodiscard]] BusStatistics statistics() const noexcept;
  /// Standard data and remote frames of one identifier, 0 .. 0x7FF.
  [[nodiscard]] const IdStatistics& standard_id(std::uint32_t id) const noexcept { return by_id_[id & 0x7FFU]; }
  /// All extended frames together.
  [[nodiscard]] const IdStatistics& extended_ids() const noexcept { return by_id_[kExtendedSlot]; }
  void reset_statistics() noexcept;

  static constexpr std::size_t kMaxFaults = 32;

 private:
  struct Queued {
    can::Frame frame;
    Time since;
    std::uint64_t key = 0;
  };
  struct Port {
    std::vector<Queued> ring;  // capacity fixed at construction
    std::size_t head = 0;
    Time may_send_from;  // suspend transmission, bus-off recovery
    bool recovering = false;
    PortStatus status;
  };
  struct PendingFault {
    WireFault kind = WireFault::kCorrupt;
    std::uint32_t id = 0;
    bool extended = false;
    int count = 0;
    std::uint32_t receivers = 0;
  };
  struct Start {
    int port = -1;
    Time at;
    bool conflict = false;
  };
  static constexpr std::size_t kExtendedSlot = 0x800;

  [[nodiscard]] Port& at(int port) noexcept { return ports_[static_cast<std::size_t>(port)]; }
  [[nodiscard]] const Port& at(int port) const noexcept { return ports_[static_cast<std::size_t>(port)]; }
  [[nodiscard]] const Queued& head(int port) const noexcept { return at(port).ring[at(port).head]; }
  [[nodiscard]] static bool listening(const Port& port) noexcept;
  /// Bit mask of the ports that hear the wire, without the port `except` (by default the sender).
  [[nodiscard]] std::uint32_t listeners(int except) const noexcept;
  [[nodiscard]] std::uint32_t listeners() const noexcept { return listeners(sender_); }
  [[nodiscard]] Start next_start() const noexcept;
  bool run_until(Time until) noexcept;
  void begin(const Start& start) noexcept;
  bool finish() noexcept;
  void settle() noexcept;
  static void update_state(Port& port) noexcept;
  void suspend_if_passive(Port& port) noexcept;
  static void discard(Port& port, int keep) noexcept;
  [[nodiscard]] Duration nominal_bits(std::int64_t bits) const noexcept;
  std::optional<PendingFault> take_fault(WireFault kind, const can::Frame& frame) noexcept;

  BusConfig config_;
  std::vector<Port> ports_;
  std::vector<IdStatistics> by_id_;
  StaticVector<PendingFault, kMaxFaults> faults_;
  Random random_;
  BusStatistics statistics_;
  Time now_;
  Time statistics_since_;
  Time idle_from_;      // the wire is free from then on
  int recovering_ = 0;  // ports on their way out of bus-off
  // The transmission on the wire.
  int sender_ = -1;
  bool failing_ = false;  // will end in an error frame
  bool unacknowledged_ = false;
  Time started_;
  Time ends_;  // end of frame, or end of the error frame
  int frame_bits_ = 0;
  Delivery delivery_;
};

}  // namespace mrr::sim
