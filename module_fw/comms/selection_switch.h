// Room: module_fw/comms. The selection broadcast as one module sees it: arm, now, cancel; when it is due; what to
// acknowledge. May touch can_protocol/selection.h, module_fw/control/sync_pll.h. Freestanding.
#pragma once

#include <cstdint>
#include <optional>

#include "can_protocol/selection.h"
#include "module_fw/control/sync_pll.h"

namespace mrr::fw {

class SelectionSwitch {
 public:
  explicit SelectionSwitch(std::uint8_t bit) noexcept : bit_(bit) {}

  /// What the module knows when a selection arrives.
  struct Context {
    Time now;
    bool allowed = false;  ///< the joint is under control and may change its law
    std::uint8_t counter_overflow = 0;
    std::optional<std::uint8_t> counter;  ///< of the last SYNC
  };

  /// A selection arrived. A repetition (same sequence) of the last accepted one has no effect.
  void command(const can::SelectionCommand& command, const Context& context, const SyncPll& pll) noexcept;
  /// A SYNC arrived: the instant an armed selection is due is predicted anew.
  void on_sync(std::uint8_t counter, std::uint8_t counter_overflow, const SyncPll& pll) noexcept;
  /// The law to change to, in the first tick at or after the instant; nothing otherwise. `period`: of SYNC; an order
  /// that could not be asked for until ten periods after its instant is dropped.
  std::optional<bool> due(Time now, Duration period) noexcept;
  /// Forgets what is armed (fault, stop by the user).
  void disarm() noexcept { armed_ = false; }
  /// Forgets everything, the sequence too: the joint was enabled anew.
  void reset() noexcept { *this = SelectionSwitch(bit_); }

  [[nodiscard]] bool armed() const noexcept { return armed_; }
  /// selection_acknowledged (2010h sub 5).
  [[nodiscard]] std::uint8_t acknowledgement() const noexcept;

 private:
  /// Periods from SYNC `from` to SYNC `to`, counters running 1..overflow: the nearer way round.
  static std::int32_t periods_between(std::uint8_t from, std::uint8_t to, std::uint8_t overflow) noexcept;

  std::uint8_t bit_;
  std::uint8_t sequence_ = 0;  ///< last accepted, 0: none
  bool refused_ = false;
  bool armed_ = false;
  bool timed_ = false;  ///< armed for a SYNC, as opposed to now
  bool to_active_ = true;
  std::uint8_t counter_ = 0;
  Duration offset_;
  Time due_at_;
};

}  // namespace mrr::fw
