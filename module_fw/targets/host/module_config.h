// Room: module_fw/targets/host. A module's configuration from the robot description. Host only: the core never sees
// text. May touch module_fw/config.h, common/robot.
#pragma once

#include "common/robot/robot.h"
#include "module_fw/config.h"

namespace mrr::fw {

/// Configuration of the module that drives `joint` (0 .. dof-1).
/// Throws std::out_of_range for another joint. The description has been checked by load_robot().
[[nodiscard]] ModuleConfig module_config(const RobotDescription& robot, int joint);

/// FNV-1a over every figure of a configuration: what object 2001h shows. Two sides with the same hash were told the
/// same.
[[nodiscard]] std::uint32_t configuration_hash(const ModuleConfig& config);

}  // namespace mrr::fw
