// Cores allocate nothing when they are stepped: not in bring-up, not in a swing, not coming back.
#include <gtest/gtest.h>

#include "tests/integration/world/whole_robot.h"
#include "tests/unit/model/allocation_count.h"

namespace mrr::sim::test {
namespace {

TEST(WorldStep, AllocatesNothingInAWholeJob) {
  if (!mrr::test::kCountsAllocations) GTEST_SKIP() << "the sanitizer owns malloc";
  for (const char* name : {"mrr3", "arm7"}) {
    for (const char* board : {"styrofoam", "hardwood"}) {
      SCOPED_TRACE(std::string(name) + " on " + board);
      const RobotDescription robot = example(name);
      World world(robot, plant_on(robot, board), seeded(1).world);
      put_to_rest(world);
      sup::HammerSession session(robot, world.supervisor(), seeded(1).session);
      long in_steps = 0;
      std::int64_t steps = 0;
      const long at_start = mrr::test::allocations.load();
      while (world.now() < Time{} + milliseconds(120'000)) {
        const long before = mrr::test::allocations.load();
        world.step();
        in_steps += mrr::test::allocations.load() - before;
        ++steps;
        if (!world.supervisor_stepped()) continue;
        world.supervisor().events().clear();
        if (session.step(world.now())) break;  // planning, between swings: may allocate
      }
      EXPECT_FALSE(session.swings().empty()) << session.reason();
      EXPECT_GT(steps, 4'000);
      EXPECT_EQ(in_steps, 0) << "in " << steps << " steps of modules, supervisor, plant and wire";
      EXPECT_GT(mrr::test::allocations.load(), at_start) << "nothing was counted at all";
    }
  }
}

}  // namespace
}  // namespace mrr::sim::test
