// Room: module_fw/actions. Brake and power stage in the right order, so that the arm never hangs on nothing.
// May touch module_fw/config.h. Freestanding.
#pragma once

#include <cstdint>

#include "common/core/time.h"
#include "module_fw/config.h"

namespace mrr::fw {

/// Up: power stage on, torque confirmed -> brake released -> dwell -> motion.
/// Down: at rest -> brake engaged -> dwell, contact closed -> torque off. A brake that does not engage keeps the
/// torque.
class BrakeSequence {
 public:
  enum class Phase : std::uint8_t { off, confirming, releasing, open, stopping, engaging, testing };
  enum class Trouble : std::uint8_t { none, torque_not_confirmed, not_released, not_engaged };

  explicit BrakeSequence(const BrakeConfig& config) noexcept : config_(config) {}

  struct Inputs {
    bool wanted = false;            ///< the joint shall be under control
    bool torque_confirmed = false;  ///< measured current is what was asked for
    bool at_rest = false;           ///< reference at rest
    bool feedback_released = false;
    bool test = false;  ///< brake test: engaged with the power stage on
    bool cut = false;   ///< torque off at once, brake engaged at once
  };

  /// One tick.
  Trouble update(Time now, const Inputs& in) noexcept;

  [[nodiscard]] Phase phase() const noexcept { return phase_; }
  [[nodiscard]] bool power_stage_enabled() const noexcept { return phase_ != Phase::off; }
  [[nodiscard]] bool brake_release() const noexcept {
    return phase_ == Phase::releasing || phase_ == Phase::open || phase_ == Phase::stopping;
  }
  /// Released, dwell over: torque moves the joint.
  [[nodiscard]] bool brake_open() const noexcept { return phase_ == Phase::open || phase_ == Phase::stopping; }
  /// Brake test: it holds, the torque may push.
  [[nodiscard]] bool test_ready(Time now, bool feedback_released) const noexcept {
    return phase_ == Phase::testing && now - since_ >= config_.engage && !feedback_released;
  }
  [[nodiscard]] bool motion_allowed() const noexcept { return phase_ == Phase::open; }

 private:
  void enter(Phase phase, Time now) noexcept {
    phase_ = phase;
    since_ = now;
  }
  const BrakeConfig config_;
  Phase phase_ = Phase::off;
  Time since_;
  std::uint8_t confirmed_ticks_ = 0;
};

}  // namespace mrr::fw
