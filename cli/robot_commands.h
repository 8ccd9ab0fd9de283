// Room: cli. The commands that talk to a running mrr_supervisor.
// May touch common/rpc.
#pragma once

#include <CLI/CLI.hpp>
#include <cstdint>
#include <functional>
#include <string>

#include "cli/exit_status.h"
#include "common/rpc/client.h"

namespace mrr::cli {

/// status, enable, disable, home, move, passive, active, stop, fault, reset, monitor, log.
void add_robot_commands(CLI::App& app, int& status);

/// What the supervisor says of itself (docs/rpc.md, hello). Throws ConnectionError if it is no supervisor of the
/// interface version that this command speaks.
[[nodiscard]] rpc::Json greet(rpc::Client& client);

/// How a command ended, and for people why not.
struct CommandEnd {
  int status = kExitDone;
  std::string reason;
};
/// Waits until command `number` has ended; the client has subscribed to "command". `moves`: Ctrl-C, and a wait that is
/// too long, stop the robot. `meanwhile` is called some times a second.
[[nodiscard]] CommandEnd await_command(rpc::Client& client, const std::string& method, std::int64_t number,
                                       double timeout_s, bool moves, const std::function<void()>& meanwhile = {});

/// JOINT of a command: a name as it is; a number as a number.
[[nodiscard]] rpc::Json joint_parameter(const std::string& joint);

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
