// Room: module_fw/faults. What is wrong with the joint, for how long, and the hardest reaction that follows from it:
// the table of faults (can_protocol/schema) at work. May touch the generated table. Freestanding.
#pragma once

#include <array>
#include <cstdint>

#include "can_protocol/faults.h"
#include "common/core/time.h"

namespace mrr::fw {

/// One tick: begin_tick(), check() for each cause, then the results.
class FaultMonitor {
 public:
  explicit FaultMonitor(Duration tick) noexcept {
    for (std::size_t i = 0; i < can::kFaultCount; ++i) {
      reaction_[i] = can::kFaults[i].reaction;
      needed_[i] = ticks_for(can::kFaults[i].time, tick);
    }
  }

  /// Where an object configures it instead of the table.
  void set_reaction(can::Fault fault, can::Reaction reaction) noexcept { reaction_[at(fault)] = reaction; }
  [[nodiscard]] can::Reaction reaction_of(can::Fault fault) const noexcept { return reaction_[at(fault)]; }

  void begin_tick() noexcept {
    present_ = 0;
    worst_ = can::Reaction::report;
    cause_ = can::Fault::none;
  }
  /// `bad`, and for longer than the table's time: the fault is in force. @returns whether it is.
  bool check(can::Fault fault, bool bad) noexcept {
    const bool in_force = lasts(fault, bad);
    if (in_force) find(fault);
    return in_force;
  }
  /// The same, but what follows is the caller's choice.
  bool lasts(can::Fault fault, bool bad) noexcept {
    std::uint16_t& ticks = ticks_[at(fault)];
    if (!bad) {
      ticks = 0;
      return false;
    }
    if (ticks < 0xFFFFU) ++ticks;
    return ticks > needed_[at(fault)];
  }
  /// In force in this tick, whatever the table's time.
  void find(can::Fault fault) noexcept {
    present_ |= bit(fault);
    const can::Reaction reaction = reaction_[at(fault)];
    if (cause_ == can::Fault::none || reaction > worst_) {
      worst_ = reaction;
      cause_ = fault;
    }
  }
  /// Not looked at in this tick: its time starts anew.
  void forget(can::Fault fault) noexcept { ticks_[at(fault)] = 0; }

  /// Causes in force in this tick, a bit each.
  [[nodiscard]] std::uint64_t present() const noexcept { return present_; }
  [[nodiscard]] bool is_present(can::Fault fault) const noexcept { return (present_ & bit(fault)) != 0; }
  /// The one with the hardest reaction; none.
  [[nodiscard]] can::Fault cause() const noexcept { return cause_; }
  [[nodiscard]] can::Reaction worst() const noexcept { return worst_; }
  /// One is in force that ends in FAULT.
  [[nodiscard]] bool disables() const noexcept { return cause_ != can::Fault::none && worst_ >= can::Reaction::stop; }

  [[nodiscard]] static constexpr std::uint64_t bit(can::Fault fault) noexcept { return 1ULL << at(fault); }

 private:
  static constexpr std::size_t at(can::Fault fault) noexcept { return static_cast<std::size_t>(fault); }
  static constexpr std::uint16_t ticks_for(Duration time, Duration tick) noexcept {
    const std::int64_t n = tick.ns > 0 ? time / tick : 0;
    return static_cast<std::uint16_t>(n < 0xFFFE ? n : 0xFFFE);
  }
  static_assert(can::kFaultCount <= 64);

  std::array<std::uint16_t, can::kFaultCount> needed_{};
  std::array<std::uint16_t, can::kFaultCount> ticks_{};
  std::array<can::Reaction, can::kFaultCount> reaction_{};
  std::uint64_t present_ = 0;
  can::Reaction worst_ = can::Reaction::report;
  can::Fault cause_ = can::Fault::none;
};

}  // namespace mrr::fw
