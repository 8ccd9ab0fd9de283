// Calibrations through the supervisor, in the whole one-clock robot under gravity: what they find against what is true.
#include <gtest/gtest.h>

#include <cmath>
#include <memory>
#include <vector>

#include "supervisor/strike/move.h"
#include "tests/integration/world/whole_robot.h"

namespace mrr::sim::test {
namespace {

using sup::ActionState;
using sup::Activity;
using sup::CalibrationKind;
using sup::CalibrationReport;
using sup::CommandFailure;
using sup::CommandState;
using sup::EventKind;
using sup::Refusal;

/// mrr3 whose drives are not as robot.yaml says: the modules believe the file.
class Wrong {
 public:
  Wrong(std::uint64_t seed, double friction, double torque_constant, bool torque_sensor = true) {
    robot = example("mrr3");
    PlantDescription plant = plant_on(robot, "styrofoam");
    for (JointTruth& joint : plant.joints) {
      for (const std::size_t way : {0U, 1U}) {
        joint.friction.coulomb_nm[way] *= friction;
        joint.friction.static_nm[way] *= friction;
        joint.drive.torque_constant_nm_a[way] *= torque_constant;
      }
      joint.friction.viscous_nm_s_rad *= friction;
    }
    for (JointDescription& joint : robot.joints) joint.sensors.torque_sensor = torque_sensor;
    world = std::make_unique<World>(robot, plant, seeded(seed).world);
    put_to_rest(*world);
  }
  [[nodiscard]] sup::Supervisor& supervisor() const { return world->supervisor(); }
  template <typename Condition>
  [[nodiscard]] bool run_until(Condition&& condition, Duration limit) {
    const Time end = world->now() + limit;
    while (world->now() < end) {
      world->step();
      if (!world->supervisor_stepped()) continue;
      for (const sup::Event& event : supervisor().events()) events.push_back(event);
      supervisor().events().clear();
      if (condition()) return true;
    }
    return false;
  }
  [[nodiscard]] bool done(Duration limit = milliseconds(600'000)) {
    return run_until([&] { return supervisor().command().state != CommandState::running; }, limit) &&
           supervisor().command().state == CommandState::done;
  }
  [[nodiscard]] bool holds() {
    return run_until([&] { return supervisor().activity() == Activity::holding; }, milliseconds(3000));
  }
  [[nodiscard]] bool enable() {
    supervisor().enable(true);
    return done();
  }
  [[nodiscard]] const JointTruth& truth(int joint) const {
    return world->plant().actual_description().joints[static_cast<std::size_t>(joint)];
  }

  RobotDescription robot;
  std::unique_ptr<World> world;
  std::vector<sup::Event> events;
};

struct Case {
  int joint;
  std::uint64_t seed;
  double friction;
  double torque_constant;
  friend void PrintTo(const Case& c, std::ostream* out) {
    *out << "joint " << c.joint + 1 << ", seed " << c.seed << ", friction x " << c.friction << ", K x "
         << c.torque_constant;
  }
};
class Friction : public testing::TestWithParam<Case> {};
INSTANTIATE_TEST_SUITE_P(JointsAndSeeds, Friction,
                         testing::Values(Case{0, 1, 1.3, 1.08}, Case{0, 2, 0.7, 0.92}, Case{1, 3, 1.3, 0.92},
                                         Case{1, 4, 0.7, 1.08}, Case{2, 5, 1.3, 1.08}, Case{2, 6, 0.7, 0.92},
                                         Case{0, 11, 0.7, 0.92}, Case{1, 12, 1.3, 0.92}, Case{2, 13, 0.7, 1.08},
                                         Case{0, 14, 1.3, 1.08}, Case{1, 15, 0.7, 0.92}, Case{2, 16, 1.3, 0.92}));

TEST_P(Friction, IsFoundWithinATenthOfWhatIsTrue) {
  const Case& c = GetParam();
  Wrong robot(c.seed, c.friction, c.torque_constant);
  ASSERT_TRUE(robot.enable());
  const double before = robot.supervisor().measured_position()[c.joint];
  ASSERT_EQ(robot.supervisor().calibrate(c.joint, {}), Refusal::none);
  EXPECT_EQ(robot.supervisor().activity(), Activity::calibrating);
  ASSERT_TRUE(robot.done()) << describe(robot.supervisor().command().failure) << ": "
                            << why_failed(robot.supervisor().calibration());
  const CalibrationReport& found = robot.supervisor().calibration();
  EXPECT_EQ(found.joint, c.joint);
  EXPECT_EQ(found.state, ActionState::attained);
  ASSERT_TRUE(found.has_result);
  const JointTruth& truth = robot.truth(c.joint);
  const auto near = [&](const char* what, float x, double wanted) {
    EXPECT_NEAR(double{x}, wanted, 0.1 * wanted) << what;
  };
  // A sensor that reads too high by a constant makes one direction look harder and the other easier by as much: what
  // is friction is the mean of the two. That is what goes into robot.yaml.
  const auto mean = [&](std::size_t k) { return 0.5F * (found.friction[0][k] + found.friction[1][k]); };
  near("f_c", mean(0), truth.friction.coulomb_nm[0]);
  near("f_s", mean(1), truth.friction.static_nm[0]);
  near("f_tau", mean(2), truth.friction.stribeck_decay_s2_rad2);
  near("b", mean(3), truth.friction.viscous_nm_s_rad);
  const double wander_nm = 2.0 * truth.sensor.torque_drift_nm + std::abs(truth.sensor.torque_offset_nm);
  for (const std::size_t way : {0U, 1U}) {
    EXPECT_NEAR(double{found.friction[way][0]}, truth.friction.coulomb_nm[way],
                0.1 * truth.friction.coulomb_nm[way] + wander_nm);
    near("K", found.torque_constant_nm_a[way], truth.drive.torque_constant_nm_a[way]);
  }
  EXPECT_LT(double{found.residual_nm}, 0.1 * truth.friction.coulomb_nm[0]);
  // It comes back to set points by itself, near where it was, and has told how far it was.
  ASSERT_TRUE(robot.holds());
  EXPECT_NEAR(robot.supervisor().measured_position()[c.joint], before, 0.35);
  EXPECT_EQ(count(robot.events, EventKind::calibration_began), 1);
  EXPECT_GT(count(robot.events, EventKind::calibration_progress), 8);
  EXPECT_EQ(count(robot.events, EventKind::calibration_ended), 1);
  EXPECT_EQ(count(robot.events, EventKind::fault), 0);
}

}  // namespace
}  // namespace mrr::sim::test
