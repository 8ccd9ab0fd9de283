// Room: module_fw/targets/linux. How late the ticks of a loop began: a histogram in fixed memory. Host only; no I/O, no
// clock.
#pragma once

#include <fmt/format.h>

#include <array>
#include <cstdint>
#include <string>

#include "common/core/time.h"

namespace mrr::fw {

class Lateness {
 public:
  void add(Duration late) noexcept {
    const auto us = static_cast<std::size_t>(late.ns < 0 ? 0 : late.ns / 1000);
    ++buckets_[us < kBuckets ? us : kBuckets - 1];
    ++count_;
    if (late > max_) max_ = late;
  }
  /// Smallest lateness, to the microsecond, that `share` (0 .. 1) of the ticks did not exceed; beyond 20 ms: the
  /// largest.
  [[nodiscard]] Duration percentile(double share) const noexcept {
    std::int64_t left = static_cast<std::int64_t>(share * static_cast<double>(count_));
    for (std::size_t us = 0; us + 1 < kBuckets; ++us) {
      left -= buckets_[us];
      if (left < 0) return microseconds(static_cast<std::int64_t>(us));
    }
    return max_;
  }
  [[nodiscard]] Duration max() const noexcept { return max_; }
  [[nodiscard]] std::int64_t count() const noexcept { return count_; }
  [[nodiscard]] std::string in_words() const {
    return fmt::format("p50 {:.0f} us, p99 {:.0f} us, p99.9 {:.0f} us, max {:.0f} us", percentile(0.5).seconds() * 1e6,
                       percentile(0.99).seconds() * 1e6, percentile(0.999).seconds() * 1e6, max_.seconds() * 1e6);
  }

 private:
  static constexpr std::size_t kBuckets = 20'001;
  std::array<std::uint32_t, kBuckets> buckets_{};
  std::int64_t count_ = 0;
  Duration max_{};
};

}  // namespace mrr::fw
