// Test support: the seeds a property test tries. May touch nothing but the environment.
#pragma once

#include <cstdint>
#include <cstdlib>
#include <vector>

namespace mrr::test {

/// `usual` of them from `first` on. With MRR_SEEDS=10 in the environment ten times as many, none of the usual ones.
inline std::vector<std::uint64_t> seeds(std::uint64_t usual, std::uint64_t first = 1) {
  const char* asked = std::getenv("MRR_SEEDS");
  const std::uint64_t times = asked != nullptr ? std::strtoull(asked, nullptr, 10) : 0;
  if (times > 0) first += 1000;
  std::vector<std::uint64_t> all(usual * (times > 0 ? times : 1));
  for (std::uint64_t& seed : all) seed = first++;
  return all;
}

}  // namespace mrr::test
