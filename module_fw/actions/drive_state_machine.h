// Room: module_fw/actions. CiA 402 power drive state machine: controlword in, state and statusword out.
// May touch module_fw/status.h. Freestanding.
#pragma once

#include <cstdint>

#include "module_fw/status.h"

namespace mrr::fw {

/// Bits of the statusword that the state alone does not give.
enum StatuswordBit : std::uint16_t {
  kStatusFault = 1U << 3U,
  kStatusVoltageEnabled = 1U << 4U,
  kStatusWarning = 1U << 7U,
  kStatusRemote = 1U << 9U,
  kStatusTargetReached = 1U << 10U,  ///< homing: at rest; cyclic modes: reserved
  kStatusInternalLimit = 1U << 11U,
  kStatusFollowing = 1U << 12U,       ///< mode 8: the joint follows the set points; mode 6: homing attained
  kStatusFollowingError = 1U << 13U,  ///< mode 8; mode 6: homing error
};

/// Bits of the controlword that are looked at one by one.
enum ControlwordBit : std::uint16_t {
  kControlEnable = 1U << 3U,
  kControlHomingStart = 1U << 4U,
  kControlFaultReset = 1U << 7U,
  kControlHalt = 1U << 8U,
};

class DriveStateMachine {
 public:
  struct Inputs {
    std::uint16_t controlword = 0;
    bool ready = false;    ///< self-test done, every sensor seen
    bool fault = false;    ///< a fault is in force now
    bool stopped = false;  ///< reference at rest (or nothing left to control): a reaction may end
    std::int16_t quick_stop_option = 6;
  };

  /// One control word, new or standing: at most one transition (3 and 4 follow each other in two calls).
  /// @returns the state in force.
  DriveState update(const Inputs& in) noexcept;
  /// Nothing new: what left the joint enabled in the last tick leaves it enabled in this one; no need to update().
  [[nodiscard]] bool settled(std::uint16_t controlword, bool fault) const noexcept {
    return settled_ && state_ == DriveState::operation_enabled && !fault && controlword == last_controlword_;
  }
  /// NMT reset. Of the communication: like after power-up, but a fault stays. Of the node: the start anew, so that a
  /// cause that is still there is a fault anew; a reaction under way is carried through.
  void restart(bool whole_node) noexcept;

  [[nodiscard]] DriveState state() const noexcept { return state_; }
  /// Rising edge of the fault reset bit in the last update, in state FAULT.
  [[nodiscard]] bool fault_reset_requested() const noexcept { return reset_edge_; }
  /// Bits 0-3, 5, 6 of the statusword.
  [[nodiscard]] std::uint16_t state_bits() const noexcept;

 private:
  DriveState state_ = DriveState::not_ready_to_switch_on;
  std::uint16_t last_controlword_ = 0;
  bool reset_edge_ = false;
  bool settled_ = false;  ///< the last update changed nothing
};

}  // namespace mrr::fw
