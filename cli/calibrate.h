// Room: cli. `mrr calibrate`: a joint calibrates itself, and what was found goes into the robot's YAML.
// May touch common/rpc and common/robot.
#pragma once

#include <CLI/CLI.hpp>

namespace mrr::cli {

void add_calibrate_command(CLI::App& app, int& status);

}  // namespace mrr::cli
