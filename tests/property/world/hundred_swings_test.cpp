// A hundred seeded swings against hardwood: clocks, noise, friction and masses differ from seed to seed.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdio>

#include "tests/integration/world/whole_robot.h"

namespace mrr::sim::test {
namespace {

TEST(HundredSwings, EveryPlannedJointIsPassiveBeforeContactAndEverySwitchAcknowledged) {
  const RobotDescription robot = example("mrr3");
  const PlantDescription plant = plant_on(robot, "hardwood");
  std::vector<double> leads_s;
  int swings = 0;
  for (std::uint64_t seed = 1000; swings < 100 && seed < 1100; ++seed) {
    SCOPED_TRACE(seed);
    const HammerJobResult job = run_hammer_job(robot, plant, seeded(seed));
    EXPECT_EQ(job.verdict, sup::Verdict::nothing_moves) << job.reason;
    EXPECT_TRUE(job.within_limits) << job.limit_note;
    int switches = 0;
    for (std::size_t k = 0; k < job.truth.size(); ++k) {
      ++swings;
      EXPECT_TRUE(job.truth[k].hit);
      switches += job.swings[k].plan.passive != 0 ? 1 : 0;
      for (std::size_t i = 0; i < robot.joints.size(); ++i) {
        if (!planned_passive(job.swings[k].plan, i)) continue;
        EXPECT_GT(job.truth[k].joints[i].switch_lead_s, 0.0) << robot.joints[i].name << ", swing " << k + 1;
        leads_s.push_back(job.truth[k].joints[i].switch_lead_s);
      }
    }
    EXPECT_EQ(count(job.events, sup::EventKind::selection_acknowledged), switches);
    EXPECT_EQ(count(job.events, sup::EventKind::selection_cancelled), 0);
  }
  EXPECT_GE(swings, 100);
  ASSERT_GE(leads_s.size(), 100U) << "the plans make too few joints passive to say anything";
  std::sort(leads_s.begin(), leads_s.end());
  std::printf("passive before contact, %d swings, %zu joints: least %.2f ms, median %.2f ms, most %.2f ms\n", swings,
              leads_s.size(), leads_s.front() * 1e3, leads_s[leads_s.size() / 2] * 1e3, leads_s.back() * 1e3);
}

}  // namespace
}  // namespace mrr::sim::test
