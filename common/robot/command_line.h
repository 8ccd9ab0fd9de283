// Room: common/robot. What the main functions of all programs have in common.
// Host only; may touch CLI11 and signals.
#pragma once

#include <CLI/CLI.hpp>
#include <csignal>
#include <string>

namespace mrr {

/// An option that is given has a value: `--can ""`, as scripts write it when a variable is not set, is refused and not
/// taken for an option left out. Call it when all options are there.
inline void refuse_empty_values(CLI::App& app) {
  const CLI::Validator not_empty(
      [](std::string& value) {
        return value.empty() ? std::string("is empty; give a value, or leave it out") : std::string();
      },
      "");
  for (CLI::Option* option : app.get_options()) {
    if (option->get_items_expected_max() > 0) option->check(not_empty);
  }
  for (CLI::App* command : app.get_subcommands({})) refuse_empty_values(*command);
}

/// `handler` is called when the program is to end: SIGTERM, SIGINT, and SIGHUP (its terminal is gone) unless whoever
/// started it had that ignored, as nohup does. Waiting system calls return early.
inline void on_end(void (*handler)(int)) {
  struct sigaction action {};
  action.sa_handler = handler;  // without SA_RESTART
  sigaction(SIGTERM, &action, nullptr);
  sigaction(SIGINT, &action, nullptr);
  struct sigaction found {};
  sigaction(SIGHUP, nullptr, &found);
  if (found.sa_handler != SIG_IGN) sigaction(SIGHUP, &action, nullptr);
}

}  // namespace mrr
