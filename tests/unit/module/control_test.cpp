// The laws, the reference and the phase-locked loop against closed forms.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "common/core/random.h"
#include "module_fw/comms/selection_switch.h"
#include "module_fw/control/active_law.h"
#include "module_fw/control/passive_law.h"
#include "module_fw/control/reference.h"
#include "module_fw/control/sync_pll.h"
#include "module_fw/control/torque_selector.h"
#include "module_fw/drive/drive.h"
#include "module_fw/sensing/sensing.h"
#include "tests/unit/module/joint_simulation.h"

namespace mrr::fw {
namespace {

constexpr float kDt = 1e-3F;

TEST(ScalarMath, ExpNegativeIsWithinFourMillionths) {
  double worst = 0.0;
  double worst_near = 0.0;
  for (double x = 0.0; x < 79.0; x += 0.00137) {
    const double wanted = std::exp(-static_cast<double>(static_cast<float>(x)));
    const double error = std::abs(double{exp_negative(static_cast<float>(x))} - wanted) / wanted;
    worst = std::max(worst, error);
    if (x < 5.0) worst_near = std::max(worst_near, error);
  }
  EXPECT_LT(worst, 4e-6);  // rounding of x log2(e) where the result is 1e-34; 5e-7 below x = 5
  EXPECT_LT(worst_near, 5e-7);
  EXPECT_EQ(exp_negative(0.0F), 1.0F);
  EXPECT_EQ(exp_negative(1e9F), 0.0F);
  EXPECT_EQ(exp_negative(std::numeric_limits<float>::infinity()), 0.0F);
}

TEST(ScalarMath, TellsFiniteNumbers) {
  EXPECT_TRUE(is_finite(-3.0e38F));
  EXPECT_FALSE(is_finite(std::numeric_limits<float>::infinity()));
  EXPECT_FALSE(is_finite(std::numeric_limits<float>::quiet_NaN()));
  EXPECT_TRUE(std::isnan(limit(std::numeric_limits<float>::quiet_NaN(), 1.0F))) << "a NaN must not turn into a limit";
}

TEST(Friction, RegressorIsTheDerivativeOfTheModel) {
  const FrictionConfig f{3.9F, 4.6F, 1111.0F, 2.0F};
  const auto torque = [](double b, double fc, double fs, double ft, double v) {
    return (fc + (fs - fc) * std::exp(-ft * v * v)) * (v > 0 ? 1.0 : -1.0) + b * v;
  };
  for (const double v : {-1.3, -0.04, -0.01, 0.006, 0.03, 0.7}) {
    const FrictionRegressor Y = friction_regressor(f, static_cast<float>(v), v > 0 ? 1.0F : -1.0F);
    const double b = 2.0, fc = 3.9, fs = 4.6, ft = 1111.0;
    const auto slope = [&](double h, auto at) { return (at(h) - at(-h)) / (2 * h); };
    EXPECT_NEAR(Y.viscous, slope(1e-4, [&](double h) { return torque(b + h, fc, fs, ft, v); }), 1e-5);
    EXPECT_NEAR(Y.coulomb, slope(1e-4, [&](double h) { return torque(b, fc + h, fs, ft, v); }), 1e-5);
    EXPECT_NEAR(Y.stat, slope(1e-4, [&](double h) { return torque(b, fc, fs + h, ft, v); }), 1e-5);
    EXPECT_NEAR(Y.stribeck, slope(1e-2, [&](double h) { return torque(b, fc, fs, ft + h, v); }), 1e-5);
    EXPECT_NEAR(friction_torque(f, Y), torque(b, fc, fs, ft, v), 2e-5);
  }
}

TEST(Friction, DirectionIsContinuousAndZeroAtRest) {
  const ControlConfig c;
  EXPECT_EQ(motion_direction(0.0F, 0.0F, c), 0.0F);
  EXPECT_EQ(motion_direction(0.5F, 0.0F, c), 0.0F) << "a held joint's friction is not compensated";
  EXPECT_EQ(motion_direction(0.5F, 0.5F, c), 1.0F);
  EXPECT_EQ(motion_direction(-0.5F, 0.5F, c), -1.0F);
  EXPECT_EQ(motion_direction(0.0F, -0.5F, c), -1.0F);
  Random random(3);
  for (int i = 0; i < 200000; ++i) {
    const auto v = static_cast<float>(random.uniform(-0.05, 0.05));
    const auto r = static_cast<float>(random.uniform(-0.005, 0.005));
    const auto d = static_cast<float>(random.uniform(-1e-5, 1e-5));
    const float here = motion_direction(v, r, c);
    ASSERT_LE(absolute(here), 1.0F);
    ASSERT_NEAR(motion_direction(v + d, r, c), here, 2.2e-3);
    ASSERT_NEAR(motion_direction(v, r + d, c), here, 1.1e-2);
  }
}

TEST(ActiveLaw, EqualsItsEquationWithoutCompensator) {
  auto config = test::module_config(test::hammer_joint());
  config.control.compensator.enabled = false;
  ActiveLaw law(config.control, config.friction, kDt);
  Random random(5);
  for (int i = 0; i < 1000; ++i) {
    const double e = random.uniform(-0.05, 0.05);
    const double v = random.uniform(-2.0, 2.0);
    const double vd = random.uniform(-2.0, 2.0);
    const double ad = random.uniform(-20.0, 20.0);
    const double tau_s = random.uniform(-30.0, 30.0);
    if (std::abs(v) < 0.03 || std::abs(vd) < 0.01) continue;
    const MotionState r{0.3F, static_cast<float>(vd), static_cast<float>(ad)};
    const double J = double{config.control.inertia_kg_m2};
    const double lambda = 50.0;
    // (14)-(18): J a + tau_s + tau_f with a = q_d'' - 2 lambda e' - lambda^2 e.
    const double a = ad - 2.0 * lambda * (v - vd) - lambda * lambda * e;
    const double friction = (3.9 + 0.7 * std::exp(-v * v / 9e-4)) * (v > 0 ? 1 : -1) + 2.0 * v;
    const double wanted = J * a + tau_s + friction;
    EXPECT_NEAR(law.step(static_cast<float>(e), static_cast<float>(v), r, static_cast<float>(tau_s), true).torque_nm,
                wanted, 1e-4 + 1e-5 * std::abs(wanted));
  }
}

TEST(ActiveLaw, CompensatorIntegralIsProjectedOntoItsBound) {
  auto config = test::module_config(test::hammer_joint());
  ActiveLaw law(config.control, config.friction, kDt);
  const MotionState r{0.0F, 1.0F, 0.0F};
  float compensator = 0.0F;
  for (int i = 0; i < 20000; ++i) compensator = law.step(-0.02F, 0.8F, r, 0.0F, true).compensator_nm;
  // u_c at its bounds (2 on viscous, 2.5 on Coulomb), u_b at rho, u_q at rho_q: nothing more can come, however long it
  // lasts.
  const double E = std::exp(-0.64 / 9e-4);
  EXPECT_NEAR(compensator, 0.8 * (2.0 + 0.5) + (1 - E) * (2.5 + 0.8) + 0.4, 1e-3);
  law.reset();
  const float after = law.step(0.0F, 0.0F, {}, 0.0F, true).compensator_nm;
  EXPECT_EQ(after, 0.0F);
}

// The figures of the design's simulation: 10.4 / 2.15 / 0.46 mrad at the hammer joint, 41.5 / 8.5 / 1.27 at the base.
struct Tracking {
  double rms_mrad;
  double mean_torque_step_nm;
};
Tracking track(bool base, float feedforward, bool compensator) {
  const auto p = base ? test::base_joint() : test::hammer_joint();
  auto c = test::module_config(p, base);
  c.control.friction_feedforward = feedforward;
  c.control.compensator.enabled = compensator;
  test::Joint joint(p, c, 1);
  joint.brake_released = true;
  Sensing sensing(c.sensing, c.drive, kDt);
  ActiveLaw law(c.control, c.friction, kDt);
  Drive drive(c.drive, c.sensing, c.limits, kDt);
  ActuatorCommand a{0, true, true};
  for (int i = 0; i < 30; ++i) joint.step(1e-3, a);  // the brake opens
  double sum = 0.0;
  int n = 0;
  float last = 0.0F;
  double steps = 0.0;
  const double w = M_PI;
  for (int i = 0; i < 8000; ++i) {
    sensing.update(Time{} + milliseconds(i), joint.sample());
    const double t = i * 1e-3;
    const MotionState r{static_cast<float>(0.3 * (1 - std::cos(w * t))), static_cast<float>(0.3 * w * std::sin(w * t)),
                        static_cast<float>(0.3 * w * w * std::cos(w * t))};
    const float e = sensing.position_rad() - r.position_rad;
    const auto out = law.step(e, sensing.velocity_rad_s(), r, sensing.joint_torque_nm().value, true);
    const auto command = drive.command(out.torque_nm, sensing.current_a(), sensing.winding_c(), 1e9F);
    a.current_duty = command.duty;
    joint.step(1e-3, a);
    if (i > 2000) {
      const double error = joint.motor_q - 0.3 * (1 - std::cos(w * (t + 1e-3)));
      sum += error * error;
      steps += double{absolute(command.torque_nm - last)};
      ++n;
    }
    last = command.torque_nm;
  }
  return {std::sqrt(sum / n) * 1e3, steps / n};
}

TEST(ActiveLaw, TracksAnElasticDriveWithLuGreFriction) {
  EXPECT_NEAR(track(false, 0.0F, false).rms_mrad, 10.4, 2.1);
  EXPECT_NEAR(track(false, 0.8F, false).rms_mrad, 2.15, 0.43);
  EXPECT_LT(track(false, 0.8F, true).rms_mrad, 0.46);
  EXPECT_NEAR(track(true, 0.0F, false).rms_mrad, 41.5, 8.3);
  EXPECT_NEAR(track(true, 0.8F, false).rms_mrad, 8.5, 1.7);
  const Tracking base = track(true, 0.8F, true);
  EXPECT_LT(base.rms_mrad, 1.27);
  EXPECT_LT(base.mean_torque_step_nm, 3.0) << "it tracks, but rattles";
}

TEST(PassiveLaw, NeverExceedsItsCompensationAndIsContinuous) {
  PassiveConfig config;
  config.compensation_nm = 3.3F;
  config.static_compensation_nm = 3.9F;
  PassiveLaw law(config, kDt);
  Random random(11);
  float last = 0.0F;
  law.begin({});
  EXPECT_EQ(law.torque_nm(), 0.0F) << "nothing is known, nothing is pushed";
  for (int i = 0; i < 100000; ++i) {
    law.update({static_cast<float>(random.normal() * 0.05), random.uniform() < 0.9,
                static_cast<float>(random.normal() * 5.0), static_cast<float>(random.normal())});
    ASSERT_LE(absolute(law.torque_nm()), config.static_compensation_nm);
    // The trend at its rate, and friction's own fall from static to Coulomb.
    ASSERT_LE(absolute(law.torque_nm() - last),
              config.static_compensation_nm * (config.trend_rate_1_s * kDt * 1.0001F + 1.0F) - config.compensation_nm);
    last = law.torque_nm();
  }
}

TEST(PassiveLaw, TrendIsMotionThenTorqueThenPrediction) {
  PassiveConfig config;
  config.compensation_nm = config.static_compensation_nm = 1.0F;
  PassiveLaw law(config, kDt);
  law.begin({0.5F, true, 20.0F, -1.0F});
  EXPECT_EQ(law.trend(), 1.0F) << "it moves: motion alone";
  law.begin({0.0F, true, 20.0F, 1.0F});
  EXPECT_EQ(law.trend(), -1.0F) << "at rest: the transmission pulls the motor against the torque it gives the link";
  law.begin({0.0F, true, 0.5F, 1.0F});
  EXPECT_EQ(law.trend(), 1.0F) << "within the dead band: the prediction";
  law.begin({0.0F, false, 50.0F, 0.0F});
  EXPECT_EQ(law.trend(), 0.0F) << "a torque that is not valid says nothing";
}

// How far a resting joint gives under the passive law and a push that leaves a tenth of its static friction, and how
// much of that it still creeps in the last second and a half of three.
struct Creep {
  double given_rad;
  double creeping_rad;
};
Creep creep(int seed, bool predicted) {
  const bool base = seed % 2 == 0;
  const auto p = base ? test::base_joint() : test::hammer_joint();
  const auto c = test::module_config(p, base);
  test::Joint joint(p, c, static_cast<std::uint64_t>(seed));
  joint.brake_released = true;
  Sensing sensing(c.sensing, c.drive, kDt);
  PassiveLaw law(c.passive, kDt);
  Drive drive(c.drive, c.sensing, c.limits, kDt);
  ActuatorCommand a{0, true, true};
  for (int i = 0; i < 30; ++i) joint.step(1e-3, a);
  Random random(static_cast<std::uint64_t>(seed));
  joint.external_nm = random.uniform(-1.0, 1.0) * 0.4 * (p.coulomb_nm - double{c.passive.compensation_nm});
  const double before = joint.motor_q;
  double half_way = 0.0;
  for (int i = 0; i < 3000; ++i) {
    if (i == 1500) half_way = joint.motor_q;
    sensing.update(Time{} + milliseconds(i), joint.sample());
    const float prediction = predicted ? (i / 500 % 2 == 0 ? 1.0F : -1.0F) : 0.0F;
    law.update({sensing.velocity_rad_s(), true, sensing.joint_torque_nm().value, prediction});
    a.current_duty = drive.command(law.torque_nm(), sensing.current_a(), sensing.winding_c(), 1e9F).duty;
    joint.step(1e-3, a);
  }
  return {std::abs(joint.motor_q - before), std::abs(joint.motor_q - half_way)};
}

TEST(PassiveLaw, DoesNotMoveARestingJoint) {
  for (int seed = 1; seed <= 20; ++seed) {
    const Creep c = creep(seed, false);
    EXPECT_LT(c.given_rad, 1.5e-3) << "seed " << seed << ": more than presliding";
    EXPECT_LT(c.creeping_rad, 1e-4) << "seed " << seed;
  }
}

TEST(PassiveLaw, APredictionThatKeepsChangingDoesNotMoveARestingJointEither) {
  for (int seed = 1; seed <= 20; ++seed) EXPECT_LT(creep(seed, true).given_rad, 2e-3) << "seed " << seed;
}

// ------------------------------------------------------------------------------------------------ reference

struct Quintic {
  std::array<double, 6> c;
  MotionState at(double t) const {
    double p = 0, v = 0, a = 0;
    for (int k = 5; k >= 0; --k) p = p * t + c[static_cast<std::size_t>(k)];
    for (int k = 5; k >= 1; --k) v = v * t + k * c[static_cast<std::size_t>(k)];
    for (int k = 5; k >= 2; --k) a = a * t + k * (k - 1) * c[static_cast<std::size_t>(k)];
    return {static_cast<float>(p), static_cast<float>(v), static_cast<float>(a)};
  }
};

TEST(Reference, ReproducesAQuinticExactlyBetweenKnots) {
  for (const int period_ms : {4, 10, 20}) {
    LimitsConfig limits;
    limits.velocity_rad_s = 10.0F;
    limits.acceleration_rad_s2 = 100.0F;
    Reference reference({}, limits, kDt);
    const Quintic quintic{{0.2, 0.0, 0.0, 4.0, -5.0, 2.0}};  // from rest, so that it can be taken over
    reference.start_at(0.2F, 0.0F, 20.0F);
    reference.step(Time{});
    const Duration period = milliseconds(period_ms);
    const double T = period.seconds();
    double worst_p = 0, worst_v = 0, worst_a = 0;
    std::uint16_t sequence = 65500;  // wraps on the way
    for (int k = 0; k * T < 0.8; ++k) {
      const Time sync = Time{} + period * k;
      // Takes over with two knots at rest, then the quintic from t = 0 at the third SYNC.
      const auto shape = [&](double t) { return t <= 0.0 ? MotionState{0.2F, 0.0F, 0.0F} : quintic.at(t); };
      const KnotVerdict verdict = reference.offer({shape((k + 1 - 2) * T), sequence++}, sync, period, 0.2F);
      ASSERT_EQ(verdict, k == 0 ? KnotVerdict::resynchronised : KnotVerdict::accepted) << k;
      for (int i = 0; i < 8; ++i) {
        const double t = sync.seconds() + i * T / 8;
        const MotionState& r = reference.step(sync + Duration{period.ns * i / 8});
        const MotionState wanted = shape(t - 2 * T);
        worst_p = std::max(worst_p, std::abs(double{r.position_rad} - double{wanted.position_rad}));
        worst_v = std::max(worst_v, std::abs(double{r.velocity_rad_s} - double{wanted.velocity_rad_s}));
        worst_a = std::max(worst_a, std::abs(double{r.acceleration_rad_s2} - double{wanted.acceleration_rad_s2}));
      }
    }
    EXPECT_LT(worst_p, 5e-7) << period_ms;
    EXPECT_LT(worst_v, 1e-4) << period_ms;  // rounding of the position in float, over the period
    EXPECT_LT(worst_a, 0.1) << period_ms;
  }
}

TEST(Reference, StopsAtABoundedRateWithoutOvershoot) {
  Random random(2);
  for (int run = 0; run < 500; ++run) {
    Reference reference({}, {}, kDt);
    const auto v0 = static_cast<float>(random.uniform(-2.0, 2.0));
    const auto a_max = static_cast<float>(random.uniform(5.0, 40.0));
    reference.start_at(0.1F, v0, a_max);
    float last = v0;
    int ticks = 0;
    while (!reference.at_rest()) {
      const MotionState& r = reference.step(Time{} + milliseconds(++ticks));
      ASSERT_LE(absolute(r.velocity_rad_s), absolute(last) + 1e-7F);
      ASSERT_GE(r.velocity_rad_s * v0, 0.0F) << "turned round";
      ASSERT_LE(absolute(r.acceleration_rad_s2), a_max * 1.0001F);
      last = r.velocity_rad_s;
      ASSERT_LT(ticks, 1000);
    }
    const double braking = 0.5 * double{v0} * double{v0} / double{a_max};
    EXPECT_NEAR(std::abs(double{reference.state().position_rad} - 0.1), braking, 0.006 + 0.2 * braking);
  }
}

TEST(Reference, TakesOverFromAHoldWithoutAJump) {
  Random random(8);
  for (int run = 0; run < 300; ++run) {
    ReferenceConfig config;
    Reference reference(config, {}, kDt);
    reference.start_at(0.5F, 0.0F, 20.0F);
    reference.step(Time{});
    const auto away = static_cast<float>(random.uniform(-0.0099, 0.0099));
    std::uint16_t sequence = static_cast<std::uint16_t>(random.below(65536));
    MotionState last = reference.state();
    for (int tick = 0; tick < 600; ++tick) {
      const Time now = Time{} + milliseconds(tick);
      if (tick % 4 == 0) {
        ASSERT_NE(reference.offer({{0.5F + away, 0.0F, 0.0F}, sequence++}, now, milliseconds(4), 0.5F),
                  KnotVerdict::jump);
      }
      const MotionState& r = reference.step(now);
      ASSERT_LE(absolute(r.position_rad - last.position_rad), 1.1e-4F);
      ASSERT_LE(absolute(r.velocity_rad_s - last.velocity_rad_s), 4.2e-3F);
      ASSERT_LE(absolute(r.acceleration_rad_s2), 4.1F);  // window * decay^2
      last = r;
    }
    EXPECT_NEAR(last.position_rad, 0.5F + away, 2e-6);
  }
}

TEST(Reference, IgnoresWhatIsFarStaleOrOutOfLimits) {
  LimitsConfig limits;
  limits.lower_rad = -1.0F;
  limits.upper_rad = 1.0F;
  Reference reference({}, limits, kDt);
  reference.start_at(0.95F, 0.0F, 20.0F);
  reference.step(Time{});
  const Duration T = milliseconds(4);
  EXPECT_EQ(reference.offer({{0.90F, 0.0F, 0.0F}, 5}, Time{}, T, 0.95F), KnotVerdict::ignored_far);
  EXPECT_EQ(reference.offer({{0.95F, 1.8F, 0.0F}, 5}, Time{}, T, 0.95F), KnotVerdict::out_of_limits)
      << "1.8 rad/s takes 62 mrad to stop, 50 are left";
  EXPECT_EQ(reference.offer({{0.90F, 0.3F, 0.0F}, 5}, Time{}, T, 0.95F), KnotVerdict::ignored_far);
  EXPECT_EQ(reference.offer({{1.01F, 0.0F, 0.0F}, 5}, Time{}, T, 0.95F), KnotVerdict::out_of_limits);
  EXPECT_EQ(reference.offer({{0.95F, 0.0F, 30.0F}, 5}, Time{}, T, 0.95F), KnotVerdict::out_of_limits);
  EXPECT_EQ(reference.offer({{std::numeric_limits<float>::quiet_NaN(), 0.0F, 0.0F}, 5}, Time{}, T, 0.95F),
            KnotVerdict::out_of_limits);
  EXPECT_EQ(reference.offer({{0.95F, 0.0F, 0.0F}, 5}, Time{}, T, 0.95F), KnotVerdict::resynchronised);
  EXPECT_EQ(reference.offer({{0.95F, 0.0F, 0.0F}, 5}, Time{} + T, T, 0.95F), KnotVerdict::stale);
  EXPECT_EQ(reference.offer({{0.95F, 0.0F, 0.0F}, 4}, Time{} + T, T, 0.95F), KnotVerdict::stale);
  EXPECT_EQ(reference.offer({{0.955F, 0.0F, 0.0F}, 6}, Time{} + T, T, 0.95F), KnotVerdict::jump);
  EXPECT_EQ(reference.offer({{0.95F, 0.0F, 0.0F}, 6}, Time{} + T, T, 0.95F), KnotVerdict::accepted);
  Reference moving({}, limits, kDt);
  moving.start_at(0.0F, 1.0F, 20.0F);
  moving.step(Time{});
  EXPECT_EQ(moving.offer({{0.001F, 0.0F, 0.0F}, 5}, Time{}, T, 0.0F), KnotVerdict::ignored_moving);
}

TEST(Reference, MeetsAJointThatIsKeptOffItsReferenceWhereItIs) {
  Reference reference({}, {}, kDt);
  reference.start_at(0.5F, 0.0F, 20.0F);
  reference.step(Time{});
  const Duration T = milliseconds(4);
  EXPECT_EQ(reference.offer({{0.54F, 0.0F, 0.0F}, 5}, Time{}, T, 0.5F), KnotVerdict::ignored_far);
  EXPECT_EQ(reference.offer({{0.54F, 0.0F, 0.0F}, 5}, Time{}, T, 0.541F), KnotVerdict::resynchronised);
  EXPECT_NEAR(reference.step(Time{}).position_rad, 0.5F, 1e-6F) << "no jump";
}

TEST(Reference, DoesNotRunAheadOfABlockedJoint) {
  Reference reference({}, {}, kDt);
  reference.start_at(0.1F, 1.5F, 20.0F);
  for (int i = 0; i < 300; ++i) {
    reference.not_faster_than(0.0F);
    reference.step(Time{} + milliseconds(i));
    ASSERT_LE(reference.state().position_rad, 0.1F + 0.003F);
  }
  EXPECT_TRUE(reference.at_rest());
}

// ------------------------------------------------------------------------------------------------ SYNC

TEST(SyncPll, LocksWithDriftAndJitterAndPredictsAhead) {
  for (const double ppm : {-100.0, 0.0, 100.0}) {
    SyncPll pll(milliseconds(4));
    Random random(4);
    const double period_ns = 4e6 * (1.0 + ppm * 1e-6);
    double worst_phase = 0.0;
    double worst_ahead = 0.0;
    double worst_drift = 0.0;
    for (int k = 0; k < 4000; ++k) {
      const double truth = 1e9 + k * period_ns;
      const double delay = random.uniform(0.0, 135e3);  // waits for a frame on the bus
      const auto arrival = pll.on_sync(Time{static_cast<std::int64_t>(truth + delay)});
      ASSERT_EQ(arrival.periods, 1);
      if (k > 400) {
        ASSERT_TRUE(pll.locked());
        // The mean delay of 67.5 us cannot be told from the clock; what remains is jitter.
        worst_phase = std::max(worst_phase, std::abs(static_cast<double>(pll.sync_time().ns) - truth - 67.5e3));
        worst_ahead = std::max(worst_ahead,
                               std::abs(static_cast<double>(pll.predict(10).ns) - (truth + 10 * period_ns) - 67.5e3));
        worst_drift = std::max(worst_drift, std::abs(double{pll.drift_ppm()} - ppm));
      }
    }
    EXPECT_LT(worst_phase, 40e3) << ppm;
    EXPECT_LT(worst_ahead, 90e3) << ppm;
    EXPECT_LT(worst_drift, 250.0) << ppm;
  }
}

TEST(SyncPll, IsExactWithoutJitter) {
  SyncPll pll(milliseconds(4));
  for (int k = 0; k < 500; ++k) pll.on_sync(Time{4'000'400LL * k});  // +100 ppm
  EXPECT_LT(std::abs(pll.last_error().ns), 30);
  EXPECT_NEAR(pll.drift_ppm(), 100.0F, 0.5F);
  EXPECT_NEAR(static_cast<double>(pll.predict(10).ns), 4'000'400.0 * 509, 300.0);
}

TEST(SyncPll, CountsLostSyncsAndIgnoresDoubles) {
  SyncPll pll(milliseconds(4));
  Time t;
  for (int k = 0; k < 50; ++k) {
    pll.on_sync(t);
    t += milliseconds(4);
  }
  EXPECT_TRUE(pll.locked());
  t += milliseconds(8);
  EXPECT_EQ(pll.on_sync(t).periods, 3);
  EXPECT_TRUE(pll.locked());
  EXPECT_EQ(pll.on_sync(t + milliseconds(1)).periods, 0);
  EXPECT_TRUE(pll.locked()) << "one frame delivered twice is no second sender";
}

TEST(SyncPll, ASenderThatIsLateNowAndThenMovesNothing) {
  SyncPll pll(milliseconds(4));
  Time t;
  for (int k = 0; k < 200; ++k) {
    const bool late = k > 50 && k % 5 < 2;  // two in a row
    EXPECT_EQ(pll.on_sync(late ? t + milliseconds(1) : t).periods, 1);
    t += milliseconds(4);
    if (k > 50) {
      EXPECT_TRUE(pll.locked()) << k;
      EXPECT_EQ(pll.predict(1), t) << k;
    }
  }
}

TEST(SyncPll, FollowsNeitherOfTwoSenders) {
  SyncPll pll(milliseconds(4));
  Time t;
  for (int k = 0; k < 50; ++k) {
    pll.on_sync(t);
    t += milliseconds(4);
  }
  ASSERT_TRUE(pll.locked());
  for (int k = 0; k < 50; ++k) {
    pll.on_sync(t);
    pll.on_sync(t + milliseconds(1));
    t += milliseconds(4);
    if (k > 5) {
      EXPECT_FALSE(pll.locked()) << k;
    }
  }
}

TEST(SelectionSwitch, OrderThatWasHeldUpUntilTheBlowIsOverIsDropped) {
  SyncPll pll(milliseconds(4));
  SelectionSwitch selection(0);
  SelectionSwitch::Context context;
  context.now = Time{milliseconds(100).ns};
  context.allowed = true;
  selection.command({.mask = 0, .sequence = 1, .action = can::SelectionAction::now}, context, pll);
  ASSERT_TRUE(selection.armed());
  EXPECT_EQ(SelectionSwitch(selection).due(context.now + milliseconds(40), pll.period()), std::optional<bool>(false));
  EXPECT_EQ(selection.due(context.now + milliseconds(41), pll.period()), std::nullopt);
  EXPECT_FALSE(selection.armed());
}

TEST(SyncPll, FindsASenderThatRestartsWithAnotherPhase) {
  SyncPll pll(milliseconds(4));
  Time t;
  for (int k = 0; k < 50; ++k) {
    pll.on_sync(t);
    t += milliseconds(4);
  }
  t += microseconds(1700);
  for (int k = 0; k < 60; ++k) {
    pll.on_sync(t);
    t += milliseconds(4);
  }
  EXPECT_TRUE(pll.locked());
  EXPECT_LT(std::abs((pll.predict(1) - t).ns), 1000);
}

// ------------------------------------------------------------------------------------------------ sensing, drive

TEST(Sensing, VelocityDelayOnARampIsAsDocumented) {
  SensingConfig config;
  DriveConfig drive;
  drive.gear_ratio = 101.0F;
  Sensing sensing(config, drive, kDt);
  const double rad_per_count = 2 * M_PI / (16384 * 101.0);
  double delay = 0.0;
  for (int i = 0; i < 300; ++i) {
    const double t = i * 1e-3;
    RawSensors raw;
    raw.encoder_count = static_cast<std::int32_t>(std::lround(0.5 * 20.0 * t * t / rad_per_count));
    raw.fresh = kFreshEncoder;
    sensing.update(Time{} + milliseconds(i), raw);
    if (i >= 200) delay += (20.0 * t - double{sensing.velocity_rad_s()}) / 20.0 / 100;
  }
  EXPECT_GT(delay, 0.4e-3);
  EXPECT_LT(delay, 0.8e-3) << "half a tick for the difference, and the filter";
}

TEST(Sensing, AMissingReadingTurnsInvalidAfterItsTimeAndNeverLooksFresh) {
  Sensing sensing({}, {}, kDt);
  RawSensors raw;
  raw.fresh = kFreshEncoder | kFreshTorque | kFreshCurrent | kFreshTemperature | kFreshBusVoltage;
  raw.encoder_count = 1000;
  EXPECT_FALSE(sensing.position_valid()) << "nothing was read yet";
  sensing.update(Time{}, raw);
  EXPECT_TRUE(sensing.position_valid());
  EXPECT_TRUE(sensing.complete());
  raw.fresh = 0;
  for (int i = 1; i <= 20; ++i) {
    sensing.update(Time{} + milliseconds(i), raw);
    EXPECT_EQ(sensing.position_valid(), i <= 3) << i;
    EXPECT_EQ(sensing.joint_torque_nm().valid, i <= 5) << i;
    EXPECT_EQ(sensing.current_a().valid, i <= 10) << i;
  }
}

TEST(Sensing, CountsAreRightAcrossTheWrapOfTheCounter) {
  DriveConfig drive;
  drive.gear_ratio = 100.0F;
  SensingConfig config;
  config.encoder_zero_count = std::numeric_limits<std::int32_t>::max() - 500;
  Sensing sensing(config, drive, kDt);
  RawSensors raw;
  raw.fresh = kFreshEncoder;
  for (int i = 0; i <= 1000; ++i) {
    raw.encoder_count =
        static_cast<std::int32_t>(static_cast<std::uint32_t>(config.encoder_zero_count) + static_cast<unsigned>(i));
    sensing.update(Time{} + milliseconds(i), raw);
  }
  EXPECT_TRUE(sensing.position_valid());
  EXPECT_NEAR(sensing.position_rad(), 1000.0 * 2 * M_PI / (16384 * 100.0), 1e-7);
}

TEST(Drive, GivesTheTorqueAskedForPerDirection) {
  auto c = test::module_config(test::hammer_joint());
  c.drive.torque_constant_positive_nm_a = 0.19F;
  c.drive.torque_constant_negative_nm_a = 0.25F;
  Drive drive(c.drive, c.sensing, c.limits, kDt);
  const Reading none;
  for (const float tau : {20.0F, -20.0F, 0.0F, 3.3F}) {
    const Drive::Output out = drive.command(tau, none, none, 1e9F);
    const double amperes = out.duty / 32767.0 * double{c.sensing.current_full_scale_a};
    const double kt = tau >= 0.0F ? 0.19 : 0.25;
    EXPECT_NEAR(amperes * kt * 101.0, double{tau}, 0.02);
    EXPECT_EQ(out.limit, DriveLimit::none);
  }
}

TEST(Drive, LimitsCurrentAndTorqueAndRefusesWhatIsNotANumber) {
  auto c = test::module_config(test::hammer_joint());
  Drive drive(c.drive, c.sensing, c.limits, kDt);
  const Reading none;
  EXPECT_EQ(drive.command(1000.0F, none, none, 1e9F).limit, DriveLimit::torque);
  c.drive.peak_current_a = 1.6F;
  Drive weak(c.drive, c.sensing, c.limits, kDt);
  const Drive::Output out = weak.command(44.0F, none, none, 1e9F);
  EXPECT_EQ(out.limit, DriveLimit::current_peak);
  EXPECT_NEAR(out.torque_nm, 1.6 * 0.22 * 101.0, 1e-3);
  for (const float bad : {std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity()}) {
    const Drive::Output refused = drive.command(bad, none, none, 1e9F);
    EXPECT_FALSE(refused.finite);
    EXPECT_EQ(refused.duty, 0);
  }
}

TEST(Drive, ThermalModelBringsThePeakDownToTheContinuousCurrent) {
  auto c = test::module_config(test::hammer_joint());
  c.drive.thermal_time_constant_s = 1.0F;
  Drive drive(c.drive, c.sensing, c.limits, kDt);
  Reading current;
  float torque = 0.0F;
  DriveLimit limit = DriveLimit::none;
  for (int i = 0; i < 20000; ++i) {
    const Drive::Output out = drive.command(44.0F, current, {}, 1e9F);
    torque = out.torque_nm;
    limit = out.limit;
    current = {drive.commanded_current_a(), true};
    ASSERT_LE(drive.thermal_load(), 1.001F);
  }
  EXPECT_EQ(limit, DriveLimit::current_thermal);
  EXPECT_NEAR(torque, 1.5 * 0.22 * 101.0, 1.0);
}

TEST(TorqueSelector, BlendIsMonotonicAndEndsExactlyOnThePassiveTorque) {
  TorqueSelector selector(3, 2.0F);
  selector.go_active();
  for (int i = 0; i < 20; ++i) selector.step(10.0F, 0.0F);
  selector.go_passive(-2.0F);
  EXPECT_FLOAT_EQ(selector.step(99.0F, -2.0F), 6.0F);
  EXPECT_FLOAT_EQ(selector.step(99.0F, -2.0F), 2.0F);
  EXPECT_TRUE(selector.blending());
  EXPECT_EQ(selector.step(99.0F, -2.0F), -2.0F);
  EXPECT_FALSE(selector.blending());
  selector.go_active();
  EXPECT_FLOAT_EQ(selector.step(5.0F, 0.0F), 0.0F);
  EXPECT_FLOAT_EQ(selector.step(5.0F, 0.0F), 2.0F);
  EXPECT_FLOAT_EQ(selector.step(5.0F, 0.0F), 4.0F);
  EXPECT_FLOAT_EQ(selector.step(5.0F, 0.0F), 5.0F);
  EXPECT_FLOAT_EQ(selector.step(50.0F, 0.0F), 50.0F) << "caught up: no slew any more";
}

}  // namespace
}  // namespace mrr::fw
