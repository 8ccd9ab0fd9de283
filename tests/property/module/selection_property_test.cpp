// Ten thousand random switches between the laws, at random states, through the whole module.
#include <gtest/gtest.h>

#include <cmath>
#include <optional>

#include "common/core/random.h"
#include "tests/unit/module/module_bench.h"
#include "tests/unit/module/seeds.h"

namespace mrr::fw {
namespace {

using test::ModuleBench;

struct RestToRest {
  double from, to, start_s, duration_s;
  MotionState operator()(double t) const {
    const double s = std::clamp((t - start_s) / duration_s, 0.0, 1.0);
    const double d = to - from;
    return {static_cast<float>(from + d * s * s * s * (10 - 15 * s + 6 * s * s)),
            static_cast<float>(d * 30 * s * s * (1 - 2 * s + s * s) / duration_s),
            static_cast<float>(d * 60 * s * (1 - 3 * s + 2 * s * s) / (duration_s * duration_s))};
  }
};

/// Watches every tick for what must hold at any switch.
class SwitchWatch {
 public:
  explicit SwitchWatch(const ModuleConfig& c) : c_(c) {}
  int to_passive = 0;
  int to_active = 0;
  int interrupted_blends = 0;

  void operator()(const ModuleStatus& s) {
    const double tau = double{s.torque_command_nm};
    const double step = std::abs(tau - last_torque_);
    const double slew = double{c_.passive.resume_torque_slew_nm_s} * c_.tick.seconds();
    if (s.law == Law::passive && last_law_ != Law::passive) {
      ++to_passive;
      start_ = last_torque_;
      target_ = double{s.passive_torque_nm};
      began_ = s.now;
      blending_ = true;
      if (catching_up_) ++interrupted_blends;
    }
    if (s.law == Law::passive && blending_) {
      const double low = std::min(start_, target_) - 1e-6;
      const double high = std::max(start_, target_) + 1e-6;
      ASSERT_TRUE(tau >= low && tau <= high) << "overshoot: " << tau << " between " << start_ << " and " << target_;
      ASSERT_GE((tau - last_torque_) * (target_ - start_), -1e-6) << "not monotonic";
      ASSERT_EQ(double{s.passive_torque_nm}, target_) << "the goal moved during the blend";
      ASSERT_NEAR(step, std::abs(target_ - start_) / static_cast<double>(c_.passive.blend / c_.tick), 1e-4)
          << "not in equal steps";
      if (s.blend_ended_at >= began_) {
        ASSERT_LE(s.blend_ended_at - began_, c_.passive.blend);
        ASSERT_NEAR(tau, target_, 1e-6);
        blending_ = false;
      }
      ASSERT_LE(s.now - began_, c_.passive.blend) << "the blend does not end in time";
    } else if (s.law == Law::passive) {
      // The trend at its rate, friction's own fall from static to Coulomb, and what the guard takes back.
      const auto& p = c_.passive;
      const double taken_back =
          s.limit == can::LimitCode::passivity_guard ? double{p.static_compensation_nm} / 3.0 : 0.0;
      ASSERT_LE(step, double{p.static_compensation_nm * p.trend_rate_1_s} * c_.tick.seconds() +
                          double{p.static_compensation_nm - p.compensation_nm} + taken_back + 1e-5);
      ASSERT_LE(std::abs(tau), double{p.static_compensation_nm} * (1.0 + 1e-6) + 1e-6);
    }
    if (s.law == Law::active && last_law_ == Law::passive) {
      ++to_active;
      if (blending_) ++interrupted_blends;
      blending_ = false;
      catching_up_ = true;
      // q_d := q, q_d' := q', up to the first tick of the stop.
      ASSERT_NEAR(s.reference_position_rad, s.position_rad, std::abs(double{s.velocity_rad_s}) * 1.1e-3 + 1e-5);
      ASSERT_NEAR(s.reference_velocity_rad_s, s.velocity_rad_s,
                  double{c_.reference.quick_stop_deceleration_rad_s2} * 1.1e-3);
      ASSERT_FALSE(s.following_knots);
    }
    if (s.law == Law::active && catching_up_) {
      if (std::abs(tau - double{s.active_torque_nm}) < 1e-5) {
        catching_up_ = false;
      } else {
        ASSERT_NEAR(step, slew, 1e-4) << "neither there nor on the way";
        ASSERT_GT((tau - last_torque_) * (double{s.active_torque_nm} - last_torque_), 0.0)
            << "away from the active torque";
      }
      ASSERT_LE(step, slew + 1e-4);
    }
    last_torque_ = tau;
    last_law_ = s.law;
  }

 private:
  ModuleConfig c_;
  double last_torque_ = 0.0, start_ = 0.0, target_ = 0.0;
  Law last_law_ = Law::off;
  bool blending_ = false;
  bool catching_up_ = false;
  Time began_;
};

void many_switches(std::uint64_t seed, bool base, int wanted) {
  Random random(seed);
  auto p = base ? test::base_joint() : test::hammer_joint();
  p.gravity_nm = base ? 0.0 : random.uniform(0.0, 4.0);
  auto c = test::module_config(p, base);
  c.passive.blend = milliseconds(static_cast<std::int64_t>(2 + random.below(5)));
  ModuleBench b(p, c, seed);
  ASSERT_TRUE(b.enable());
  SwitchWatch watch(c);
  std::uint8_t sequence = 0;
  const auto next_sequence = [&] { return sequence = static_cast<std::uint8_t>(sequence % 31U + 1U); };
  b.each_tick = [&](const ModuleStatus& s) { watch(s); };
  int cycles = 0;
  while (watch.to_passive + watch.to_active < wanted && cycles < wanted) {
    ++cycles;
    b.joint.external_nm = 0.0;
    ASSERT_TRUE(b.run_until([&] { return std::abs(b.status().reference_velocity_rad_s) == 0.0F; }, 1.0));
    ASSERT_TRUE(b.follow_here()) << "cycle " << cycles;
    if (random.uniform() < 0.7) {
      const double from = double(b.module.objects().target_position_urad) * 1e-6;
      // Towards the middle, so that the limits stay far.
      const double to = from + random.uniform(0.05, 0.4) * (from > 0.0 ? -1.0 : 1.0);
      b.trajectory = RestToRest{from, to, b.seconds_now() + 0.01, random.uniform(0.5, 0.7)};
      b.run(random.uniform(0.02, 0.5));
      ASSERT_EQ(b.status().fault, can::Emergency::none);
    }
    const int changes = 1 + static_cast<int>(random.below(3));
    for (int k = 0; k < changes; ++k) {
      const bool armed = random.uniform() < 0.5;
      if (armed) {
        const auto at = static_cast<std::uint8_t>((b.sync_counter + random.below(6)) % 240 + 1);
        b.select(can::SelectionAction::arm, false, next_sequence(), at, static_cast<std::uint16_t>(random.below(4000)));
        b.run(0.001);
        ASSERT_EQ(can::acknowledged_sequence(b.status().selection_acknowledged), sequence);
        ASSERT_TRUE(b.run_until([&] { return b.status().law == Law::passive; }, 0.05))
            << "an armed switch did not come";
      } else {
        b.select(can::SelectionAction::now, false, next_sequence());
        b.tick();
        ASSERT_EQ(b.status().law, Law::passive);
      }
      b.joint.external_nm = random.uniform() < 0.5 ? random.uniform(-1.2, 1.2) * p.static_nm : 0.0;
      // Now and then back before the blend is over.
      b.run(random.uniform() < 0.3 ? 0.001 : random.uniform(0.001, 0.06));
      b.select(can::SelectionAction::now, true, next_sequence());
      b.tick();
      ASSERT_EQ(b.status().law, Law::active);
      b.run(random.uniform(0.001, 0.02));
      b.joint.external_nm = 0.0;
      if (testing::Test::HasFatalFailure()) FAIL() << "seed " << seed << " cycle " << cycles;
    }
    if (random.uniform() < 0.1) {  // to and fro at every tick
      for (int k = 0; k < 20; ++k) {
        b.select(can::SelectionAction::now, k % 2 == 1, next_sequence());
        b.tick();
        // A hand may have thrown the joint: a passive phase ends at the velocity limit, in its first tick if need be.
        if (k % 2 == 0 && b.status().limit == can::LimitCode::velocity) {
          ASSERT_GT(std::abs(b.status().velocity_rad_s), c.limits.velocity_rad_s);
          continue;
        }
        ASSERT_EQ(b.status().law, k % 2 == 1 ? Law::active : Law::passive)
            << "seed " << seed << " cycle " << cycles << " k " << k << ", limit "
            << can::name_of_code(static_cast<std::uint16_t>(b.status().limit));
      }
      if (testing::Test::HasFatalFailure()) FAIL() << "seed " << seed << " cycle " << cycles << ", every tick";
    }
    ASSERT_EQ(b.status().fault, can::Emergency::none) << "seed " << seed << " cycle " << cycles;
  }
  EXPECT_GE(watch.to_passive + watch.to_active, wanted);
  EXPECT_GT(watch.interrupted_blends, 0);
}

TEST(SelectionProperty, HammerJointSwitchesWithoutABumpThousandsOfTimes) {
  for (const std::uint64_t seed : mrr::test::seeds(12)) {
    many_switches(seed, false, 500);
    if (HasFatalFailure()) return;
  }
}

TEST(SelectionProperty, BaseJointSwitchesWithoutABump) {
  for (const std::uint64_t seed : mrr::test::seeds(8, 101)) {
    many_switches(seed, true, 500);
    if (HasFatalFailure()) return;
  }
}

}  // namespace
}  // namespace mrr::fw
