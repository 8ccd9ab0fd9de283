// Room: cli. The reference's published tables beside what this product computes for them.
#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "common/robot/robot.h"
#include "sim_vcan/world/experiment.h"

namespace mrr::cli {

/// One figure of a published table.
struct ReproducedFigure {
  std::string table;     ///< e.g. "Table 5"
  std::string quantity;  ///< with unit
  double published = 0.0;
  double computed = 0.0;
  int digits = 2;    ///< decimals printed by the reference
  std::string note;  ///< empty, or why it differs
  /// Equal when rounded as printed; for effective masses (Tables 6, 7) within 1 %.
  bool reproduced = false;
};

/// Tables 4 to 8 from the equations as printed. `robot` must be the reference's arm.
std::vector<ReproducedFigure> reproduce_tables(const RobotDescription& robot);
std::string tables_text(const std::vector<ReproducedFigure>& figures);
nlohmann::ordered_json tables_json(const std::vector<ReproducedFigure>& figures);

/// The hammering experiment, published / simulated.
std::string experiment_text(const std::vector<sim::SimulatedSeries>& series);
nlohmann::ordered_json experiment_json(const std::vector<sim::SimulatedSeries>& series);
/// All swings within the tolerances.
bool experiment_reproduced(const std::vector<sim::SimulatedSeries>& series);

}  // namespace mrr::cli
