// Room: sim_vcan/plant, private to it. Rigid-body dynamics of a serial arm with spinning rotors, written for the
// emulator alone: composite bodies and Newton-Euler sums in base-frame coordinates. No heap, noexcept after
// construction.
#pragma once

#include <Eigen/Core>
#include <array>

#include "common/robot/robot.h"

namespace mrr::sim {

using PerJoint = std::array<double, kMaxJoints>;
using SquareMatrix = std::array<PerJoint, kMaxJoints>;  ///< [row][column]

/// Where everything is, base frame. The base counts as nothing: entry i belongs to joint and link i.
struct ArmPose {
  std::array<Eigen::Matrix3d, kMaxJoints> rotation;  ///< base <- link
  std::array<Eigen::Vector3d, kMaxJoints> origin;    ///< of the joint, m
  std::array<Eigen::Vector3d, kMaxJoints> axis;      ///< unit
  std::array<Eigen::Vector3d, kMaxJoints> com;       ///< of the link, m
  Eigen::Vector3d face;                              ///< centre of the hammer face, m
  Eigen::Vector3d face_axis;                         ///< out of the face, unit
};

/// Generalised forces that the motion and gravity ask for, Nm.
struct BiasTorque {
  PerJoint link;   ///< at the joints
  PerJoint motor;  ///< at the rotors, joint side
};

/// Link i turns about joint i; rotor i sits in link i - 1, turns about the same axis gear times as fast as its motor
/// coordinate (joint side), and has the spin inertia I_r; its mass belongs to the link it sits in. The kinetic energy
/// is
///   1/2 q'^T M q' + sum_i 1/2 gamma_i^2 I_ri m_i'^2 + sum_i gamma_i I_ri m_i' z_i . omega_{i-1}:
/// theory's symmetric variant once q = m, and its gyroscopic terms follow from it.
class Multibody {
 public:
  Multibody(const RobotDescription& robot, bool rotor_coupling);

  [[nodiscard]] int dof() const noexcept { return dof_; }
  [[nodiscard]] double reflected_inertia(int i) const noexcept { return reflected_inertia_[at(i)]; }

  void place(const PerJoint& q, ArmPose& pose) const noexcept;
  /// M(q), lower and upper triangle, kg m^2. Rotors do not enter.
  void mass_matrix(const ArmPose& pose, SquareMatrix& m) const noexcept;
  /// S: kinetic energy q'^T S m'. Row j (link) < column i (rotor), else zero.
  void coupling(const ArmPose& pose, SquareMatrix& s) const noexcept;
  /// Right-hand side at zero acceleration: velocities of links and rotors (joint side) in rad/s.
  void bias(const ArmPose& pose, const PerJoint& link_velocity, const PerJoint& motor_velocity,
            BiasTorque& result) const noexcept;

  /// Velocity of a point which moves with the last link, base frame.
  [[nodiscard]] Eigen::Vector3d point_velocity(const ArmPose& pose, const PerJoint& qd,
                                               const Eigen::Vector3d& point) const noexcept;
  /// Adds J^T f of a force (N, base frame) on the last link at `point`.
  void add_force(const ArmPose& pose, const Eigen::Vector3d& point, const Eigen::Vector3d& force,
                 PerJoint& torque) const noexcept;

  [[nodiscard]] double kinetic_energy(const ArmPose& pose, const PerJoint& qd, const PerJoint& motor_qd) const noexcept;
  [[nodiscard]] double gravity_energy(const ArmPose& pose) const noexcept;

 private:
  static constexpr std::size_t at(int i) noexcept { return static_cast<std::size_t>(i); }

  /// Link frames are turned at construction so that each joint's axis is its frame's z.
  struct Link {
    Eigen::Matrix3d rotation_from_parent;
    Eigen::Vector3d translation_from_parent;
    double mass;
    Eigen::Vector3d com;
    Eigen::Matrix3d inertia;
  };
  int dof_;
  std::array<Link, kMaxJoints> links_;
  PerJoint reflected_inertia_{};  ///< gamma^2 I_r
  PerJoint spin_{};               ///< gamma I_r; 0 without rotor coupling
  Eigen::Vector3d gravity_;
  Eigen::Vector3d face_;
  Eigen::Vector3d face_axis_;
};

/// Solves A x = b for a symmetric positive definite A of size n; A and b are overwritten, b becomes x.
void solve_spd(int n, SquareMatrix& a, PerJoint& b) noexcept;

}  // namespace mrr::sim
