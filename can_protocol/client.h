// Room: can_protocol. The master's side, sans-I/O: SDO client and all that builds or reads a module's messages.
// Freestanding, fixed memory, noexcept. NMT, SYNC, heartbeat, EMCY: messages.h; PDOs: pdo.h; selection: selection.h.
#pragma once

#include <span>

#include "can_protocol/messages.h"
#include "can_protocol/object_access.h"
#include "can_protocol/pdo.h"
#include "can_protocol/selection.h"
#include "can_protocol/units.h"

namespace mrr::can {

/// The selection broadcast (COB-ID 181h): one frame for all modules.
constexpr Frame selection_frame(const SelectionCommand& c) noexcept {
  return pack_rpdo4({c.mask, c.sync_counter, c.offset_us, selection_byte(c.sequence, c.action)});
}
/// Nothing if it is no selection, or its action is unknown.
constexpr std::optional<SelectionCommand> parse_selection(const Frame& f) noexcept {
  if (f.id != kRpdo4CobId || f.length != 8) return std::nullopt;
  const auto v = unpack_rpdo4(f);
  return v ? selection_from(*v) : std::nullopt;
}

/// One SDO transfer at a time with one node: start it, then handle() every frame and tick() every cycle until it is
/// done or failed. Expedited and segmented, objects up to kMaxObjectSize bytes.
class SdoClient {
 public:
  enum class Status : std::uint8_t { idle, busy, done, failed };

  /// timeout: for each answer.
  explicit SdoClient(std::uint8_t node_id, Duration timeout = milliseconds(500)) noexcept
      : node_id_(node_id), timeout_(timeout) {}

  /// Both start a transfer whose first frame goes out with the next tick(). False, and no effect, while busy or if
  /// the data is larger than kMaxObjectSize.
  bool upload(std::uint16_t index, std::uint8_t sub) noexcept;
  bool download(std::uint16_t index, std::uint8_t sub, std::span<const std::uint8_t> data) noexcept;

  bool upload(ObjectId id) noexcept { return upload(entry_of(id).index, entry_of(id).sub); }
  /// With the object's own type and size. False as well if the type is no integer, no real.
  bool download_integer(ObjectId id, std::int64_t value) noexcept;
  bool download_real(ObjectId id, float value) noexcept;

  void handle(const Frame& f, Time now, TransmitQueue& tx) noexcept;
  void tick(Time now, TransmitQueue& tx) noexcept;
  /// Gives up a running transfer without telling the server.
  void cancel() noexcept { status_ = Status::idle; }

  [[nodiscard]] Status status() const noexcept { return status_; }
  [[nodiscard]] bool busy() const noexcept { return status_ == Status::busy; }
  /// Why it failed: the server's code, or timeout, toggle, unknown_command found here.
  [[nodiscard]] Abort abort_code() const noexcept { return abort_; }
  /// What was uploaded; valid when done.
  [[nodiscard]] const Value& value() const noexcept { return value_; }
  [[nodiscard]] std::uint16_t index() const noexcept { return index_; }
  [[nodiscard]] std::uint8_t sub() const noexcept { return sub_; }

 private:
  enum class Step : std::uint8_t { start, upload_first, upload_segment, download_first, download_segment };
  bool begin(std::uint16_t index, std::uint8_t sub, bool is_upload) noexcept;
  void fail(Abort code, bool tell, TransmitQueue& tx) noexcept;
  void send(const std::array<std::uint8_t, 8>& data, Time now, TransmitQueue& tx) noexcept;
  void send_segment(Time now, TransmitQueue& tx) noexcept;

  std::uint8_t node_id_;
  Duration timeout_;
  Status status_ = Status::idle;
  Step step_ = Step::start;
  bool is_upload_ = false;
  bool toggle_ = false;
  std::uint16_t index_ = 0;
  std::uint8_t sub_ = 0;
  Value value_;
  std::size_t at_ = 0;
  std::size_t announced_ = 0;
  bool has_announced_ = false;
  Abort abort_ = Abort::none;
  Time sent_{};
};

}  // namespace mrr::can
