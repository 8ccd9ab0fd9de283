// Room: can_protocol. The selection broadcast: which joints are active from which instant on. Freestanding.
#pragma once

#include <cstdint>
#include <optional>

#include "can_protocol/pdo.h"

namespace mrr::can {

enum class SelectionAction : std::uint8_t { arm = 0, now = 1, cancel = 2 };

inline constexpr std::uint8_t kSelectionSequenceMask = 0x1F;

/// "From `offset_us` after the SYNC with this counter on, modules with their bit set are active, the others passive."
struct SelectionCommand {
  std::uint32_t mask = 0;         ///< bit = JointDescription::selection_bit; 1: active
  std::uint8_t sync_counter = 0;  ///< counter of the SYNC that the offset counts from; ignored by now and cancel
  std::uint16_t offset_us = 0;    ///< ignored by now and cancel
  std::uint8_t sequence = 0;      ///< 1-31; a repetition carries the same one and has no further effect
  SelectionAction action = SelectionAction::arm;

  friend bool operator==(const SelectionCommand&, const SelectionCommand&) = default;
};

/// The byte that carries sequence and action.
constexpr std::uint8_t selection_byte(std::uint8_t sequence, SelectionAction action) noexcept {
  return static_cast<std::uint8_t>((sequence & kSelectionSequenceMask) | (static_cast<unsigned>(action) << 5U));
}

/// Nothing if the action is none of the three.
constexpr std::optional<SelectionCommand> selection_from(const Rpdo4& v) noexcept {
  const unsigned action = v.selection_command >> 5U;
  if (!(action <= 2)) return std::nullopt;
  return SelectionCommand{v.selection_mask, v.selection_sync_counter, v.selection_offset_us,
                          static_cast<std::uint8_t>(v.selection_command & kSelectionSequenceMask),
                          static_cast<SelectionAction>(action)};
}

/// What a module's selection_acknowledged says: bits 0-4 the sequence last accepted, bits 5-7 what became of it.
enum class SelectionState : std::uint8_t { idle = 0, armed = 1, refused = 2 };

constexpr std::uint8_t acknowledgement_byte(std::uint8_t sequence, SelectionState state) noexcept {
  return static_cast<std::uint8_t>((sequence & kSelectionSequenceMask) | (static_cast<unsigned>(state) << 5U));
}
constexpr std::uint8_t acknowledged_sequence(std::uint8_t acknowledgement) noexcept {
  return acknowledgement & kSelectionSequenceMask;
}

}  // namespace mrr::can
