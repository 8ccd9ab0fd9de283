// The three prediction models: refusals, limits in which they must agree, orders that must come out right, no NaN.
#include "supervisor/impact/prediction.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <numbers>
#include <string>

#include "supervisor/impact/external.h"
#include "tests/unit/model/arms.h"

namespace mrr::sup {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr std::array kModels{PredictionModel::instant, PredictionModel::finite_time, PredictionModel::resolved};

RobotDescription reference_arm() { return load_robot(std::filesystem::path(MRR_SOURCE_DIR) / "robots" / "mrr3"); }

/// The stretched arm coming down with joint 2 at 0.62 rad/s on a nail that stands.
PredictInput home_blow() {
  PredictInput in;
  in.q = JointVector::Zero(3);
  in.q << 0.0, 0.05, -0.1;
  in.qd = JointVector::Zero(3);
  in.qd[1] = -0.62;
  for (auto& joint : in.joints) joint = JointHold::controlled;
  in.contact.face_stiffness_n_m = 7600.0;
  in.contact.face_damping_s_m = 1.0;
  return in;
}

void expect_finite(const Prediction& p) {
  EXPECT_TRUE(std::isfinite(p.impulse_n_s) && std::isfinite(p.contact_s) && std::isfinite(p.peak_force_n) &&
              std::isfinite(p.penetration_m) && std::isfinite(p.speed_before_m_s) && std::isfinite(p.speed_after_m_s));
  EXPECT_TRUE(p.delta_qd.allFinite() && p.axis_impulse_nm_s.allFinite() && p.blow_impulse_nm_s.allFinite() &&
              p.carried_before_nm.allFinite() && p.peak_torque_nm.allFinite());
  for (const WrenchImpulse& w : p.wrench) EXPECT_TRUE(w.force_n_s.allFinite() && w.torque_nm_s.allFinite());
}

TEST(Prediction, RefusesWhatItCannotUseAndSaysWhat) {
  const StrikeArm arm(reference_arm());
  EXPECT_EQ(validate_input(arm, home_blow(), PredictionModel::resolved), "");
  const auto refused = [&](auto&& spoil, const char* says) {
    PredictInput in = home_blow();
    spoil(in);
    for (const PredictionModel model : kModels) {
      const std::string why = validate_input(arm, in, model);
      if (model == PredictionModel::instant && why.empty()) continue;  // it does not look at that field
      EXPECT_NE(why.find(says), std::string::npos) << why;
      const Prediction p = predict(arm, in, model);
      EXPECT_FALSE(p.feasible) << says;
      expect_finite(p);
      EXPECT_EQ(p.impulse_n_s, 0.0);
    }
  };
  refused([](PredictInput& in) { in.q[1] = kNan; }, "q of joint 2");
  refused([](PredictInput& in) { in.qd.resize(2); }, "one entry");
  refused([](PredictInput& in) { in.normal *= 2.0; }, "normal is 2");
  refused([](PredictInput& in) { in.normal[0] = kNan; }, "normal");
  refused([](PredictInput& in) { in.contact.face_stiffness_n_m = 0.0; }, "face_stiffness_n_m is 0: N/m");
  refused([](PredictInput& in) { in.contact.nail_resistance_n = kNan; }, "nail_resistance_n");
  refused([](PredictInput& in) { in.contact.nail_room_m = -1e-3; }, "nail_room_m");
  refused([](PredictInput& in) { in.restitution = 1.5; }, "restitution is 1.5");
  refused([](PredictInput& in) { in.nail_mass_kg = 0.0; }, "nail_mass_kg is 0: kg");
  refused([](PredictInput& in) { in.reference.stop_s = 0.0; }, "reference.stop_s is 0: s");
  refused([](PredictInput& in) { in.passive_s = kInfinity; }, "passive_s");
}

TEST(Prediction, RotorWithoutInertiaIsRefusedWhereItMatters) {
  RobotDescription robot = reference_arm();
  robot.joints[1].motor.rotor_inertia_kg_m2 = 0.0;
  const StrikeArm arm(robot);
  EXPECT_NE(validate_input(arm, home_blow(), PredictionModel::resolved).find("rotor_inertia"), std::string::npos);
  EXPECT_FALSE(predict(arm, home_blow(), PredictionModel::resolved).feasible);
  const Prediction p = predict(arm, home_blow(), PredictionModel::instant);
  EXPECT_TRUE(p.feasible);
  expect_finite(p);
}

TEST(Prediction, GoingAwayStrikesNothing) {
  const StrikeArm arm(reference_arm());
  PredictInput in = home_blow();
  in.qd[1] = 0.62;
  for (const PredictionModel model : kModels) {
    const Prediction p = predict(arm, in, model);
    EXPECT_FALSE(p.approaching) << describe(model);
    EXPECT_EQ(p.impulse_n_s, 0.0) << describe(model);
  }
}

TEST(Prediction, InstantWithGivenRestitutionIsTheReferencesFormula) {
  const RobotDescription robot = reference_arm();
  const StrikeArm arm(robot);
  PredictInput in = home_blow();
  in.joints.fill(JointHold::free);
  in.restitution = 0.7;
  in.contact_s = 0.05;
  for (const double nail_mass : {kInfinity, 12.0}) {
    in.nail_mass_kg = nail_mass;
    const Prediction p = predict(arm, in, PredictionModel::instant);
    ImpactInput bare;
    bare.q = in.q;
    bare.qd = in.qd;
    bare.restitution = 0.7;
    bare.nail_mass_kg = nail_mass;
    const ImpactPrediction expected = predict(arm.chain, bare);
    ASSERT_TRUE(p.feasible && expected.feasible);
    EXPECT_NEAR(p.impulse_n_s, expected.impulse_n_s, 1e-12);
    EXPECT_LT((p.delta_qd - expected.delta_qd).cwiseAbs().maxCoeff(), 1e-12);
    EXPECT_LT((p.blow_impulse_nm_s - expected.axis_impulse_nm_s).cwiseAbs().maxCoeff(), 1e-12);
  }
}

TEST(Prediction, LumpedBlowOfAnUndampedRubberIsHalfASine) {
  ContactLaw law;
  law.face_stiffness_n_m = 8000.0;
  law.face_damping_s_m = 0.0;
  const LumpedBlow blow = lumped_blow(law, 2.0, 0.5, 0.0);
  EXPECT_NEAR(blow.impulse_n_s, 2.0 * 2.0 * 0.5, 0.02);
  EXPECT_NEAR(blow.contact_s, M_PI * std::sqrt(2.0 / 8000.0), 1e-3);
  EXPECT_NEAR(blow.peak_force_n, 0.5 * std::sqrt(2.0 * 8000.0), 0.5);
  EXPECT_NEAR(blow.speed_after_m_s, -0.5, 0.01);
  EXPECT_EQ(blow.penetration_m, 0.0);
  // A nail that yields takes energy, and stops at its room.
  law.nail_resistance_n = 5.0;
  law.nail_room_m = 0.004;
  const LumpedBlow driven = lumped_blow(law, 2.0, 0.5, 0.0);
  EXPECT_NEAR(driven.penetration_m, 0.004, 1e-9);
  EXPECT_LT(-driven.speed_after_m_s, 0.5);
  EXPECT_EQ(lumped_blow(law, 0.0, 0.5, 0.0).impulse_n_s, 0.0);
  EXPECT_EQ(lumped_blow(law, 2.0, -0.5, 0.0).impulse_n_s, 0.0);
}

TEST(Prediction, AxisImpulseIsTheAxisComponentOfTheWrench) {
  const StrikeArm arm(reference_arm());
  for (const std::uint32_t passive : {0U, 2U, 4U, 6U}) {
    PredictInput in = home_blow();
    for (int i = 0; i < 3; ++i) {
      if ((passive >> i & 1U) != 0) in.joints[static_cast<std::size_t>(i)] = JointHold::free;
    }
    const ChainPose pose = arm.chain.pose(in.q);
    for (const PredictionModel model : kModels) {
      const Prediction p = predict(arm, in, model);
      ASSERT_TRUE(p.feasible && p.approaching) << describe(model);
      expect_finite(p);
      if (model == PredictionModel::finite_time) continue;  // integrated at one pose: to a few per cent
      for (int i = 0; i < 3; ++i) {
        const auto k = static_cast<std::size_t>(i);
        EXPECT_NEAR(pose.axis[k].dot(p.wrench[k].torque_nm_s), p.blow_impulse_nm_s[i], 1e-9) << describe(model);
      }
    }
  }
}

// Measured in the emulator over seeds (docs/reproduction.md): letting joint 2 go loads joint 3 more, not less, and the
// nail gets more, because the weight of the arm rests on it.
TEST(Prediction, LettingTheShoulderGoLoadsTheElbowMore) {
  const StrikeArm arm(reference_arm());
  PredictInput active = home_blow();
  PredictInput passive = active;
  passive.joints[1] = JointHold::free;
  for (const PredictionModel model : {PredictionModel::finite_time, PredictionModel::resolved}) {
    const Prediction a = predict(arm, active, model);
    const Prediction p = predict(arm, passive, model);
    EXPECT_GT(p.impulse_n_s, a.impulse_n_s) << describe(model);
    EXPECT_GT(std::abs(p.blow_impulse_nm_s[2]) / p.impulse_n_s, std::abs(a.blow_impulse_nm_s[2]) / a.impulse_n_s)
        << describe(model);
    EXPECT_LT(p.peak_torque_nm[1], a.peak_torque_nm[1]) << describe(model);
  }
}

TEST(Prediction, ResolvedNailGivesWayAsFarAsThereIsRoom) {
  const StrikeArm arm(reference_arm());
  PredictInput in = home_blow();
  in.joints[1] = JointHold::free;
  in.contact.nail_resistance_n = 4.0;
  in.contact.nail_resistance_slope_n_m = 100.0;
  in.contact.nail_room_m = 0.04;
  const Prediction far = predict(arm, in, PredictionModel::resolved);
  in.contact.nail_room_m = 0.003;
  const Prediction flush = predict(arm, in, PredictionModel::resolved);
  in.contact.nail_resistance_n = kInfinity;
  const Prediction stands = predict(arm, in, PredictionModel::resolved);
  EXPECT_GT(far.penetration_m, 0.01);
  EXPECT_NEAR(flush.penetration_m, 0.003, 1e-9);
  EXPECT_EQ(stands.penetration_m, 0.0);
  EXPECT_GT(stands.peak_force_n, far.peak_force_n);
}

/// Right or refused, by every model: a joint frozen, nothing negative, ranges in order.
void expect_sound(const StrikeArm& arm, const PredictInput& in, const char* what) {
  for (const PredictionModel model : kModels) {
    const bool usable = validate_input(arm, in, model).empty();
    const Prediction p = predict(arm, in, model);
    SCOPED_TRACE(std::string(what) + ", " + describe(model));
    expect_finite(p);
    EXPECT_TRUE(usable || !p.feasible);
    EXPECT_GE(p.impulse_n_s, 0.0);
    EXPECT_GE(p.peak_torque_nm.minCoeff(), 0.0);
    EXPECT_LE(p.impulse_low_n_s, p.impulse_n_s);
    EXPECT_GE(p.impulse_high_n_s, p.impulse_n_s);
    for (int i = 0; i < arm.chain.dof(); ++i) {
      if (in.joints[static_cast<std::size_t>(i)] == JointHold::held && model == PredictionModel::instant) {
        EXPECT_NEAR(p.delta_qd[i], 0.0, 1e-12);
      }
    }
  }
}

TEST(Prediction, DegenerateBlowsGiveRightOrRefusedAnswers) {
  const StrikeArm arm(reference_arm());
  for (const JointHold hold : {JointHold::free, JointHold::controlled, JointHold::held}) {
    PredictInput in = home_blow();
    in.joints.fill(hold);
    // Stretched out and folded up: singular. Along the stretched arm no joint moves the face.
    for (const double elbow : {0.0, std::numbers::pi}) {
      in.q << 0.0, 0.0, elbow;
      in.normal = Eigen::Vector3d::UnitZ();
      expect_sound(arm, in, "singular pose");
      in.normal = -Eigen::Vector3d::UnitX();
      expect_sound(arm, in, "singular pose, struck along the arm");
    }
    // A normal to which every joint is orthogonal: the base's axis is upright, the others swing in one plane.
    in = home_blow();
    in.joints.fill(hold);
    in.normal = Eigen::Vector3d::UnitY();
    in.qd << 0.0, -0.62, 0.3;
    expect_sound(arm, in, "beside the plane of the swing");
    EXPECT_EQ(predict(arm, in, PredictionModel::resolved).impulse_n_s, 0.0);
    in = home_blow();
    in.joints.fill(hold);
    in.qd.setZero();
    expect_sound(arm, in, "at rest");
    for (const double e : {0.0, 1.0}) {
      for (const double mass : {kInfinity, 5.0, 1e-9, 0.0}) {
        in = home_blow();
        in.joints.fill(hold);
        in.restitution = e;
        in.nail_mass_kg = mass;
        in.contact_s = 0.05;
        expect_sound(arm, in, "e and M*");
        const Prediction p = predict(arm, in, PredictionModel::instant);
        if (!(mass > 0.0)) {
          EXPECT_FALSE(p.feasible);
        } else if (hold == JointHold::held && !std::isfinite(mass)) {
          EXPECT_FALSE(p.feasible);  // nothing yields
        } else {
          ASSERT_TRUE(p.feasible) << e << ", " << mass;
          // The nail of mass M* starts at P / M*: the speeds part at e times the approach.
          const double nail_speed = std::isfinite(mass) ? p.impulse_n_s / mass : 0.0;
          EXPECT_NEAR(nail_speed - p.speed_after_m_s, e * p.speed_before_m_s, 1e-9);
        }
      }
    }
  }
}

TEST(Prediction, OneJointIsAnArm) {
  RobotDescription robot = reference_arm();
  Random random(3);
  RobotDescription one = test::random_robot(random, 1);
  one.joints[0].control = robot.joints[1].control;
  one.joints[0].limits = robot.joints[1].limits;
  one.joints[0].motor = robot.joints[1].motor;
  one.joints[0].transmission = robot.joints[1].transmission;
  one.joints[0].friction = robot.joints[1].friction;
  one.joints[0].sensors = robot.joints[1].sensors;
  one.bus = robot.bus;
  one.hammer.face_radius_m = 0.012;
  const StrikeArm arm(one);
  PredictInput in;
  in.q = JointVector::Zero(1);
  in.qd = JointVector::Constant(1, 0.5);
  in.normal = -(arm.chain.jacobian(in.q).topRows<3>() * in.qd).normalized();
  for (const JointHold hold : {JointHold::free, JointHold::controlled, JointHold::held}) {
    in.joints.fill(hold);
    expect_sound(arm, in, "one joint");
  }
  in.joints.fill(JointHold::free);
  in.restitution = 1.0;
  in.contact_s = 0.05;
  const Prediction p = predict(arm, in, PredictionModel::instant);
  ASSERT_TRUE(p.feasible && p.approaching);
  EXPECT_NEAR(p.delta_qd[0], -2.0 * in.qd[0], 1e-9);  // it comes back as fast as it went
  // Struck along its own axis it does not move at all.
  in.normal = arm.chain.pose(in.q).axis[0];
  expect_sound(arm, in, "one joint along its axis");
}

TEST(Prediction, RotorWithoutInertiaIsRightOrRefusedByEveryModel) {
  RobotDescription robot = reference_arm();
  for (JointDescription& j : robot.joints) j.motor.rotor_inertia_kg_m2 = 0.0;
  const StrikeArm arm(robot);
  for (const JointHold hold : {JointHold::free, JointHold::controlled, JointHold::held}) {
    PredictInput in = home_blow();
    in.joints.fill(hold);
    expect_sound(arm, in, "no rotors");
    EXPECT_FALSE(predict(arm, in, PredictionModel::finite_time).feasible);
    EXPECT_FALSE(predict(arm, in, PredictionModel::resolved).feasible);
  }
  PredictInput in = home_blow();
  in.joints.fill(JointHold::free);
  in.restitution = 0.5;
  const Prediction p = predict(arm, in, PredictionModel::instant);
  ASSERT_TRUE(p.feasible);
  EXPECT_LT(p.blow_impulse_nm_s.cwiseAbs().maxCoeff(), 1e-9);  // nothing behind the gears: they carry nothing
}

TEST(Prediction, SeveralRobotsGiveARangeAroundTheirMiddle) {
  const StrikeArm arm(reference_arm());
  PredictInput in = home_blow();
  in.joints[2] = JointHold::free;
  const Prediction one = predict(arm, in);
  EXPECT_EQ(one.impulse_low_n_s, one.impulse_n_s);
  EXPECT_EQ(one.impulse_high_n_s, one.impulse_n_s);
  double width = 0.0;
  for (const int robots : {2, 5, 9, 32}) {
    in.robots = robots;
    const Prediction p = predict(arm, in);
    ASSERT_TRUE(p.feasible && p.approaching);
    EXPECT_LE(p.impulse_low_n_s, std::min(p.impulse_n_s, one.impulse_n_s));
    EXPECT_GE(p.impulse_high_n_s, std::max(p.impulse_n_s, one.impulse_n_s));
    for (int i = 0; i < 3; ++i) {
      EXPECT_LE(p.axis_impulse_low_nm_s[i], p.axis_impulse_nm_s[i]);
      EXPECT_GE(p.axis_impulse_high_nm_s[i], p.axis_impulse_nm_s[i]);
      EXPECT_LE(p.peak_torque_low_nm[i], p.peak_torque_nm[i]);
      EXPECT_GE(p.peak_torque_high_nm[i], p.peak_torque_nm[i]);
    }
    EXPECT_GE(p.impulse_high_n_s - p.impulse_low_n_s, width);  // more robots, the first of them the same
    width = p.impulse_high_n_s - p.impulse_low_n_s;
    EXPECT_EQ(predict(arm, in).impulse_n_s, p.impulse_n_s);  // the same robots every time
  }
  EXPECT_GT(width, 0.0);
  for (const int robots : {0, -1, 33}) {
    in.robots = robots;
    EXPECT_NE(validate_input(arm, in, PredictionModel::resolved).find("robots"), std::string::npos);
    EXPECT_FALSE(predict(arm, in).feasible);
  }
}

TEST(Prediction, RandomArmsGiveFiniteOrRefusedAnswers) {
  Random random(5, 1);
  int hits = 0;
  for (int k = 0; k < 60; ++k) {
    const int n = 1 + k % kMaxJoints;
    RobotDescription robot = test::random_robot(random, n);
    for (JointDescription& j : robot.joints) {
      j.control.lambda_1_s = 50.0;
      j.control.position_gain_nm_rad = 2500.0 * j.reflected_inertia_kg_m2();
      j.control.velocity_gain_nm_s_rad = 100.0 * j.reflected_inertia_kg_m2();
      j.control.carried_departure_nm = 4.0;
      j.limits.torque_nm = 60.0;
      j.limits.acceleration_rad_s2 = 20.0;
      j.limits.velocity_rad_s = 2.0;
      j.motor.peak_current_a = 5.0;
      j.motor.torque_constant_positive_nm_a = j.motor.torque_constant_negative_nm_a = 0.2;
      j.motor.max_velocity_rad_s = 200.0;
      j.transmission.stiffness_nm_rad = {8400.0, 9400.0, 13000.0};
      j.transmission.stiffness_break_nm = {3.9, 12.0};
      j.friction = {3.9, 4.6, 1111.0, 2.0};
    }
    robot.bus.loop_rate_hz = 1000.0;
    robot.bus.knot_rate_hz = 250.0;
    robot.hammer.face_radius_m = 0.05;
    const StrikeArm arm(robot);
    PredictInput in;
    in.q = test::random_vector(random, n, -1.5, 1.5);
    in.qd = test::random_vector(random, n, -1.0, 1.0);
    in.normal = -arm.chain.face_pose(in.q).rotation.col(2);
    for (int i = 0; i < n; ++i) {
      in.joints[static_cast<std::size_t>(i)] = static_cast<JointHold>(random.below(3));
    }
    if (k % 3 == 0) in.contact.nail_resistance_n = 5.0;
    for (const PredictionModel model : kModels) {
      ASSERT_EQ(validate_input(arm, in, model), "");
      const Prediction p = predict(arm, in, model);
      expect_finite(p);
      EXPECT_GE(p.impulse_n_s, 0.0);
      if (p.feasible && p.approaching) ++hits;
    }
  }
  EXPECT_GT(hits, 30);
}

}  // namespace
}  // namespace mrr::sup
