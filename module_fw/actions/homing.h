// Room: module_fw/actions. Homing on a switch: fast search, back off, slow approach; the edge is the reference.
// May touch module_fw/config.h. Freestanding.
#pragma once

#include <cstdint>

#include "common/core/time.h"
#include "module_fw/config.h"

namespace mrr::fw {

/// CiA 402 methods on a home switch that is met in the positive (20) or the negative direction (22), or on the index
/// pulse beyond it (4, 6). Any other method: as configured.
[[nodiscard]] HomingConfig homing_by_method(HomingConfig config, std::int8_t method) noexcept;

/// The switch is closed from its edge on in the direction of the search.
class Homing {
 public:
  enum class Phase : std::uint8_t { idle, search, pass_over, clear, approach, index, done, failed };

  void configure(const HomingConfig& config) noexcept { config_ = config; }

  struct Inputs {
    bool home_switch = false;
    bool negative_limit = false;
    bool positive_limit = false;
    bool index_pulse = false;
    float position_rad = 0.0F;
    float effort_nm = 0.0F;  ///< torque beyond what the joint carries
  };

  void start(Time now, bool on_switch, float position_rad) noexcept;
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
    return phase_ == Phase::search || phase_ == Phase::pass_over || phase_ == Phase::clear ||
           phase_ == Phase::approach || phase_ == Phase::index;
  }
  /// Velocity to move with, 0 when not running.
  [[nodiscard]] float velocity_rad_s() const noexcept;
  /// What the joint reads at the reference: the switch's edge, or the index pulse after it.
  [[nodiscard]] float reference_rad() const noexcept {
    return config_.index ? config_.index_position_rad : config_.switch_position_rad;
  }
  [[nodiscard]] const HomingConfig& config() const noexcept { return config_; }

 private:
  HomingConfig config_;
  Phase phase_ = Phase::idle;
  Time started_;
  bool seen_switch_ = false;
  float from_rad_ = 0.0F;
  std::int32_t hard_ticks_ = 0;
};

}  // namespace mrr::fw
