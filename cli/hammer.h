// Room: cli. `mrr hammer`: drive a nail in the world, print, write the report.
#pragma once

#include <CLI/CLI.hpp>

namespace mrr::cli {

/// Adds the command; `status` gets its exit status when it ran.
void add_hammer_command(CLI::App& app, int& status);

}  // namespace mrr::cli
