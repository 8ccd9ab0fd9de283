// Room: supervisor/model. Kinematics and rigid-body dynamics of a serial chain of revolute joints.
// May touch common/; knows nothing of impacts, buses or the plant. After construction: no heap, no exceptions.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>

#include "common/robot/robot.h"

namespace mrr::sup {

using JointVector = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, kMaxJoints, 1>;
using JointMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, kMaxJoints, kMaxJoints>;
/// 6 x n, rows linear then angular, base frame.
using Jacobian = Eigen::Matrix<double, 6, Eigen::Dynamic, 0, 6, kMaxJoints>;
using Vector6 = Eigen::Matrix<double, 6, 1>;

/// Position and orientation of a frame in the base frame. Unset until computed: sixteen of them are made per q.
struct Pose {
  Eigen::Matrix3d rotation;    ///< base <- frame
  Eigen::Vector3d position_m;  ///< its origin, base frame
};

/// Where everything is at one q; all in the base frame. Entries beyond the chain's dof are unset.
struct ChainPose {
  std::array<Pose, kMaxJoints> link;              ///< link i's frame: at joint i, URDF convention
  std::array<Eigen::Vector3d, kMaxJoints> axis;   ///< unit axis of joint i
  std::array<Eigen::Vector3d, kMaxJoints> com_m;  ///< centre of mass of link i
  Pose face;                                      ///< hammer face: z out of the face
};

/// What the links' inertia and a blow on the face need of one pose besides; base frame. Entries beyond dof are unset.
struct PoseTerms {
  Jacobian face;                                    ///< J_h
  std::array<Eigen::Matrix3d, kMaxJoints> inertia;  ///< of link i about its centre of mass, kg m^2
};

/// How the inertia of the rotors enters (docs/impulse_models.md).
enum class RotorModel : std::uint8_t {
  diag,   ///< B_ii = gamma_i^2 I_r,i alone
  lower,  ///< and B_ij = gamma_i I_r,i z_i.z_j for j < i: the reference's (11)-(13), asymmetric, does not conserve
          ///< energy
  sym,    ///< its symmetric completion, the default
};

/// A serial chain built from a robot description. Links are rigid; `M` is of the links alone, the rotors are `B`.
/// Vectors have dof() entries. A vector of another size, or a NaN, is the caller's error: results are then meaningless.
class Chain {
 public:
  /// Copies what it needs. Precondition: 1 <= dof <= kMaxJoints, as load_robot() guarantees; throws DescriptionError
  /// else.
  explicit Chain(const RobotDescription& robot);

  [[nodiscard]] int dof() const noexcept { return dof_; }
  /// Largest possible distance from joint 1 to the face centre, m: the chain's lengths added up.
  [[nodiscard]] double reach_m() const noexcept { return reach_m_; }
  /// gamma^2 I_r of joint i, kg m^2.
  [[nodiscard]] double rotor_inertia_kg_m2(int joint) const noexcept { return body_[at(joint)].reflected_inertia; }
  [[nodiscard]] double link_mass_kg(int joint) const noexcept { return body_[at(joint)].mass; }
  /// Inertia of link i about its centre of mass, link-frame axes.
  [[nodiscard]] const Eigen::Matrix3d& link_inertia_kg_m2(int joint) const noexcept { return body_[at(joint)].inertia; }

  /// Forward kinematics of all links. Callers that need several quantities at one q compute this once.
  [[nodiscard]] ChainPose pose(const JointVector& q) const noexcept;
  [[nodiscard]] Pose face_pose(const JointVector& q) const noexcept;

  /// J_h: velocity (linear; angular) of the hammer face centre = J_h q', base frame.
  [[nodiscard]] Jacobian jacobian(const JointVector& q) const noexcept { return jacobian(pose(q)); }
  [[nodiscard]] Jacobian jacobian(const ChainPose& pose) const noexcept;
  /// J_ci: the same for the centre of mass of link `link` (0-based); columns after it are zero.
  [[nodiscard]] Jacobian com_jacobian(const ChainPose& pose, int link) const noexcept;

  [[nodiscard]] PoseTerms terms(const ChainPose& pose) const noexcept;

  /// M(q), links only, kg m^2 (composite rigid bodies).
  [[nodiscard]] JointMatrix mass_matrix(const JointVector& q) const noexcept { return mass_matrix(pose(q)); }
  [[nodiscard]] JointMatrix mass_matrix(const ChainPose& pose) const noexcept { return mass_matrix(pose, terms(pose)); }
  [[nodiscard]] JointMatrix mass_matrix(const ChainPose& pose, const PoseTerms& terms) const noexcept;

  /// B, joint side, kg m^2; (10)-(13). It depends on the pose through z_i.z_j.
  [[nodiscard]] JointMatrix reflected_inertia(const JointVector& q, RotorModel model = RotorModel::sym) const noexcept {
    return reflected_inertia(pose(q), model);
  }
  [[nodiscard]] JointMatrix reflected_inertia(const ChainPose& pose,
                                              RotorModel model = RotorModel::sym) const noexcept {
    JointMatrix B = JointMatrix::Zero(dof_, dof_);
    add_reflected_inertia(pose, model, B);
    return B;
  }
  /// += B.
  void add_reflected_inertia(const ChainPose& pose, RotorModel model, JointMatrix& sum) const noexcept;

  /// g(q), Nm: what holds the links at rest against gravity.
  [[nodiscard]] JointVector gravity(const JointVector& q) const noexcept { return gravity(pose(q)); }
  [[nodiscard]] JointVector gravity(const ChainPose& pose) const noexcept;

  /// h = C(q, q') q' + g(q), Nm.
  [[nodiscard]] JointVector bias(const JointVector& q, const JointVector& qd) const noexcept;

  /// M q'' + h, Nm, links only (recursive Newton-Euler); rotors need B q'' more, friction is not here.
  [[nodiscard]] JointVector inverse_dynamics(const JointVector& q, const JointVector& qd,
                                             const JointVector& qdd) const noexcept {
    return inverse_dynamics(pose(q), qd, qdd);
  }
  [[nodiscard]] JointVector inverse_dynamics(const ChainPose& pose, const JointVector& qd,
                                             const JointVector& qdd) const noexcept;

 private:
  struct Body {
    // Rodrigues with the offset: parent <- link is still + sin q sine + cos q cosine.
    Eigen::Matrix3d still, sine, cosine;
    Eigen::Vector3d offset_translation;  // parent frame
    Eigen::Vector3d axis;                // parent frame
    Eigen::Vector3d com;                 // link frame
    Eigen::Matrix3d inertia;             // about com, link axes
    double mass;
    // Of the links beyond this one and it together: reduced mass of the two, and its share of their sum.
    double outboard_mass;  // its own included
    double reduced_mass;
    double share;
    double reflected_inertia;  // gamma^2 I_r
    double rotor_coupling;     // gamma I_r
  };
  static constexpr std::size_t at(int i) noexcept { return static_cast<std::size_t>(i); }

  std::array<Body, kMaxJoints> body_{};
  Eigen::Matrix3d face_rotation_;
  Eigen::Vector3d face_translation_;
  Eigen::Vector3d gravity_;
  double reach_m_ = 0.0;
  int dof_ = 0;
};

}  // namespace mrr::sup
