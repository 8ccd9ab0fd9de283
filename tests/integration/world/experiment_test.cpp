// The reference's hammering experiment with the whole robot, against its published figures.
#include <gtest/gtest.h>

#include "sim_vcan/world/experiment.h"
#include "tests/integration/world/whole_robot.h"

namespace mrr::sim::test {
namespace {

class ReferenceExperiment : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    const RobotDescription robot = example("mrr3");
    series_ = run_experiment(robot, load_experiment(robot), plant_on, 0);  // nominal values
  }
  static inline std::vector<SimulatedSeries> series_;
};

TEST_F(ReferenceExperiment, EveryFoamSwingIsWithinTheTolerances) {
  ASSERT_FALSE(series_.empty());
  const SimulatedSeries& foam = series_[0];
  ASSERT_EQ(foam.board, "styrofoam");
  EXPECT_EQ(foam.swings.size(), 8U);
  for (const SimulatedSwing& swing : foam.swings) {
    SCOPED_TRACE(swing.swing.name);
    const PublishedSwing& published = swing.swing.published;
    EXPECT_TRUE(swing.hit);
    EXPECT_NEAR(swing.contact_ms, published.contact_ms, 0.15 * published.contact_ms);
    EXPECT_NEAR(swing.impulse_n_s, published.impulse_n_s, 0.25 * published.impulse_n_s);
    EXPECT_NEAR(swing.penetration_mm, published.penetration_mm, std::max(0.5, 0.10 * published.penetration_mm));
    EXPECT_TRUE(swing.within);
  }
}

TEST_F(ReferenceExperiment, HardwoodSwingsAreInTheMeasuredRange) {
  ASSERT_EQ(series_.size(), 2U);
  const SimulatedSeries& wood = series_[1];
  ASSERT_EQ(wood.board, "hardwood");
  ASSERT_GE(wood.swings.size(), 3U);
  for (const SimulatedSwing& swing : wood.swings) {
    SCOPED_TRACE(swing.swing.name);
    EXPECT_TRUE(swing.hit);
    EXPECT_GE(swing.contact_ms, 70.0);
    EXPECT_LE(swing.contact_ms, 85.0);
    EXPECT_GE(swing.impulse_n_s, 1.26);
    EXPECT_LE(swing.impulse_n_s, 1.42);
    EXPECT_NEAR(swing.penetration_mm, 0.0, 0.05);
    EXPECT_TRUE(swing.within);
  }
}

TEST_F(ReferenceExperiment, PassiveJointLetsGoBeforeEveryContact) {
  for (const SimulatedSeries& series : series_) {
    for (const SimulatedSwing& swing : series.swings) {
      EXPECT_GT(swing.switch_lead_ms, 0.0) << series.board << " " << swing.swing.name;
    }
  }
}

}  // namespace
}  // namespace mrr::sim::test
