// Room: supervisor/strike. All ways to put the hammer face on a nail: damped least squares from many seeded starts.
// May touch common/ and supervisor/model. Plans, so it may allocate; the same seed gives the same answer.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "supervisor/model/chain.h"

namespace mrr::sup {

/// Where the face shall be: its centre on a point, its z axis along -normal to within a tilt.
struct FaceTarget {
  Eigen::Vector3d position_m = Eigen::Vector3d::Zero();  ///< base frame
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();     ///< unit, from the surface into the robot's space, base frame
  double max_tilt_rad = 0.0;
  /// How far beside the point (at right angles to the normal) the face may be when it cannot reach it: the head is
  /// struck off centre. Along the normal it is always exact.
  double max_lateral_m = 0.0;
};

struct FaceSolution {
  JointVector q;
  double normal_error_m = 0.0;   ///< signed, along the normal
  double lateral_error_m = 0.0;  ///< at right angles to it, >= 0
  double tilt_rad = 0.0;         ///< between the face axis and -normal
};

struct IkOptions {
  std::uint64_t seed = 1;
  int starts = 96;  ///< at most, besides the present pose, the middle and zero
  int max_solutions = 32;
  double same_rad = 1e-3;  ///< nearer than this (largest joint difference) is the same solution
  double distinct_rad =
      0.15;  ///< for redundant arms (and those of four joints), whose solutions are a continuum: sampled this far apart
  int null_space_steps = 6;  ///< redundant arms: steps either way along the null space of each solution
  double null_space_step_rad = 0.2;
};

struct IkResult {
  std::vector<FaceSolution> solutions;  ///< nearest to `near` first; empty: unreachable
  FaceSolution closest;                 ///< if unreachable: the best that was found
  std::string why;                      ///< if unreachable: one sentence that says how far off, mm and degrees
};

/// Solutions within joint limits less 0.02 rad, exact to 1e-7 m. The task has 5 dimensions: arms with fewer joints meet
/// the position and take the tilt they get; arms with more have a null space, which is sampled. `near`: present pose;
/// first start and order of the result.
[[nodiscard]] IkResult solve_face_on_point(const RobotDescription& robot, const Chain& chain, const FaceTarget& target,
                                           const JointVector& near, const IkOptions& options = {});

/// The solution that damped least squares reaches from `q`, on the point exactly; nullopt if it reaches none.
[[nodiscard]] std::optional<FaceSolution> solve_near(const RobotDescription& robot, const Chain& chain,
                                                     const FaceTarget& target, const JointVector& q);

}  // namespace mrr::sup
