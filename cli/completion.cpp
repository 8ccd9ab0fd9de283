#include "cli/completion.h"

#include <fmt/format.h>

#include <memory>
#include <string_view>
#include <vector>

#include "cli/app.h"
#include "cli/exit_status.h"

namespace mrr::cli {

namespace {

enum class Values { none, words, folders, files, interfaces };

struct Completed {
  Values kind = Values::none;
  std::string words;  // separated by blanks
};

/// What may follow an option: its list of choices, or what its name says.
Completed values_of(const CLI::Option& option) {
  const std::string type = option.get_type_name();
  const std::size_t open = type.find('{');
  const std::size_t close = type.find('}');
  if (open != std::string::npos && close != std::string::npos) {
    Completed choices{Values::words, type.substr(open + 1, close - open - 1)};
    for (char& c : choices.words) {
      if (c == ',') c = ' ';
    }
    return choices;
  }
  const std::string name = option.get_positional() ? option.get_name(true) : option.get_single_name();
  if (name == "robot" || name == "out" || name == "folder") return {Values::folders, {}};
  if (name == "socket" || name == "plant-socket") return {Values::files, {}};
  if (name == "board") return {Values::words, "styrofoam hardwood"};
  if (name == "bus" || name == "can") return {Values::interfaces, {}};
  return {};
}

/// A shell's own word in single quotes.
std::string quoted(std::string text) {
  for (std::size_t at = text.find('\''); at != std::string::npos; at = text.find('\'', at + 4))
    text.replace(at, 1, "'\\''");
  return "'" + text + "'";
}

std::string bash(const CLI::App& app) {
  std::string commands;
  std::string per_command;
  for (const CLI::App* command : commands_of(app)) {
    commands += (commands.empty() ? "" : " ") + command->get_name();
    std::string options;
    std::string words;
    std::string after;
    for (const CLI::Option* option : options_of(*command)) {
      const Completed values = values_of(*option);
      if (option->get_positional()) {
        if (values.kind == Values::words) words += " " + values.words;
        continue;
      }
      std::string pattern;
      for (const std::string& name : names_of(*option)) {
        options += (options.empty() ? "" : " ") + name;
        pattern += (pattern.empty() ? "" : "|") + name;
      }
      if (!takes_value(*option)) continue;
      std::string reply;
      switch (values.kind) {
        case Values::words:
          reply = fmt::format("COMPREPLY=($(compgen -W '{}' -- \"$word\"))", values.words);
          break;
        case Values::folders:
          reply = "compopt -o filenames; COMPREPLY=($(compgen -d -- \"$word\"))";
          break;
        case Values::files:
          reply = "compopt -o filenames; COMPREPLY=($(compgen -f -- \"$word\"))";
          break;
        case Values::interfaces:
          reply = "COMPREPLY=($(compgen -W \"$(command ls /sys/class/net 2>/dev/null)\" -- \"$word\"))";
          break;
        case Values::none:
          reply = ":";
          break;
      }
      after += fmt::format("        {}) {}; return ;;\n", pattern, reply);
    }
    per_command += fmt::format(
        "    {})\n      case $before in\n{}      esac\n      COMPREPLY=($(compgen -W '{}{}' -- \"$word\")) ;;\n",
        command->get_name(), after, options, words);
  }
  return fmt::format(
      "# bash completion of mrr; made by `mrr completion bash`\n"
      "_mrr() {{\n"
      "  local word=${{COMP_WORDS[COMP_CWORD]}} before=${{COMP_WORDS[COMP_CWORD - 1]}} command= i\n"
      "  COMPREPLY=()\n"
      "  for ((i = 1; i < COMP_CWORD; ++i)); do\n"
      "    if [[ ${{COMP_WORDS[i]}} != -* ]]; then command=${{COMP_WORDS[i]}}; break; fi\n"
      "  done\n"
      "  case $command in\n"
      "    '') COMPREPLY=($(compgen -W '{} --help --version' -- \"$word\")) ;;\n{}"
      "  esac\n"
      "}}\n"
      "complete -F _mrr mrr\n",
      commands, per_command);
}

std::string zsh(const CLI::App& app) {
  std::string commands;
  std::string per_command;
  const auto bracketed = [](std::string text) {
    for (std::size_t at = text.find_first_of("[]:"); at != std::string::npos; at = text.find_first_of("[]:", at + 2))
      text.insert(at, 1, '\\');
    return text;
  };
  for (const CLI::App* command : commands_of(app)) {
    commands += fmt::format("    {}\n", quoted(command->get_name() + ":" + bracketed(command->get_description())));
    std::string specs;
    for (const CLI::Option* option : options_of(*command)) {
      const Completed values = values_of(*option);
      std::string action;
      switch (values.kind) {
        case Values::words:
          action = ":value:(" + values.words + ")";
          break;
        case Values::folders:
          action = ":folder:_files -/";
          break;
        case Values::files:
          action = ":file:_files";
          break;
        case Values::interfaces:
          action = ":interface:_net_interfaces";
          break;
        case Values::none:
          action = ":value: ";
          break;
      }
      if (option->get_positional()) {
        specs += " \\\n      " + quoted("*" + action);
        continue;
      }
      for (const std::string& name : names_of(*option)) {
        specs += " \\\n      " + quoted(fmt::format("{}[{}]{}", name, bracketed(option->get_description()),
                                                    takes_value(*option) ? action : ""));
      }
    }
    per_command += fmt::format("    {}) _arguments{} ;;\n", command->get_name(), specs);
  }
  return fmt::format(
      "#compdef mrr\n"
      "# zsh completion of mrr; made by `mrr completion zsh`\n"
      "_mrr() {{\n"
      "  local -a commands=(\n{}  )\n"
      "  if ((CURRENT == 2)); then _describe command commands; return; fi\n"
      "  local command=$words[2]\n"
      "  shift words; ((CURRENT--))\n"
      "  case $command in\n{}"
      "  esac\n"
      "}}\n"
      "compdef _mrr mrr\n",
      commands, per_command);
}

std::string fish(const CLI::App& app) {
  std::string out = "# fish completion of mrr; made by `mrr completion fish`\ncomplete -c mrr -f\n";
  for (const CLI::App* command : commands_of(app)) {
    out += fmt::format("complete -c mrr -n __fish_use_subcommand -a {} -d {}\n", command->get_name(),
                       quoted(command->get_description()));
    for (const CLI::Option* option : options_of(*command)) {
      const Completed values = values_of(*option);
      if (option->get_positional() && values.kind != Values::words) continue;
      std::string line = fmt::format("complete -c mrr -n '__fish_seen_subcommand_from {}'", command->get_name());
      for (const std::string& name : option->get_snames()) line += " -s " + name;
      for (const std::string& name : option->get_lnames()) line += " -l " + name;
      if (takes_value(*option) && !option->get_positional()) line += " -r";
      switch (values.kind) {
        case Values::words:
          line += " -a " + quoted(values.words);
          break;
        case Values::folders:
          line += " -a '(__fish_complete_directories)'";
          break;
        case Values::files:
          line += " -F";
          break;
        case Values::interfaces:
          line += " -a '(command ls /sys/class/net 2>/dev/null)'";
          break;
        case Values::none:
          break;
      }
      out += line + " -d " + quoted(option->get_description()) + '\n';
    }
  }
  return out;
}

}  // namespace

std::string completion_script(const CLI::App& app, const std::string& shell) {
  if (shell == "zsh") return zsh(app);
  return shell == "fish" ? fish(app) : bash(app);
}

void add_completion_command(CLI::App& app, int& status) {
  auto shell = std::make_shared<std::string>();
  CLI::App* command = app.add_subcommand("completion", "Print what a shell needs to complete mrr's commands");
  command->add_option("SHELL", *shell, "bash, zsh or fish")->required()->check(CLI::IsMember({"bash", "zsh", "fish"}));
  command->footer(
      "Use it at once:\n  bash: source <(mrr completion bash)\n  zsh: source <(mrr completion zsh)\n"
      "  fish: mrr completion fish | source");
  command->callback([&app, shell, &status] {
    fmt::print("{}", completion_script(app, *shell));
    status = kExitDone;
  });
}

}  // namespace mrr::cli
