// Room: supervisor/daemon. Durations counted in bins of fixed memory, written by one thread and read by another.
// May touch common/core. No heap, no lock.
#pragma once

#include <algorithm>
#include <array>
#include <atomic>
#include <bit>
#include <cstdint>

#include "common/core/time.h"

namespace mrr::sup {

/// Bins grow with the duration: 16 per power of two of a microsecond, so what is read is right to 6 %. Below 16 us to
/// 1 us; above 8 s counted as 8 s.
class LatencyHistogram {
 public:
  void add(Duration d) noexcept {
    const auto us = static_cast<std::uint32_t>(std::clamp<std::int64_t>(d.ns / 1000, 0, kLargest_us));
    bins_[bin_of(us)].fetch_add(1, std::memory_order_relaxed);
    if (us > max_us_.load(std::memory_order_relaxed)) max_us_.store(us, std::memory_order_relaxed);
  }
  struct Summary {
    double p50_us = 0.0, p99_us = 0.0, p999_us = 0.0, max_us = 0.0;
  };
  [[nodiscard]] Summary summary() const noexcept {
    std::array<std::uint32_t, kBins> bins{};
    std::uint64_t count = 0;
    for (std::size_t i = 0; i < kBins; ++i) count += bins[i] = bins_[i].load(std::memory_order_relaxed);
    const double max = max_us_.load(std::memory_order_relaxed);
    const auto at = [&](double share) {
      std::uint64_t left = static_cast<std::uint64_t>(share * static_cast<double>(count));
      for (std::size_t i = 0; i < kBins; ++i) {
        if (left < bins[i]) return std::min(max, static_cast<double>(start_of(i)));
        left -= bins[i];
      }
      return max;
    };
    return {at(0.5), at(0.99), at(0.999), max};
  }

 private:
  static constexpr std::int64_t kLargest_us = (1 << 23) - 1;
  static constexpr std::size_t kBins = 16 + 16 * (23 - 4);
  static std::size_t bin_of(std::uint32_t us) noexcept {
    if (us < 16) return us;
    const auto power = static_cast<unsigned>(std::bit_width(us)) - 1;  // 4 .. 22
    return 16 + 16 * (power - 4) + ((us >> (power - 4)) & 15U);
  }
  static std::uint32_t start_of(std::size_t bin) noexcept {
    if (bin < 16) return static_cast<std::uint32_t>(bin);
    const auto power = static_cast<unsigned>((bin - 16) / 16);
    return static_cast<std::uint32_t>((16 + (bin - 16) % 16) << power);
  }
  std::array<std::atomic<std::uint32_t>, kBins> bins_{};
  std::atomic<std::uint32_t> max_us_{0};
};

}  // namespace mrr::sup
