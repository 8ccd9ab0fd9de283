#include "supervisor/impact/internal.h"

#include <Eigen/Geometry>
#include <Eigen/LU>

namespace mrr::sup {

using Eigen::Vector3d;

JointVector internal_impulses(const Chain& chain, const ChainPose& pose, const PoseTerms& terms,
                              const JointVector& delta_qd, const Vector6& external, Formulation formulation,
                              JointWrenches& wrench) noexcept {
  const int n = chain.dof();
  const Vector3d& face = pose.face.position_m;

  // Out: what every link gets from the jump of its motion, (41): momentum, and angular momentum about the face's
  // centre.
  std::array<Vector3d, kMaxJoints> momentum;  // N s
  std::array<Vector3d, kMaxJoints> spin;      // Nm s
  Vector3d v = Vector3d::Zero();              // of the link's point at the face's centre, m/s
  Vector3d w = Vector3d::Zero();              // rad/s
  for (int i = 0; i < n; ++i) {
    const auto link = static_cast<std::size_t>(i);
    v += terms.face.col(i).head<3>() * delta_qd[i];
    w += terms.face.col(i).tail<3>() * delta_qd[i];
    const Vector3d c = pose.com_m[link] - face;
    momentum[link] = chain.link_mass_kg(i) * (v + w.cross(c));
    spin[link] = terms.inertia[link].lazyProduct(w) + c.cross(momentum[link]);
  }

  // In: (39), (40), beginning with what the face receives, (46), (47).
  JointVector axis_nm_s(n);
  Vector3d F = external.head<3>();
  Vector3d tau = external.tail<3>();  // about the face's centre
  Vector3d slip = Vector3d::Zero();
  for (int i = n - 1; i >= 0; --i) {
    const auto link = static_cast<std::size_t>(i);
    const Vector3d& p = pose.link[link].position_m;
    F -= momentum[link];
    tau -= spin[link];
    // The reference's (52) takes r_ci^i x F_i with the wrong sign, and hands that on link by link.
    if (formulation == Formulation::as_printed) slip += 2.0 * (p - pose.com_m[link]).cross(F);
    wrench[link].force_n_s = F;
    wrench[link].torque_nm_s = tau + (face - p).cross(F) + slip;
    axis_nm_s[i] = pose.axis[link].dot(wrench[link].torque_nm_s);
  }
  return axis_nm_s;
}

ImpulseMap impulse_map(const Chain& chain, const ChainPose& pose, RotorModel rotors, Formulation formulation) noexcept {
  const int n = chain.dof();
  const PoseTerms terms = chain.terms(pose);
  const JointMatrix H = chain.mass_matrix(pose, terms) + chain.reflected_inertia(pose, rotors);
  const Eigen::PartialPivLU<JointMatrix> solver(H);
  ImpulseMap L(6 * n, 6);
  for (int column = 0; column < 6; ++column) {
    const JointVector J_row = terms.face.row(column).transpose();
    const JointVector delta_qd = solver.solve(J_row);
    JointWrenches wrenches;
    internal_impulses(chain, pose, terms, delta_qd, Vector6::Unit(column), formulation, wrenches);
    for (int i = 0; i < n; ++i) {
      const WrenchImpulse& wrench = wrenches[static_cast<std::size_t>(i)];
      L.block<3, 1>(3 * i, column) = wrench.force_n_s;
      L.block<3, 1>(3 * (n + i), column) = wrench.torque_nm_s;
    }
  }
  return L;
}

}  // namespace mrr::sup
