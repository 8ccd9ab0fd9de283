// Room: cli. `mrr doctor`: what a robot on a CAN bus needs of this machine, each lack with its remedy.
// May touch can_protocol/socketcan, common/rpc and the scheduler.
#pragma once

#include <CLI/CLI.hpp>

namespace mrr::cli {

void add_doctor_command(CLI::App& app, int& status);

}  // namespace mrr::cli
