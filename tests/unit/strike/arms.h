// Arms for the strike tests: the two example robots and random ones made of the reference arm's drives.
#pragma once

#include <Eigen/Geometry>
#include <filesystem>

#include "common/core/random.h"
#include "common/robot/robot.h"
#include "supervisor/model/chain.h"

namespace mrr::sup::test {

inline RobotDescription example(const char* name) {
  return load_robot(std::filesystem::path(MRR_SOURCE_DIR) / "robots" / name);
}

inline JointVector vector_of(std::initializer_list<double> values) {
  JointVector v(static_cast<Eigen::Index>(values.size()));
  Eigen::Index i = 0;
  for (const double value : values) v[i++] = value;
  return v;
}

inline JointVector random_pose(const RobotDescription& robot, Random& random, double share = 1.0) {
  JointVector q(robot.dof());
  for (int i = 0; i < robot.dof(); ++i) {
    const JointLimits& limits = robot.joints[static_cast<std::size_t>(i)].limits;
    const double middle = 0.5 * (limits.lower_rad + limits.upper_rad);
    q[i] = middle + share * 0.5 * (limits.upper_rad - limits.lower_rad) * random.uniform(-1.0, 1.0);
  }
  return q;
}

/// n joints, axes turned at random against each other, links of 0.2 to 0.4 m with masses of 1 to 3 kg; drives and
/// limits as the reference arm's base and hammer joints.
inline RobotDescription random_arm(const RobotDescription& reference, int n, Random& random) {
  RobotDescription robot = reference;
  robot.name = "random";
  robot.joints.clear();
  const auto length = [&] { return random.uniform(0.2, 0.4); };
  for (int i = 0; i < n; ++i) {
    JointDescription joint = reference.joints[i < 2 ? 0 : 1];
    joint.name = "joint_" + std::to_string(i + 1);
    joint.limits.lower_rad = -2.6;
    joint.limits.upper_rad = 2.6;
    const double turn = random.uniform(0.8, 2.3);
    joint.offset.rotation = (Eigen::AngleAxisd(random.uniform(-3.1, 3.1), Eigen::Vector3d::UnitZ()) *
                             Eigen::AngleAxisd(i == 0 ? 0.0 : turn, Eigen::Vector3d::UnitX()))
                                .toRotationMatrix();
    joint.offset.translation_m = i == 0 ? Eigen::Vector3d(0, 0, 0.4) : Eigen::Vector3d(length(), 0, 0);
    joint.axis = Eigen::Vector3d::UnitZ();
    joint.link.mass_kg = random.uniform(1.0, 3.0);
    joint.link.com_m = Eigen::Vector3d(0.15, random.uniform(-0.03, 0.03), random.uniform(-0.03, 0.03));
    joint.link.inertia_kg_m2 =
        Eigen::Vector3d(random.uniform(0.01, 0.015), random.uniform(0.015, 0.02), random.uniform(0.015, 0.02))
            .asDiagonal();
    robot.joints.push_back(joint);
  }
  robot.hammer.face.translation_m = Eigen::Vector3d(0.3, 0, 0);
  robot.hammer.face.rotation =
      Eigen::AngleAxisd(random.uniform(-3.1, 3.1), Eigen::Vector3d(1, 1, 1).normalized()).toRotationMatrix();
  return robot;
}

}  // namespace mrr::sup::test
