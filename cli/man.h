// Room: cli. `mrr man`: manual pages made from the tree of commands.
// May touch the folder it is told to write to.
#pragma once

#include <CLI/CLI.hpp>
#include <string>

namespace mrr::cli {

void add_man_command(CLI::App& app, int& status);

/// mrr.1, or the page of one command if `command` is not nullptr; roff for man(1).
[[nodiscard]] std::string man_page(const CLI::App& app, const CLI::App* command);

}  // namespace mrr::cli
