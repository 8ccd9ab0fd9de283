// Room: supervisor/strike. The largest component of a joint vector. May touch Chain's types.
#pragma once

#include <cmath>

#include "supervisor/model/chain.h"

namespace mrr::sup {

/// max_i |v_i|, 0 if empty; NaN components are passed over. (Eigen's lpNorm reads the first element before it looks at
/// the size, which the compiler objects to.)
[[nodiscard]] inline double largest_magnitude(const JointVector& v) noexcept {
  double largest = 0.0;
  for (Eigen::Index i = 0; i < v.size(); ++i) {
    if (std::abs(v[i]) > largest) largest = std::abs(v[i]);
  }
  return largest;
}

}  // namespace mrr::sup
