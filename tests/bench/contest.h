// Room: tests/bench. Contenders measured beside each other: interleaved rounds in a shuffled order, ratios of the
// shortest rounds with their spread, heap allocations. One source file per program includes it: it counts in malloc.
#pragma once

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstddef>
#include <cstdlib>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include "common/core/random.h"

namespace mrr::bench {

/// What anybody in this process took from the heap so far.
inline std::size_t allocations = 0;

inline constexpr int kRounds = 400;
inline constexpr int kCallsPerRound = 64;

struct Contender {
  std::string name;
  std::function<double(std::size_t)> work = {};  ///< call k of a round
  std::function<void()> prepare = {};            ///< before each round, not timed; may be empty
  std::vector<double> rounds_ns = {};            ///< per call; in the order of the rounds
  double allocations_per_call = 0.0;

  [[nodiscard]] double best_ns() const { return *std::min_element(rounds_ns.begin(), rounds_ns.end()); }
};

inline double quantile(std::vector<double> values, double share) {
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

inline void measure(std::vector<Contender>& contenders) {
  Random random(3, 3);
  std::vector<std::size_t> order(contenders.size());
  for (std::size_t i = 0; i < order.size(); ++i) order[i] = i;
  double sink = 0.0;
  const auto round = [&](Contender& c) {
    if (c.prepare) c.prepare();
    const std::size_t before = allocations;
    const auto begin = std::chrono::steady_clock::now();
    for (std::size_t k = 0; k < kCallsPerRound; ++k) sink += c.work(k);
    const double ns = std::chrono::duration<double, std::nano>(std::chrono::steady_clock::now() - begin).count();
    c.allocations_per_call = static_cast<double>(allocations - before) / kCallsPerRound;
    return ns / kCallsPerRound;
  };
  for (Contender& c : contenders) {
    c.rounds_ns.reserve(kRounds);
    round(c);  // warm
  }
  for (int k = 0; k < kRounds; ++k) {
    for (std::size_t i = order.size(); i > 1; --i) std::swap(order[i - 1], order[random.below(i)]);
    for (const std::size_t i : order) contenders[i].rounds_ns.push_back(round(contenders[i]));
  }
  if (!std::isfinite(sink)) std::abort();
}

/// One line each. The first is ours: the others' lines say which share of their time it takes.
inline void print(const std::string& what, const std::vector<Contender>& contenders) {
  const Contender& ours = contenders.front();
  for (const Contender& c : contenders) {
    fmt::print("{:<8} {:<16} {:8.0f} ns  median {:6.0f}  95 % {:6.0f}  allocations {:.1f}", what, c.name, c.best_ns(),
               quantile(c.rounds_ns, 0.5), quantile(c.rounds_ns, 0.95), c.allocations_per_call);
    if (&c != &ours) {
      std::vector<double> ratios(c.rounds_ns.size());
      for (std::size_t k = 0; k < ratios.size(); ++k) ratios[k] = ours.rounds_ns[k] / c.rounds_ns[k];
      fmt::print("  ours takes {:.3f} of it (round by round {:.3f} to {:.3f})", ours.best_ns() / c.best_ns(),
                 quantile(ratios, 0.1), quantile(ratios, 0.9));
    }
    fmt::print("\n");
  }
}

}  // namespace mrr::bench

extern "C" {
void* __libc_malloc(std::size_t);
void* malloc(std::size_t size) {
  ++mrr::bench::allocations;
  return __libc_malloc(size);
}
}
