// Room: cli. The commands that talk to a running mrr_supervisor.
// May touch common/rpc.
#pragma once

#include <CLI/CLI.hpp>

#include "cli/exit_status.h"
#include "common/rpc/client.h"

namespace mrr::cli {

/// status, enable, disable, home, move, passive, active, stop, fault, reset, monitor, log.
void add_robot_commands(CLI::App& app, int& status);

/// --socket of a command.
void add_socket_option(CLI::App& command, std::string& socket);

/// What a refusal means for the exit status.
[[nodiscard]] ExitStatus exit_status_of(const rpc::Error& error) noexcept;

/// One target of `mrr move`: "joint_2=30deg", "2=-0.5rad". Throws std::invalid_argument with one sentence.
struct JointTarget {
  std::string joint;
  double position_rad = 0.0;
};
[[nodiscard]] JointTarget parse_target(const std::string& text);

}  // namespace mrr::cli
