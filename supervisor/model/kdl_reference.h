// Room: supervisor/model. The same quantities by Orocos KDL: a second opinion on Chain, for tests and the start-up self
// check. May touch common/ and Chain's types; shares no formula with Chain. Allocates.
#pragma once

#include <memory>

#include "supervisor/model/chain.h"

namespace mrr::sup {

/// Orocos KDL on a robot description. Each call costs microseconds and may allocate: not for the cycle.
class KdlReference {
 public:
  explicit KdlReference(const RobotDescription& robot);
  ~KdlReference();
  KdlReference(const KdlReference&) = delete;
  KdlReference& operator=(const KdlReference&) = delete;

  [[nodiscard]] Pose face_pose(const JointVector& q) const;
  [[nodiscard]] Jacobian jacobian(const JointVector& q) const;
  /// Links only, as Chain::mass_matrix.
  [[nodiscard]] JointMatrix mass_matrix(const JointVector& q) const;
  [[nodiscard]] JointVector gravity(const JointVector& q) const;
  /// C(q, q') q' without gravity.
  [[nodiscard]] JointVector coriolis(const JointVector& q, const JointVector& qd) const;
  /// KDL's own recursive Newton-Euler: M q'' + h.
  [[nodiscard]] JointVector inverse_dynamics(const JointVector& q, const JointVector& qd, const JointVector& qdd) const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// Largest difference between Chain and KDL over J, M, g, C q' and inverse dynamics at a few fixed states, each
/// relative to the largest entry of the quantity (or 1, if that is smaller). Healthy: below 1e-9. NaN anywhere gives
/// infinity.
double model_self_check(const RobotDescription& robot);

}  // namespace mrr::sup
