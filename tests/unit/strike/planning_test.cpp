#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <bit>
#include <cmath>
#include <functional>
#include <numbers>

#include "arms.h"
#include "supervisor/strike/planner.h"

namespace mrr::sup {
namespace {

using test::example;
using test::vector_of;
using testing::HasSubstr;

double largest(const JointVector& v) {
  double value = 0.0;
  for (Eigen::Index i = 0; i < v.size(); ++i) value = std::max(value, std::abs(v[i]));
  return value;
}

TEST(InverseKinematics, GivesBothBranchesBesideTheStretchedPose) {
  const RobotDescription robot = example("mrr3");
  const Chain chain(robot);
  FaceTarget target;
  target.max_tilt_rad = robot.hammer.max_tilt_rad;
  for (const double height : {0.50, 0.49, 0.48, 0.47, 0.46}) {
    target.position_m = {0.7595, 0.0, height};
    const IkResult result = solve_face_on_point(robot, chain, target, JointVector::Zero(3));
    // Two links of 0.38 m from the shoulder at 0.48 m: the elbow bends by 2 acos(r / 0.76), up or down.
    const double radius = std::hypot(0.7595, height - 0.48);
    const double bend = 2.0 * std::acos(radius / 0.76);
    const double lift = std::atan2(height - 0.48, 0.7595);
    ASSERT_EQ(result.solutions.size(), 2U) << height;
    for (const FaceSolution& s : result.solutions) {
      EXPECT_NEAR(std::abs(s.q[2]), bend, 1e-5);
      EXPECT_NEAR(s.q[1], lift - 0.5 * s.q[2], 1e-5);
      EXPECT_NEAR(s.tilt_rad, std::abs(s.q[1] + s.q[2]), 1e-9);
    }
    EXPECT_LT(result.solutions[0].q[2] * result.solutions[1].q[2], 0.0);
  }
}

TEST(InverseKinematics, StrikesOffCentreWhatIsJustOutOfReach) {
  const RobotDescription robot = example("mrr3");
  const Chain chain(robot);
  FaceTarget target;
  target.position_m = {0.7615, 0.0, 0.49};
  target.max_tilt_rad = robot.hammer.max_tilt_rad;
  EXPECT_TRUE(solve_face_on_point(robot, chain, target, JointVector::Zero(3)).solutions.empty());
  target.max_lateral_m = 0.003;
  const IkResult result = solve_face_on_point(robot, chain, target, JointVector::Zero(3));
  ASSERT_FALSE(result.solutions.empty());
  const FaceSolution& s = result.solutions.front();
  EXPECT_LT(std::abs(s.normal_error_m), 1e-6);
  EXPECT_NEAR(s.lateral_error_m, 0.7615 - std::sqrt(0.76 * 0.76 - 0.01 * 0.01), 2e-4);
}

// Whatever pose a nail is made of is found again among the solutions: none is missed.
TEST(InverseKinematics, FindsThePoseATargetWasMadeOf) {
  const RobotDescription reference = example("mrr3");
  Random random(11);
  int cases = 0;
  int missed = 0;
  for (int k = 0; k < 120; ++k) {
    const RobotDescription robot = k % 2 == 0 ? reference : test::random_arm(reference, 3, random);
    const Chain chain(robot);
    const JointVector q = test::random_pose(robot, random, 0.95);
    const Pose face = chain.face_pose(q);
    FaceTarget target;
    target.position_m = face.position_m;
    target.normal = -face.rotation.col(2);
    target.max_tilt_rad = 0.14;
    IkOptions options;
    options.seed = static_cast<std::uint64_t>(k);
    const IkResult result = solve_face_on_point(robot, chain, target, JointVector::Zero(3), options);
    ++cases;
    bool found = false;
    for (const FaceSolution& s : result.solutions) {
      found = found || largest(s.q - q) < 2e-3;
      const Pose reached = chain.face_pose(s.q);
      EXPECT_LT((reached.position_m - target.position_m).norm(), 2e-7);
      EXPECT_LE(std::acos(std::min(1.0, -reached.rotation.col(2).dot(target.normal))), target.max_tilt_rad + 1e-9);
      for (int i = 0; i < 3; ++i) {
        EXPECT_GE(s.q[i], robot.joints[static_cast<std::size_t>(i)].limits.lower_rad);
        EXPECT_LE(s.q[i], robot.joints[static_cast<std::size_t>(i)].limits.upper_rad);
      }
    }
    if (!found) ++missed;
  }
  EXPECT_EQ(missed, 0) << "of " << cases;
}

TEST(InverseKinematics, SamplesTheNullSpaceOfARedundantArm) {
  const RobotDescription robot = example("arm7");
  const Chain chain(robot);
  FaceTarget target;
  target.position_m = robot.task.nail_position_m + robot.task.nail_height_m * robot.task.normal;
  target.normal = robot.task.normal;
  target.max_tilt_rad = robot.hammer.max_tilt_rad;
  const IkOptions options;
  const IkResult result = solve_face_on_point(robot, chain, target, JointVector::Zero(7), options);
  ASSERT_GE(result.solutions.size(), 8U);
  for (std::size_t a = 0; a < result.solutions.size(); ++a) {
    EXPECT_LT((chain.face_pose(result.solutions[a].q).position_m - target.position_m).norm(), 2e-7);
    EXPECT_LE(result.solutions[a].tilt_rad, target.max_tilt_rad);
    for (std::size_t b = 0; b < a; ++b) {
      EXPECT_GE(largest(result.solutions[a].q - result.solutions[b].q), options.distinct_rad);
    }
  }
}

TEST(InverseKinematics, IsTheSameForTheSameSeed) {
  const RobotDescription robot = example("arm7");
  const Chain chain(robot);
  FaceTarget target;
  target.position_m = robot.task.nail_position_m;
  target.max_tilt_rad = robot.hammer.max_tilt_rad;
  const IkResult a = solve_face_on_point(robot, chain, target, JointVector::Zero(7));
  const IkResult b = solve_face_on_point(robot, chain, target, JointVector::Zero(7));
  ASSERT_EQ(a.solutions.size(), b.solutions.size());
  for (std::size_t k = 0; k < a.solutions.size(); ++k) EXPECT_EQ(a.solutions[k].q, b.solutions[k].q);
}

TEST(InverseKinematics, SaysHowFarOffAnUnreachableNailIs) {
  const RobotDescription robot = example("mrr3");
  const Chain chain(robot);
  FaceTarget target;
  target.position_m = {0.80, 0.0, 0.48};
  target.max_tilt_rad = robot.hammer.max_tilt_rad;
  const IkResult result = solve_face_on_point(robot, chain, target, JointVector::Zero(3));
  EXPECT_TRUE(result.solutions.empty());
  EXPECT_THAT(result.why, HasSubstr("40.00 mm away"));
}

PlanInput request_for(const RobotDescription& robot, double height_m) {
  PlanInput r;
  r.head_position_m = robot.task.nail_position_m + height_m * robot.task.normal;
  r.normal = robot.task.normal;
  r.board_distance_m = height_m;
  r.contact_duration_s = robot.task.assumed_contact_s;
  r.start = JointVector::Zero(robot.dof());
  if (robot.dof() == 3) r.start = vector_of({0.0, 0.5, -0.3});
  return r;
}

TEST(StrikeVelocity, MovesTheFaceAlongTheNailAtOneMetrePerSecond) {
  Random random(12);
  const RobotDescription reference = example("mrr3");
  for (int k = 0; k < 300; ++k) {
    const int n = 3 + static_cast<int>(random.below(5));
    const RobotDescription robot = test::random_arm(reference, n, random);
    const Chain chain(robot);
    const Jacobian J = chain.jacobian(test::random_pose(robot, random));
    const Eigen::Vector3d normal =
        Eigen::Vector3d(random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1)).normalized();
    const JointVector u = unit_strike_velocity(J, normal, JointVector::Constant(n, 0.6));
    ASSERT_TRUE(u.allFinite());
    if (u.isZero()) continue;
    const Eigen::Vector3d v = J.topRows<3>() * u;
    EXPECT_NEAR(v.dot(normal), -1.0, 1e-9);
  }
}

// Loads that were seen to be small allow more than (59), and never more than the joints can do.
TEST(Plan, SpeedFactorLiftsTheLimitOfTheGearsAndNoOther) {
  const RobotDescription robot = example("mrr3");
  const Chain chain(robot);
  PlanInput r = request_for(robot, 0.02);
  const StrikePlan usual = sup::plan(robot, chain, r);
  r.speed_factor = 1.3;
  const StrikePlan faster = sup::plan(robot, chain, r);
  EXPECT_NEAR(faster.speed_m_s, 1.3 * usual.speed_m_s, 0.02 * usual.speed_m_s);
  r.speed_factor = 2.0;
  const StrikePlan fastest = sup::plan(robot, chain, r);
  ASSERT_TRUE(fastest.blow.feasible);
  EXPECT_GT(fastest.speed_m_s, faster.speed_m_s);
  const MotionLimits limits = motion_limits(robot);
  for (int i = 0; i < robot.dof(); ++i) {
    EXPECT_LE(std::abs(fastest.qd_impact[i]), limits.velocity_rad_s[i] * (1.0 + 1e-9));
    EXPECT_LE(fastest.blow.peak_torque_nm[i], robot.joints[static_cast<std::size_t>(i)].transmission.repeated_peak_nm);
  }
}

// The reference's own blow: stretched out, joint 2 alone at what (59) allows.
TEST(Plan, HomePoseGivesTheReferencesBlow) {
  const RobotDescription robot = example("mrr3");
  const Chain chain(robot);
  PlanInput r = request_for(robot, 0.02);
  const StrikePlan plan = sup::plan(robot, chain, r);
  const double qd_limit = std::numbers::pi / (0.05 * 101.0);  // (59) with N = 1e4
  EXPECT_NEAR(plan.qd_impact[1], -qd_limit, 1e-9);
  EXPECT_NEAR(plan.qd_impact[0], 0.0, 1e-9);
  EXPECT_NEAR(plan.qd_impact[2], 0.0, 1e-9);
  EXPECT_NEAR(plan.speed_m_s, 0.7595 * qd_limit, 1e-6);
  // Axis impulses at 0.62 rad/s: free 0.167 and 0.092, joint 2 held 1.44, joint 3 held 0.198 Nms (diagonal rotors).
  const double scale = qd_limit / 0.62;
  EXPECT_NEAR(plan.loads[1].free_nm_s, 0.167 * scale, 0.003);
  EXPECT_NEAR(plan.loads[2].free_nm_s, 0.0924 * scale, 0.003);
  EXPECT_NEAR(plan.loads[1].held_nm_s, 1.44 * scale, 0.02);
  EXPECT_NEAR(plan.loads[2].held_nm_s, 0.1982 * scale, 0.003);
  EXPECT_NEAR(plan.loads[1].limits.rated_nm_s, 2.0 / std::numbers::pi * 16.0 * 0.05, 1e-12);
  EXPECT_EQ(plan.loads[1].decision, ModeDecision::passive);
  EXPECT_EQ(plan.loads[2].decision, ModeDecision::active);
  // That is the instant; over the contact the largest share of rated is least with joint 3 passive too.
  EXPECT_EQ(plan.passive, 0b110U);
  EXPECT_NEAR(plan.back_swing_rad, 0.6, 1e-12);
  // An even swing: 1.4 times travel over speed, in whole knots.
  EXPECT_NEAR(plan.contact_time.seconds(), 1.4 * 0.6 / qd_limit, 0.004);
}

TEST(Plan, ModesForceTheSelection) {
  const RobotDescription robot = example("mrr3");
  const Chain chain(robot);
  PlanInput r = request_for(robot, 0.03);
  r.mode = PassiveMode::never;
  const StrikePlan never = sup::plan(robot, chain, r);
  EXPECT_EQ(never.passive, 0U);
  EXPECT_EQ(never.passive_time, Duration{});
  r.mode = PassiveMode::always;
  const StrikePlan always = sup::plan(robot, chain, r);
  EXPECT_EQ(always.passive, 0b111U);
  EXPECT_LT(always.loads[1].planned_nm_s, 0.5 * never.loads[1].planned_nm_s);
  EXPECT_NEAR(always.loads[1].planned_nm_s, always.loads[1].free_nm_s, 1e-12);
}

TEST(Plan, TakesTheLightestSelectionAndSaysWhyOthersLost) {
  const RobotDescription robot = example("mrr3");
  const Chain chain(robot);
  const StrikePlan plan = sup::plan(robot, chain, request_for(robot, 0.03));
  ASSERT_EQ(plan.selections.size(), 8U);
  EXPECT_EQ(plan.selections_weighed, 8);
  EXPECT_EQ(plan.selections.front().passive, plan.passive);
  for (const SelectionCandidate& c : plan.selections) EXPECT_FALSE(c.note.empty());
  for (const PoseCandidate& c : plan.poses) EXPECT_FALSE(c.note.empty());
  EXPECT_THAT(report(robot, plan), HasSubstr("joint_2"));
}

TEST(Plan, RanksByTheMeasureAskedFor) {
  const RobotDescription robot = example("arm7");
  const Chain chain(robot);
  PlanInput r = request_for(robot, 0.03);
  r.nail_mass_kg = 20.0;
  r.restitution = 0.4;
  r.measure = StrikeMeasure::effective_mass;
  const StrikePlan heavy = sup::plan(robot, chain, r);
  for (const PoseCandidate& c : heavy.poses) {
    if (c.feasible) {
      EXPECT_LE(c.measure, 1.02 * heavy.measure_value);
    }
  }
  r.measure = StrikeMeasure::load_ratio;
  EXPECT_LT(sup::plan(robot, chain, r).effective_mass_kg, heavy.effective_mass_kg);
}

TEST(Plan, NoPassiveJointMayFallOutOfItsTravel) {
  RobotDescription robot = example("mrr3");
  robot.joints[1].control.max_passive_travel_rad = 0.01;  // joint 2 falls by 27 mrad
  const StrikePlan plan = sup::plan(robot, Chain(robot), request_for(robot, 0.03));
  EXPECT_EQ(plan.passive & 0b010U, 0U);
}

TEST(Plan, StrikesNoHarderThanAWantedPenetrationNeeds) {
  const RobotDescription robot = example("mrr3");
  const Chain chain(robot);
  PlanInput r = request_for(robot, 0.03);
  r.nail_mass_kg = 12.0;
  r.contact_duration_s = 0.09;
  const StrikePlan full = sup::plan(robot, chain, r);
  const double full_m = full.prediction.impulse_n_s * r.contact_duration_s / r.nail_mass_kg;  // (33), (34)
  r.wanted_penetration_m = 0.6 * full_m;
  const StrikePlan softer = sup::plan(robot, chain, r);
  EXPECT_NEAR(softer.prediction.impulse_n_s * r.contact_duration_s / r.nail_mass_kg, r.wanted_penetration_m, 1e-9);
  EXPECT_LT(softer.speed_m_s, 0.61 * full.speed_m_s);  // slower still if more joints may then stay active
  EXPECT_NEAR(softer.speed_reduction, 1.0, 1e-12);
  r.wanted_penetration_m = 0.19;  // more than one blow can do
  EXPECT_NEAR(sup::plan(robot, chain, r).speed_m_s, full.speed_m_s, 1e-9);
  r.nail_mass_kg = std::numeric_limits<double>::infinity();  // nothing learnt yet
  r.wanted_penetration_m = 0.001;
  EXPECT_NEAR(sup::plan(robot, chain, r).speed_m_s, full.speed_m_s, 1e-9);
}

TEST(Plan, SearchesTheNullSpaceOfARedundantArmForABetterPose) {
  const RobotDescription robot = example("arm7");
  const Chain chain(robot);
  const PlanInput r = request_for(robot, 0.04);
  FaceTarget target;
  target.position_m = r.head_position_m;
  target.normal = r.normal;
  target.max_tilt_rad = robot.hammer.max_tilt_rad;
  const std::size_t sampled = solve_face_on_point(robot, chain, target, r.start).solutions.size();
  const StrikePlan plan = sup::plan(robot, chain, r);
  EXPECT_GT(plan.poses.size(), sampled);
  EXPECT_EQ(plan.poses.front().note, "chosen");
  for (const PoseCandidate& c : plan.poses) {
    if (!c.feasible) continue;
    EXPECT_GE(c.measure, plan.measure_value * (1.0 - 0.03));
  }
}

TEST(Plan, SlowsDownUntilTheGearsStandIt) {
  RobotDescription robot = example("mrr3");
  PlanInput r = request_for(robot, 0.03);
  r.mode = PassiveMode::never;
  const StrikePlan full = sup::plan(robot, Chain(robot), r);
  // Half of what the blow asks of joint 3: rated and repeated peak are brought down, not what motion needs of joint 2.
  const double peak = full.loads[2].planned_nm_s / (2.0 / std::numbers::pi * r.contact_duration_s) * 0.75;
  robot.joints[2].transmission.rated_nm = 0.5 * peak;
  robot.joints[2].transmission.repeated_peak_nm = peak;
  const StrikePlan slow = sup::plan(robot, Chain(robot), r);
  EXPECT_LT(slow.speed_reduction, 0.76);
  EXPECT_GT(slow.speed_reduction, 0.6);
  EXPECT_LE(slow.loads[2].planned_nm_s, slow.loads[2].limits.repeated_nm_s);
}

std::string refusal(const RobotDescription& robot, const PlanInput& r) {
  try {
    (void)sup::plan(robot, Chain(robot), r);
  } catch (const PlanError& error) {
    return error.what();
  }
  return "";
}

TEST(Plan, RefusesWhatTheGearsDoNotStandEvenFree) {
  RobotDescription robot = example("mrr3");
  robot.joints[2].transmission.rated_nm = 0.1;
  robot.joints[2].transmission.repeated_peak_nm = 0.3;
  EXPECT_THAT(refusal(robot, request_for(robot, 0.03)), HasSubstr("joint_3 would carry"));
}

TEST(Plan, RefusesWithoutRoomForTheBackSwing) {
  RobotDescription robot = example("mrr3");
  robot.joints[1].limits.upper_rad = 0.1;
  PlanInput r = request_for(robot, 0.03);
  r.start = JointVector::Zero(3);
  EXPECT_THAT(refusal(robot, r), HasSubstr("no room for the back-swing: joint_2"));
}

TEST(Plan, RefusesANailOutOfReach) {
  const RobotDescription robot = example("mrr3");
  PlanInput r = request_for(robot, 0.03);
  r.head_position_m.x() = 0.81;
  EXPECT_THAT(refusal(robot, r), HasSubstr("mm away"));
}

TEST(Plan, RefusesAnApproachThroughTheBoard) {
  const RobotDescription robot = example("mrr3");
  PlanInput r = request_for(robot, 0.03);
  r.start = vector_of({0.0, -0.3, 0.0});  // under the board
  EXPECT_THAT(refusal(robot, r), HasSubstr("on its way from the present pose"));
}

TEST(Plan, GoesRoundTheBoardIfTheStraightWayMeetsIt) {
  const RobotDescription robot = example("mrr3");
  PlanInput r = request_for(robot, 0.03);
  r.start = vector_of({0.0, -0.8, 0.3});  // below the board's surface, beside it
  const StrikePlan plan = sup::plan(robot, Chain(robot), r);
  EXPECT_EQ(plan.approach.segments(), 2U);
}

TEST(Plan, NamesTheFieldOfABadRequest) {
  const RobotDescription robot = example("mrr3");
  const std::vector<std::pair<std::function<void(PlanInput&)>, std::string>> bad{
      {[](PlanInput& r) { r.head_position_m.x() = std::nan(""); }, "head_position_m"},
      {[](PlanInput& r) { r.normal *= 2.0; }, "normal"},
      {[](PlanInput& r) { r.normal.setConstant(std::nan("")); }, "normal"},
      {[](PlanInput& r) { r.board_distance_m = -1e-3; }, "board_distance_m"},
      {[](PlanInput& r) { r.restitution = 1.1; }, "restitution"},
      {[](PlanInput& r) { r.restitution = std::nan(""); }, "restitution"},
      {[](PlanInput& r) { r.nail_mass_kg = 0.0; }, "nail_mass_kg"},
      {[](PlanInput& r) { r.contact_duration_s = 0.0; }, "contact_duration_s"},
      {[](PlanInput& r) { r.follow_through_m = -0.001; }, "follow_through_m"},
      {[](PlanInput& r) { r.speed_share = 0.0; }, "speed_share"},
      {[](PlanInput& r) { r.speed_factor = 0.5; }, "speed_factor"},
      {[](PlanInput& r) { r.wanted_penetration_m = std::nan(""); }, "wanted_penetration_m"},
      {[](PlanInput& r) { r.passive = 0b1000U; }, "passive"},
      {[](PlanInput& r) { r.start.resize(2); }, "start"},
      {[](PlanInput& r) { r.start[1] = std::nan(""); }, "start"},
  };
  for (const auto& [spoil, field] : bad) {
    PlanInput r = request_for(robot, 0.03);
    spoil(r);
    EXPECT_THAT(refusal(robot, r), HasSubstr("plan: " + field));
  }
}

/// The chosen selection against every other one that may be taken, each predicted on its own over the contact.
void expect_right_selection(const RobotDescription& robot, const PlanInput& r, const StrikePlan& plan) {
  const StrikeArm arm(robot);
  const int n = robot.dof();
  EXPECT_EQ(plan.selections_weighed, 1 << n);
  const auto peak_ratio_per_n_s = [&](const SelectionCandidate& c) {
    PredictInput in = predict_input(plan, r.contact);
    for (std::size_t i = 0; i < static_cast<std::size_t>(n); ++i) {
      in.joints[i] = (c.passive >> i & 1U) != 0 ? JointHold::free : JointHold::controlled;
    }
    in.switch_lead_s = c.switch_lead_s;
    in.passive_s = c.passive_s;
    const Prediction p = predict(arm, in, c.model);
    double ratio = 0.0;
    for (int i = 0; i < n; ++i) {
      ratio = std::max(ratio, p.peak_torque_nm[i] / robot.joints[static_cast<std::size_t>(i)].transmission.rated_nm);
    }
    return ratio / p.impulse_n_s;
  };
  ASSERT_FALSE(plan.selections.empty());
  const SelectionCandidate& chosen = plan.selections.front();
  EXPECT_EQ(chosen.passive, plan.passive);
  EXPECT_EQ(chosen.note, "chosen");
  if (chosen.model == PredictionModel::instant) {  // no model sees it hit
    EXPECT_FALSE(plan.blow.feasible && plan.blow.approaching);
    return;
  }
  ASSERT_EQ(chosen.model, PredictionModel::resolved);
  EXPECT_NEAR(peak_ratio_per_n_s(chosen), chosen.load_ratio_per_n_s, 1e-9 * chosen.load_ratio_per_n_s);
  for (int i = 0; i < n; ++i) {
    EXPECT_LE(plan.blow.peak_torque_nm[i], robot.joints[static_cast<std::size_t>(i)].transmission.repeated_peak_nm);
  }
  for (const SelectionCandidate& other : plan.selections) {
    SCOPED_TRACE(other.passive);
    EXPECT_FALSE(other.note.empty());
    if (!other.feasible || other.model != PredictionModel::resolved) continue;
    const double ratio = peak_ratio_per_n_s(other);
    EXPECT_NEAR(ratio, other.load_ratio_per_n_s, 1e-9 * ratio);
    EXPECT_LE(chosen.load_ratio_per_n_s, (1.02 + 1e-9) * ratio);
    if (ratio < chosen.load_ratio_per_n_s) {
      EXPECT_LE(std::popcount(chosen.passive), std::popcount(other.passive));
    }
  }
}

/// Everything that must hold of any plan, looked at from outside.
void expect_sound(const RobotDescription& robot, const PlanInput& r, const StrikePlan& plan) {
  const Chain chain(robot);
  const int n = robot.dof();
  JointMotion m;
  // The impact state, exactly.
  plan.strike.sample(plan.contact_time, m);
  EXPECT_LT(largest(m.q - plan.q_impact), 1e-9);
  EXPECT_LT(largest(m.qd - plan.qd_impact), 1e-9);
  const Eigen::Vector3d v = chain.jacobian(m.q).topRows<3>() * m.qd;
  EXPECT_NEAR(-v.dot(r.normal), plan.speed_m_s, 1e-9);
  EXPECT_GT(plan.speed_m_s, 0.0);
  EXPECT_LT((chain.face_pose(plan.q_impact).position_m - r.head_position_m).norm(), plan.lateral_m + 1e-6);
  for (int i = 0; i < n; ++i) {
    EXPECT_LE(std::abs(plan.qd_impact[i]), plan.loads[static_cast<std::size_t>(i)].qd_limit_rad_s * (1 + 1e-9));
  }
  // Modes and loads.
  for (int i = 0; i < n; ++i) {
    const JointLoad& load = plan.loads[static_cast<std::size_t>(i)];
    EXPECT_LE(load.planned_nm_s, load.limits.repeated_nm_s);
    EXPECT_NE(load.decision, ModeDecision::refuse);
  }
  expect_right_selection(robot, r, plan);
  // Trajectories: joined, within limits, clear of the head until contact.
  EXPECT_LT(largest(plan.approach.start().q - r.start), 1e-12);
  EXPECT_LT(largest(plan.approach.end().q - plan.q_back_swing), 1e-9);
  EXPECT_LT(largest(plan.strike.start().q - plan.q_back_swing), 1e-12);
  EXPECT_LT(largest(plan.strike.end().q - plan.q_back_swing), 1e-12);
  EXPECT_LT(plan.switch_time, plan.contact_time);
  EXPECT_LT(plan.contact_time, plan.stop_time);
  const MotionLimits limits = motion_limits(robot);
  for (const JointTrajectory* way : {&plan.approach, &plan.strike}) {
    for (Duration t; t <= way->duration(); t += microseconds(1700)) {
      way->sample(t, m);
      const MotionTorques torques = motion_torques(robot, chain, m);
      for (int i = 0; i < n; ++i) {
        EXPECT_GE(m.q[i], std::min(limits.lower_rad[i], r.start[i]) - 1e-9);
        EXPECT_LE(m.q[i], std::max(limits.upper_rad[i], r.start[i]) + 1e-9);
        EXPECT_LE(std::abs(m.qd[i]), limits.velocity_rad_s[i] * (1 + 1e-6));
        EXPECT_LE(std::abs(m.qdd[i]), limits.acceleration_rad_s2[i] * (1 + 1e-6));
        EXPECT_LE(std::abs(torques.drive_nm[i]), robot.joints[static_cast<std::size_t>(i)].limits.torque_nm);
        EXPECT_LE(std::abs(torques.transmission_nm[i]), limits.transmission_nm[i] * 1.01);
      }
      const Eigen::Vector3d off = chain.face_pose(m.q).position_m - r.head_position_m;
      const double height = r.normal.dot(off);
      if (way == &plan.strike && t < plan.contact_time &&
          (off - r.normal * height).norm() < robot.hammer.face_radius_m) {
        EXPECT_GE(height, -1e-4);
      }
    }
  }
  // Follow-through, at rest.
  plan.strike.sample(plan.stop_time, m);
  EXPECT_LT(largest(m.qd), 1e-9);
  const double past = r.normal.dot(r.head_position_m - chain.face_pose(m.q).position_m);
  EXPECT_GE(past, r.follow_through_m - 1e-9);
  EXPECT_NEAR(past, plan.follow_through_m, 1e-9);
  EXPECT_FALSE(plan.why.empty());
}

TEST(Plan, IsSoundOnTheExampleRobotsAtEveryHeightOfTheNail) {
  for (const char* name : {"mrr3", "arm7"}) {
    const RobotDescription robot = example(name);
    const Chain chain(robot);
    for (double height = robot.task.nail_height_m; height >= 0.0; height -= 0.01) {
      SCOPED_TRACE(std::string(name) + " " + std::to_string(height));
      const PlanInput r = request_for(robot, height);
      expect_sound(robot, r, sup::plan(robot, chain, r));
    }
  }
}

// Any serial arm: planned soundly or refused with a sentence.
TEST(Plan, TakesArmsOfOneToSixteenJoints) {
  Random random(17);
  const RobotDescription reference = example("mrr3");
  for (const int n : {1, 2, 3, 4, 5, 6, 8, 12, 16}) {
    SCOPED_TRACE(n);
    int planned = 0;
    std::string last_refusal;
    for (int k = 0; k < 6 && planned == 0; ++k) {
      RobotDescription robot = test::random_arm(reference, n, random);
      for (JointDescription& joint : robot.joints) {  // strong enough to carry the rest of the arm
        joint.link.mass_kg *= 3.0 / n;
        joint.link.inertia_kg_m2 *= 3.0 / n;
      }
      const Chain chain(robot);
      const JointVector q = test::random_pose(robot, random, 0.5);
      const Pose face = chain.face_pose(q);
      PlanInput r;
      r.head_position_m = face.position_m;
      r.normal = -face.rotation.col(2);
      if (n == 1) {  // one joint strikes only along its circle
        r.normal = chain.jacobian(q).col(0).head<3>().normalized();
        robot.hammer.max_tilt_rad = 3.0;
      }
      r.board_distance_m = 0.01;
      r.start = q;
      try {
        const StrikePlan plan = sup::plan(robot, Chain(robot), r);
        EXPECT_TRUE(plan.q_impact.allFinite() && plan.qd_impact.allFinite());
        EXPECT_GT(plan.speed_m_s, 0.0);
        EXPECT_EQ(plan.selections_weighed, 1 << n);
        EXPECT_LT((Chain(robot).face_pose(plan.q_impact).position_m - r.head_position_m).norm(), 0.004);
        ++planned;
      } catch (const PlanError& error) {
        last_refusal = error.what();
        EXPECT_GT(last_refusal.size(), 30U);
      }
    }
    EXPECT_GE(planned, 1) << last_refusal;
  }
}

TEST(Plan, IsSoundOnRandomArmsAndNails) {
  Random random(13);
  const RobotDescription reference = example("mrr3");
  int planned = 0;
  std::string last_refusal;
  for (int k = 0; k < 60; ++k) {
    SCOPED_TRACE(k);
    const int n = 3 + static_cast<int>(random.below(5));
    const RobotDescription robot = test::random_arm(reference, n, random);
    const Chain chain(robot);
    const Pose face = chain.face_pose(test::random_pose(robot, random, 0.7));
    PlanInput r;
    r.head_position_m = face.position_m;
    r.normal = -face.rotation.col(2);
    r.board_distance_m = random.uniform(0.0, 0.05);
    r.restitution = random.uniform(0.0, 1.0);
    r.nail_mass_kg = random.uniform() < 0.5 ? random.uniform(5.0, 50.0) : std::numeric_limits<double>::infinity();
    r.contact_duration_s = random.uniform(0.04, 0.12);
    r.follow_through_m = random.uniform(0.0, 0.02);
    r.start = test::random_pose(robot, random, 0.7);
    r.seed = static_cast<std::uint64_t>(k);
    try {
      const StrikePlan plan = sup::plan(robot, chain, r);
      expect_sound(robot, r, plan);
      const StrikePlan again = sup::plan(robot, chain, r);
      EXPECT_EQ(again.q_impact, plan.q_impact);
      EXPECT_EQ(again.strike.duration(), plan.strike.duration());
      ++planned;
    } catch (const PlanError& error) {
      last_refusal = error.what();
      EXPECT_GT(last_refusal.size(), 30U);
    }
  }
  EXPECT_GE(planned, 25) << last_refusal;
  RecordProperty("planned", planned);
}

}  // namespace
}  // namespace mrr::sup
