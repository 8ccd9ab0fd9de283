// Room: cli. What a program reads: docs/result.schema.json describes it.
#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>
#include <string>

#include "sim_vcan/world/hammer_job.h"

namespace mrr::cli {

/// What was asked for, so that a result says what it is a result of.
struct RunLabel {
  std::string board;  ///< as given on the command line
  std::uint64_t seed = 1;
  sup::PassiveMode mode = sup::PassiveMode::planned;
  sup::Formulation formulation = sup::Formulation::corrected;
};

/// Numbers that are not finite become null.
nlohmann::ordered_json result_json(const RobotDescription& robot, const RunLabel& label,
                                   const sim::HammerJobResult& result, double realtime_factor);

}  // namespace mrr::cli
