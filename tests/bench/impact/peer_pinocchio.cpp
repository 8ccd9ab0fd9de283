// The same prediction by Pinocchio at its best: crba, Cholesky, rnea with the jump of speeds as acceleration. A library
// of its own, opened at run time: its Eigen is compiled with other options than ours.
#include <Eigen/Cholesky>
#include <pinocchio/algorithm/crba.hpp>
#include <pinocchio/algorithm/joint-configuration.hpp>
#include <pinocchio/algorithm/rnea.hpp>
#include <pinocchio/multibody.hpp>
#include <vector>

#include "tests/bench/impact/peer.h"

namespace pin = pinocchio;

namespace {

struct Peer {
  pin::Model model;
  pin::Data data;
  pin::Data still;  // of rnea, which computes its own kinematics
  Eigen::Vector3d face;
  Eigen::VectorXd q, zero, lever, x, delta;
  Eigen::MatrixXd M;
  Eigen::LLT<Eigen::MatrixXd> llt;
  std::vector<pin::Force> external;
};

}  // namespace

extern "C" {

__attribute__((visibility("default"))) void* peer_create(const PeerJoint* joints, int n, const double* face) {
  auto* p = new Peer;
  pin::JointIndex parent = 0;
  for (int i = 0; i < n; ++i) {
    const PeerJoint& j = joints[i];
    const Eigen::Map<const Eigen::Matrix3d> rotation(j.rotation), inertia(j.inertia);
    const Eigen::Map<const Eigen::Vector3d> offset(j.offset), axis(j.axis), com(j.com);
    // The plain axes have code of their own, which is faster.
    const pin::SE3 placement(rotation, offset);
    const std::string name = "joint_" + std::to_string(i);
    if (axis == Eigen::Vector3d::UnitX()) {
      parent = p->model.addJoint(parent, pin::JointModelRX(), placement, name);
    } else if (axis == Eigen::Vector3d::UnitY()) {
      parent = p->model.addJoint(parent, pin::JointModelRY(), placement, name);
    } else if (axis == Eigen::Vector3d::UnitZ()) {
      parent = p->model.addJoint(parent, pin::JointModelRZ(), placement, name);
    } else {
      parent = p->model.addJoint(parent, pin::JointModelRevoluteUnaligned(axis), placement, name);
    }
    p->model.appendBodyToJoint(parent, pin::Inertia(j.mass, com, inertia), pin::SE3::Identity());
    p->model.armature[i] = j.rotor_inertia;
  }
  p->model.gravity.setZero();  // impulses know none
  p->data = pin::Data(p->model);
  p->still = pin::Data(p->model);
  p->face = Eigen::Map<const Eigen::Vector3d>(face);
  p->q = p->zero = p->lever = p->x = p->delta = Eigen::VectorXd::Zero(n);
  p->M = Eigen::MatrixXd::Zero(n, n);
  p->llt = Eigen::LLT<Eigen::MatrixXd>(n);
  p->external.assign(static_cast<std::size_t>(n) + 1, pin::Force::Zero());
  return p;
}

__attribute__((visibility("default"))) double peer_predict(void* peer, const double* q, const double* qd,
                                                           const double* normal, double restitution, double* axis,
                                                           double* wrench) {
  Peer& p = *static_cast<Peer*>(peer);
  const int n = p.model.nv;
  const Eigen::Map<const Eigen::Vector3d> d(normal);
  p.q = Eigen::Map<const Eigen::VectorXd>(q, n);
  pin::crba(p.model, p.data, p.q, pin::Convention::WORLD);
  const pin::SE3& tip = p.data.oMi[static_cast<std::size_t>(n)];
  const Eigen::Vector3d at = tip.act(p.face);
  // data.J holds the joints' twists about the base's origin.
  p.lever.noalias() = p.data.J.topRows<3>().transpose() * d;
  p.lever.noalias() += p.data.J.bottomRows<3>().transpose() * at.cross(d);
  p.M.triangularView<Eigen::Upper>() = p.data.M;
  p.llt.compute(p.M.selfadjointView<Eigen::Upper>());
  p.x = p.lever;
  p.llt.solveInPlace(p.x);
  const double speed = -p.lever.dot(Eigen::Map<const Eigen::VectorXd>(qd, n));
  const double P = (1.0 + restitution) * speed / p.lever.dot(p.x);
  p.delta = P * p.x;
  const Eigen::Vector3d local = tip.rotation().transpose() * d * P;
  p.external.back() = pin::Force(local, p.face.cross(local));
  pin::rnea(p.model, p.still, p.q, p.zero, p.delta, p.external);
  for (int i = 0; i < n; ++i) {
    // What link i gives link i-1 is the opposite of what it gets; without the rotor's share.
    axis[i] = -(p.still.tau[i] - p.model.armature[i] * p.delta[i]);
    Eigen::Map<Eigen::Matrix<double, 6, 1>>(wrench + 6 * i) = -p.still.f[static_cast<std::size_t>(i) + 1].toVector();
  }
  return P;
}

}  // extern "C"
