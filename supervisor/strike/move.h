// Room: supervisor/strike. Motions from rest to rest, all joints together, within limits. May touch common/ and
// supervisor/model. Not for the cycle: allocates.
#pragma once

#include "common/core/time.h"
#include "common/robot/robot.h"
#include "supervisor/model/chain.h"
#include "supervisor/strike/trajectory.h"

namespace mrr::sup {

/// The quickest quintic from rest at `start` to rest at `target` (rad), in whole steps of `grid` (the knot period),
/// that stays within the position limits, within `speed` (0 < speed <= 1) of velocity and acceleration limits, and
/// within the torques of drives and transmissions. Throws PlanError: a joint, its value and its range; or the limit
/// that no duration respects.
[[nodiscard]] JointTrajectory plan_move(const RobotDescription& robot, const Chain& chain, const JointVector& start,
                                        const JointVector& target, double speed, Duration grid);

}  // namespace mrr::sup
