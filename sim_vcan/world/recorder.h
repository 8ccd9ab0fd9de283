// Room: sim_vcan/world. Keeps what a run leaves behind: telemetry once per millisecond, the bus log, events.
// Host only; writes to streams its caller owns.
#pragma once

#include <iosfwd>
#include <span>
#include <string>
#include <vector>

#include "sim_vcan/wire/candump.h"
#include "sim_vcan/world/world.h"

namespace mrr::sim {

/// What a row says of a joint beyond the plant's truth: the module's own view.
struct JointTelemetry {
  double reference_rad = 0.0;
  double reference_velocity_rad_s = 0.0;
  double sensed_torque_nm = 0.0;
  double commanded_torque_nm = 0.0;
  bool passive = false;
};

/// What a row says beyond the plant's truth: the supervisor's own view.
struct RobotTelemetry {
  Time now;
  int swing = 0;  ///< counts from 1; 0: none yet
  int activity = 0;
  double estimated_force_n = 0.0;
};

/// One row per step of the supervisor. Names carry their unit in brackets.
class Telemetry {
 public:
  explicit Telemetry(const RobotDescription& robot);
  /// Appends the world's present state; `swing` counts from 1, 0 before the first.
  void sample(const World& world, int swing);
  /// The same from its parts; `joints` has an entry per joint.
  void append(const RobotTelemetry& robot, const PlantTruth& truth, std::span<const JointTelemetry> joints);
  /// Comma separated, a header line, "%.9g".
  void write_csv(std::ostream& out) const;

  [[nodiscard]] const std::vector<std::string>& columns() const noexcept { return columns_; }
  [[nodiscard]] std::size_t rows() const noexcept { return columns_.empty() ? 0 : values_.size() / columns_.size(); }

 private:
  int dof_;
  std::vector<std::string> columns_;
  std::vector<double> values_;
};

}  // namespace mrr::sim
