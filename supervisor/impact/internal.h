// Room: supervisor/impact. Impulses inside the arm, link by link from the tip: Newton-Euler, O(n); (37)-(53).
// May touch common/ and supervisor/model. Allocates nothing, throws nothing.
#pragma once

#include <array>

#include "supervisor/impact/external.h"

namespace mrr::sup {

/// Link i on link i-1, at the centre of joint i, base frame. (The reference expresses them in its distal frame i:
/// rotate.)
using JointWrenches = std::array<WrenchImpulse, kMaxJoints>;

/// Joint impulses that go with an impulse on the face and the jump of joint speeds it made, whatever holds the joints.
/// `external`: (force; torque) impulse on the robot at the face centre, base frame, N s and Nm s. Sets `wrench` of the
/// chain's joints. @returns torque_i . z_i, what transmission i carries, Nm s.
JointVector internal_impulses(const Chain& chain, const ChainPose& pose, const PoseTerms& terms,
                              const JointVector& delta_qd, const Vector6& external, Formulation formulation,
                              JointWrenches& wrench) noexcept;
inline JointVector internal_impulses(const Chain& chain, const ChainPose& pose, const JointVector& delta_qd,
                                     const Vector6& external, Formulation formulation, JointWrenches& wrench) noexcept {
  return internal_impulses(chain, pose, chain.terms(pose), delta_qd, external, formulation, wrench);
}

/// L of (53): 6n x 6, rows F_1..F_n then tau_1..tau_n (three each, base frame), for all joints free and the given
/// rotors.
using ImpulseMap = Eigen::Matrix<double, Eigen::Dynamic, 6, 0, 6 * kMaxJoints, 6>;
[[nodiscard]] ImpulseMap impulse_map(const Chain& chain, const ChainPose& pose, RotorModel rotors,
                                     Formulation formulation = Formulation::corrected) noexcept;

}  // namespace mrr::sup
