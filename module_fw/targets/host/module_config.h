// Room: module_fw/targets/host. From the robot description to one module's configuration. Host only.
#pragma once

#include "common/robot/robot.h"
#include "module_fw/config.h"

namespace mrr::fw {

/// The configuration of joint `joint` (0-based). Its `configuration_hash` covers every other field: two modules with
/// the same hash behave alike, and the supervisor refuses one whose hash is not the robot's. Precondition: 0 <= joint <
/// robot.dof(), the description as load_robot() gives it.
[[nodiscard]] ModuleConfig module_config(const RobotDescription& robot, int joint);

}  // namespace mrr::fw
