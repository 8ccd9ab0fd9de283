#include "supervisor/master/bus_budget.h"

#include <fmt/format.h>

#include "common/robot/errors.h"

namespace mrr::sup {

BusBudget bus_budget(const RobotDescription& robot) {
  constexpr double kSlowRate = 10.0;        // heartbeats and the condition PDO
  constexpr double kSupervisorRate = 20.0;  // the supervisor's own heartbeat
  const double knots = robot.bus.knot_rate_hz;
  BusBudget budget;
  budget.max_load = robot.bus.max_load;
  budget.frames.push_back({.id = 0x080, .length = 1, .rate_hz = knots});
  budget.frames.push_back({.id = 0x701, .length = 1, .rate_hz = kSupervisorRate});
  for (const auto& joint : robot.joints) {
    for (const std::uint32_t base : {0x180U, 0x280U, 0x300U, 0x400U}) {
      budget.frames.push_back({.id = base + joint.node_id, .length = 8, .rate_hz = knots});
    }
    budget.frames.push_back({.id = 0x380U + joint.node_id, .length = 8, .rate_hz = kSlowRate});
    budget.frames.push_back({.id = 0x700U + joint.node_id, .length = 1, .rate_hz = kSlowRate});
  }
  const can::BitRates rates{static_cast<std::int64_t>(robot.bus.bit_rate),
                            static_cast<std::int64_t>(robot.bus.data_bit_rate)};
  budget.load = can::worst_case_load(budget.frames, rates);
  return budget;
}

void require_fits(const RobotDescription& robot, const BusBudget& budget) {
  if (robot.bus.fd) {
    throw DescriptionError(
        fmt::format("{}: bus.fd: true: the modules speak classic CAN; packing several joints into a "
                    "CAN FD frame is not there yet; set it to false",
                    (robot.source / "robot.yaml").string()));
  }
  if (budget.load <= budget.max_load) return;
  throw DescriptionError(
      fmt::format("{}: bus.knot_rate: {:g} Hz: {} joints at this rate load a bus of {:g} kbit/s to {:.1f} % in the "
                  "worst case, where "
                  "bus.max_load allows {:.1f} %; lower bus.knot_rate",
                  (robot.source / "robot.yaml").string(), robot.bus.knot_rate_hz, robot.dof(),
                  robot.bus.bit_rate * 1e-3, budget.load * 100.0, budget.max_load * 100.0));
}

}  // namespace mrr::sup
