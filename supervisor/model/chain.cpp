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

/// += R I R^T, symmetric I.
void add_rotated(Matrix3d& sum, const Matrix3d& R, const Matrix3d& I) noexcept {
  const Matrix3d half = R.lazyProduct(I);
  for (int row = 0; row < 3; ++row) {
    for (int column = row; column < 3; ++column) {
      sum(row, column) += half.row(row).dot(R.row(column));
      sum(column, row) = sum(row, column);
    }
  }
}

/// m ([r]^T [r]): what moving the reference point by r adds to an inertia matrix (parallel axes).
Matrix3d parallel_axes(double mass, const Vector3d& r) noexcept {
  return mass * (r.squaredNorm() * Matrix3d::Identity() - r * r.transpose());
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
                .reflected_inertia = joint.reflected_inertia_kg_m2(),
                .rotor_coupling = joint.transmission.gear_ratio * joint.motor.rotor_inertia_kg_m2};
  }
}

ChainPose Chain::pose(const JointVector& q) const noexcept {
  ChainPose pose;
  Matrix3d rotation = Matrix3d::Identity();
  Vector3d position = Vector3d::Zero();
  for (int i = 0; i < dof_; ++i) {
    const Body& body = body_[at(i)];
    position += rotation * body.offset_translation;
    pose.axis[at(i)].noalias() = rotation * body.axis;  // turning about the axis leaves it where it is
    const Matrix3d turned = body.still + std::sin(q[i]) * body.sine + std::cos(q[i]) * body.cosine;
    Pose& link = pose.link[at(i)];
    link.rotation.noalias() = rotation * turned;
    link.position_m = position;
    rotation = link.rotation;
    pose.com_m[at(i)] = position + rotation * body.com;
  }
  pose.face.rotation.noalias() = rotation * face_rotation_;
  pose.face.position_m = position + rotation * face_translation_;
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

JointMatrix Chain::mass_matrix(const ChainPose& pose) const noexcept {
  JointMatrix M(dof_, dof_);
  // The body outboard of joint i as one rigid body: mass, centre of mass, inertia about that centre, base frame.
  double mass = 0.0;
  Vector3d com = Vector3d::Zero();
  Matrix3d inertia = Matrix3d::Zero();
  for (int i = dof_ - 1; i >= 0; --i) {
    const Body& body = body_[at(i)];
    const Matrix3d& R = pose.link[at(i)].rotation;
    const double sum = mass + body.mass;
    const Vector3d between = pose.com_m[at(i)] - com;
    // Reduced mass: both bodies seen from their common centre of mass. A massless arm has none.
    if (i == dof_ - 1) {
      com = pose.com_m[at(i)];
    } else if (sum > 0.0) {
      inertia += parallel_axes(mass * body.mass / sum, between);
      com += (body.mass / sum) * between;
    }
    add_rotated(inertia, R, body.inertia);
    mass = sum;

    const Vector3d& z = pose.axis[at(i)];
    const Vector3d momentum = mass * z.cross(com - pose.link[at(i)].position_m);
    const Vector3d spin = inertia * z;
    for (int j = i; j >= 0; --j) {
      const Vector3d arm = com - pose.link[at(j)].position_m;
      M(i, j) = M(j, i) = pose.axis[at(j)].dot(spin + arm.cross(momentum));
    }
  }
  return M;
}

JointMatrix Chain::reflected_inertia(const ChainPose& pose, RotorModel model) const noexcept {
  JointMatrix B(dof_, dof_);
  B.setZero();
  for (int i = 0; i < dof_; ++i) {
    B(i, i) = body_[at(i)].reflected_inertia;
    if (model == RotorModel::diag) continue;
    for (int j = 0; j < i; ++j) {
      B(i, j) = body_[at(i)].rotor_coupling * pose.axis[at(i)].dot(pose.axis[at(j)]);
      if (model == RotorModel::sym) B(j, i) = B(i, j);
    }
  }
  return B;
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
