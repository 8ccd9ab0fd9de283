// Room: can_protocol/socketcan. When a frame arrived: the kernel's stamp (CLOCK_REALTIME) as CLOCK_MONOTONIC, also
// over a step of the system's time. Values in, values out: host only, no I/O.
#pragma once

#include <algorithm>

#include "common/core/time.h"

namespace mrr::can {

class ArrivalClock {
 public:
  /// Apart by more than this, the clocks were not merely read slowly: the system's time was stepped.
  static constexpr Duration kStep = milliseconds(1);
  /// A stamp older than this was given before a step, if there was one. Frames wait much shorter.
  static constexpr Duration kOld = milliseconds(1000);

  /// `offset`: CLOCK_MONOTONIC minus CLOCK_REALTIME, as measured now.
  void set(Duration offset) noexcept {
    previous_ = known_ ? offset_ : offset;
    offset_ = offset;
    known_ = true;
  }

  /// Two readings of the clocks, one after the other, deny the offset in force.
  [[nodiscard]] bool stepped(Time monotonic, Time real) const noexcept {
    const Duration apart = monotonic - real - offset_;
    return apart > kStep || -apart > kStep;
  }

  /// Never later than `now`. A stamp from before the latest step is read with the offset of then.
  [[nodiscard]] Time arrival(Time stamp, Time now) const noexcept {
    const auto plausible = [now](Time at) { return at <= now && now - at <= kOld; };
    const Time at = stamp + offset_;
    const Time before_step = stamp + previous_;
    if (!plausible(at) && plausible(before_step)) return before_step;
    return std::min(at, now);
  }

 private:
  Duration offset_{};
  Duration previous_{};
  bool known_ = false;
};

}  // namespace mrr::can
