// Room: module_fw/actions. Homing on a switch: fast search, back off, slow approach; the edge, or the encoder's index
// pulse beyond it, is the reference.
// May touch module_fw/config.h. Freestanding.
#pragma once

#include <cstdint>

#include "common/core/time.h"
#include "module_fw/config.h"

namespace mrr::fw {

/// As a CiA 402 method has it: 17, 18 leaving the negative, the positive limit switch; 19, 20 the home switch that is
/// searched for in the positive direction, as it is left, as it is met; 21, 22 the same in the negative direction; 1 to
/// 6 as 17 to 22 and on to the index pulse; 33, 34 the next index pulse, negative, positive. Any other: as configured.
[[nodiscard]] HomingConfig homing_by_method(HomingConfig config, std::int8_t method) noexcept;

/// A switch is closed from its edge on in the direction of the search.
class Homing {
 public:
  enum class Phase : std::uint8_t { idle, search, pass_over, clear, approach, leave, index, done, failed };

  void configure(const HomingConfig& config) noexcept { config_ = config; }

  struct Inputs {
    bool home_switch = false;
    bool negative_limit = false;
    bool positive_limit = false;
    bool index_pulse = false;
    float position_rad = 0.0F;
    float moving_rad_s = 0.0F;  ///< of the reference
    float effort_nm = 0.0F;     ///< torque beyond what the joint carries
  };

  void start(Time now, const Inputs& in) noexcept;
  void abort() noexcept {
    if (running()) phase_ = Phase::idle;
  }
  /// Homing where the joint stands (methods 35, 37).
  void finish() noexcept { phase_ = Phase::done; }
  /// One tick while running. @returns true in the tick in which the reference was met: the joint is at
  /// reference_rad() now.
  bool update(Time now, const Inputs& in) noexcept;

  [[nodiscard]] Phase phase() const noexcept { return phase_; }
  [[nodiscard]] bool running() const noexcept {
    return phase_ != Phase::idle && phase_ != Phase::done && phase_ != Phase::failed;
  }
  /// Velocity to move with, 0 when not running.
  [[nodiscard]] float velocity_rad_s() const noexcept;
  /// What the joint reads at the reference: the switch's edge, or the index pulse after it.
  [[nodiscard]] float reference_rad() const noexcept {
    return config_.index ? config_.index_position_rad : config_.switch_position_rad;
  }
  [[nodiscard]] const HomingConfig& config() const noexcept { return config_; }

 private:
  [[nodiscard]] bool limit_towards(int direction, const Inputs& in) const noexcept {
    return direction < 0 ? in.negative_limit : in.positive_limit;
  }
  [[nodiscard]] bool on_mark(const Inputs& in) const noexcept {
    return config_.mark == HomingMark::limit_switch ? limit_towards(config_.direction, in) : in.home_switch;
  }
  /// @returns whether this is the reference already
  bool at_edge() noexcept {
    phase_ = config_.index ? Phase::index : Phase::done;
    return !config_.index;
  }

  HomingConfig config_;
  Phase phase_ = Phase::idle;
  Time started_;
  bool seen_switch_ = false;
  float from_rad_ = 0.0F;
  std::int32_t hard_ticks_ = 0;
};

}  // namespace mrr::fw
