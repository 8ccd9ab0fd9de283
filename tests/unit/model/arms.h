// Test support: arms written as Denavit-Hartenberg rows (the reference's convention) and random chains, as robot
// descriptions.
#pragma once

#include <Eigen/Geometry>
#include <string>
#include <vector>

#include "common/core/random.h"
#include "common/robot/robot.h"
#include "supervisor/model/chain.h"

namespace mrr::test {

/// One row of standard (distal) DH with the link's data in its distal frame.
struct DhLink {
  double d_m, theta0_rad, a_m, alpha_rad;
  double mass_kg;
  Eigen::Vector3d com_m;
  Eigen::Matrix3d inertia_kg_m2;
  double gear_ratio;
  double rotor_inertia_kg_m2;
};

/// A robot description made from DH rows, and the rotations that lead back from its frames to the distal ones.
struct DhArm {
  RobotDescription robot;
  std::vector<Eigen::Matrix3d> link_to_distal;  ///< link frame (at the joint) <- distal frame i

  /// Rotation base <- distal frame i.
  [[nodiscard]] Eigen::Matrix3d distal(const sup::ChainPose& pose, int i) const {
    const auto k = static_cast<std::size_t>(i);
    return pose.link[k].rotation * link_to_distal[k];
  }
};

/// "j1" for ("j", 0).
inline std::string numbered(std::string letter, std::size_t index) {
  letter += std::to_string(index + 1);
  return letter;
}

/// A URDF joint frame is the distal frame of the link before, so the offset of joint i+1 is the constant part of DH row
/// i.
inline DhArm make_dh_arm(const std::vector<DhLink>& links, const Eigen::Vector3d& tool_m) {
  DhArm arm;
  arm.robot.name = "dh";
  FrameOffset offset;
  for (const DhLink& row : links) {
    const Eigen::Isometry3d to_distal = Eigen::AngleAxisd(row.theta0_rad, Eigen::Vector3d::UnitZ()) *
                                        Eigen::Translation3d(row.a_m, 0.0, row.d_m) *
                                        Eigen::AngleAxisd(row.alpha_rad, Eigen::Vector3d::UnitX());
    const Eigen::Matrix3d R = to_distal.linear();
    JointDescription joint;
    joint.name = numbered("j", arm.robot.joints.size());
    joint.offset = offset;
    joint.link = {.name = numbered("l", arm.robot.joints.size()),
                  .mass_kg = row.mass_kg,
                  .com_m = to_distal * row.com_m,
                  .inertia_kg_m2 = R * row.inertia_kg_m2 * R.transpose()};
    joint.transmission.gear_ratio = row.gear_ratio;
    joint.motor.rotor_inertia_kg_m2 = row.rotor_inertia_kg_m2;
    arm.robot.joints.push_back(joint);
    arm.link_to_distal.push_back(R);
    offset = {.rotation = R, .translation_m = to_distal.translation()};
  }
  arm.robot.hammer.face = {.rotation = offset.rotation,
                           .translation_m = offset.translation_m + offset.rotation * tool_m};
  return arm;
}

/// Table 3 of the reference: the arm of its experiments.
inline DhArm reference_arm() {
  constexpr double kRightAngle = 1.57079632679489661923;
  const auto diagonal = [](double x, double y, double z) {
    return Eigen::Matrix3d(Eigen::Vector3d(x, y, z).asDiagonal());
  };
  return make_dh_arm({{0.48, 0, 0, kRightAngle, 3.5, {0, -0.24, 0}, diagonal(.25, .017, .25), 133, 1.68e-5},
                      {0, 0, 0.38, 0, 3.5, {-0.19, 0, 0}, diagonal(.017, .25, .25), 101, 1.68e-5},
                      {0, 0, 0.38, 0, 1.0, {-0.03, 0, 0}, diagonal(.017, .25, .25), 101, 1.68e-5}},
                     Eigen::Vector3d::Zero());
}

inline Eigen::Vector3d random_unit(Random& random) {
  Eigen::Vector3d v;
  do {
    v = {random.normal(), random.normal(), random.normal()};
  } while (!(v.norm() > 0.1));
  return v.normalized();
}

inline Eigen::Matrix3d random_rotation(Random& random) {
  return Eigen::AngleAxisd(random.uniform(-3.1, 3.1), random_unit(random)).toRotationMatrix();
}

/// A chain with arbitrary offsets, axes and physically possible inertias.
inline RobotDescription random_robot(Random& random, int dof) {
  RobotDescription robot;
  robot.name = "random";
  robot.gravity_m_s2 = 9.81 * random_unit(random);
  for (int i = 0; i < dof; ++i) {
    JointDescription joint;
    joint.name = numbered("j", robot.joints.size());
    joint.offset.rotation = random_rotation(random);
    joint.offset.translation_m = 0.4 * random.uniform() * random_unit(random);
    joint.axis = random_unit(random);
    // The second moments of a mass distribution may be anything positive; inertia follows from them.
    const Eigen::Vector3d moments{random.uniform(.002, .1), random.uniform(.002, .1), random.uniform(.002, .1)};
    const Eigen::Matrix3d R = random_rotation(random);
    joint.link = {
        .name = numbered("l", robot.joints.size()),
        .mass_kg = random.uniform(0.3, 4.0),
        .com_m = 0.2 * random.uniform() * random_unit(random),
        .inertia_kg_m2 =
            R * (moments.sum() * Eigen::Matrix3d::Identity() - Eigen::Matrix3d(moments.asDiagonal())) * R.transpose()};
    joint.transmission.gear_ratio = random.uniform(50.0, 160.0);
    joint.motor.rotor_inertia_kg_m2 = random.uniform(0.5e-5, 6e-5);
    robot.joints.push_back(joint);
  }
  robot.hammer.face.rotation = random_rotation(random);
  robot.hammer.face.translation_m = 0.3 * random.uniform() * random_unit(random);
  return robot;
}

inline sup::JointVector random_vector(Random& random, int dof, double low, double high) {
  sup::JointVector v(dof);
  for (int i = 0; i < dof; ++i) v[i] = random.uniform(low, high);
  return v;
}

}  // namespace mrr::test
