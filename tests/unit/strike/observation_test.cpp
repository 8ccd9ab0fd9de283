#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <atomic>
#include <cmath>
#include <cstdlib>
#include <limits>
#include <new>
#include <numbers>

#include "arms.h"
#include "supervisor/strike/contact_observer.h"
#include "supervisor/strike/estimate.h"
#include "supervisor/strike/switch_condition.h"

namespace {
std::atomic<long> allocations{0};
}
// Counts what the whole program takes from the heap: what runs in the cycle must take nothing.
void* operator new(std::size_t size) {
  ++allocations;
  if (void* p = std::malloc(size)) return p;
  throw std::bad_alloc();
}
void* operator new(std::size_t size, const std::nothrow_t& /*tag*/) noexcept {
  ++allocations;
  return std::malloc(size);
}
void operator delete(void* p) noexcept { std::free(p); }
void operator delete(void* p, std::size_t) noexcept { std::free(p); }

namespace mrr::sup {
namespace {

using test::example;
using test::vector_of;

constexpr Duration kKnot = milliseconds(4);

struct Strike {
  RobotDescription robot = example("mrr3");
  Chain chain{robot};
  StrikePlan plan;
  explicit Strike(double height_m = 0.03) {
    PlanInput r;
    r.head_position_m = robot.task.nail_position_m + height_m * robot.task.normal;
    r.normal = robot.task.normal;
    r.board_distance_m = height_m;
    r.contact_duration_s = robot.task.assumed_contact_s;
    r.start = vector_of({0.0, 0.5, -0.3});
    plan = sup::plan(robot, chain, r);
  }
};

/// Steps the condition along the plan, distorted by `change`, until it decides; returns when.
template <typename Change>
Duration decide(const Strike& s, SwitchCondition& condition, Change change) {
  JointMotion m;
  for (Duration t; t <= s.plan.stop_time; t += kKnot) {
    s.plan.strike.sample(t, m);
    change(m);
    if (condition.step(m.q, m.qd).verdict != SwitchVerdict::wait) return t;
  }
  return s.plan.stop_time;
}

TEST(SwitchCondition, SwitchesOnTimeAlongThePlan) {
  for (const double height : {0.04, 0.02, 0.0}) {
    const Strike s(height);
    SwitchCondition condition(s.chain, s.plan, switch_config(s.robot));
    const Duration t = decide(s, condition, [](JointMotion&) {});
    EXPECT_EQ(condition.state().verdict, SwitchVerdict::switch_now);
    // The first knot in the window: it opens a margin of 0.5 mm (1 ms) before the planned switch.
    EXPECT_GE(t, s.plan.switch_time - milliseconds(2));
    EXPECT_LT(t, s.plan.switch_time + kKnot);
    EXPECT_NEAR(condition.state().time_to_contact_s, (s.plan.contact_time - t).seconds(), 1e-3);
    EXPECT_NEAR(condition.state().momentum_ratio, 1.0, 0.1);
  }
}

TEST(SwitchCondition, WaitsWhileTheMomentumIsThereButTheNailIsNot) {
  // Half-way in the swing, and faster than planned: more momentum than the impact alone must not switch.
  const Strike s;
  SwitchCondition condition(s.chain, s.plan, switch_config(s.robot));
  JointMotion m;
  s.plan.strike.sample(s.plan.contact_time / 2, m);
  condition.step(m.q, 1.5 * m.qd);
  EXPECT_GT(condition.state().momentum_ratio, 1.2);
  EXPECT_EQ(condition.state().verdict, SwitchVerdict::wait);
}

TEST(SwitchCondition, CancelsASwingThatMissesSideways) {
  const Strike s;
  SwitchCondition condition(s.chain, s.plan, switch_config(s.robot));
  decide(s, condition, [](JointMotion& m) { m.q[0] += 0.01; });  // 7.6 mm at the head
  EXPECT_EQ(condition.state().verdict, SwitchVerdict::cancel);
  EXPECT_EQ(condition.state().cause, SwitchCause::lateral_miss);
  EXPECT_NEAR(condition.state().lateral_m, 0.0076, 5e-4);
}

TEST(SwitchCondition, CancelsATiltedFace) {
  const Strike s;
  SwitchConfig config = switch_config(s.robot);
  config.max_lateral_m = 1.0;  // this distortion also misses sideways; here only tilt is to count
  SwitchCondition condition(s.chain, s.plan, config);
  decide(s, condition, [](JointMotion& m) {
    m.q[1] += 0.09;
    m.q[2] -= 0.27;
  });
  EXPECT_EQ(condition.state().verdict, SwitchVerdict::cancel);
  EXPECT_EQ(condition.state().cause, SwitchCause::tilted);
  EXPECT_GT(condition.state().tilt_rad, config.max_tilt_rad);
}

TEST(SwitchCondition, NeverSwitchesForASlowSwing) {
  const Strike s;
  SwitchCondition condition(s.chain, s.plan, switch_config(s.robot));
  const Duration t = decide(s, condition, [](JointMotion& m) { m.qd *= 0.7; });
  EXPECT_EQ(condition.state().verdict, SwitchVerdict::cancel);
  EXPECT_EQ(condition.state().cause, SwitchCause::momentum_low);
  EXPECT_GE(t, s.plan.contact_time);
}

TEST(SwitchCondition, DecidesNothingOnUnusableMeasurements) {
  const Strike s;
  SwitchCondition condition(s.chain, s.plan, switch_config(s.robot));
  JointMotion m;
  s.plan.strike.sample(s.plan.contact_time - milliseconds(8), m);
  JointVector broken = m.q;
  broken[1] = std::nan("");
  EXPECT_EQ(condition.step(broken, m.qd).verdict, SwitchVerdict::wait);
  EXPECT_EQ(condition.state().cause, SwitchCause::not_finite);
  EXPECT_EQ(condition.step(m.q, m.qd).verdict, SwitchVerdict::switch_now);
}

/// The arm as one rigid body per link with its rotors, PD-controlled along the plan, and a rubber face on a nail in
/// foam. Euler steps of 20 us. What the observer gets is made as a drive would: motor side, with torsion and noise.
struct Blow {
  double head_above_plan_m = 0.0;  // where the head really is
  bool nail = true;
  double resistance_n = 3.8;
  double resistance_n_m = 113.0;
  double torque_noise_nm = 0.0;
  double torque_bandwidth_hz = 0.0;  // of the sensors, a first-order lag; 0: none
  double velocity_noise_rad_s = 0.0;
  std::uint64_t seed = 1;
  // What happened.
  double impulse_n_s = 0.0;
  double penetration_m = 0.0;
  double head_after_m = 0.0;  // above the plan's head, when the first contact ended
  double start_s = -1.0;
  double end_s = -1.0;
  double speed_before_m_s = 0.0;
  JointVector qd_before;
  JointVector qd_after;

  void run(const Strike& s, ContactObserver& observer) {
    constexpr double dt = 2e-5;
    constexpr int kStepsPerKnot = 200;
    const Eigen::Vector3d n = s.plan.normal;
    const double head0 = n.dot(s.plan.head_position_m) + head_above_plan_m;
    Random random(seed);
    JointMotion ref;
    s.plan.strike.sample(Duration{}, ref);
    JointVector q = ref.q;
    JointVector qd = ref.qd;
    JointVector flexion = JointVector::Zero(3);
    JointVector shown;  // by the torque sensors
    bool touched = false;
    bool over = false;
    const long steps = s.plan.strike.duration().ns / 20'000;
    observer.reset(n);
    for (long k = 0; k <= steps; ++k) {
      const double t = static_cast<double>(k) * dt;
      s.plan.strike.sample(nanoseconds(k * 20'000), ref);
      const ChainPose pose = s.chain.pose(q);
      const JointMatrix B = s.chain.reflected_inertia(pose);
      const JointMatrix H = s.chain.mass_matrix(pose) + B;
      const Jacobian J = s.chain.jacobian(pose);
      const JointVector J_n = J.topRows<3>().transpose() * n;
      const double v = J_n.dot(qd);  // along +n
      double force = 0.0;
      if (nail) {
        const double squeeze = head0 - penetration_m - n.dot(pose.face.position_m);
        if (squeeze > 0.0) force = std::max(0.0, 8000.0 * squeeze * (1.0 - 1.8 * v));
        const double R = resistance_n + resistance_n_m * penetration_m;
        penetration_m += dt * std::max(0.0, (force - R) / 11.6);
      }
      // The first contact: over once the face has been off the head for 8 ms (it comes back later).
      if (end_s >= 0.0 && t > end_s + 8e-3) over = true;
      const bool touching = force > 0.0 && !over;
      if (touching && !touched) {
        start_s = t;
        speed_before_m_s = -v;
        qd_before = qd;
      }
      if (touching) {
        impulse_n_s += force * dt;
        end_s = t + dt;
        qd_after = qd;
        head_after_m = head0 - penetration_m - n.dot(s.plan.head_position_m);
      }
      touched = touched || touching;
      const JointVector bias = s.chain.bias(q, qd);
      const JointVector motor =
          s.chain.inverse_dynamics(ref.q, ref.qd, ref.qdd) + B * ref.qdd + 428.0 * (ref.q - q) + 17.0 * (ref.qd - qd);
      const JointVector right = motor - bias + J_n * force;
      const JointVector qdd = H.llt().solve(right);
      const JointVector gear = motor - B * qdd;
      const JointVector before = flexion;
      for (int i = 0; i < 3; ++i) {
        flexion[i] = flexion_rad(s.robot.joints[static_cast<std::size_t>(i)].transmission, gear[i]);
      }
      if (k == 0 || torque_bandwidth_hz <= 0.0) {
        shown = gear;
      } else {
        shown += (1.0 - std::exp(-2.0 * std::numbers::pi * torque_bandwidth_hz * dt)) * (gear - shown);
      }
      if (k % kStepsPerKnot == 0) {
        ContactSample sample{q + flexion, qd, shown};
        if (k > 0) sample.qd += (flexion - before) / dt;
        for (int i = 0; i < 3; ++i) {
          sample.torque_nm[i] += torque_noise_nm * random.normal();
          sample.qd[i] += velocity_noise_rad_s * random.normal();
        }
        observer.step(Time{k * 20'000}, sample);
      }
      qd += dt * qdd;
      q += dt * qd;
    }
  }
};

/// Its sensors show the torque of this instant.
RobotDescription without_lag(RobotDescription robot) {
  for (JointDescription& joint : robot.joints) joint.sensors.torque_bandwidth_hz = 0.0;
  return robot;
}

TEST(ContactObserver, MeasuresABlowWithoutNoise) {
  for (const double resistance : {3.8, 15.0, 1000.0}) {
    SCOPED_TRACE(resistance);
    const Strike s;
    ContactObserver observer(without_lag(s.robot), s.chain);
    Blow blow;
    blow.resistance_n = resistance;
    blow.run(s, observer);
    ASSERT_EQ(observer.report().phase, ContactPhase::over);
    StrikeEstimator estimator(0.05);
    const SeenBlow seen = estimator.look(s.plan, observer.report());
    const ContactReport& r = seen.contact;
    const double head_after = (r.face_end_m - s.plan.head_position_m).dot(s.plan.normal);
    // At 4 ms and 0.47 m/s a sample is 1.9 mm: where contact began is known to about half of that, where it ended,
    // slower, much better.
    EXPECT_NEAR(r.start.seconds(), blow.start_s, 2.5e-3);
    EXPECT_NEAR(r.end.seconds(), blow.end_s, 4e-3);
    EXPECT_NEAR(r.impulse_n_s, blow.impulse_n_s, 0.05 * blow.impulse_n_s);
    EXPECT_NEAR(head_after, blow.head_after_m, 4e-4);
    EXPECT_NEAR(r.penetration_m, -blow.head_after_m, 1.3e-3);
    EXPECT_NEAR(r.speed_before_m_s, blow.speed_before_m_s, 0.02);
    EXPECT_NEAR(r.qd_before[1], blow.qd_before[1], 0.03);
    EXPECT_NEAR(r.qd_after[1], blow.qd_after[1], 0.1);
  }
}

// What a sensor of 200 Hz shows is old by 0.8 ms. Largest error of the head 0.37 mm, on the nail that hardly moves. It
// is no test that taking the lag off the heights helps: told of no lag, the observer is off by 0.14 mm at most in this
// simulation.
TEST(ContactObserver, FindsTheHeadThroughSlowTorqueSensors) {
  Strike s;
  for (JointDescription& joint : s.robot.joints) joint.sensors.torque_bandwidth_hz = 200.0;
  for (const double resistance : {3.8, 15.0, 1000.0}) {
    SCOPED_TRACE(resistance);
    ContactObserver observer(s.robot, s.chain);
    Blow blow;
    blow.resistance_n = resistance;
    blow.torque_bandwidth_hz = 200.0;
    blow.run(s, observer);
    ASSERT_EQ(observer.report().phase, ContactPhase::over);
    StrikeEstimator estimator(0.05);
    const ContactReport r = estimator.look(s.plan, observer.report()).contact;
    EXPECT_NEAR((r.face_end_m - s.plan.head_position_m).dot(s.plan.normal), blow.head_after_m, 4e-4);
    EXPECT_NEAR(r.impulse_n_s, blow.impulse_n_s, 0.05 * blow.impulse_n_s);
  }
}

TEST(ContactObserver, MeasuresABlowThroughSensorNoise) {
  const Strike s;
  double worst_impulse = 0.0;
  double worst_head = 0.0;
  const RobotDescription robot = without_lag(s.robot);
  for (std::uint64_t seed = 1; seed <= 8; ++seed) {
    ContactObserver observer(robot, s.chain);
    Blow blow;
    blow.seed = seed;
    blow.torque_noise_nm = 0.07;
    blow.velocity_noise_rad_s = 1e-3;
    blow.run(s, observer);
    ASSERT_EQ(observer.report().phase, ContactPhase::over) << seed;
    StrikeEstimator estimator(0.05);
    const ContactReport r = estimator.look(s.plan, observer.report()).contact;
    worst_impulse = std::max(worst_impulse, std::abs(r.impulse_n_s / blow.impulse_n_s - 1.0));
    const double head_after = (r.face_end_m - s.plan.head_position_m).dot(s.plan.normal);
    worst_head = std::max(worst_head, std::abs(head_after - blow.head_after_m));
    EXPECT_NEAR(r.start.seconds(), blow.start_s, 8e-3) << seed;  // two samples: noise may look like the first rise
  }
  EXPECT_LT(worst_impulse, 0.15);
  EXPECT_LT(worst_head, 1e-3);
  RecordProperty("worst_impulse_percent", static_cast<int>(100 * worst_impulse));
  RecordProperty("worst_head_um", static_cast<int>(1e6 * worst_head));
}

TEST(ContactObserver, SeesNothingWhereThereIsNothing) {
  const Strike s;
  for (std::uint64_t seed = 1; seed <= 8; ++seed) {
    ContactObserver observer(s.robot, s.chain);
    Blow blow;
    blow.nail = false;
    blow.seed = seed;
    blow.torque_noise_nm = 0.07;
    blow.velocity_noise_rad_s = 1e-3;
    blow.run(s, observer);
    EXPECT_EQ(observer.report().phase, ContactPhase::none) << seed;
  }
}

TEST(ContactObserver, FindsTheHeadWhereItIsAndNotWhereItWasPlanned) {
  const Strike s;
  for (const double off : {-0.003, 0.003}) {
    ContactObserver observer(s.robot, s.chain);
    Blow blow;
    blow.head_above_plan_m = off;
    blow.run(s, observer);
    const double height = (observer.report().face_start_m - s.plan.head_position_m).dot(s.plan.normal);
    EXPECT_NEAR(height, off, 1.3e-3);
  }
}

/// A face that leaves a head at rest at `head_m`, every 4 ms, with rubber of k and c.
std::vector<ContactPoint> leaving(double head_m, double k, double c, double noise_n, std::uint64_t seed) {
  Random random(seed);
  std::vector<ContactPoint> points;
  for (int i = 0; i <= 12; ++i) {
    const double t = 4e-3 * i;
    ContactPoint p;
    p.height_m = head_m - 6e-3 * std::cos(45.0 * t) * std::exp(-8.0 * t);
    const double next_m = head_m - 6e-3 * std::cos(45.0 * (t + 1e-6)) * std::exp(-8.0 * (t + 1e-6));
    p.leaving_m_s = (next_m - p.height_m) / 1e-6;
    const double d = head_m - p.height_m;
    p.force_n = d > 0.0 ? k * d * (1.0 - c * p.leaving_m_s) : 0.0;
    p.force_n += noise_n * random.normal();
    points.push_back(p);
  }
  return points;
}

TEST(HeadFit, FindsHeadAndRubberItWasToldWrongOf) {
  const auto points = leaving(0.021, 7000.0, 1.0, 0.0, 1);
  const HeadFit fit = fit_head(points, 1.0, {}, 0.0225);
  ASSERT_TRUE(fit.usable);
  EXPECT_NEAR(fit.height_m, 0.021, 1e-4);
  EXPECT_NEAR(fit.rubber.stiffness_n_m, 7000.0, 250.0);
  EXPECT_NEAR(fit.rubber.damping_s_m, 1.0, 0.15);
  EXPECT_LT(fit.rubber.stiffness_share, RubberBelief{}.stiffness_share);
}

TEST(HeadFit, KnowsHowSureItIs) {
  int within = 0;
  for (std::uint64_t seed = 1; seed <= 50; ++seed) {
    const HeadFit fit = fit_head(leaving(0.021, 7000.0, 1.0, 2.0, seed), 2.0, {}, 0.020);
    ASSERT_TRUE(fit.usable) << seed;
    EXPECT_NEAR(fit.height_m, 0.021, 1e-3) << seed;
    within += std::abs(fit.height_m - 0.021) <= 2.0 * fit.height_sd_m ? 1 : 0;
  }
  EXPECT_GE(within, 43);
}

TEST(HeadFit, IsNotPulledByASampleThatWasLate) {
  auto points = leaving(0.021, 7000.0, 1.0, 1.0, 3);
  points[7].force_n += 30.0;
  points[8].force_n -= 60.0;
  points[9].force_n += 30.0;
  const HeadFit fit = fit_head(points, 1.0, {}, 0.0225);
  ASSERT_TRUE(fit.usable);
  EXPECT_NEAR(fit.height_m, 0.021, 3e-4);
}

TEST(HeadFit, SaysWhenItCannotTell) {
  const auto points = leaving(0.021, 7000.0, 1.0, 0.0, 1);
  EXPECT_FALSE(fit_head({points.data(), 2}, 1.0, {}, 0.02).usable);
  EXPECT_FALSE(fit_head(points, 0.0, {}, 0.02).usable);
  EXPECT_FALSE(fit_head(points, std::nan(""), {}, 0.02).usable);
  EXPECT_FALSE(fit_head(points, 1.0, {}, std::nan("")).usable);
  auto broken = points;
  broken[3].force_n = std::nan("");
  EXPECT_FALSE(fit_head(broken, 1.0, {}, 0.02).usable);
}

TEST(ContactObserver, SkipsUnusableSamples) {
  const Strike s;
  ContactObserver observer(s.robot, s.chain);
  ContactSample sample{s.plan.q_impact, JointVector::Zero(3), JointVector::Zero(3)};
  observer.step(Time{0}, sample);
  observer.step(Time{0}, sample);  // not later
  sample.torque_nm[1] = std::nan("");
  observer.step(Time{4'000'000}, sample);
  sample.torque_nm.resize(2);
  observer.step(Time{8'000'000}, sample);
  EXPECT_EQ(observer.skipped(), 3U);
  EXPECT_TRUE(std::isfinite(observer.force_n()));
}

TEST(Flexion, IsPiecewiseLinearAndOdd) {
  TransmissionDescription drive;
  drive.stiffness_nm_rad = {1e4, 2e4, 4e4};
  drive.stiffness_break_nm = {4.0, 12.0};
  EXPECT_NEAR(flexion_rad(drive, 2.0), 2e-4, 1e-15);
  EXPECT_NEAR(flexion_rad(drive, 8.0), 4e-4 + 2e-4, 1e-15);
  EXPECT_NEAR(flexion_rad(drive, -20.0), -(4e-4 + 4e-4 + 2e-4), 1e-15);
}

TEST(Cycle, AllocatesNothing) {
  const Strike s;
  SwitchCondition condition(s.chain, s.plan, switch_config(s.robot));
  ContactObserver observer(s.robot, s.chain);
  JointMotion m;
  const long before = allocations.load();
  for (Duration t; t < s.plan.strike.duration(); t += kKnot) {
    s.plan.strike.sample(t, m);
    condition.step(m.q, m.qd);
    observer.step(Time{t.ns}, {m.q, m.qd, s.chain.inverse_dynamics(m.q, m.qd, m.qdd)});
  }
  observer.reset(s.plan.normal);
  EXPECT_EQ(allocations.load(), before);
}

ContactReport blow_report(double impulse_n_s, double duration_s, double depth_m, double speed_m_s) {
  ContactReport r;
  r.phase = ContactPhase::over;
  r.end = Time{seconds(duration_s).ns};
  r.impulse_n_s = impulse_n_s;
  r.penetration_m = depth_m;
  r.speed_before_m_s = speed_m_s;
  return r;
}

TEST(Estimator, ABlowWhoseFaceNeverLeftKeepsAllOfItsImpulse) {
  const auto points = leaving(0.021, 7000.0, 1.0, 0.5, 2);
  StrikePlan plan;
  for (const std::size_t seen : {std::size_t{8}, points.size()}) {
    ContactReport report = blow_report(1.0, 0.050, 0.0, 0.47);
    report.force_noise_n = 0.5;
    report.face_end_m = 0.0215 * plan.normal;
    for (std::size_t k = 0; k < seen; ++k) {
      ContactPoint point = points[k];
      point.counted_s = 4e-3;
      (void)report.leaving.push_back(point);
    }
    StrikeEstimator estimator(0.05);
    const SeenBlow blow = estimator.look(plan, report);
    ASSERT_NEAR(blow.head.m, 0.021, 1e-3);
    EXPECT_EQ(blow.contact.impulse_n_s == report.impulse_n_s, seen == 8) << seen;
  }
}

TEST(Estimator, LearnsTheEffectiveMassOfTheReferencesFirstBlow) {
  StrikePlan plan;
  plan.effective_mass_kg = 2.2;
  plan.follow_through_m = 0.0172;
  StrikeEstimator estimator(0.05);
  EXPECT_TRUE(std::isinf(estimator.nail_mass_kg()));
  ASSERT_TRUE(estimator.learn(plan, blow_report(1.02, 0.150, 0.022, 0.47)));
  EXPECT_NEAR(estimator.nail_mass_kg(), 1.02 * 0.150 / 0.022, 1e-9);
  EXPECT_NEAR(estimator.contact_duration_s(), 0.150, 1e-12);
  EXPECT_NEAR(estimator.depth_m(), 0.022, 1e-12);
  // e from P = (1 + e) v / (1/m + 1/M*).
  const double M = 1.02 * 0.150 / 0.022;
  EXPECT_NEAR(estimator.restitution(), std::clamp(1.02 * (1 / 2.2 + 1 / M) / 0.47 - 1.0, 0.0, 1.0), 1e-9);
  // 22 mm came of 17.2 mm of reference: 4.8 mm less next time.
  EXPECT_NEAR(estimator.follow_through_for(0.010), 0.010 - 0.0048, 1e-9);
}

TEST(Estimator, LearnsNothingOfTheReferenceFromJointsThatDoNotFollowIt) {
  StrikePlan plan;
  plan.effective_mass_kg = 2.2;
  plan.follow_through_m = 0.0172;
  plan.passive = 0b010;
  StrikeEstimator estimator(0.05);
  const double before_m = estimator.follow_through_for(0.010);
  ASSERT_TRUE(estimator.learn(plan, blow_report(1.02, 0.150, 0.022, 0.47)));
  EXPECT_EQ(estimator.follow_through_for(0.010), before_m);
  EXPECT_TRUE(std::isinf(estimator.contact_law(0.02).nail_resistance_n));
}

TEST(Estimator, TakesANailThatDoesNotMoveForARigidBoard) {
  StrikePlan plan;
  plan.effective_mass_kg = 2.2;
  StrikeEstimator estimator(0.05);
  for (const double depth : {0.0, -0.001, 1e-5}) {
    ASSERT_TRUE(estimator.learn(plan, blow_report(1.3, 0.08, depth, 0.47)));
    EXPECT_TRUE(std::isinf(estimator.nail_mass_kg()));
    EXPECT_GE(estimator.restitution(), 0.0);
    EXPECT_LE(estimator.restitution(), 1.0);
  }
}

TEST(Estimator, RefusesReportsThatSayNothing) {
  StrikePlan plan;
  plan.effective_mass_kg = 2.2;
  StrikeEstimator estimator(0.05);
  ContactReport r = blow_report(1.0, 0.08, 0.01, 0.47);
  r.phase = ContactPhase::touching;
  EXPECT_FALSE(estimator.learn(plan, r));
  EXPECT_FALSE(estimator.learn(plan, blow_report(std::nan(""), 0.08, 0.01, 0.47)));
  EXPECT_FALSE(estimator.learn(plan, blow_report(1.0, 0.0, 0.01, 0.47)));
  EXPECT_FALSE(estimator.learn(plan, blow_report(1.0, 0.08, std::nan(""), 0.47)));
  EXPECT_EQ(estimator.blows(), 0);
}

TEST(Estimator, FitsTheResistanceOverDepth) {
  StrikePlan plan;
  plan.effective_mass_kg = 2.2;
  StrikeEstimator estimator(0.05);
  double depth = 0.0;
  for (const double moved : {0.010, 0.006, 0.004, 0.003}) {
    const double resistance = 3.8 + 113.0 * (depth + 0.5 * moved);
    ASSERT_TRUE(estimator.learn(plan, blow_report(resistance * 0.1, 0.1, moved, 0.47)));
    depth += moved;
  }
  EXPECT_NEAR(estimator.resistance_n(0.0), 3.8, 1e-6);
  EXPECT_NEAR(estimator.resistance_n(0.03), 3.8 + 113.0 * 0.03, 1e-6);
}

}  // namespace
}  // namespace mrr::sup
