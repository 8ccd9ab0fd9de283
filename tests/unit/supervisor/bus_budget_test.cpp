// What a robot puts on its bus, and the refusal of one that does not fit.
#include "supervisor/master/bus_budget.h"

#include <gtest/gtest.h>

#include <string>

#include "common/robot/errors.h"

namespace mrr::sup {
namespace {

RobotDescription robot_of(int joints, double knot_rate_hz) {
  RobotDescription robot;
  robot.source = "there";
  robot.bus.knot_rate_hz = knot_rate_hz;
  robot.joints.resize(static_cast<std::size_t>(joints));
  for (int i = 0; i < joints; ++i) {
    robot.joints[static_cast<std::size_t>(i)].node_id = static_cast<std::uint8_t>(2 + i);
  }
  return robot;
}

// 135 bits for 8 bytes, 65 for 1: SYNC and four PDOs a knot, own heartbeat at 20 Hz, TPDO3 and heartbeat at 10 Hz.
double by_hand(int n, double knot_rate_hz) {
  return ((65.0 + 4 * 135.0 * n) * knot_rate_hz + 65.0 * 20.0 + n * (135.0 + 65.0) * 10.0) / 1e6;
}

TEST(BusBudget, FollowsTheWorstCaseStuffingFormula) {
  for (const int n : {1, 3, 7}) {
    for (const double rate : {100.0, 250.0}) {
      EXPECT_NEAR(bus_budget(robot_of(n, rate)).load, by_hand(n, rate), 1e-12) << n << " joints, " << rate << " Hz";
    }
  }
}

TEST(BusBudget, RobotThatDoesNotFitIsRefusedWithFileKeyValueAndRemedy) {
  EXPECT_NO_THROW(require_fits(robot_of(7, 200.0), bus_budget(robot_of(7, 200.0))));
  const RobotDescription robot = robot_of(7, 250.0);
  try {
    require_fits(robot, bus_budget(robot));
    FAIL() << "98 % of the bus is not refused";
  } catch (const DescriptionError& error) {
    const std::string said = error.what();
    for (const char* part : {"there/robot.yaml", "bus.knot_rate", "250 Hz", "7 joints", "97.7 %", "80.0 %", "lower"}) {
      EXPECT_NE(said.find(part), std::string::npos) << part << " is not in: " << said;
    }
  }
}

TEST(BusBudget, CanFdIsRefused) {
  RobotDescription robot = robot_of(3, 250.0);
  robot.bus.fd = true;
  EXPECT_THROW(require_fits(robot, bus_budget(robot)), DescriptionError);
}

}  // namespace
}  // namespace mrr::sup
