#include "module_fw/actions/drive_state_machine.h"

namespace mrr::fw {

namespace {

// CiA 402 table of commands.
enum class Command : std::uint8_t { disable_voltage, quick_stop, shutdown, switch_on, enable_operation };

Command decode(std::uint16_t word) noexcept {
  if ((word & 0x02U) == 0) return Command::disable_voltage;
  if ((word & 0x04U) == 0) return Command::quick_stop;
  if ((word & 0x01U) == 0) return Command::shutdown;
  return (word & 0x08U) == 0 ? Command::switch_on : Command::enable_operation;
}

}  // namespace

void DriveStateMachine::restart(bool whole_node) noexcept {
  if (state_ == DriveState::fault) {
    if (whole_node) state_ = DriveState::not_ready_to_switch_on;
  } else if (state_ != DriveState::fault_reaction_active) {
    state_ = DriveState::switch_on_disabled;
  }
  last_controlword_ = 0;
  settled_ = false;
}

DriveState DriveStateMachine::update(const Inputs& in) noexcept {
  using enum DriveState;
  const DriveState before = state_;
  const Command command = decode(in.controlword);
  reset_edge_ =
      (in.controlword & kControlFaultReset & ~static_cast<unsigned>(last_controlword_)) != 0 && state_ == fault;
  last_controlword_ = in.controlword;

  if (in.fault && state_ != fault && state_ != fault_reaction_active) {
    state_ = fault_reaction_active;  // 13
    settled_ = false;
    return state_;
  }
  // With bit 7 set the word is no command (CiA 402: fault reset).
  const bool commanded = (in.controlword & kControlFaultReset) == 0;
  switch (state_) {
    case not_ready_to_switch_on:
      if (in.ready) state_ = switch_on_disabled;  // 1
      break;
    case switch_on_disabled:
      if (commanded && command == Command::shutdown) state_ = ready_to_switch_on;  // 2
      break;
    case ready_to_switch_on:
      if (!commanded) break;
      if (command == Command::switch_on || command == Command::enable_operation) state_ = switched_on;         // 3
      if (command == Command::disable_voltage || command == Command::quick_stop) state_ = switch_on_disabled;  // 7
      break;
    case switched_on:
      if (!commanded) break;
      if (command == Command::enable_operation) state_ = operation_enabled;                                    // 4
      if (command == Command::shutdown) state_ = ready_to_switch_on;                                           // 6
      if (command == Command::disable_voltage || command == Command::quick_stop) state_ = switch_on_disabled;  // 10
      break;
    case operation_enabled:
      if (!commanded) break;
      if (command == Command::switch_on) state_ = switched_on;               // 5
      if (command == Command::shutdown) state_ = ready_to_switch_on;         // 8
      if (command == Command::disable_voltage) state_ = switch_on_disabled;  // 9
      if (command == Command::quick_stop) {
        state_ = in.quick_stop_option == 0 ? switch_on_disabled : quick_stop_active;  // 11
      }
      break;
    case quick_stop_active:
      if (in.quick_stop_option < 5) {
        if (in.stopped) state_ = switch_on_disabled;  // 12, by itself
      } else if (commanded && command == Command::enable_operation) {
        state_ = operation_enabled;  // 16
      }
      if (commanded && command == Command::disable_voltage) state_ = switch_on_disabled;  // 12
      break;
    case fault_reaction_active:
      if (in.stopped) state_ = fault;  // 14
      break;
    case fault:
      if (reset_edge_ && !in.fault) state_ = switch_on_disabled;  // 15
      break;
  }
  settled_ = state_ == before;
  return state_;
}

std::uint16_t DriveStateMachine::state_bits() const noexcept {
  switch (state_) {
    case DriveState::not_ready_to_switch_on:
      return 0x00;
    case DriveState::switch_on_disabled:
      return 0x40;
    case DriveState::ready_to_switch_on:
      return 0x21;
    case DriveState::switched_on:
      return 0x23;
    case DriveState::operation_enabled:
      return 0x27;
    case DriveState::quick_stop_active:
      return 0x07;
    case DriveState::fault_reaction_active:
      return 0x0F;
    case DriveState::fault:
      return 0x08;
  }
  return 0x00;
}

}  // namespace mrr::fw
