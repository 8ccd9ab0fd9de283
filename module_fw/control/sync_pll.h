// Room: module_fw/control. Phase-locked loop on SYNC arrivals: own clock drifts, frames wait for the bus, the loop does
// not. May touch common/core. Freestanding.
#pragma once

#include <cstdint>

#include "common/core/time.h"

namespace mrr::fw {

/// Second order, critically damped: phase += kPhaseGain err, period += kPhaseGain^2/4 err. With SYNC delayed by up to a
/// frame time (uniform 0-135 us at 1 Mbit/s) the predicted instant is the mean arrival, about 10 us rms around it.
class SyncPll {
 public:
  explicit SyncPll(Duration nominal_period) noexcept : nominal_(nominal_period), period_(nominal_period) {}

  struct Arrival {
    bool usable = false;       ///< the loop has a phase: sync_time() may be used
    std::int32_t periods = 0;  ///< since the last arrival, >= 1 (more than one: SYNCs were lost); 0: double, ignored
  };

  /// A SYNC arrived at `at` on the own clock.
  Arrival on_sync(Time at) noexcept;

  /// Filtered instant of the last SYNC.
  [[nodiscard]] Time sync_time() const noexcept { return phase_; }
  /// Filtered SYNC period on the own clock.
  [[nodiscard]] Duration period() const noexcept { return period_; }
  /// Instant of the SYNC `n` periods after the last one (n may be negative).
  [[nodiscard]] Time predict(std::int32_t n) const noexcept {
    return phase_ + Duration{period_.ns * n + fraction_ns_times_256_ * n / 256};
  }
  [[nodiscard]] bool locked() const noexcept { return good_ >= kGoodToLock; }
  [[nodiscard]] Duration last_error() const noexcept { return error_; }
  /// Own clock against SYNC, parts per million.
  [[nodiscard]] float drift_ppm() const noexcept;
  void reset() noexcept;

 private:
  static constexpr std::int32_t kPhaseDivisor = 10;            // phase gain 1/10
  static constexpr std::int32_t kPeriodDivisor = 4 * 10 * 10;  // critically damped
  static constexpr std::int32_t kGoodToLock = 20;
  static constexpr std::int32_t kBadToUnlock = 3;
  static constexpr std::int32_t kBadToRestart = 5;
  static constexpr std::int32_t kDoubleWeight = 8;  // a double is forgotten after so many periods
  static constexpr std::int32_t kDoublesToUnlock = 3 * kDoubleWeight;

  Duration nominal_;
  Time phase_;
  Duration period_;
  std::int64_t fraction_ns_times_256_ = 0;  ///< of the period, below a nanosecond
  std::int64_t period_256_ = 0;             ///< deviation of the period from nominal, ns * 256
  Duration error_;
  std::int32_t good_ = 0;
  std::int32_t bad_ = 0;
  std::int32_t doubles_ = 0;
  bool has_phase_ = false;
};

}  // namespace mrr::fw
