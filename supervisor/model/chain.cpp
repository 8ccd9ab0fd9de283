#include "supervisor/model/chain.h"

#include <Eigen/Geometry>
#include <cmath>

#include "common/robot/errors.h"

namespace mrr::sup {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

/// [v]: [v] x = v cross x.
Matrix3d cross_matrix(const Vector3d& v) noexcept {
  Matrix3d m;
  m << 0.0, -v.z(), v.y(), v.z(), 0.0, -v.x(), -v.y(), v.x(), 0.0;
  return m;
}

/// R I R^T, symmetric I.
Matrix3d rotated(const Matrix3d& R, const Matrix3d& I) noexcept {
  const Matrix3d half = R.lazyProduct(I);
  const auto entry = [&](int row, int column) { return half.row(row).dot(R.row(column)); };
  Matrix3d to;
  to(0, 0) = entry(0, 0);
  to(1, 1) = entry(1, 1);
  to(2, 2) = entry(2, 2);
  to(0, 1) = to(1, 0) = entry(0, 1);
  to(0, 2) = to(2, 0) = entry(0, 2);
  to(1, 2) = to(2, 1) = entry(1, 2);
  return to;
}

/// m ([r]^T [r]): what moving the reference point by r adds to an inertia matrix (parallel axes).
Matrix3d parallel_axes(double mass, const Vector3d& r) noexcept {
  const Vector3d moment = mass * r;
  Matrix3d m = -moment * r.transpose();
  m.diagonal().array() += moment.dot(r);
  return m;
}

}  // namespace

Chain::Chain(const RobotDescription& robot)
    : face_rotation_(robot.hammer.face.rotation),
      face_translation_(robot.hammer.face.translation_m),
      gravity_(robot.gravity_m_s2),
      reach_m_(robot.hammer.face.translation_m.norm()),
      dof_(robot.dof()) {
  if (dof_ < 1 || dof_ > kMaxJoints) {
    throw DescriptionError("robot \"" + robot.name + "\" has " + std::to_string(dof_) + " joints; 1 to " +
                           std::to_string(kMaxJoints) + " are supported");
  }
  for (std::size_t i = 0; i < at(dof_); ++i) {
    const JointDescription& joint = robot.joints[i];
    if (i > 0) reach_m_ += joint.offset.translation_m.norm();
    const Matrix3d along = joint.axis * joint.axis.transpose();
    body_[i] = {.still = joint.offset.rotation * along,
                .sine = joint.offset.rotation * cross_matrix(joint.axis),
                .cosine = joint.offset.rotation * (Matrix3d::Identity() - along),
                .offset_translation = joint.offset.translation_m,
                .axis = joint.offset.rotation * joint.axis,
                .com = joint.link.com_m,
                .inertia = joint.link.inertia_kg_m2,
                .mass = joint.link.mass_kg,
                .outboard_mass = 0.0,
                .reduced_mass = 0.0,
                .share = 0.0,
                .reflected_inertia = joint.reflected_inertia_kg_m2(),
                .rotor_coupling = joint.transmission.gear_ratio * joint.motor.rotor_inertia_kg_m2};
  }
  double outboard = 0.0;
  for (int i = dof_ - 1; i >= 0; --i) {
    Body& body = body_[at(i)];
    body.outboard_mass = outboard + body.mass;
    body.share = outboard > 0.0 ? body.mass / body.outboard_mass : 1.0;
    body.reduced_mass = outboard * body.share;
    outboard = body.outboard_mass;
  }
}

ChainPose Chain::pose(const JointVector& q) const noexcept {
  ChainPose pose;
  for (int i = 0; i < dof_; ++i) {
    const Body& body = body_[at(i)];
    Pose& link = pose.link[at(i)];
    const Matrix3d turned = body.still + std::sin(q[i]) * body.sine + std::cos(q[i]) * body.cosine;
    if (i == 0) {
      link.rotation = turned;
      link.position_m = body.offset_translation;
      pose.axis[0] = body.axis;
    } else {
      const Pose& inner = pose.link[at(i - 1)];
      link.rotation = inner.rotation.lazyProduct(turned);
      link.position_m = inner.position_m + inner.rotation.lazyProduct(body.offset_translation);
      pose.axis[at(i)] = inner.rotation.lazyProduct(body.axis);  // turning about the axis leaves it where it is
    }
    pose.com_m[at(i)] = link.position_m + link.rotation.lazyProduct(body.com);
  }
  const Pose& last = pose.link[at(dof_ - 1)];
  pose.face.rotation = last.rotation.lazyProduct(face_rotation_);
  pose.face.position_m = last.position_m + last.rotation.lazyProduct(face_translation_);
  return pose;
}

Pose Chain::face_pose(const JointVector& q) const noexcept { return pose(q).face; }

Jacobian Chain::jacobian(const ChainPose& pose) const noexcept {
  Jacobian J(6, dof_);
  for (int i = 0; i < dof_; ++i) {
    J.col(i).head<3>() = pose.axis[at(i)].cross(pose.face.position_m - pose.link[at(i)].position_m);
    J.col(i).tail<3>() = pose.axis[at(i)];
  }
  return J;
}

Jacobian Chain::com_jacobian(const ChainPose& pose, int link) const noexcept {
  Jacobian J(6, dof_);
  J.setZero();
  for (int i = 0; i <= link; ++i) {
    J.col(i).head<3>() = pose.axis[at(i)].cross(pose.com_m[at(link)] - pose.link[at(i)].position_m);
    J.col(i).tail<3>() = pose.axis[at(i)];
  }
  return J;
}

PoseTerms Chain::terms(const ChainPose& pose) const noexcept {
  PoseTerms terms{jacobian(pose), {}};
  for (int i = 0; i < dof_; ++i) terms.inertia[at(i)] = rotated(pose.link[at(i)].rotation, body_[at(i)].inertia);
  return terms;
}

JointMatrix Chain::mass_matrix(const ChainPose& pose, const PoseTerms& terms) const noexcept {
  JointMatrix M(dof_, dof_);
  // The links from i on as one rigid body: centre of mass, and inertia about it.
  Vector3d com = Vector3d::Zero();
  Matrix3d inertia = Matrix3d::Zero();
  for (int i = dof_ - 1; i >= 0; --i) {
    const Body& body = body_[at(i)];
    const Vector3d between = pose.com_m[at(i)] - com;
    inertia += terms.inertia[at(i)] + parallel_axes(body.reduced_mass, between);
    com += body.share * between;
    // What it has when joint i turns at one rad/s: momentum, and angular momentum about the face's centre.
    const Vector3d& z = pose.axis[at(i)];
    const Vector3d momentum = body.outboard_mass * z.cross(com - pose.link[at(i)].position_m);
    const Vector3d spin = inertia.lazyProduct(z) + (com - pose.face.position_m).cross(momentum);
    for (int j = i; j >= 0; --j) {
      M(i, j) = M(j, i) = terms.face.col(j).head<3>().dot(momentum) + terms.face.col(j).tail<3>().dot(spin);
    }
  }
  return M;
}

void Chain::add_reflected_inertia(const ChainPose& pose, RotorModel model, JointMatrix& sum) const noexcept {
  for (int i = 0; i < dof_; ++i) {
    sum(i, i) += body_[at(i)].reflected_inertia;
    if (model == RotorModel::diag) continue;
    for (int j = 0; j < i; ++j) {
      const double coupling = body_[at(i)].rotor_coupling * pose.axis[at(i)].dot(pose.axis[at(j)]);
      sum(i, j) += coupling;
      if (model == RotorModel::sym) sum(j, i) += coupling;
    }
  }
}

JointVector Chain::gravity(const ChainPose& pose) const noexcept {
  JointVector g(dof_);
  double mass = 0.0;
  Vector3d moment = Vector3d::Zero();  // sum of m c of the links outboard of joint i
  for (int i = dof_ - 1; i >= 0; --i) {
    mass += body_[at(i)].mass;
    moment += body_[at(i)].mass * pose.com_m[at(i)];
    g[i] = -pose.axis[at(i)].dot((moment - mass * pose.link[at(i)].position_m).cross(gravity_));
  }
  return g;
}

JointVector Chain::bias(const JointVector& q, const JointVector& qd) const noexcept {
  JointVector none(dof_);
  none.setZero();
  return inverse_dynamics(q, qd, none);
}

JointVector Chain::inverse_dynamics(const ChainPose& pose, const JointVector& qd,
                                    const JointVector& qdd) const noexcept {
  // Out: velocities and accelerations; gravity is an upward acceleration of the base. In: forces.
  std::array<Vector3d, kMaxJoints> force;  // on link i, what its motion needs, at its centre of mass
  std::array<Vector3d, kMaxJoints> moment;
  Vector3d w = Vector3d::Zero();
  Vector3d wd = Vector3d::Zero();
  Vector3d a = -gravity_;  // of the point `from`, fixed in the link before
  Vector3d from = Vector3d::Zero();
  for (int i = 0; i < dof_; ++i) {
    const Body& body = body_[at(i)];
    const Pose& link = pose.link[at(i)];
    const Vector3d& z = pose.axis[at(i)];
    const Vector3d r = link.position_m - from;
    a += wd.cross(r) + w.cross(w.cross(r));
    from = link.position_m;
    wd += z * qdd[i] + w.cross(z) * qd[i];
    w += z * qd[i];
    const Vector3d c = pose.com_m[at(i)] - link.position_m;
    force[at(i)] = body.mass * (a + wd.cross(c) + w.cross(w.cross(c)));
    const Matrix3d& R = link.rotation;
    const Vector3d w_link = R.transpose() * w;
    const Vector3d wd_link = R.transpose() * wd;
    moment[at(i)].noalias() = R * (body.inertia * wd_link + w_link.cross(body.inertia * w_link));
  }
  JointVector torque(dof_);
  Vector3d f = Vector3d::Zero();
  Vector3d n = Vector3d::Zero();  // about the joint's centre
  Vector3d inner = Vector3d::Zero();
  for (int i = dof_ - 1; i >= 0; --i) {
    const Vector3d& p = pose.link[at(i)].position_m;
    if (i < dof_ - 1) n += (inner - p).cross(f);
    n += moment[at(i)] + (pose.com_m[at(i)] - p).cross(force[at(i)]);
    f += force[at(i)];
    inner = p;
    torque[i] = pose.axis[at(i)].dot(n);
  }
  return torque;
}

}  // namespace mrr::sup
