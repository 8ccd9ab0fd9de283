#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>

#include "arms.h"
#include "supervisor/impact/external.h"
#include "supervisor/strike/trajectory.h"

namespace mrr::sup {
namespace {

using test::example;

QuinticState random_state(Random& random) {
  return {random.uniform(-2, 2), random.uniform(-2, 2), random.uniform(-20, 20)};
}

TEST(Quintic, ReproducesTheReferenceCases) {
  std::ifstream file(std::string(MRR_SOURCE_DIR) + "/tests/data/cases.json");
  ASSERT_TRUE(file);
  int seen = 0;
  const nlohmann::json all = nlohmann::json::parse(file);
  for (const auto& c : all["cases"]) {
    if (c["kind"] != "quintic") continue;
    ++seen;
    const auto state = [&](const char* key) {
      const auto& v = c["input"][key];
      return QuinticState{v[0], v[1], v[2]};
    };
    const Quintic q = Quintic::between(state("start_pos_vel_acc"), state("end_pos_vel_acc"), c["input"]["T"]);
    const double tolerance = c["abs_tol"];
    for (std::size_t k = 0; k < 6; ++k) {
      EXPECT_NEAR(q.coefficients()[k], c["expect"]["coeff_ascending"][k].get<double>(), tolerance) << c["id"];
    }
    for (std::size_t k = 0; k < c["input"]["t"].size(); ++k) {
      const QuinticState s = q.sample(c["input"]["t"][k]);
      EXPECT_NEAR(s.position, c["expect"]["pos"][k].get<double>(), tolerance) << c["id"];
      EXPECT_NEAR(s.velocity, c["expect"]["vel"][k].get<double>(), tolerance) << c["id"];
      EXPECT_NEAR(s.acceleration, c["expect"]["acc"][k].get<double>(), tolerance) << c["id"];
    }
  }
  EXPECT_EQ(seen, 2);
}

TEST(Quintic, MeetsBothEndStates) {
  Random random(1);
  for (int k = 0; k < 2000; ++k) {
    const QuinticState a = random_state(random);
    const QuinticState b = random_state(random);
    const double T = random.uniform(0.05, 5.0);
    const Quintic q = Quintic::between(a, b, T);
    EXPECT_EQ(q.sample(0.0).position, a.position);
    EXPECT_EQ(q.sample(0.0).velocity, a.velocity);
    EXPECT_EQ(q.sample(0.0).acceleration, a.acceleration);
    EXPECT_NEAR(q.sample(T).position, b.position, 1e-10 * (1 + T * T * 20));
    EXPECT_NEAR(q.sample(T).velocity, b.velocity, 1e-10 * (1 + 1 / T + T * 20));
    EXPECT_NEAR(q.sample(T).acceleration, b.acceleration, 1e-10 * (20 + 1 / (T * T)));
  }
}

TEST(Quintic, RangesAreBoundsThatAreReached) {
  Random random(2);
  for (int k = 0; k < 500; ++k) {
    const double T = random.uniform(0.1, 3.0);
    const Quintic q = Quintic::between(random_state(random), random_state(random), T);
    std::array<Range, 3> sampled;
    sampled.fill({1e300, -1e300});
    for (int i = 0; i <= 4000; ++i) {
      const QuinticState s = q.sample(T * i / 4000.0);
      const std::array<double, 3> values{s.position, s.velocity, s.acceleration};
      for (std::size_t j = 0; j < 3; ++j) {
        sampled[j].low = std::min(sampled[j].low, values[j]);
        sampled[j].high = std::max(sampled[j].high, values[j]);
      }
    }
    const std::array<Range, 3> exact{q.position_range(), q.velocity_range(), q.acceleration_range()};
    for (std::size_t j = 0; j < 3; ++j) {
      const double size = exact[j].high - exact[j].low;
      EXPECT_LE(exact[j].low, sampled[j].low + 1e-9 * (1 + size));
      EXPECT_GE(exact[j].high, sampled[j].high - 1e-9 * (1 + size));
      EXPECT_NEAR(exact[j].low, sampled[j].low, 1e-4 * (1 + size));
      EXPECT_NEAR(exact[j].high, sampled[j].high, 1e-4 * (1 + size));
    }
  }
}

JointMotion random_motion(int n, Random& random) {
  JointMotion m{JointVector(n), JointVector(n), JointVector(n)};
  for (int i = 0; i < n; ++i) {
    m.q[i] = random.uniform(-1, 1);
    m.qd[i] = random.uniform(-1, 1);
    m.qdd[i] = random.uniform(-5, 5);
  }
  return m;
}

TEST(Trajectory, IsContinuousInPositionVelocityAndAcceleration) {
  Random random(3);
  JointTrajectory trajectory(random_motion(5, random));
  for (std::size_t k = 0; k < JointTrajectory::kMaxSegments; ++k) {
    ASSERT_TRUE(trajectory.append(random_motion(5, random), milliseconds(200 + 37 * static_cast<int>(k))));
  }
  EXPECT_FALSE(trajectory.append(random_motion(5, random), milliseconds(100))) << "full";
  JointMotion before;
  JointMotion after;
  for (std::size_t k = 1; k < trajectory.segments(); ++k) {
    const Duration t = trajectory.segment_start(k);
    trajectory.sample(t - nanoseconds(1), before);
    trajectory.sample(t, after);
    EXPECT_LT((before.q - after.q).norm(), 1e-7);
    EXPECT_LT((before.qd - after.qd).norm(), 1e-6);
    EXPECT_LT((before.qdd - after.qdd).norm(), 1e-4);
  }
}

TEST(Trajectory, StaysPutOutsideItsTime) {
  Random random(4);
  JointTrajectory trajectory(at_rest(test::vector_of({1.0, 2.0})));
  JointMotion m;
  trajectory.sample(milliseconds(5), m);
  EXPECT_EQ(m.q[1], 2.0);
  ASSERT_TRUE(trajectory.append(at_rest(test::vector_of({3.0, -1.0})), milliseconds(500)));
  trajectory.sample(milliseconds(-1), m);
  EXPECT_EQ(m.q[0], 1.0);
  EXPECT_TRUE(m.qd.isZero());
  trajectory.sample(milliseconds(501), m);
  EXPECT_EQ(m.q[0], 3.0);
  EXPECT_TRUE(m.qd.isZero() && m.qdd.isZero());
}

TEST(Trajectory, RefusesWhatCannotBeMoved) {
  JointTrajectory trajectory(at_rest(test::vector_of({0.0, 0.0})));
  EXPECT_FALSE(trajectory.append(at_rest(test::vector_of({1.0, 1.0})), Duration{}));
  EXPECT_FALSE(trajectory.append(at_rest(test::vector_of({1.0})), milliseconds(100)));
  EXPECT_FALSE(trajectory.append(at_rest(test::vector_of({1.0, std::nan("")})), milliseconds(100)));
  EXPECT_EQ(trajectory.segments(), 0U);
}

// A quintic Hermite over each knot interval gives the trajectory back: what the wire protocol relies on.
TEST(Trajectory, KnotsReproduceItExactly) {
  Random random(5);
  JointTrajectory trajectory(random_motion(3, random));
  ASSERT_TRUE(trajectory.append(random_motion(3, random), milliseconds(400)));
  ASSERT_TRUE(trajectory.append(random_motion(3, random), milliseconds(120)));
  const Duration knot = milliseconds(4);
  JointMotion a;
  JointMotion b;
  JointMotion middle;
  for (Duration t; t < trajectory.duration(); t += knot) {
    trajectory.sample(t, a);
    trajectory.sample(t + knot, b);
    trajectory.sample(t + knot / 3, middle);
    for (int i = 0; i < 3; ++i) {
      const Quintic q = Quintic::between({a.q[i], a.qd[i], a.qdd[i]}, {b.q[i], b.qd[i], b.qdd[i]}, knot.seconds());
      EXPECT_NEAR(q.sample((knot / 3).seconds()).position, middle.q[i], 1e-12);
      EXPECT_NEAR(q.sample((knot / 3).seconds()).velocity, middle.qd[i], 1e-9);
    }
  }
}

TEST(ShortestDuration, MeetsTheClosedFormsOfRestToRest) {
  RobotDescription robot = example("mrr3");
  const Chain chain(robot);
  MotionLimits limits = motion_limits(robot);
  limits.torque_nm.setConstant(1e6);
  limits.transmission_nm.setConstant(1e6);
  const Duration grid = milliseconds(4);
  Random random(6);
  for (int k = 0; k < 200; ++k) {
    const JointVector a = test::random_pose(robot, random);
    const JointVector b = test::random_pose(robot, random);
    double least = 0.0;  // peak speed 15/8 d/T, peak acceleration 10/sqrt(3) d/T^2, jerk 60 d/T^3
    for (int i = 0; i < 3; ++i) {
      const double d = std::abs(b[i] - a[i]);
      least = std::max(least, 15.0 / 8.0 * d / limits.velocity_rad_s[i]);
      least = std::max(least, std::sqrt(10.0 / std::sqrt(3.0) * d / limits.acceleration_rad_s2[i]));
      least = std::max(least, std::cbrt(60.0 * d / limits.jerk_rad_s3[i]));
    }
    LimitCheck why;
    const auto T = shortest_duration(robot, chain, limits, at_rest(a), at_rest(b), grid, seconds(30.0), why);
    ASSERT_TRUE(T);
    EXPECT_EQ(T->ns % grid.ns, 0);
    EXPECT_GE(T->seconds(), least - 1e-8);
    EXPECT_LT(T->seconds(), least + 1.0001 * grid.seconds());
  }
}

TEST(ShortestDuration, RespectsEveryLimitTorqueIncluded) {
  RobotDescription robot = example("mrr3");
  for (JointDescription& joint : robot.joints) {  // torques in the way, not speed
    joint.limits.acceleration_rad_s2 = 60.0;
    joint.limits.velocity_rad_s = 6.0;
    joint.motor.max_velocity_rad_s = 6.0 * joint.transmission.gear_ratio;
  }
  const Chain chain(robot);
  const MotionLimits limits = motion_limits(robot);
  Random random(7);
  int torque_bound = 0;
  for (int k = 0; k < 60; ++k) {
    const JointVector a = test::random_pose(robot, random);
    const JointVector b = test::random_pose(robot, random);
    LimitCheck why;
    const auto T = shortest_duration(robot, chain, limits, at_rest(a), at_rest(b), milliseconds(4), seconds(30.0), why);
    ASSERT_TRUE(T) << describe(why, robot);
    if (why.worst == LimitKind::torque || why.worst == LimitKind::transmission) ++torque_bound;
    JointTrajectory trajectory(at_rest(a));
    ASSERT_TRUE(trajectory.append(at_rest(b), *T));
    JointMotion m;
    for (int i = 0; i <= 997; ++i) {
      trajectory.sample(nanoseconds(T->ns * i / 997), m);
      // The long way round: M q'' + h + B q'' + friction.
      const JointVector gear = chain.mass_matrix(m.q) * m.qdd + chain.bias(m.q, m.qd);
      const JointVector rotors = chain.reflected_inertia(m.q) * m.qdd;
      for (int j = 0; j < 3; ++j) {
        const JointDescription& joint = robot.joints[static_cast<std::size_t>(j)];
        EXPECT_LE(std::abs(m.qd[j]), joint.limits.velocity_rad_s);
        EXPECT_LE(std::abs(m.qdd[j]), joint.limits.acceleration_rad_s2);
        EXPECT_GE(m.q[j], joint.limits.lower_rad - 1e-9);
        EXPECT_LE(m.q[j], joint.limits.upper_rad + 1e-9);
        EXPECT_LE(std::abs(gear[j]), joint.transmission.repeated_peak_nm * 1.005);
        EXPECT_LE(std::abs(gear[j] + rotors[j] + friction_torque_nm(joint.friction, m.qd[j])), joint.limits.torque_nm);
      }
    }
  }
  EXPECT_GT(torque_bound, 5) << "the test never met a torque limit";
}

TEST(ShortestDuration, SaysWhichLimitIsInTheWay) {
  RobotDescription robot = example("mrr3");
  robot.joints[1].transmission.repeated_peak_nm = 10.0;  // less than gravity at full stretch
  const Chain chain(robot);
  LimitCheck why;
  const auto T = shortest_duration(robot, chain, motion_limits(robot), at_rest(test::vector_of({0, 0.5, 0})),
                                   at_rest(test::vector_of({0, 0, 0})), milliseconds(4), seconds(10.0), why);
  EXPECT_FALSE(T);
  EXPECT_EQ(why.worst, LimitKind::transmission);
  EXPECT_EQ(why.joint, 1);
}

}  // namespace
}  // namespace mrr::sup
