// Room: cli. What the supervisor answers, as text for people: pure functions of its JSON.
// May touch common/rpc for the type of JSON only.
#pragma once

#include <cstddef>
#include <deque>
#include <string>
#include <vector>

#include "common/rpc/message.h"

namespace mrr::cli {

/// Table of the joints, then bus, clock, command and job. `hello` and `status` as docs/rpc.md has them.
[[nodiscard]] std::string status_text(const rpc::Json& hello, const rpc::Json& status);
/// Faults there are, each with what to do, then those there were.
[[nodiscard]] std::string faults_text(const rpc::Json& faults);
/// What to do about an emergency code (CiA 301, 402 and docs/module.md).
[[nodiscard]] std::string remedy(int code);
/// One line of the log.
[[nodiscard]] std::string log_line(const rpc::Json& line);
/// One event as a line.
[[nodiscard]] std::string event_line(const rpc::Json& event);

/// The last torques of each joint, for the curves of `mrr monitor`.
struct TorqueHistory {
  explicit TorqueHistory(std::size_t samples) : length(samples) {}
  void add(const rpc::Json& status);
  std::size_t length;
  std::vector<std::deque<double>> joints;  ///< Nm, newest last; NaN: unknown
};
/// Per joint a bar of its position within its limits and a curve of its torque. `columns`: of the terminal, >= 60.
[[nodiscard]] std::string monitor_text(const rpc::Json& hello, const rpc::Json& status, const TorqueHistory& history,
                                       std::size_t columns, bool utf8);
/// Column names, and one sample, for pipes.
[[nodiscard]] std::string sample_header(const rpc::Json& hello);
[[nodiscard]] std::string sample_line(const rpc::Json& status);

}  // namespace mrr::cli
