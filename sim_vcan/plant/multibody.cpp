#include "sim_vcan/plant/multibody.h"

#include <Eigen/Geometry>
#include <cmath>

namespace mrr::sim {

using Eigen::Matrix3d;
using Eigen::Vector3d;

namespace {

/// A rotation that takes e_z to `axis`.
Matrix3d turn_z_to(const Vector3d& axis) {
  return Eigen::Quaterniond::FromTwoVectors(Vector3d::UnitZ(), axis).matrix();
}

}  // namespace

Multibody::Multibody(const RobotDescription& robot, bool rotor_coupling)
    : dof_(robot.dof()), gravity_(robot.gravity_m_s2) {
  Matrix3d parent_turn = Matrix3d::Identity();
  for (int i = 0; i < dof_; ++i) {
    const JointDescription& joint = robot.joints[at(i)];
    const Matrix3d turn = turn_z_to(joint.axis.normalized());
    Link& link = links_[at(i)];
    link.rotation_from_parent = parent_turn.transpose() * joint.offset.rotation * turn;
    link.translation_from_parent = parent_turn.transpose() * joint.offset.translation_m;
    link.mass = joint.link.mass_kg;
    link.com = turn.transpose() * joint.link.com_m;
    link.inertia = turn.transpose() * joint.link.inertia_kg_m2 * turn;
    reflected_inertia_[at(i)] = joint.reflected_inertia_kg_m2();
    spin_[at(i)] = rotor_coupling ? joint.transmission.gear_ratio * joint.motor.rotor_inertia_kg_m2 : 0.0;
    parent_turn = turn;
  }
  face_ = parent_turn.transpose() * robot.hammer.face.translation_m;
  face_axis_ = parent_turn.transpose() * robot.hammer.face.rotation.col(2);
}

void Multibody::place(const PerJoint& q, ArmPose& pose) const noexcept {
  for (std::size_t i = 0; i < at(dof_); ++i) {
    const Link& link = links_[i];
    const double c = std::cos(q[i]);
    const double s = std::sin(q[i]);
    const Matrix3d& offset = link.rotation_from_parent;
    Matrix3d turned;
    turned.col(0) = c * offset.col(0) + s * offset.col(1);
    turned.col(1) = c * offset.col(1) - s * offset.col(0);
    turned.col(2) = offset.col(2);
    if (i == 0) {
      pose.rotation[0] = turned;
      pose.origin[0] = link.translation_from_parent;
    } else {
      pose.rotation[i].noalias() = pose.rotation[i - 1] * turned;
      pose.origin[i] = pose.origin[i - 1] + pose.rotation[i - 1] * link.translation_from_parent;
    }
    pose.axis[i] = pose.rotation[i].col(2);
    pose.com[i] = pose.origin[i] + pose.rotation[i] * link.com;
  }
  const std::size_t last = at(dof_ - 1);
  pose.face = pose.origin[last] + pose.rotation[last] * face_;
  pose.face_axis = pose.rotation[last] * face_axis_;
}

void Multibody::mass_matrix(const ArmPose& pose, SquareMatrix& m) const noexcept {
  // Joint j moves links j .. n-1 as one body: its mass, centre and inertia, built up from the tip.
  double mass = 0.0;
  Vector3d com = Vector3d::Zero();
  Matrix3d inertia = Matrix3d::Zero();
  for (std::size_t j = at(dof_); j-- > 0;) {
    const Link& link = links_[j];
    const Vector3d apart = pose.com[j] - com;
    const double total = mass + link.mass;
    const double reduced = mass * link.mass / total;
    inertia += pose.rotation[j] * link.inertia * pose.rotation[j].transpose();
    inertia -= reduced * apart * apart.transpose();
    inertia.diagonal().array() += reduced * apart.squaredNorm();
    com += (link.mass / total) * apart;
    mass = total;

    const Vector3d& axis = pose.axis[j];
    const Vector3d force = mass * axis.cross(com - pose.origin[j]);  // to accelerate it by one unit of joint j
    const Vector3d moment = inertia * axis;
    for (std::size_t i = 0; i <= j; ++i) {
      m[i][j] = m[j][i] = pose.axis[i].dot(moment + (com - pose.origin[i]).cross(force));
    }
  }
}

void Multibody::coupling(const ArmPose& pose, SquareMatrix& s) const noexcept {
  for (std::size_t j = 0; j < at(dof_); ++j) {
    for (std::size_t i = 0; i < at(dof_); ++i) s[j][i] = j < i ? spin_[i] * pose.axis[j].dot(pose.axis[i]) : 0.0;
  }
}

void Multibody::bias(const ArmPose& pose, const PerJoint& link_velocity, const PerJoint& motor_velocity,
                     BiasTorque& result) const noexcept {
  const std::size_t n = at(dof_);
  std::array<Vector3d, kMaxJoints> force;   // of each link's own motion
  std::array<Vector3d, kMaxJoints> moment;  // likewise, about its centre of mass

  Vector3d omega = Vector3d::Zero();
  Vector3d alpha = Vector3d::Zero();
  Vector3d acceleration = -gravity_;  // of the joint's origin
  for (std::size_t i = 0; i < n; ++i) {
    const Vector3d& axis = pose.axis[i];
    if (i > 0) {
      const Vector3d reach = pose.origin[i] - pose.origin[i - 1];
      acceleration += alpha.cross(reach) + omega.cross(omega.cross(reach));
    }
    // Rotor i precesses with the link that carries it, and is left behind when that link speeds up.
    result.motor[i] = spin_[i] * axis.dot(alpha);
    const Vector3d precession = omega.cross(axis);
    if (i > 0) moment[i - 1] += (spin_[i] * motor_velocity[i]) * precession;

    alpha += link_velocity[i] * precession;
    omega += link_velocity[i] * axis;
    const Vector3d arm = pose.com[i] - pose.origin[i];
    force[i] = links_[i].mass * (acceleration + alpha.cross(arm) + omega.cross(omega.cross(arm)));
    // R (I R^T v): two products with a vector are cheaper than turning the inertia.
    const Matrix3d& rotation = pose.rotation[i];
    const Vector3d omega_link = rotation.transpose() * omega;
    const Vector3d alpha_link = rotation.transpose() * alpha;
    const Matrix3d& inertia = links_[i].inertia;
    moment[i] = rotation * (inertia * alpha_link + omega_link.cross(inertia * omega_link));
  }

  Vector3d total_force = Vector3d::Zero();
  Vector3d total_moment = Vector3d::Zero();  // about the joint's origin
  for (std::size_t i = n; i-- > 0;) {
    if (i + 1 < n) total_moment += (pose.origin[i + 1] - pose.origin[i]).cross(total_force);
    total_force += force[i];
    total_moment += moment[i] + (pose.com[i] - pose.origin[i]).cross(force[i]);
    result.link[i] = pose.axis[i].dot(total_moment);
  }
}

Vector3d Multibody::point_velocity(const ArmPose& pose, const PerJoint& qd, const Vector3d& point) const noexcept {
  Vector3d velocity = Vector3d::Zero();
  for (std::size_t i = 0; i < at(dof_); ++i) velocity += qd[i] * pose.axis[i].cross(point - pose.origin[i]);
  return velocity;
}

void Multibody::add_force(const ArmPose& pose, const Vector3d& point, const Vector3d& force,
                          PerJoint& torque) const noexcept {
  for (std::size_t i = 0; i < at(dof_); ++i) torque[i] += pose.axis[i].dot((point - pose.origin[i]).cross(force));
}

double Multibody::kinetic_energy(const ArmPose& pose, const PerJoint& qd, const PerJoint& motor_qd) const noexcept {
  double energy = 0.0;
  Vector3d omega = Vector3d::Zero();
  for (std::size_t i = 0; i < at(dof_); ++i) {
    energy += 0.5 * reflected_inertia_[i] * motor_qd[i] * motor_qd[i];
    energy += spin_[i] * motor_qd[i] * pose.axis[i].dot(omega);
    omega += qd[i] * pose.axis[i];
    Vector3d velocity = Vector3d::Zero();
    for (std::size_t j = 0; j <= i; ++j) velocity += qd[j] * pose.axis[j].cross(pose.com[i] - pose.origin[j]);
    const Vector3d omega_link = pose.rotation[i].transpose() * omega;
    energy += 0.5 * links_[i].mass * velocity.squaredNorm() + 0.5 * omega_link.dot(links_[i].inertia * omega_link);
  }
  return energy;
}

double Multibody::gravity_energy(const ArmPose& pose) const noexcept {
  double energy = 0.0;
  for (std::size_t i = 0; i < at(dof_); ++i) energy -= links_[i].mass * gravity_.dot(pose.com[i]);
  return energy;
}

void solve_spd(int n, SquareMatrix& a, PerJoint& b) noexcept {
  // L D L^T in place, lower triangle; b is reduced on the way.
  const auto size = static_cast<std::size_t>(n);
  for (std::size_t j = 0; j < size; ++j) {
    for (std::size_t i = j + 1; i < size; ++i) {
      const double unscaled = a[i][j];
      a[i][j] = unscaled / a[j][j];
      for (std::size_t k = j + 1; k <= i; ++k) a[i][k] -= unscaled * a[k][j];
      b[i] -= a[i][j] * b[j];
    }
  }
  for (std::size_t j = size; j-- > 0;) {
    b[j] /= a[j][j];
    for (std::size_t i = j + 1; i < size; ++i) b[j] -= a[i][j] * b[i];
  }
}

}  // namespace mrr::sim
