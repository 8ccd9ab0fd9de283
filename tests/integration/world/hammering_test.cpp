// Whole jobs, from a robot that is switched off to a verdict; what the robot says against what the emulator knows.
#include <gtest/gtest.h>

#include <cmath>

#include "tests/integration/world/whole_robot.h"

namespace mrr::sim::test {
namespace {

class EverySeed : public testing::TestWithParam<std::uint64_t> {};
INSTANTIATE_TEST_SUITE_P(Seeds, EverySeed, testing::Range<std::uint64_t>(0, 10));

TEST_P(EverySeed, FoamNailIsFlushWithinSixSwingsAndLimits) {
  const RobotDescription robot = example("mrr3");
  ASSERT_DOUBLE_EQ(robot.task.nail_height_m, 0.04);
  const HammerJobResult job = hammer(robot, "styrofoam", seeded(GetParam()));
  EXPECT_EQ(job.verdict, sup::Verdict::flush) << job.reason;
  EXPECT_LE(job.nail_height_m, 0.0005);
  EXPECT_TRUE(job.really_flush);
  EXPECT_LE(job.swings.size(), 6U);
  EXPECT_TRUE(job.within_limits) << job.limit_note;
  EXPECT_TRUE(job.success());
}

TEST_P(EverySeed, HardwoodStopsByItselfAndLeavesTheNailWhereItWas) {
  const RobotDescription robot = example("mrr3");
  double height_at_start_m = -1.0;  // the seed moves it a little
  const HammerJobResult job = hammer(robot, "hardwood", seeded(GetParam()), [&](World& world) {
    world.on_tick = [&](int, Time, const fw::ModuleStatus&) {
      if (height_at_start_m < 0.0) height_at_start_m = world.plant().truth().nail_height_m;
    };
  });
  EXPECT_EQ(job.verdict, sup::Verdict::nothing_moves) << job.reason;
  EXPECT_EQ(job.swings.size(), static_cast<std::size_t>(robot.task.still_swings));
  EXPECT_NEAR(job.nail_height_m, height_at_start_m, 5e-5);
  EXPECT_NEAR(job.nail_height_m, robot.task.nail_height_m, 1e-3);
  EXPECT_TRUE(job.within_limits) << job.limit_note;
  EXPECT_FALSE(job.success());
  for (const SwingTruth& swing : job.truth) EXPECT_TRUE(swing.hit);
}

// What the next blow is planned with, and what `flush` is judged by: the task says what the joints can tell
// (still_tolerance). Single looks may be off by twice that, all of them together not by more than that (rms).
TEST_P(EverySeed, RobotKnowsTheHeightOfTheHeadAsWellAsTheTaskSays) {
  const RobotDescription robot = example("mrr3");
  for (const char* board : {"styrofoam", "hardwood"}) {
    const HammerJobResult job = hammer(robot, board, seeded(GetParam()));
    ASSERT_FALSE(job.swings.empty()) << job.reason;
    double sum_m2 = 0.0;
    for (std::size_t k = 0; k < job.swings.size(); ++k) {
      const double error_m = job.swings[k].head_height_after_m - job.truth[k].nail_height_m;
      EXPECT_LE(std::abs(error_m), 1e-3) << board << ", swing " << k + 1;
      sum_m2 += error_m * error_m;
    }
    EXPECT_LE(std::sqrt(sum_m2 / static_cast<double>(job.swings.size())), 0.7e-3) << board;
    EXPECT_TRUE(job.verdict != sup::Verdict::flush || job.really_flush) << board << ": said to be flush, but is not";
  }
}

TEST(Hardwood, GivesUpAfterAsManyStillSwingsAsTheTaskSays) {
  RobotDescription robot = example("mrr3");
  for (const int still : {1, 2, 5}) {
    robot.task.still_swings = still;
    const HammerJobResult job = hammer(robot, "hardwood", seeded(1));
    EXPECT_EQ(job.verdict, sup::Verdict::nothing_moves) << job.reason;
    EXPECT_EQ(job.swings.size(), static_cast<std::size_t>(still));
  }
}

TEST(Hardwood, NeverMakesMoreSwingsThanAllowed) {
  HammerJobOptions options = seeded(1);
  options.session.max_swings = 2;
  const HammerJobResult job = hammer(example("mrr3"), "hardwood", options);
  EXPECT_EQ(job.verdict, sup::Verdict::swings_used_up) << job.reason;
  EXPECT_EQ(job.swings.size(), 2U);
}

// A nail that takes many blows: what the first ones showed of the loads lets the next ones be harder.
TEST(DenseFoam, LearningSavesSwings) {
  const RobotDescription robot = example("mrr3");
  for (const std::uint64_t seed : {1U, 2U, 3U}) {
    HammerJobOptions options = seeded(seed);
    const HammerJobResult learnt = hammer(robot, "dense_foam", options);
    options.session.learn = false;
    const HammerJobResult fixed = hammer(robot, "dense_foam", options);
    EXPECT_TRUE(learnt.success()) << learnt.reason << learnt.limit_note;
    EXPECT_TRUE(fixed.within_limits) << fixed.limit_note;
    EXPECT_LT(learnt.swings.size(), fixed.swings.size()) << seed;
    double fastest_m_s = 0.0;
    for (std::size_t k = 0; k < learnt.swings.size(); ++k) {
      fastest_m_s = std::max(fastest_m_s, learnt.swings[k].plan.speed_m_s);
      if (learnt.swings[k].speed_factor == 1.0) continue;
      // Faster is planned only for what the gears bear for good; half of that was the most in 20 seeds.
      for (std::size_t i = 0; i < robot.joints.size(); ++i) {
        EXPECT_LE(learnt.truth[k].joints[i].peak_torque_nm, robot.joints[i].transmission.rated_nm)
            << "seed " << seed << ", swing " << k + 1 << ", " << robot.joints[i].name;
      }
    }
    EXPECT_GT(fastest_m_s, 1.2 * fixed.swings.front().plan.speed_m_s) << seed;
  }
}

// What the whole robot is for: the same blow with and without letting go.
// Counted is the joint that carries most of its rated torque; another may carry more than held, and still little.
TEST(Passive, TheHeaviestJointCarriesClearlyLessThanHeldInTheSameBlow) {
  const RobotDescription robot = example("mrr3");
  const PlantDescription plant = plant_on(robot, "hardwood");
  for (std::uint64_t seed = 0; seed < 6; ++seed) {
    HammerJobOptions options = seeded(seed);
    options.session.max_swings = 1;
    const HammerJobResult planned = run_hammer_job(robot, plant, options);
    options.session.mode = sup::PassiveMode::never;
    const HammerJobResult held = run_hammer_job(robot, plant, options);
    ASSERT_EQ(planned.truth.size(), 1U) << planned.reason;
    ASSERT_EQ(held.truth.size(), 1U) << held.reason;
    ASSERT_TRUE(planned.truth[0].hit && held.truth[0].hit);
    EXPECT_EQ(held.swings[0].plan.passive, 0U);
    EXPECT_NE(planned.swings[0].plan.passive, 0U) << "nothing to compare";
    // The comparison must not be won by hitting more gently (a joint that let go falls, and arrives a little faster).
    EXPECT_GE(planned.truth[0].speed_m_s, 0.97 * held.truth[0].speed_m_s);
    const auto heaviest = [&](const HammerJobResult& job) {
      double share = 0.0;
      for (std::size_t i = 0; i < robot.joints.size(); ++i) {
        share = std::max(share, job.truth[0].joints[i].peak_torque_nm / robot.joints[i].transmission.rated_nm);
      }
      return share;
    };
    EXPECT_LE(heaviest(planned), 0.6 * heaviest(held)) << "seed " << seed;
  }
}

TEST(Arm7, RunsToAVerdictOnBothBoards) {
  const RobotDescription robot = example("arm7");
  ASSERT_EQ(robot.dof(), 7);
  const HammerJobResult foam = hammer(robot, "styrofoam", seeded(1));
  EXPECT_EQ(foam.verdict, sup::Verdict::flush) << foam.reason;
  EXPECT_TRUE(foam.really_flush);
  EXPECT_TRUE(foam.within_limits) << foam.limit_note;
  const HammerJobResult wood = hammer(robot, "hardwood", seeded(1));
  EXPECT_EQ(wood.verdict, sup::Verdict::nothing_moves) << wood.reason;
  EXPECT_TRUE(wood.within_limits) << wood.limit_note;
}

TEST(Job, BusLoadOnTheWireStaysBelowTheComputedWorstCase) {
  for (const char* name : {"mrr3", "arm7"}) {
    const HammerJobResult job = hammer(example(name), "styrofoam", seeded(2));
    EXPECT_GT(job.bus_load, 0.2);
    EXPECT_LE(job.bus_load, job.bus_load_worst_case) << name;
  }
}

}  // namespace
}  // namespace mrr::sim::test
