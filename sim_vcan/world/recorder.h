// Room: sim_vcan/world. Keeps what a run leaves behind: telemetry once per millisecond, the bus log, events.
// Host only; writes to streams its caller owns.
#pragma once

#include <iosfwd>
#include <string>
#include <vector>

#include "sim_vcan/wire/candump.h"
#include "sim_vcan/world/world.h"

namespace mrr::sim {

/// One row per step of the supervisor. Names carry their unit in brackets.
class Telemetry {
 public:
  explicit Telemetry(const RobotDescription& robot);
  /// Appends the world's present state; `swing` counts from 1, 0 before the first.
  void sample(const World& world, int swing);
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
