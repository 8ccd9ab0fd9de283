#include "cli/app.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>

#include "cli/calibrate.h"
#include "cli/completion.h"
#include "cli/doctor.h"
#include "cli/exit_status.h"
#include "cli/hammer.h"
#include "cli/man.h"
#include "cli/plan_commands.h"
#include "cli/robot_commands.h"
#include "cli/text.h"

namespace mrr::cli {

std::unique_ptr<CLI::App> make_app(int& status) {
  auto app =
      std::make_unique<CLI::App>("Drive a modular robot that strikes with a hammer and keeps its joints whole.", "mrr");
  // Before the commands: they inherit it.
  app->formatter(std::make_shared<HelpFormatter>());
  app->option_defaults()->always_capture_default(false);
  app->require_subcommand(1);
  app->set_version_flag("--version", MRR_VERSION, "Print the version");
  app->set_help_flag("-h,--help", "Print this help");
  add_hammer_command(*app, status);
  add_plan_command(*app, status);
  add_predict_command(*app, status);
  add_map_command(*app, status);
  add_robot_commands(*app, status);
  add_calibrate_command(*app, status);
  add_doctor_command(*app, status);
  add_completion_command(*app, status);
  add_man_command(*app, status);
  // After the commands: they would inherit it.
  std::string statuses = "Exit status of every command:\n";
  for (const ExitStatusText& one : kExitStatuses)
    statuses += fmt::format("  {:<4}{}\n", static_cast<int>(one.status), one.meaning);
  app->footer(statuses + "\nmrr COMMAND --help tells more; so do the man pages (mrr man COMMAND).");
  return app;
}

std::vector<const CLI::App*> commands_of(const CLI::App& app) {
  return app.get_subcommands([](const CLI::App* command) { return !command->get_name().empty(); });
}

std::vector<const CLI::Option*> options_of(const CLI::App& command) {
  std::vector<const CLI::Option*> options;
  for (const bool positional : {false, true}) {
    for (const CLI::Option* option : command.get_options()) {
      if ((option->get_positional()) == positional && !option->get_group().empty()) options.push_back(option);
    }
  }
  return options;
}

std::vector<std::string> names_of(const CLI::Option& option) {
  std::vector<std::string> names;
  for (const std::string& name : option.get_snames()) names.push_back("-" + name);
  for (const std::string& name : option.get_lnames()) names.push_back("--" + name);
  return names;
}

bool takes_value(const CLI::Option& option) { return option.get_items_expected_max() > 0; }

constexpr std::size_t kLongestChoice = 40;

CLI::Validator whole_number() {
  return CLI::Validator(
      [](std::string& text) -> std::string {
        const bool digits = !text.empty() && text.find_first_not_of("0123456789") == std::string::npos;
        if (digits && text.size() <= 18) return {};
        return fmt::format("'{}' is not a whole number from 0 to 999999999999999999", text);
      },
      "", "whole number");
}

CLI::Validator between(double low, double high) {
  const CLI::Range range(low, high);
  return CLI::Validator(
      [range](std::string& text) -> std::string {
        if (std::string why = range(text); !why.empty()) return why;
        return std::isnan(std::strtod(text.c_str(), nullptr)) ? fmt::format("'{}' is not a number", text) : "";
      },
      range.get_description());
}

OptionWords words_of(const CLI::Option& option) {
  OptionWords words;
  words.description = option.get_description();
  // As CLI11 has it: "SHARE:FLOAT in [0 - 1]", "TEXT:{planned,never}", "N:whole number".
  std::string type = takes_value(option) ? option.get_type_name() : std::string();
  if (const std::size_t range = type.find(" in ["); range != std::string::npos) {
    const std::string limits = type.substr(range + 5, type.find(']', range) - range - 5);
    const std::size_t dash = limits.find(" - ");
    words.description += fmt::format(" ({} to {})", limits.substr(0, dash), limits.substr(dash + 3));
  }
  if (const std::size_t open = type.find('{'); open != std::string::npos) {
    words.value = type.substr(open + 1, type.find('}', open) - open - 1);
    std::replace(words.value.begin(), words.value.end(), ',', '|');
    // A long list does not fit beside the name: the description has it.
    if (words.value.size() > kLongestChoice) words.value = type.substr(0, type.find(':'));
  } else {
    words.value = type.substr(0, type.find(':'));
  }
  if (option.get_positional()) {
    words.names = option.get_name(true) + (option.get_items_expected_max() > 1 ? "..." : "");
    words.value.clear();
  } else {
    for (const std::string& name : names_of(option)) words.names += (words.names.empty() ? "" : ", ") + name;
  }
  if (const std::string value = option.get_default_str(); takes_value(option) && !value.empty())
    words.description += fmt::format(" (default: {})", value);
  std::string others;
  for (const CLI::Option* other : option.get_excludes())
    others += (others.empty() ? "" : ", ") + other->get_name(false);
  if (!others.empty()) words.description += fmt::format(" (not with {})", others);
  for (const CLI::Option* other : option.get_needs())
    words.description += fmt::format(" (only with {})", other->get_name(false));
  return words;
}

}  // namespace mrr::cli
