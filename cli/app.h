// Room: cli. The tree of commands and options: what is parsed, shown as help, completed and printed as man pages.
// May touch CLI11 and the commands of this room.
#pragma once

#include <CLI/CLI.hpp>
#include <memory>
#include <string>
#include <vector>

namespace mrr::cli {

/// The whole tree. `status` gets the exit status of the command that runs during parse().
[[nodiscard]] std::unique_ptr<CLI::App> make_app(int& status);

/// Commands of the tree, in the order of the help.
[[nodiscard]] std::vector<const CLI::App*> commands_of(const CLI::App& app);
/// Options of one command, its help included; positionals last.
[[nodiscard]] std::vector<const CLI::Option*> options_of(const CLI::App& command);
/// "-n" and "--name" of an option.
[[nodiscard]] std::vector<std::string> names_of(const CLI::Option& option);
/// The option is followed by a value.
[[nodiscard]] bool takes_value(const CLI::Option& option);

/// Of an option whose value is a whole number, 0 included (CLI11 lets -1 wrap).
[[nodiscard]] CLI::Validator whole_number();
/// Of an option whose value is a number from `low` to `high`; CLI::Range lets "nan" pass.
[[nodiscard]] CLI::Validator between(double low, double high);

/// What help and manual say of an option.
struct OptionWords {
  std::string names;        ///< "-n, --count", or a positional's name
  std::string value;        ///< "N", "planned|never|always"; empty: none
  std::string description;  ///< with its range, default and what it does not go with
};
[[nodiscard]] OptionWords words_of(const CLI::Option& option);

}  // namespace mrr::cli
