// Room: cli. Exit statuses: the one place that lists them, for help, man pages and scripts.
// Touches nothing.
#pragma once

#include <array>

namespace mrr::cli {

/// The same for every command.
enum ExitStatus : int {
  kExitDone = 0,
  kExitNotDone = 1,
  kExitUsage = 2,
  kExitInternal = 3,
  kExitInterrupted = 130,
};

struct ExitStatusText {
  ExitStatus status;
  const char* meaning;
};
inline constexpr std::array<ExitStatusText, 5> kExitStatuses{{
    {kExitDone, "done; for hammer: the nail is flush and no limit was broken"},
    {kExitNotDone, "not done: the robot refuses, is not there or did not manage; the message says why"},
    {kExitUsage, "unusable input: an option, a description, a joint or a target; nothing was moved or written"},
    {kExitInternal, "a defect in MRR"},
    {kExitInterrupted, "ended by Ctrl-C; a motion that the command began was stopped"},
}};

}  // namespace mrr::cli
