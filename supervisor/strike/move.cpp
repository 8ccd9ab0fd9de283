#include "supervisor/strike/move.h"

#include <fmt/format.h>

#include <numbers>

#include "common/robot/errors.h"

namespace mrr::sup {

namespace {
constexpr Duration kLongest = milliseconds(120'000);
}

JointTrajectory plan_move(const RobotDescription& robot, const Chain& chain, const JointVector& start,
                          const JointVector& target, double speed, Duration grid) {
  if (!(speed > 0.0 && speed <= 1.0)) {
    throw PlanError(fmt::format("speed is {:g}; give a share of the limits above 0, up to 1", speed));
  }
  MotionLimits limits = motion_limits(robot);
  for (int i = 0; i < robot.dof(); ++i) {
    if (target[i] >= limits.lower_rad[i] && target[i] <= limits.upper_rad[i]) continue;
    constexpr double kDeg = 180.0 / std::numbers::pi;
    throw PlanError(
        fmt::format("{}: {:.4f} rad ({:.2f} deg) is outside its limits, {:.4f} to {:.4f} rad ({:.2f} to {:.2f} deg)",
                    joint_words(robot, i), target[i], target[i] * kDeg, limits.lower_rad[i], limits.upper_rad[i],
                    limits.lower_rad[i] * kDeg, limits.upper_rad[i] * kDeg));
  }
  limits.velocity_rad_s *= speed;
  limits.acceleration_rad_s2 *= speed;
  LimitCheck why;
  const auto duration = shortest_duration(robot, chain, limits, at_rest(start), at_rest(target), grid, kLongest, why);
  JointTrajectory motion(at_rest(start));
  if (!duration || !motion.append(at_rest(target), *duration)) {
    throw PlanError(fmt::format("there is no motion to that position within limits: {}; give another position",
                                describe(why, robot)));
  }
  return motion;
}

}  // namespace mrr::sup
