// The emulator's mechanics against closed forms, conservation laws and the reference arm's published matrices.
#include <gtest/gtest.h>

#include <Eigen/Geometry>

#include "common/core/random.h"
#include "sim_vcan/plant/multibody.h"
#include "tests/unit/plant/reference_arm.h"

namespace mrr::sim::test {
namespace {

double stored_drift(const Plant& plant, double stored_at_start) {
  const EnergyTerms energy = plant.truth().energy;
  return energy.stored_j() - stored_at_start - energy.work_j();
}

/// A chain of n joints about random axes, with reasonable masses: the general case that the reference arm is not.
RobotDescription random_arm(int n, std::uint64_t seed) {
  Random random(seed);
  const auto vector = [&](double size) {
    return Eigen::Vector3d(random.uniform(-size, size), random.uniform(-size, size), random.uniform(-size, size));
  };
  const auto rotation = [&] {
    return Eigen::Quaterniond(Eigen::Vector4d(random.normal(), random.normal(), random.normal(), random.normal()))
        .normalized()
        .matrix();
  };
  RobotDescription robot = reference_arm();
  const JointDescription pattern = robot.joints[1];
  robot.joints.clear();
  for (int i = 0; i < n; ++i) {
    JointDescription joint = pattern;
    joint.name = "joint_" + std::to_string(i + 1);
    joint.axis = rotation().col(0);
    joint.offset = {rotation(), vector(0.25)};
    joint.link.mass_kg = random.uniform(0.5, 3.0);
    joint.link.com_m = vector(0.15);
    const Eigen::Vector3d masses = Eigen::Vector3d(1, 1, 1) + 0.3 * vector(1.0);
    const Eigen::Matrix3d turn = rotation();
    joint.link.inertia_kg_m2 = 0.05 * turn * masses.asDiagonal() * turn.transpose();
    joint.limits.lower_rad = -100.0;
    joint.limits.upper_rad = 100.0;
    robot.joints.push_back(joint);
  }
  robot.task.nail_position_m = {0, 0, -100.0};
  return robot;
}

// The reference arm's mass matrix, gravity and Coriolis torques, worked out independently (published cases K1, K2).
TEST(Multibody, GivesTheReferenceArmsMatrices) {
  const Multibody body(reference_arm(), true);
  ArmPose pose;
  SquareMatrix m{};
  BiasTorque bias{};
  const PerJoint still{};

  body.place({0.0, 0.0, 0.0}, pose);
  body.mass_matrix(pose, m);
  EXPECT_NEAR(m[0][0], 1.17625, 1e-12);
  EXPECT_NEAR(m[1][1], 1.15925, 1e-12);
  EXPECT_NEAR(m[1][2], 0.5055, 1e-12);
  EXPECT_NEAR(m[2][2], 0.3725, 1e-12);
  EXPECT_NEAR(m[0][1], 0.0, 1e-12);
  body.bias(pose, still, still, bias);
  EXPECT_NEAR(bias.link[1], 13.68495, 1e-9);
  EXPECT_NEAR(bias.link[2], 3.4335, 1e-9);
  EXPECT_NEAR((pose.face - Eigen::Vector3d(0.76, 0, 0.48)).norm(), 0.0, 1e-12);
  EXPECT_NEAR((pose.face_axis + Eigen::Vector3d::UnitZ()).norm(), 0.0, 1e-12);

  body.place({0.35, 0.6, -0.95}, pose);
  body.mass_matrix(pose, m);
  EXPECT_NEAR(m[0][0], 0.914073761185, 1e-9);
  EXPECT_NEAR(m[1][1], 1.0479777018, 1e-9);
  EXPECT_NEAR(m[2][1], 0.449863850899, 1e-9);
  EXPECT_NEAR((pose.face - Eigen::Vector3d(0.629933162707, 0.229943554227, 0.564262973057)).norm(), 0.0, 1e-9);
  const Multibody links_only(reference_arm(), false);
  links_only.bias(pose, {0.3, -0.7, 0.4}, {0.3, -0.7, 0.4}, bias);
  EXPECT_NEAR(bias.link[0], 0.100839869334, 1e-9);
  EXPECT_NEAR(bias.link[1], 11.686222999 - 0.0294899908836, 1e-8);
  EXPECT_NEAR(bias.link[2], 3.22533620956 - 0.0667037399982, 1e-8);

  // With rigid transmissions M + B + S + S^T is theory's symmetric variant.
  SquareMatrix s{};
  body.coupling(pose, s);
  EXPECT_NEAR(body.reflected_inertia(1), 0.1713768, 1e-9);
  EXPECT_NEAR(s[1][2], 0.0016968, 1e-9);
  EXPECT_NEAR(s[0][1], 0.0, 1e-12);
}

// Kinetic energy is computed from link velocities, not from M: the two must agree for any arm.
TEST(Multibody, MassMatrixIsThatOfTheKineticEnergy) {
  Random random(5);
  for (int n : {1, 2, 7, 16}) {
    const Multibody body(random_arm(n, static_cast<std::uint64_t>(n)), true);
    for (int k = 0; k < 20; ++k) {
      PerJoint q{};
      PerJoint v{};
      PerJoint vm{};
      for (std::size_t i = 0; i < static_cast<std::size_t>(n); ++i) {
        q[i] = random.uniform(-3, 3);
        v[i] = random.normal();
        vm[i] = random.normal();
      }
      ArmPose pose;
      SquareMatrix m{};
      SquareMatrix s{};
      body.place(q, pose);
      body.mass_matrix(pose, m);
      body.coupling(pose, s);
      double energy = 0.0;
      for (std::size_t i = 0; i < static_cast<std::size_t>(n); ++i) {
        for (std::size_t j = 0; j < static_cast<std::size_t>(n); ++j) {
          energy += 0.5 * v[i] * m[i][j] * v[j] + v[i] * s[i][j] * vm[j];
        }
        energy += 0.5 * body.reflected_inertia(static_cast<int>(i)) * vm[i] * vm[i];
      }
      EXPECT_NEAR(body.kinetic_energy(pose, v, vm), energy, 1e-10 * (1.0 + energy));
    }
  }
}

TEST(Multibody, SolvesSymmetricSystems) {
  Random random(11);
  for (int n = 1; n <= kMaxJoints; ++n) {
    const auto size = static_cast<std::size_t>(n);
    SquareMatrix root{};
    SquareMatrix a{};
    PerJoint x{};
    PerJoint b{};
    for (std::size_t i = 0; i < size; ++i) {
      x[i] = random.normal();
      for (std::size_t j = 0; j < size; ++j) root[i][j] = random.normal();
    }
    for (std::size_t i = 0; i < size; ++i) {
      for (std::size_t j = 0; j < size; ++j) {
        a[i][j] = i == j ? 0.5 : 0.0;
        for (std::size_t k = 0; k < size; ++k) a[i][j] += root[i][k] * root[j][k];
        b[i] += a[i][j] * x[j];
      }
    }
    solve_spd(n, a, b);
    for (std::size_t i = 0; i < size; ++i) EXPECT_NEAR(b[i], x[i], 1e-9);
  }
}

// A one-joint arm without friction and with its rotor on a stiff spring is a physical pendulum.
TEST(PlantMotion, SmallSwingsHaveThePendulumsPeriod) {
  RobotDescription robot = reference_arm();
  robot.joints = {robot.joints[2]};
  robot.joints[0].axis = {0, -1, 0};
  robot.joints[0].limits = {.lower_rad = -10.0, .upper_rad = 10.0};
  robot.task.nail_position_m = {0, 0, -100.0};
  robot.joints[0].transmission.stiffness_nm_rad = {1e5, 1e5, 1e5};
  PlantDescription description = conservative_plant(robot);
  Plant plant(robot, description, 0);
  // Hanging straight down is q = -pi/2; let go 0.01 rad from there.
  plant.reset(std::array{-std::numbers::pi / 2.0 + 0.01}, 0.04);
  plant.set_actuator(0, {0, false, true});
  const double inertia = 0.25 + 0.35 * 0.35 + robot.joints[0].reflected_inertia_kg_m2();
  const double expected = 2.0 * std::numbers::pi * std::sqrt(inertia / (1.0 * 9.81 * 0.35));
  std::vector<double> crossings;
  double before = 0.01;
  while (crossings.size() < 5 && plant.now() < Time{} + milliseconds(20000)) {
    plant.step(microseconds(100));
    const double offset = plant.truth().link_position_rad[0] + std::numbers::pi / 2.0;
    if (before < 0.0 && offset >= 0.0) crossings.push_back(plant.now().seconds() - 1e-4 * offset / (offset - before));
    before = offset;
  }
  ASSERT_EQ(crossings.size(), 5U);
  const double period = (crossings.back() - crossings.front()) / 4.0;
  // The spring adds (m g l / K) of the rotor's share, some 1e-5; amplitude 0.01 rad adds 6e-6.
  EXPECT_NEAR(period / expected, 1.0, 3e-5);
}

// Torque on the link of one joint, all else at rest: the first motion is torque over inertia.
TEST(PlantMotion, ConstantTorqueGivesConstantAcceleration) {
  RobotDescription robot = reference_arm();
  robot.gravity_m_s2.setZero();
  robot.joints = {robot.joints[0]};
  robot.joints[0].limits = {.lower_rad = -10.0, .upper_rad = 10.0};
  robot.task.nail_position_m = {0, 0, -100.0};
  Plant plant(robot, conservative_plant(robot), 0);
  plant.reset(std::array{0.0}, 0.04);
  plant.set_external_torque(0, 1.0);
  plant.step(seconds(2.0));
  const double inertia = 0.017 + robot.joints[0].reflected_inertia_kg_m2();
  const PlantTruth truth = plant.truth();
  // Link and rotor swing against each other without damping; their common momentum does not.
  const double momentum =
      0.017 * truth.link_velocity_rad_s[0] + robot.joints[0].reflected_inertia_kg_m2() * truth.motor_velocity_rad_s[0];
  EXPECT_NEAR(momentum, 2.0, 1e-9);
  EXPECT_NEAR(truth.link_position_rad[0], 0.5 * 4.0 / inertia, 1e-3);
}

class Conservation : public testing::TestWithParam<int> {};

// Springs, gravity and inertia alone: energy stays, and what the integrator errs falls with the square of its step.
TEST_P(Conservation, EnergyOfTheSpringOnlyArm) {
  const int n = GetParam();
  const RobotDescription robot = n == 3 ? reference_arm() : random_arm(n, 3);
  RobotDescription apart = robot;
  apart.task.nail_position_m = {0, 0, -100.0};
  Plant plant(apart, conservative_plant(apart), 0);
  PerJoint start{};
  for (std::size_t i = 0; i < static_cast<std::size_t>(n); ++i) start[i] = 0.3 * static_cast<double>(i % 3) - 0.2;
  if (n == 1) start[0] = 1.5;
  std::array<double, 2> rms{};
  double worst = 0.0;
  double moved = 0.0;
  for (std::size_t round = 0; round < 2; ++round) {
    plant.reset(std::span(start).first(static_cast<std::size_t>(n)), 0.04);
    const double stored = plant.truth().energy.stored_j();
    for (int k = 0; k < 10000; ++k) {
      if (round == 0) {
        plant.step(microseconds(100));
      } else {
        plant.step(microseconds(50));
        plant.step(microseconds(50));
      }
      const double drift = stored_drift(plant, stored);
      rms[round] += drift * drift;
      worst = std::max(worst, std::abs(drift));
      moved = std::max(moved, plant.truth().energy.kinetic_j);
    }
  }
  ASSERT_GT(moved, 0.5);
  EXPECT_LT(worst, 2e-4 * moved);
  EXPECT_GT(std::sqrt(rms[0] / rms[1]), 3.0);  // about 4; the springs' kinks and their ringing blur it
}
INSTANTIATE_TEST_SUITE_P(Arms, Conservation, testing::Values(1, 3, 7));

// Gravity has no moment about the vertical: the angular momentum about joint 1 is shared, never made.
TEST(PlantMotion, AngularMomentumAboutTheVerticalStays) {
  RobotDescription robot = reference_arm();
  robot.task.nail_position_m = {0, 0, -100.0};
  Plant plant(robot, conservative_plant(robot), 0);
  const Multibody body(robot, true);
  plant.reset(std::array{0.0, 0.8, -0.4}, 0.04);
  const auto momentum = [&] {
    const PlantTruth truth = plant.truth();
    ArmPose pose;
    SquareMatrix m{};
    SquareMatrix s{};
    body.place(truth.link_position_rad, pose);
    body.mass_matrix(pose, m);
    body.coupling(pose, s);
    double sum = body.reflected_inertia(0) * truth.motor_velocity_rad_s[0];
    for (std::size_t i = 0; i < 3; ++i) {
      sum += m[0][i] * truth.link_velocity_rad_s[i] + s[0][i] * truth.motor_velocity_rad_s[i];
    }
    return sum;
  };
  plant.set_external_torque(0, 5.0);
  plant.step(milliseconds(400));
  plant.set_external_torque(0, 0.0);
  EXPECT_NEAR(momentum(), 2.0, 1e-5);  // torque times time
  double worst = 0.0;
  double slowest = 1e9;
  double fastest = 0.0;
  for (int k = 0; k < 1000; ++k) {
    plant.step(milliseconds(1));
    worst = std::max(worst, std::abs(momentum() - 2.0));
    slowest = std::min(slowest, plant.truth().motor_velocity_rad_s[0]);
    fastest = std::max(fastest, plant.truth().motor_velocity_rad_s[0]);
  }
  EXPECT_LT(worst, 1e-4);
  EXPECT_GT(fastest - slowest, 0.5);  // while the arm folds and unfolds, its speed changes much
}

// With friction, damping, motors, brakes: work in = work out + what is stored.
TEST(PlantMotion, EnergyBalanceOfADrivenArm) {
  const RobotDescription robot = reference_arm();
  Plant plant(robot, default_plant(robot), 0);
  plant.reset(std::array{0.2, 0.7, -0.3}, 0.04);
  const double stored = plant.truth().energy.stored_j();
  double worst = 0.0;
  for (int k = 0; k < 3000; ++k) {
    const double t = 1e-3 * k;
    if (t < 2.5) {
      plant.set_actuator(0, torque_command(plant, 0, 60.0 * std::sin(6.0 * t)));
      plant.set_actuator(1, torque_command(plant, 1, 14.0 + 12.0 * std::sin(9.0 * t)));
      plant.set_actuator(2, torque_command(plant, 2, 3.4 + 8.0 * std::cos(11.0 * t)));
    } else {
      for (int i = 0; i < 3; ++i) plant.set_actuator(i, {0, false, false});  // the brakes stop it
    }
    plant.step(milliseconds(1));
    worst = std::max(worst, std::abs(stored_drift(plant, stored)));
  }
  const EnergyTerms energy = plant.truth().energy;
  ASSERT_GT(energy.motor_work_j, 20.0);
  ASSERT_GT(energy.friction_work_j, 10.0);
  ASSERT_GT(energy.damping_work_j, 0.001);
  ASSERT_GT(energy.brake_work_j, 0.001);
  EXPECT_LT(worst, 1e-3 * energy.motor_work_j);
}

// A harmonic drive under load is twisted by torque over stiffness, piece by piece (Table of theory's section 7).
TEST(PlantMotion, TransmissionTwistFollowsTheThreeStiffnesses) {
  RobotDescription robot = reference_arm();
  robot.gravity_m_s2.setZero();
  Plant plant(robot, default_plant(robot), 0);
  plant.reset(std::array{0.0, 0.0, 0.0}, 0.04);  // brakes hold the motors
  for (const double torque : {2.0, 8.0, 25.0, -25.0}) {
    plant.set_external_torque(2, torque);
    plant.step(milliseconds(4000));  // rings down at some 5/s
    const double size = std::abs(torque);
    const double twist =
        std::min(size, 3.9) / 8.4e3 + std::clamp(size - 3.9, 0.0, 8.1) / 9.4e3 + std::max(size - 12.0, 0.0) / 1.3e4;
    const PlantTruth truth = plant.truth();
    EXPECT_NEAR(truth.link_position_rad[2] - truth.motor_position_rad[2], std::copysign(twist, torque), 2e-6);
    EXPECT_NEAR(truth.transmission_torque_nm[2], -torque, 0.01);
  }
}

}  // namespace
}  // namespace mrr::sim::test
