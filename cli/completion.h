// Room: cli. `mrr completion`: completion for bash, zsh and fish, made from the tree of commands.
// Touches no files.
#pragma once

#include <CLI/CLI.hpp>
#include <string>

namespace mrr::cli {

void add_completion_command(CLI::App& app, int& status);

/// `shell`: "bash", "zsh" or "fish".
[[nodiscard]] std::string completion_script(const CLI::App& app, const std::string& shell);

}  // namespace mrr::cli
