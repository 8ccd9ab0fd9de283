// Room: can_protocol. The CANopen slave (CiA 301), sans-I/O: given frames and the time, it says what to send.
// Freestanding, fixed memory, noexcept; it touches nothing but its object dictionary and the queue it is handed.
#pragma once

#include <limits>
#include <optional>

#include "can_protocol/frame.h"
#include "can_protocol/lss.h"
#include "can_protocol/messages.h"
#include "can_protocol/object_access.h"
#include "can_protocol/selection.h"

namespace mrr::can {

enum class WriteSource : std::uint8_t { sdo, rpdo };
enum class ResetKind : std::uint8_t { communication, node };

struct NodeConfig {
  std::uint8_t node_id = 2;                   ///< 1-127; 255: none yet, one is given by LSS
  std::uint32_t bit_rate = 1'000'000;         ///< as the shell opened the bus; informative
  bool test_objects = false;                  ///< objects marked test_only exist (--test-faults)
  Duration sdo_timeout = milliseconds(1000);  ///< an abandoned transfer is aborted after this
};

/// What a node tells its application, and asks of it. Every call comes from inside Node::handle or Node::tick.
class NodeApplication : public LssStore {
 public:
  /// A last word before an SDO write that the schema accepts (length, limits) has effect; anything but none refuses it.
  virtual Abort may_write(ObjectId, const Value&) noexcept { return Abort::none; }
  /// An object has its new value. A PDO's objects are all written before the first of these calls.
  virtual void written(ObjectId, WriteSource, Time) noexcept {}
  /// Whether written() shall tell of this object when a PDO writes it. Asked when a mapping is laid out.
  [[nodiscard]] virtual bool follows(ObjectId) const noexcept { return true; }
  /// RPDO `number` (1-4) was accepted and its objects are in force; it had arrived at `received`.
  virtual void pdo_delivered(std::uint8_t /*number*/, Time /*received*/) noexcept {}
  /// SYNC arrived (hardware time of the frame); the synchronous RPDOs before it are delivered, TPDOs go out after this
  /// call.
  virtual void sync(Time, std::optional<std::uint8_t> /*counter*/) noexcept {}
  /// A selection with a known action arrived, by RPDO or by SDO on selection_command. Repetitions are passed on too.
  virtual void selection(const SelectionCommand&, Time) noexcept {}
  /// Objects are about to be read for a TPDO that SYNC does not ask for: time to bring them up to date.
  virtual void refresh() noexcept {}
  virtual void nmt_changed(NmtState, Time) noexcept {}
  /// NMT reset: the writable objects of the range hold their power-on values again. Boot-up follows.
  virtual void reset(ResetKind, Time) noexcept {}
  /// A watched node's heartbeat stopped, or came (back).
  virtual void heartbeat_lost(std::uint8_t /*node_id*/, Time) noexcept {}
  virtual void heartbeat_seen(std::uint8_t /*node_id*/, NmtState, Time) noexcept {}
  /// 1010h and 1011h with the right signature. Default: there is no memory.
  virtual Abort store(Time) noexcept { return Abort::cannot_store; }
  virtual Abort restore_defaults(Time) noexcept { return Abort::cannot_store; }

 protected:
  ~NodeApplication() = default;
};

/// How an object dictionary comes by its values: schema defaults, then the application's own configuration, then
/// Node's constructor (adds the node id to COB-IDs), then what was stored (storage.h), then the first tick(), which
/// remembers the picture as power-on values and sends boot-up.
class Node {
 public:
  /// `od` and `application` must outlive the node.
  Node(ObjectDictionary& od, const NodeConfig& config, NodeApplication& application) noexcept;

  /// Takes one frame; answers go to `tx`. Frames that are not for this node are ignored; malformed ones are counted
  /// (count_rejected_frames) and have no effect. Frames before the first tick() are ignored.
  void handle(const ReceivedFrame& received, TransmitQueue& tx) noexcept;
  /// Timers: heartbeat, watched heartbeats, event timers, timeouts, pending EMCY. Call every control tick.
  void tick(Time now, TransmitQueue& tx) noexcept;

  /// Error `code` is present: error register, history, EMCY (once, until cleared). `detail`: EMCY bytes 3-7.
  void raise(Emergency code, const std::array<std::uint8_t, 5>& detail, Time now) noexcept;
  void raise(Emergency code, Time now) noexcept { raise(code, {}, now); }
  /// Error `code` is gone: EMCY 0000h with what remains in the error register. Nothing if it was not present.
  void clear(Emergency code, Time now) noexcept;
  [[nodiscard]] bool is_present(Emergency code) const noexcept;

  /// The CAN controller went bus-off (1029h decides the state); it came back (EMCY 8140h).
  void bus_off(Time now) noexcept;
  void bus_recovered(Time now) noexcept;

  /// Sends TPDO `number` (1-3, event-driven types) with the next tick, inhibit time permitting.
  void request_tpdo(std::uint8_t number) noexcept;

  /// Before the first tick: the node id that was stored, in place of the configured one.
  void begin_with(std::uint8_t node_id) noexcept;
  /// The parameters that a reset goes back to, for them to be stored with another node id.
  [[nodiscard]] ObjectDictionary& power_on() noexcept { return power_on_; }

  [[nodiscard]] NmtState state() const noexcept { return state_; }
  /// The objects as configured, before what was stored.
  [[nodiscard]] const ObjectDictionary& factory() const noexcept { return factory_; }
  /// `node_id` is the one in force: LSS may have changed it.
  [[nodiscard]] const NodeConfig& config() const noexcept { return config_; }

 private:
  static constexpr std::size_t kMaxPdoBytes = 8;
  static constexpr std::size_t kMaxErrors = 48;  // there are fewer codes
  static constexpr std::size_t kMaxPendingEmergencies = 16;
  static constexpr std::size_t kMaxWatched = 4;

  struct Rpdo {
    std::array<std::uint8_t, kMaxPdoBytes> data{};
    Time received{};
    bool watched = false;  ///< one has come: the deadline runs
    bool late = false;
    bool too_short = false;  ///< the last one was
  };
  struct Tpdo {
    std::array<std::uint8_t, kMaxPdoBytes> last{};  ///< as last sent
    Time sent{};
    bool has_sent = false;
    bool requested = false;
    bool waits_for_start = false;  ///< for the SYNC counter to reach the start value
    std::uint8_t syncs = 0;        ///< SYNCs since it was sent
  };
  struct Watched {
    bool running = false;
    bool lost = false;
    Time last{};
  };
  struct Error {
    Emergency code;
    std::uint8_t register_bits;
  };
  struct PendingEmergency {
    std::uint16_t code;
    std::uint8_t error_register;
    std::array<std::uint8_t, 5> detail;
  };
  enum class Transfer : std::uint8_t { none, upload, download };
  struct Sdo {
    Transfer transfer = Transfer::none;
    const Entry* entry = nullptr;
    Value value;
    std::size_t at = 0;         ///< bytes transferred
    std::size_t announced = 0;  ///< download: size announced
    bool has_announced = false;
    bool toggle = false;
    Time last{};
  };
  /// A mapped object: an entry, or a dummy (CiA 301: filler in an RPDO) of `size` bytes when null.
  struct Mapped {
    const Entry* entry;
    std::uint8_t size;
    std::uint16_t offset = 0;  ///< of the object in ObjectDictionary
    bool checked = false;      ///< RPDO: not every value is one
    bool followed = false;     ///< RPDO: somebody wants to hear of a new value
  };
  /// A mapping as it is used: looked up once when it changes, not at every PDO. No objects: nothing usable is mapped.
  struct Layout {
    StaticVector<Mapped, kMaxMappedObjects> objects;
    std::size_t bytes = 0;
    bool checked = false;  ///< any of them
    bool followed = false;
  };

  void boot_up(Time now, TransmitQueue& tx) noexcept;
  void restart_tpdo(std::size_t i) noexcept;
  void enter(NmtState state, Time now) noexcept;
  void reset(ResetKind kind, Time now, TransmitQueue& tx) noexcept;
  void error_behaviour(Time now) noexcept;

  /// COB-IDs that contain the old id contain the new one afterwards; those that a client chose stay.
  void change_node_id(std::uint8_t to) noexcept;
  [[nodiscard]] bool is_unconfigured() const noexcept { return config_.node_id == kUnconfiguredNodeId; }
  void handle_lss(const Frame& f, Time now, TransmitQueue& tx) noexcept;
  void handle_nmt(const Frame& f, Time now, TransmitQueue& tx) noexcept;
  inline void handle_sync(const Frame& f, Time now, TransmitQueue& tx) noexcept;
  void handle_heartbeat(const Frame& f, Time now) noexcept;
  inline void handle_rpdo(std::size_t i, const Frame& f, Time now) noexcept;
  /// Until then another one has to come.
  [[nodiscard]] Time deadline_of(std::size_t i) const noexcept {
    return rpdo_[i].received + milliseconds(od_.rpdo_communication[i].event_timer_ms);
  }
  inline void deliver(std::size_t i, Time now) noexcept;
  void handle_sdo(const Frame& f, Time now, TransmitQueue& tx) noexcept;
  void sdo_download(const Frame& f, Time now, TransmitQueue& tx) noexcept;
  void sdo_download_segment(const Frame& f, Time now, TransmitQueue& tx) noexcept;
  void sdo_upload(const Frame& f, Time now, TransmitQueue& tx) noexcept;
  void sdo_upload_segment(const Frame& f, Time now, TransmitQueue& tx) noexcept;
  void sdo_abort(std::uint16_t index, std::uint8_t sub, Abort code, TransmitQueue& tx) noexcept;
  void sdo_reply(const std::array<std::uint8_t, 8>& data, TransmitQueue& tx) noexcept;

  /// Everything that decides about one write by SDO, then its effect.
  Abort write(const Entry& entry, const Value& value, Time now) noexcept;
  [[nodiscard]] Abort check_communication(const Entry& entry, const Value& value) const noexcept;
  [[nodiscard]] Abort check_pdo_communication(const PdoCommunication& pdo, bool receive, std::uint8_t sub,
                                              const Value& value) const noexcept;
  [[nodiscard]] Abort check_pdo_mapping(const PdoMapping& map, const PdoCommunication& pdo, bool receive,
                                        std::uint8_t sub, const Value& value) const noexcept;
  [[nodiscard]] Abort find_mapped(std::uint32_t mapping, bool receive, Mapped& out) const noexcept;
  [[nodiscard]] Abort find(std::uint16_t index, std::uint8_t sub, const Entry*& out) const noexcept;
  [[nodiscard]] Layout layout_of(const PdoMapping& map, bool receive) const noexcept;
  void lay_out_pdos() noexcept;
  /// Which PDOs have something to do when: those with a deadline, those that SYNC sends and those that it does not.
  void sort_pdos() noexcept;
  void communication_written(const Entry& entry, Time now) noexcept;
  void after_write(ObjectId id, WriteSource source, Time now) noexcept;

  /// The mapped objects' bytes and their number; 0 if nothing is mapped.
  [[nodiscard]] inline std::size_t pack(std::size_t i, std::array<std::uint8_t, kMaxPdoBytes>& data) const noexcept;
  void send_tpdo(std::size_t i, Time now, TransmitQueue& tx) noexcept;
  inline void tick_tpdo(std::size_t i, Time now, TransmitQueue& tx) noexcept;
  inline void tick_watched(Time now) noexcept;
  /// When tick() has something to do next, unless something happens before: then wake_at_ is set to the beginning.
  [[nodiscard]] inline Time next_wake(Time now) const noexcept;
  void wake() noexcept { wake_at_ = kNow; }
  inline void tick_emergency(Time now, TransmitQueue& tx) noexcept;
  void queue_emergency(std::uint16_t code, const std::array<std::uint8_t, 5>& detail) noexcept;
  void update_error_register() noexcept;
  void send(const Frame& f, TransmitQueue& tx) noexcept;
  void reject() noexcept { ++od_.count_rejected_frames; }

  ObjectDictionary& od_;
  NodeConfig config_;
  NodeApplication& application_;
  ObjectDictionary factory_;   ///< as configured, before what was stored
  ObjectDictionary power_on_;  ///< what a reset goes back to
  NmtState state_ = NmtState::initialising;
  bool started_ = false;
  bool overflowed_ = false;
  static constexpr Time kNow{std::numeric_limits<std::int64_t>::min()};
  Time wake_at_ = kNow;
  Time next_heartbeat_{};
  std::array<Layout, kRpdoCount> rpdo_layout_{};
  std::array<Layout, kTpdoCount> tpdo_layout_{};
  static constexpr std::uint32_t kNoId = 0xFFFF'FFFFU;
  std::array<std::uint32_t, kRpdoCount> rpdo_id_{};  ///< kNoId: not valid
  std::uint32_t pending_rpdos_ = 0;                  ///< bit i: RPDO i waits for SYNC
  std::uint32_t timed_rpdos_ = 0;
  std::uint32_t timed_tpdos_ = 0;
  std::uint32_t synchronous_tpdos_ = 0;
  std::array<Rpdo, kRpdoCount> rpdo_{};
  std::array<Tpdo, kTpdoCount> tpdo_{};
  std::array<Watched, kMaxWatched> watched_{};
  bool watches_ = false;  ///< any of them was ever running
  StaticVector<Error, kMaxErrors> errors_;
  RingBuffer<PendingEmergency, kMaxPendingEmergencies> emergencies_;
  bool has_sent_emergency_ = false;
  Time emergency_sent_{};
  Sdo sdo_;
  LssSlave lss_;
};

}  // namespace mrr::can
