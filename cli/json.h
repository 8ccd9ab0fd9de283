// Room: cli. What a program reads: docs/result.schema.json describes it.
#pragma once

#include <nlohmann/json.hpp>

#include "sim_vcan/world/hammer_job.h"

namespace mrr::cli {

/// Numbers that are not finite become null.
nlohmann::ordered_json result_json(const RobotDescription& robot, const sim::HammerJobResult& result,
                                   double realtime_factor);

}  // namespace mrr::cli
