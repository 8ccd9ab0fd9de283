#include "cli/man.h"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <filesystem>
#include <memory>
#include <ostream>

#include "cli/app.h"
#include "cli/exit_status.h"
#include "cli/files.h"
#include "common/robot/errors.h"

namespace mrr::cli {

namespace fs = std::filesystem;

namespace {

/// Text that roff shows as it is.
std::string plain(const std::string& text) {
  std::string out;
  bool line_begins = true;
  for (const char c : text) {
    if (line_begins && (c == '.' || c == '\'')) out += "\\&";
    line_begins = c == '\n';
    switch (c) {
      case '\\':
        out += "\\e";
        break;
      case '-':
        out += "\\-";
        break;
      case '\'':
        out += "\\(aq";
        break;
      case '`':
        out += "\\(ga";
        break;
      case '~':
        out += "\\(ti";
        break;
      case '^':
        out += "\\(ha";
        break;
      default:
        out += c;
    }
  }
  return out;
}

std::string option_entry(const CLI::Option& option) {
  const OptionWords words = words_of(option);
  std::string line = fmt::format("\\f{}{}\\fR", option.get_positional() ? 'I' : 'B', plain(words.names));
  if (!words.value.empty()) line += fmt::format(" \\fI{}\\fR", plain(words.value));
  return fmt::format(".TP\n{}\n{}.\n", line, plain(words.description));
}

std::string heading(const std::string& name, const std::string& what) {
  std::string title = name;
  std::transform(title.begin(), title.end(), title.begin(),
                 [](unsigned char c) { return static_cast<char>(std::toupper(c)); });
  return fmt::format(".TH {} 1 \"\" \"mrr {}\" \"MRR\"\n.SH NAME\n{} \\- {}\n", plain(title), MRR_VERSION, plain(name),
                     plain(what));
}

std::string exit_statuses() {
  std::string text = ".SH EXIT STATUS\n";
  for (const ExitStatusText& one : kExitStatuses)
    text += fmt::format(".TP\n{}\n{}.\n", static_cast<int>(one.status), plain(one.meaning));
  return text;
}

std::string environment() {
  return ".SH ENVIRONMENT\n.TP\nMRR_RUNTIME_DIR\nThe runtime folder with sockets, pid files and logs. Without it: mrr "
         "in "
         "$XDG_RUNTIME_DIR, else /tmp/mrr\\-UID.\n";
}

/// A description without its full stop and with a small first letter, as NAME wants it.
std::string phrase(std::string text) {
  if (!text.empty() && text.back() == '.') text.pop_back();
  if (text.size() > 1 && std::islower(static_cast<unsigned char>(text[1])) != 0)
    text[0] = static_cast<char>(std::tolower(static_cast<unsigned char>(text[0])));
  return text;
}

std::string footer(const CLI::App& command) {
  std::string text = command.get_footer();
  return text.empty() ? std::string() : fmt::format(".SH NOTES\n.nf\n{}\n.fi\n", plain(text));
}

}  // namespace

std::string man_page(const CLI::App& app, const CLI::App* command) {
  std::string page = ".\\\" Made by mrr man from its commands and options; do not edit.\n";
  if (command == nullptr) {
    page += heading("mrr", phrase(app.get_description()));
    page += ".SH SYNOPSIS\n\\fBmrr\\fR \\fICOMMAND\\fR [\\fIOPTION\\fR...]\n";
    page +=
        ".SH DESCRIPTION\nCommands that talk to a robot need a running mrr_supervisor (scripts/robot starts a "
        "simulated robot); hammer without \\-\\-bus and the commands about mrr itself do not.\n.SH COMMANDS\n";
    for (const CLI::App* one : commands_of(app))
      page += fmt::format(".TP\n\\fB{}\\fR\n{}. See \\fBmrr\\-{}\\fR(1).\n", one->get_name(),
                          plain(one->get_description()), one->get_name());
    page += ".SH OPTIONS\n";
    for (const CLI::Option* option : options_of(app)) page += option_entry(*option);
    page += exit_statuses() + environment();
    page += ".SH SEE ALSO\n";
    std::string list;
    for (const CLI::App* one : commands_of(app))
      list += fmt::format("{}\\fBmrr\\-{}\\fR(1)", list.empty() ? "" : ",\n", one->get_name());
    return page + list + '\n';
  }
  const std::string name = command->get_name();
  page += heading("mrr-" + name, phrase(command->get_description()));
  page += fmt::format(".SH SYNOPSIS\n\\fBmrr {}\\fR [\\fIOPTION\\fR...]", name);
  for (const CLI::Option* option : options_of(*command)) {
    if (!option->get_positional()) continue;
    const std::string name_of_it =
        fmt::format("\\fI{}\\fR{}", plain(option->get_name(true)), option->get_items_expected_max() > 1 ? "..." : "");
    page += option->get_required() ? " " + name_of_it : fmt::format(" [{}]", name_of_it);
  }
  page += "\n.SH DESCRIPTION\n" + plain(command->get_description()) + ".\n.SH OPTIONS\n";
  for (const CLI::Option* option : options_of(*command)) page += option_entry(*option);
  return page + footer(*command) + exit_statuses() + environment() + ".SH SEE ALSO\n\\fBmrr\\fR(1)\n";
}

void add_man_command(CLI::App& app, int& status) {
  struct Arguments {
    std::string command;
    std::string folder;
  };
  auto arguments = std::make_shared<Arguments>();
  CLI::App* man = app.add_subcommand("man", "Print a manual page, or write them all");
  CLI::Option* name = man->add_option("COMMAND", arguments->command, "A command (default: the page of mrr itself)");
  man->add_option("--folder", arguments->folder, "Write all pages there instead")->type_name("DIR")->excludes(name);
  man->footer("Read it: mrr man hammer | man -l -");
  man->callback([&app, arguments, &status] {
    if (!arguments->folder.empty()) {
      std::error_code error;
      fs::create_directories(arguments->folder, error);
      const auto write = [&](const std::string& file, const CLI::App* command) {
        write_whole(fs::path(arguments->folder) / (file + ".1"),
                    [&](std::ostream& out) { out << man_page(app, command); });
      };
      write("mrr", nullptr);
      for (const CLI::App* one : commands_of(app)) write("mrr-" + one->get_name(), one);
    } else if (arguments->command.empty()) {
      fmt::print("{}", man_page(app, nullptr));
    } else {
      const std::vector<const CLI::App*> commands = commands_of(app);
      const auto found = std::find_if(commands.begin(), commands.end(),
                                      [&](const CLI::App* one) { return one->get_name() == arguments->command; });
      if (found == commands.end())
        throw DescriptionError(fmt::format("man {}: there is no such command; see mrr --help", arguments->command));
      fmt::print("{}", man_page(app, *found));
    }
    status = kExitDone;
  });
}

}  // namespace mrr::cli
