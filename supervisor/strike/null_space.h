// Room: supervisor/strike. Better poses along the self-motion of a redundant arm, found by NLopt.
// May touch common/ and supervisor/model. Plans, so it may allocate; deterministic.
#pragma once

#include <functional>
#include <optional>

#include "supervisor/strike/inverse_kinematics.h"

namespace mrr::sup {

/// What is looked for is the least of a cost that may have kinks and walls (a largest of loads under a best of
/// selections, joint limits): Subplex, a Nelder-Mead on subspaces that copes with many dimensions (Rowan 1990).
class NullSpaceSearch {
 public:
  NullSpaceSearch(const RobotDescription& robot, const Chain& chain, const FaceTarget& target)
      : robot_(robot), chain_(chain), target_(target) {}

  /// Freedom that is left to the arm at `q` while its face stays on the point: n - 5 joints, or n - 3 for an arm of
  /// four, which the allowed tilt leaves some. Columns are orthonormal.
  [[nodiscard]] JointMatrix freedom(const JointVector& q) const;

  /// From a solution along its null space to one of less cost. nullopt if there is no freedom or nothing better.
  /// `cost` is asked at most `evaluations` times, at solutions only. It may be infinite.
  [[nodiscard]] std::optional<FaceSolution> improve(const FaceSolution& from,
                                                    const std::function<double(const FaceSolution&)>& cost,
                                                    int evaluations = 80) const;

 private:
  const RobotDescription& robot_;
  const Chain& chain_;
  const FaceTarget& target_;
};

}  // namespace mrr::sup
