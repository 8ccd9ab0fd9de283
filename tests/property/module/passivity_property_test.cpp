// The compensation never drives a passive joint: random hands on the emulated joints, friction down to half of what was
// identified, a torque sensor as wrong as its specification allows.
#include <gtest/gtest.h>

#include "tests/bench/module/control_quality.h"
#include "tests/unit/module/seeds.h"

namespace mrr::fw {
namespace {

using namespace test;  // NOLINT: all of this file is about it

constexpr int kBase = 0;
constexpr int kHammer = 2;

class Passivity : public testing::TestWithParam<int> {};
INSTANTIATE_TEST_SUITE_P(Joints, Passivity, testing::Values(kBase, kHammer));

TEST_P(Passivity, ItPutsNoEnergyIntoTheJointDownToNineTenthsOfTheFriction) {
  for (const double friction : {1.0, 0.95, 0.9}) {
    for (const std::uint64_t seed : mrr::test::seeds(4)) {
      const PassiveResult r = push_about({GetParam(), friction, seed}, 8.0);
      ASSERT_TRUE(r.completed) << r.note;
      // On a reversal friction gives back what it stored elastically, and is pushed in the other way: no more than
      // that.
      EXPECT_LE(r.gained_j, 2.0 * r.bristle_j) << "friction " << friction << " seed " << seed;
      EXPECT_LT(r.net_j, 0.0) << "friction " << friction << " seed " << seed;
      EXPECT_LE(r.guarded, r.phases / 20) << "friction " << friction << " seed " << seed << ": false alarms";
      EXPECT_GT(r.moved_rad, 0.02) << "nothing was tried";
    }
  }
}

TEST_P(Passivity, BelowThatTheGuardTakesItBackBeforeTheJointHasGainedFiveHundredths) {
  int guarded = 0;
  for (const double friction : {0.85, 0.8, 0.7, 0.6, 0.5}) {
    for (const std::uint64_t seed : mrr::test::seeds(4)) {
      const PassiveResult r = push_about({GetParam(), friction, seed}, 8.0);
      ASSERT_TRUE(r.completed) << r.note;
      EXPECT_LT(r.gained_j, 0.05) << "friction " << friction << " seed " << seed;
      EXPECT_LT(r.net_j, 0.0);
      guarded += r.guarded;
      if (friction == 0.5) {
        EXPECT_GT(r.guarded, r.phases / 2) << "half the friction, and nothing was reported";
      }
    }
  }
  EXPECT_GT(guarded, 0);
}

TEST_P(Passivity, AJointAtRestStaysThere) {
  for (const double friction : {1.0, 0.9, 0.5}) {
    for (const std::uint64_t seed : mrr::test::seeds(3)) {
      PassiveCase c{GetParam(), friction, seed};
      c.hand_share = 0.0;
      const PassiveResult r = push_about(c, 20.0);
      ASSERT_TRUE(r.completed) << r.note;
      EXPECT_LT(r.moved_rad, 1.5e-4) << "more than its friction gives elastically, "
                                     << "friction " << friction << " seed " << seed;
      EXPECT_EQ(r.guarded, 0);
    }
  }
}

// The reference's Table 2, base joint: 36.3 / 36.2 Nm without, 7.6 / 5.7 Nm with compensation.
TEST(Table2, TheBaseJointTurnsAsEasilyAsTheReferencesOrMore) {
  EXPECT_NEAR(torque_to_turn(kBase, +1.0, false), 36.3, 0.5);
  EXPECT_NEAR(torque_to_turn(kBase, -1.0, false), 36.2, 0.5);
  EXPECT_LE(torque_to_turn(kBase, +1.0, true), 7.6);
  EXPECT_LE(torque_to_turn(kBase, -1.0, true), 5.7);
}

}  // namespace
}  // namespace mrr::fw
