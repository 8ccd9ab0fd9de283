#include "module_fw/comms/selection_switch.h"

namespace mrr::fw {

namespace {

// An order this much too late is still carried out (at once): the others have switched. An older one is not.
constexpr std::int32_t kLatePeriods = 10;

}  // namespace

std::int32_t SelectionSwitch::periods_between(std::uint8_t from, std::uint8_t to, std::uint8_t overflow) noexcept {
  std::int32_t n = static_cast<std::int32_t>(to) - static_cast<std::int32_t>(from);
  const std::int32_t half = overflow / 2;
  if (n > half) n -= overflow;
  if (n < -half) n += overflow;
  return n;
}

void SelectionSwitch::command(const can::SelectionCommand& command, const Context& context,
                              const SyncPll& pll) noexcept {
  if (command.sequence == 0) return;
  if (command.sequence == sequence_) return;  // a repetition
  const bool to_active = ((command.mask >> bit_) & 1U) != 0;
  switch (command.action) {
    case can::SelectionAction::cancel:
      armed_ = false;
      break;
    case can::SelectionAction::now:
      if (!context.allowed) {
        refused_ = true;
        return;
      }
      armed_ = true;
      timed_ = false;
      to_active_ = to_active;
      due_at_ = context.now;
      break;
    case can::SelectionAction::arm: {
      const bool known = context.counter.has_value() && context.counter_overflow >= 2 && pll.locked() &&
                         command.sync_counter >= 1 && command.sync_counter <= context.counter_overflow;
      if (!(context.allowed && known)) {
        refused_ = true;
        return;
      }
      const std::int32_t n = periods_between(*context.counter, command.sync_counter, context.counter_overflow);
      const Duration offset = microseconds(command.offset_us);
      const Time at = pll.predict(n) + offset;
      if (context.now - at > pll.period() * kLatePeriods) {
        refused_ = true;
        return;
      }
      armed_ = true;
      timed_ = true;
      to_active_ = to_active;
      counter_ = command.sync_counter;
      offset_ = offset;
      due_at_ = at;
      break;
    }
  }
  refused_ = false;
  sequence_ = command.sequence;
}

void SelectionSwitch::on_sync(std::uint8_t counter, std::uint8_t counter_overflow, const SyncPll& pll) noexcept {
  if (!armed_ || !timed_ || counter_overflow < 2) return;
  const Time at = pll.predict(periods_between(counter, counter_, counter_overflow)) + offset_;
  const std::int64_t change = (at - due_at_).ns;
  const std::int64_t quarter = pll.period().ns / 4;
  // SYNC that restarts at another phase or count must not move an armed switch.
  if (change <= quarter && change >= -quarter) due_at_ = at;
}

std::optional<bool> SelectionSwitch::due(Time now, Duration period) noexcept {
  if (!armed_ || now < due_at_) return std::nullopt;
  armed_ = false;
  if (now - due_at_ > period * kLatePeriods) return std::nullopt;  // something stood in its way until the blow was over
  return to_active_;
}

std::uint8_t SelectionSwitch::acknowledgement() const noexcept {
  using can::SelectionState;
  const SelectionState state =
      refused_ ? SelectionState::refused : (armed_ ? SelectionState::armed : SelectionState::idle);
  return can::acknowledgement_byte(sequence_, state);
}

}  // namespace mrr::fw
