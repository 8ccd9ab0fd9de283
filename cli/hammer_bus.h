// Room: cli. A hammering job by processes: asked of mrr_supervisor, recorded from the bus, its truth from mrr_plant.
// May touch common/rpc and can_protocol/socketcan.
#pragma once

#include <filesystem>
#include <string>

#include "cli/json.h"
#include "common/robot/robot.h"
#include "common/rpc/message.h"

namespace mrr::cli {

struct BusJobOptions {
  std::string bus;           ///< interface of the robot's bus
  std::string socket;        ///< of mrr_supervisor; empty: the usual place
  std::string plant_socket;  ///< of mrr_plant; empty: the usual place, and nobody there means a robot of metal
  std::string mode = "planned";
  int swings = 0;  ///< 0: as the task says
  std::uint64_t seed = 1;
  bool as_printed = false;
};

struct BusJob {
  Outcome outcome;
  std::string board;              ///< as the plant calls it; "unknown" without one
  std::string clock;              ///< "lockstep" or "realtime"
  std::string bus_log;            ///< as candump -L; in lockstep with simulated times
  std::string telemetry_csv;      ///< as telemetry.md; without a plant only the robot's own columns
  std::uint64_t lost_frames = 0;  ///< not recorded because this process did not keep up
};

/// What runs there: its robot's folder, for --robot. Throws rpc::ConnectionError.
[[nodiscard]] std::string robot_of_supervisor(const std::string& socket);

/// Brings the robot up if need be, runs the job to its end. Ctrl-C stops the robot and throws Interrupted.
/// Throws rpc::Error, rpc::ConnectionError, can::CanError, DescriptionError.
[[nodiscard]] BusJob run_bus_job(const RobotDescription& robot, const BusJobOptions& options);

class Interrupted : public std::runtime_error {
 public:
  Interrupted() : std::runtime_error("interrupted; the robot was stopped") {}
};

}  // namespace mrr::cli
