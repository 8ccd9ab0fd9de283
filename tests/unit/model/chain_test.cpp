#include "supervisor/model/chain.h"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <cmath>

#include "common/robot/errors.h"
#include "supervisor/model/kdl_reference.h"
#include "tests/unit/model/arms.h"

namespace mrr::sup {
namespace {

using test::random_robot;
using test::random_vector;

/// Largest difference relative to the largest entry expected (or 1, if that is smaller).
template <typename A, typename B>
double relative_difference(const A& ours, const B& theirs) {
  EXPECT_TRUE(ours.allFinite());
  return (ours - theirs).cwiseAbs().maxCoeff() / std::max(1.0, theirs.cwiseAbs().maxCoeff());
}

void expect_agrees_with_kdl(const RobotDescription& robot, std::uint64_t seed, int states) {
  const Chain chain(robot);
  const KdlReference kdl(robot);
  const int n = chain.dof();
  Random random(seed);
  constexpr double kTolerance = 1e-9;
  for (int k = 0; k < states; ++k) {
    const JointVector q = random_vector(random, n, -3.1, 3.1);
    const JointVector qd = random_vector(random, n, -3.0, 3.0);
    const JointVector qdd = random_vector(random, n, -20.0, 20.0);
    EXPECT_LT(relative_difference(chain.face_pose(q).position_m, kdl.face_pose(q).position_m), kTolerance);
    EXPECT_LT(relative_difference(chain.face_pose(q).rotation, kdl.face_pose(q).rotation), kTolerance);
    EXPECT_LT(relative_difference(chain.jacobian(q), kdl.jacobian(q)), kTolerance);
    EXPECT_LT(relative_difference(chain.mass_matrix(q), kdl.mass_matrix(q)), kTolerance);
    EXPECT_LT(relative_difference(chain.gravity(q), kdl.gravity(q)), kTolerance);
    EXPECT_LT(relative_difference(JointVector(chain.bias(q, qd) - chain.gravity(q)), kdl.coriolis(q, qd)), kTolerance);
    EXPECT_LT(relative_difference(chain.inverse_dynamics(q, qd, qdd), kdl.inverse_dynamics(q, qd, qdd)), kTolerance);
  }
}

TEST(Chain, AgreesWithKdlOnTheReferenceArm) { expect_agrees_with_kdl(test::reference_arm().robot, 11, 200); }

TEST(Chain, AgreesWithKdlOnRandomChainsOfEveryLength) {
  for (int dof = 1; dof <= kMaxJoints; ++dof) {
    for (std::uint64_t seed = 0; seed < 5; ++seed) {
      Random random(seed, static_cast<std::uint64_t>(dof));
      expect_agrees_with_kdl(random_robot(random, dof), seed + 100, 4);
    }
  }
}

TEST(Chain, RefusesMoreJointsThanItHolds) {
  Random random(1);
  EXPECT_THROW(Chain{random_robot(random, kMaxJoints + 1)}, DescriptionError);
  EXPECT_THROW(Chain{RobotDescription{}}, DescriptionError);
}

TEST(Chain, MassMatrixIsTheKineticEnergyOfTheLinks) {
  Random random(2);
  for (int k = 0; k < 50; ++k) {
    const Chain chain(random_robot(random, 1 + k % 8));
    const JointVector q = random_vector(random, chain.dof(), -3.0, 3.0);
    const ChainPose pose = chain.pose(q);
    Eigen::MatrixXd expected = Eigen::MatrixXd::Zero(chain.dof(), chain.dof());
    for (int i = 0; i < chain.dof(); ++i) {
      const Eigen::Matrix3d& R = pose.link[static_cast<std::size_t>(i)].rotation;
      const Eigen::MatrixXd J = chain.com_jacobian(pose, i);
      const Eigen::MatrixXd J_v = J.topRows(3);
      const Eigen::MatrixXd J_w = J.bottomRows(3);
      expected += chain.link_mass_kg(i) * J_v.transpose() * J_v +
                  J_w.transpose() * (R * chain.link_inertia_kg_m2(i) * R.transpose()) * J_w;
    }
    const JointMatrix M = chain.mass_matrix(pose);
    EXPECT_LT(relative_difference(M, expected), 1e-12);
    EXPECT_EQ(M, M.transpose().eval());
    EXPECT_EQ(Eigen::LLT<Eigen::MatrixXd>(M).info(), Eigen::Success) << "positive definite";
  }
}

TEST(Chain, JacobianIsTheDerivativeOfTheFacePose) {
  Random random(3);
  constexpr double kStep = 1e-6;
  for (int k = 0; k < 20; ++k) {
    const Chain chain(random_robot(random, 1 + k % 7));
    const JointVector q = random_vector(random, chain.dof(), -3.0, 3.0);
    const Jacobian J = chain.jacobian(q);
    for (int i = 0; i < chain.dof(); ++i) {
      JointVector before = q;
      JointVector after = q;
      before[i] -= kStep;
      after[i] += kStep;
      const Pose a = chain.face_pose(before);
      const Pose b = chain.face_pose(after);
      const Eigen::Vector3d linear = (b.position_m - a.position_m) / (2 * kStep);
      const Eigen::Matrix3d spin = (b.rotation - a.rotation) / (2 * kStep) * chain.face_pose(q).rotation.transpose();
      const Eigen::Vector3d angular{spin(2, 1), spin(0, 2), spin(1, 0)};
      EXPECT_LT((J.col(i).head<3>() - linear).norm(), 1e-8);
      EXPECT_LT((J.col(i).tail<3>() - angular).norm(), 1e-8);
    }
  }
}

TEST(Chain, GravityIsTheSlopeOfPotentialEnergy) {
  Random random(4);
  constexpr double kStep = 1e-6;
  for (int k = 0; k < 20; ++k) {
    const RobotDescription robot = random_robot(random, 1 + k % 7);
    const Chain chain(robot);
    const auto energy = [&](const JointVector& q) {
      const ChainPose pose = chain.pose(q);
      double sum = 0.0;
      for (std::size_t i = 0; i < robot.joints.size(); ++i) {
        sum -= robot.joints[i].link.mass_kg * robot.gravity_m_s2.dot(pose.com_m[i]);
      }
      return sum;
    };
    const JointVector q = random_vector(random, chain.dof(), -3.0, 3.0);
    const JointVector g = chain.gravity(q);
    for (int i = 0; i < chain.dof(); ++i) {
      JointVector before = q;
      JointVector after = q;
      before[i] -= kStep;
      after[i] += kStep;
      EXPECT_NEAR(g[i], (energy(after) - energy(before)) / (2 * kStep), 1e-6);
    }
  }
}

TEST(Chain, TorqueTimesSpeedIsTheRateOfKineticEnergyWithoutGravity) {
  Random random(5);
  constexpr double kStep = 1e-5;
  for (int k = 0; k < 20; ++k) {
    RobotDescription robot = random_robot(random, 1 + k % 7);
    robot.gravity_m_s2.setZero();
    const Chain chain(robot);
    const JointVector q = random_vector(random, chain.dof(), -3.0, 3.0);
    const JointVector qd = random_vector(random, chain.dof(), -2.0, 2.0);
    const JointVector qdd = random_vector(random, chain.dof(), -5.0, 5.0);
    const auto energy = [&](double t) {
      const JointVector q_t = q + t * qd + 0.5 * t * t * qdd;
      const JointVector qd_t = qd + t * qdd;
      return 0.5 * qd_t.dot(chain.mass_matrix(q_t) * qd_t);
    };
    const double power = qd.dot(chain.inverse_dynamics(q, qd, qdd));
    EXPECT_NEAR(power, (energy(kStep) - energy(-kStep)) / (2 * kStep), 1e-6 * std::max(1.0, std::abs(power)));
  }
}

TEST(Chain, RotorVariantsDifferOnlyInTheirCouplings) {
  Random random(6);
  const RobotDescription robot = random_robot(random, 6);
  const Chain chain(robot);
  const ChainPose pose = chain.pose(random_vector(random, 6, -3.0, 3.0));
  const JointMatrix diag = chain.reflected_inertia(pose, RotorModel::diag);
  const JointMatrix lower = chain.reflected_inertia(pose, RotorModel::lower);
  const JointMatrix sym = chain.reflected_inertia(pose, RotorModel::sym);
  EXPECT_EQ(sym, sym.transpose().eval());
  for (int i = 0; i < 6; ++i) {
    const JointDescription& joint = robot.joints[static_cast<std::size_t>(i)];
    EXPECT_DOUBLE_EQ(diag(i, i), joint.reflected_inertia_kg_m2());
    for (int j = 0; j < i; ++j) {
      const double cosine = pose.axis[static_cast<std::size_t>(i)].dot(pose.axis[static_cast<std::size_t>(j)]);
      EXPECT_EQ(diag(i, j), 0.0);
      EXPECT_NEAR(lower(i, j), joint.transmission.gear_ratio * joint.motor.rotor_inertia_kg_m2 * cosine, 1e-15);
      EXPECT_EQ(lower(j, i), 0.0);
      EXPECT_EQ(sym(i, j), lower(i, j));
    }
  }
}

TEST(ModelSelfCheck, IsHealthyOnTheReferenceArm) { EXPECT_LT(model_self_check(test::reference_arm().robot), 1e-11); }

TEST(ModelSelfCheck, NotANumberIsNotHealthy) {
  RobotDescription robot = test::reference_arm().robot;
  robot.joints[1].link.mass_kg = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(model_self_check(robot), std::numeric_limits<double>::infinity());
}

}  // namespace
}  // namespace mrr::sup
