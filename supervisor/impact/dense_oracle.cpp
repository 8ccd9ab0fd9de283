#include "supervisor/impact/dense_oracle.h"

#include <Eigen/LU>

namespace mrr::sup {
namespace {

/// [r] of (40): [r] f = r x f.
Eigen::Matrix3d skew(const Eigen::Vector3d& r) {
  Eigen::Matrix3d S;
  S << 0.0, -r.z(), r.y(), r.z(), 0.0, -r.x(), -r.y(), r.x(), 0.0;
  return S;
}

}  // namespace

DenseImpulseModel dense_impulse_model(const Chain& chain, const JointVector& q, RotorModel rotors,
                                      Formulation formulation) {
  const int n = chain.dof();
  const ChainPose pose = chain.pose(q);
  const Eigen::MatrixXd H = chain.mass_matrix(pose) + chain.reflected_inertia(pose, rotors);
  const Eigen::MatrixXd J_h = chain.jacobian(pose);
  const Eigen::MatrixXd delta_qd = H.fullPivLu().solve(J_h.transpose());
  const Eigen::Matrix3d identity = Eigen::Matrix3d::Identity();
  DenseImpulseModel model;
  model.A = Eigen::MatrixXd::Zero(6 * n, 6 * n);
  model.B = Eigen::MatrixXd::Zero(6 * n, 6);
  model.D = Eigen::MatrixXd::Zero(6 * n, 6);
  for (int i = 0; i < n; ++i) {
    const auto at = static_cast<std::size_t>(i);
    const int force = 3 * i;
    const int torque = 3 * (n + i);
    const Eigen::Vector3d inner = pose.link[at].position_m - pose.com_m[at];  // r_ci^i
    const Eigen::Vector3d outer =                                             // r_ci^{i+1}
        (i + 1 < n ? pose.link[at + 1].position_m : pose.face.position_m) - pose.com_m[at];
    model.A.block<3, 3>(force, force) = -identity;
    model.A.block<3, 3>(torque, torque) = -identity;
    model.A.block<3, 3>(torque, force) = formulation == Formulation::corrected ? -skew(inner) : skew(inner);
    if (i + 1 < n) {
      model.A.block<3, 3>(force, force + 3) = identity;
      model.A.block<3, 3>(torque, torque + 3) = identity;
      model.A.block<3, 3>(torque, force + 3) = skew(outer);
    } else {
      model.B.block<3, 3>(force, 0) = identity;
      model.B.block<3, 3>(torque, 0) = skew(outer);
      model.B.block<3, 3>(torque, 3) = identity;
    }
    const Eigen::MatrixXd J_ci = chain.com_jacobian(pose, i);
    const Eigen::Matrix3d R = pose.link[at].rotation;
    model.D.block<3, 6>(force, 0) = chain.link_mass_kg(i) * J_ci.topRows(3) * delta_qd;
    model.D.block<3, 6>(torque, 0) = R * chain.link_inertia_kg_m2(i) * R.transpose() * J_ci.bottomRows(3) * delta_qd;
  }
  model.L = model.A.fullPivLu().solve(model.D - model.B);
  return model;
}

}  // namespace mrr::sup
