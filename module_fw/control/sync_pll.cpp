#include "module_fw/control/sync_pll.h"

namespace mrr::fw {

void SyncPll::reset() noexcept { *this = SyncPll(nominal_); }

float SyncPll::drift_ppm() const noexcept {
  const auto deviation_256 = static_cast<float>(static_cast<std::int32_t>(period_256_));
  return deviation_256 / 256.0F / static_cast<float>(static_cast<std::int32_t>(nominal_.ns)) * 1e6F;
}

SyncPll::Arrival SyncPll::on_sync(Time at) noexcept {
  if (!has_phase_) {
    has_phase_ = true;
    phase_ = at;
    return {true, 1};
  }
  const std::int64_t since = (at - phase_).ns;
  const std::int64_t periods = (since + period_.ns / 2) / period_.ns;
  if (periods <= 0) {
    // A second SYNC within half a period. CAN may deliver a frame twice (an error in the last bit of its end); when it
    // goes on there are two senders, and none is ours to follow.
    doubles_ += kDoubleWeight;
    if (doubles_ > kDoublesToUnlock) {
      doubles_ = kDoublesToUnlock;
      good_ = 0;
    }
    return {true, 0};
  }
  if (periods > 1000) {
    // Silence for so long that the extrapolated phase means nothing: start again.
    reset();
    has_phase_ = true;
    phase_ = at;
    return {true, 1};
  }
  if (doubles_ > 0) --doubles_;
  const auto n = static_cast<std::int32_t>(periods);
  const Time expected = predict(n);
  const std::int64_t error = (at - expected).ns;
  error_ = {error};
  // Far out once: the sender was late, the loop runs on by itself. Several times running: it began anew with another
  // phase.
  if (error > period_.ns / 8 || error < -period_.ns / 8) {
    ++bad_;
    if (bad_ >= kBadToUnlock) good_ = 0;
    if (bad_ >= kBadToRestart) {
      reset();
      has_phase_ = true;
      phase_ = at;
      return {true, n};
    }
    phase_ = expected;
    return {true, n};
  }
  bad_ = 0;
  if (good_ < kGoodToLock) ++good_;
  phase_ = expected + Duration{error / kPhaseDivisor};
  // A crystal is good to 100 ppm; 500 ppm is as far as the loop may be pulled.
  const std::int64_t bound = nominal_.ns * 256 / 2000;
  period_256_ += error * 256 / kPeriodDivisor;
  if (period_256_ > bound) period_256_ = bound;
  if (period_256_ < -bound) period_256_ = -bound;
  period_ = nominal_ + Duration{period_256_ / 256};
  fraction_ns_times_256_ = period_256_ % 256;
  return {true, n};
}

}  // namespace mrr::fw
