#include "supervisor/impact/internal.h"

#include <Eigen/Geometry>
#include <Eigen/LU>

namespace mrr::sup {

using Eigen::Matrix3d;
using Eigen::Vector3d;

JointVector internal_impulses(const Chain& chain, const ChainPose& pose, const JointVector& delta_qd,
                              const Vector6& external, Formulation formulation, JointWrenches& wrench) noexcept {
  const auto n = static_cast<std::size_t>(chain.dof());
  JointVector axis_nm_s(chain.dof());

  // Out: the jump of every link's motion, (41).
  std::array<Vector3d, kMaxJoints> delta_w;   // rad/s
  std::array<Vector3d, kMaxJoints> delta_vc;  // of the centre of mass, m/s
  Vector3d w = Vector3d::Zero();
  Vector3d v = Vector3d::Zero();  // of the centre of the last joint
  for (std::size_t i = 0; i < n; ++i) {
    if (i > 0) v += w.cross(pose.link[i].position_m - pose.link[i - 1].position_m);
    w += pose.axis[i] * delta_qd[static_cast<Eigen::Index>(i)];
    delta_w[i] = w;
    delta_vc[i] = v + w.cross(pose.com_m[i] - pose.link[i].position_m);
  }

  // In: (39), (40), beginning with what the face receives, (46), (47). The reference's (52) takes r_ci^i x F_i with the
  // wrong sign.
  const double sign = formulation == Formulation::corrected ? -1.0 : 1.0;
  Vector3d F = external.head<3>();
  Vector3d tau = external.tail<3>();
  Vector3d outer = pose.face.position_m;  // where F, tau of the outer neighbour act
  for (std::size_t i = n; i-- > 0;) {
    const Matrix3d& R = pose.link[i].rotation;
    const Vector3d& c = pose.com_m[i];
    const int joint = static_cast<int>(i);
    const Vector3d spin = R * (chain.link_inertia_kg_m2(joint) * (R.transpose() * delta_w[i]));
    tau += (outer - c).cross(F) - spin;
    F -= chain.link_mass_kg(joint) * delta_vc[i];
    tau += sign * (pose.link[i].position_m - c).cross(F);
    outer = pose.link[i].position_m;
    wrench[i].force_n_s = F;
    wrench[i].torque_nm_s = tau;
    axis_nm_s[joint] = pose.axis[i].dot(tau);
  }
  return axis_nm_s;
}

ImpulseMap impulse_map(const Chain& chain, const ChainPose& pose, RotorModel rotors, Formulation formulation) noexcept {
  const int n = chain.dof();
  const Jacobian J_h = chain.jacobian(pose);
  const JointMatrix H = chain.mass_matrix(pose) + chain.reflected_inertia(pose, rotors);
  const Eigen::PartialPivLU<JointMatrix> solver(H);
  ImpulseMap L(6 * n, 6);
  for (int column = 0; column < 6; ++column) {
    const JointVector J_row = J_h.row(column).transpose();
    const JointVector delta_qd = solver.solve(J_row);
    JointWrenches wrenches;
    internal_impulses(chain, pose, delta_qd, Vector6::Unit(column), formulation, wrenches);
    for (int i = 0; i < n; ++i) {
      const WrenchImpulse& wrench = wrenches[static_cast<std::size_t>(i)];
      L.block<3, 1>(3 * i, column) = wrench.force_n_s;
      L.block<3, 1>(3 * (n + i), column) = wrench.torque_nm_s;
    }
  }
  return L;
}

}  // namespace mrr::sup
