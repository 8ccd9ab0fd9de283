// Room: supervisor/master. What the robot puts on its bus per second in the worst case, and the refusal if it does not
// fit. May touch common and can_protocol. Host, before the cycle.
#pragma once

#include <vector>

#include "can_protocol/bit_timing.h"
#include "common/robot/robot.h"

namespace mrr::sup {

struct BusBudget {
  std::vector<can::PeriodicFrame> frames;
  double load = 0.0;      ///< worst-case stuffing, share of the bit rate
  double max_load = 0.0;  ///< what the robot file allows
};

/// All periodic frames of a robot that streams knots (docs/protocol.md): SYNC, two RPDOs and two TPDOs per joint and
/// knot, the 10 Hz condition PDO, heartbeats.
[[nodiscard]] BusBudget bus_budget(const RobotDescription& robot);

/// Throws DescriptionError naming file, key, value and remedy if the load is above the robot file's limit, or for CAN
/// FD, which the modules do not speak.
void require_fits(const RobotDescription& robot, const BusBudget& budget);

}  // namespace mrr::sup
