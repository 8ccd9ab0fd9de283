// Room: module_fw/faults. What is wrong with the joint, for how long, and the hardest reaction that follows from it:
// the table of faults (can_protocol/schema) at work. May touch the generated table. Freestanding.
#pragma once

#include <array>
#include <bit>
#include <cstdint>

#include "can_protocol/faults.h"
#include "common/core/time.h"

namespace mrr::fw {

/// For so long in a row. Exactly the time is not longer than the time.
class Persistence {
 public:
  Persistence(Duration time, Duration tick) noexcept : needed_(ticks_for(time, tick)) {}
  /// One tick. @returns whether `bad` has lasted.
  bool update(bool bad) noexcept {
    if (!bad) {
      ticks_ = 0;
      return false;
    }
    if (ticks_ < 0xFFFFU) ++ticks_;
    return ticks_ > needed_;
  }
  static constexpr std::uint16_t ticks_for(Duration time, Duration tick) noexcept {
    const std::int64_t n = tick.ns > 0 ? time / tick : 0;
    return static_cast<std::uint16_t>(n < 0xFFFE ? n : 0xFFFE);
  }

 private:
  std::uint16_t needed_;
  std::uint16_t ticks_ = 0;
};

/// One tick: begin_tick(), check() and find() for each cause, conclude(), then the results. A good tick costs a check
/// two instructions; what is not looked at in a tick counts as good.
class FaultMonitor {
 public:
  explicit FaultMonitor(Duration tick) noexcept {
    for (std::size_t i = 0; i < can::kFaultCount; ++i) {
      reaction_[i] = can::kFaults[i].reaction;
      needed_[i] = Persistence::ticks_for(can::kFaults[i].time, tick);
    }
  }

  /// Where an object configures it instead of the table.
  void set_reaction(can::Fault fault, can::Reaction reaction) noexcept { reaction_[at(fault)] = reaction; }
  [[nodiscard]] can::Reaction reaction_of(can::Fault fault) const noexcept { return reaction_[at(fault)]; }

  /// `standing`: causes that are in force already, a bit each.
  void begin_tick(std::uint64_t standing) noexcept {
    suspected_ = 0;
    present_ = standing;
    worst_ = can::Reaction::report;
    cause_ = can::Fault::none;
  }
  /// `bad`, and for longer than the table's time: the fault is in force.
  void check(can::Fault fault, bool bad) noexcept {
    if (bad) [[unlikely]]
      suspected_ |= bit(fault);
  }
  /// In force in this tick, whatever the table's time.
  void find(can::Fault fault) noexcept { present_ |= bit(fault); }
  /// All is looked at.
  void conclude() noexcept {
    if ((suspected_ | counting_ | present_) != 0) [[unlikely]]
      count();
  }

  /// Causes in force in this tick, a bit each.
  [[nodiscard]] std::uint64_t present() const noexcept { return present_; }
  [[nodiscard]] bool is_present(can::Fault fault) const noexcept { return (present_ & bit(fault)) != 0; }
  /// The one with the hardest reaction, among those the first of the table; none.
  [[nodiscard]] can::Fault cause() const noexcept { return cause_; }
  [[nodiscard]] can::Reaction worst() const noexcept { return worst_; }
  /// One is in force that ends in FAULT.
  [[nodiscard]] bool disables() const noexcept { return cause_ != can::Fault::none && worst_ >= can::Reaction::stop; }

  [[nodiscard]] static constexpr std::uint64_t bit(can::Fault fault) noexcept { return 1ULL << at(fault); }

 private:
  static constexpr std::size_t at(can::Fault fault) noexcept { return static_cast<std::size_t>(fault); }
  void count() noexcept {
    for (std::uint64_t left = suspected_ | counting_; left != 0; left &= left - 1U) {
      const auto i = static_cast<std::size_t>(std::countr_zero(left));
      const bool bad = (suspected_ >> i & 1U) != 0;
      ticks_[i] = static_cast<std::uint16_t>(bad ? ticks_[i] + (ticks_[i] < 0xFFFFU ? 1 : 0) : 0);
      if (ticks_[i] > needed_[i]) present_ |= 1ULL << i;
    }
    counting_ = suspected_;
    for (std::uint64_t left = present_; left != 0; left &= left - 1U) {
      const auto i = static_cast<std::size_t>(std::countr_zero(left));
      if (cause_ == can::Fault::none || reaction_[i] > worst_) {
        worst_ = reaction_[i];
        cause_ = static_cast<can::Fault>(i);
      }
    }
  }
  static_assert(can::kFaultCount <= 64);

  std::array<std::uint16_t, can::kFaultCount> needed_{};
  std::array<std::uint16_t, can::kFaultCount> ticks_{};
  std::array<can::Reaction, can::kFaultCount> reaction_{};
  std::uint64_t suspected_ = 0;  ///< looked bad in this tick
  std::uint64_t counting_ = 0;   ///< looked bad in the last one
  std::uint64_t present_ = 0;
  can::Reaction worst_ = can::Reaction::report;
  can::Fault cause_ = can::Fault::none;
};

}  // namespace mrr::fw
