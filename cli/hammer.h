// Room: cli. `mrr hammer`: drive a nail in the world, print, write the report.
#pragma once

#include <CLI/CLI.hpp>
#include <functional>

namespace mrr::cli {

/// Exit statuses, the same for every command.
enum ExitStatus : int {
  kExitDone = 0,      ///< done, within limits
  kExitNotDone = 1,   ///< ran, but the nail is not flush (or a limit was broken)
  kExitUsage = 2,     ///< a description, an argument or a plan that cannot be used; nothing was written
  kExitInternal = 3,  ///< a defect in MRR
};

/// Adds the command; `status` gets its exit status when it ran.
void add_hammer_command(CLI::App& app, int& status);

}  // namespace mrr::cli
