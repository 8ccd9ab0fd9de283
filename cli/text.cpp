#include "cli/text.h"

#include <fmt/format.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <string_view>
#include <vector>

#include "cli/app.h"

namespace mrr::cli {

namespace {

bool is_unit(std::string_view word) {
  while (!word.empty() && std::string_view(".,;:)").find(word.back()) != std::string_view::npos) word.remove_suffix(1);
  constexpr std::array<std::string_view, 26> kUnits{
      "N", "s", "m",  "mm",  "kg", "Nm",    "rad",  "rad/s", "m/s",   "ms", "us",    "%", "deg",
      "A", "V", "Hz", "kHz", "C",  "deg/s", "kN/m", "ppm",   "bit/s", "kg", "times", "x", "degC"};
  return std::find(kUnits.begin(), kUnits.end(), word) != kUnits.end();
}

bool is_number(std::string_view word) {
  while (!word.empty() && std::string_view("([").find(word.front()) != std::string_view::npos) word.remove_prefix(1);
  return !word.empty() && std::string_view("0123456789]").find(word.back()) != std::string_view::npos;
}

/// Words, with a number and what it counts as one.
std::vector<std::string> words_of(const std::string& text) {
  std::vector<std::string> words;
  bool open = false;  // the last word may take a unit
  for (std::size_t at = text.find_first_not_of(' '); at < text.size(); at = text.find_first_not_of(' ', at)) {
    const std::size_t end = std::min(text.find(' ', at), text.size());
    const std::string word = text.substr(at, end - at);
    // Runs of blanks are layout: kept with the word before.
    const std::size_t blanks = std::min(text.find_first_not_of(' ', end), text.size()) - end;
    if (open && is_unit(word)) {
      words.back() += " " + word;
    } else {
      words.push_back(word);
      open = is_number(word);
    }
    open = open && std::string_view(".,;:)").find(word.back()) == std::string_view::npos;
    if (blanks > 1) words.back().append(blanks - 1, ' ');
    at = end;
  }
  return words;
}

std::atomic<bool> interrupt_seen = false;

std::size_t rows_of(const std::string& text) {
  return static_cast<std::size_t>(std::count(text.begin(), text.end(), '\n'));
}

}  // namespace

std::string wrapped(const std::string& text, std::size_t indent, std::size_t width) {
  const std::size_t margin = std::min(text.find_first_not_of(' '), text.size());
  std::string out = text.substr(0, margin);
  std::size_t column = margin;
  bool fresh = true;
  for (const std::string& word : words_of(text)) {
    const std::size_t length = shown_width(word);
    if (!fresh && column + 1 + length > width) {
      while (!out.empty() && out.back() == ' ') out.pop_back();
      out += '\n';
      out.append(indent, ' ');
      column = indent;
    } else if (!fresh) {
      out += ' ';
      ++column;
    }
    out += word;
    column += length;
    fresh = false;
  }
  return out + '\n';
}

std::size_t shown_width(const std::string& text) {
  return static_cast<std::size_t>(
      std::count_if(text.begin(), text.end(), [](char c) { return (static_cast<unsigned char>(c) & 0xC0U) != 0x80U; }));
}

std::string HelpFormatter::make_option(const CLI::Option* option, bool) const {
  constexpr std::size_t kColumn = 26;
  const OptionWords words = words_of(*option);
  std::string text = "  " + words.names + (words.value.empty() ? "" : " " + words.value);
  const std::string description = wrapped(std::string(kColumn, ' ') + words.description, kColumn);
  if (text.size() + 2 > kColumn) return text + '\n' + description;
  text.resize(kColumn, ' ');
  return text + description.substr(kColumn);
}

std::string HelpFormatter::make_description(const CLI::App* app) const {
  const std::string description = app->get_description();
  return description.empty() ? std::string() : wrapped(description, 0);
}

std::string HelpFormatter::make_usage(const CLI::App* app, std::string name) const {
  // The formatter of the library puts a blank line before and after, and knows the words.
  std::string usage = CLI::Formatter::make_usage(app, std::move(name));
  const std::size_t first = usage.find_first_not_of('\n');
  const std::size_t last = usage.find_last_not_of('\n');
  if (first == std::string::npos) return usage;
  return '\n' + wrapped(usage.substr(first, last - first + 1), 7);
}

std::string HelpFormatter::make_footer(const CLI::App* app) const {
  std::string footer = app->get_footer();
  if (app->get_parent() != nullptr)
    footer += (footer.empty() ? "" : "\n") +
              std::string("Exit status: 0 done, 1 not done, 2 unusable input, 3 defect; see mrr --help.");
  std::string text = "\n";
  for (std::size_t at = 0; at < footer.size();) {
    const std::size_t end = std::min(footer.find('\n', at), footer.size());
    const std::string line = footer.substr(at, end - at);
    const std::size_t margin = std::min(line.find_first_not_of(' '), line.size());
    text += line.empty() ? "\n" : wrapped(line, margin == 0 ? 0 : margin + 4);
    at = end + 1;
  }
  return text;
}

std::string HelpFormatter::make_subcommand(const CLI::App* command) const {
  constexpr std::size_t kColumn = 14;
  std::string text = "  " + command->get_name();
  text.resize(std::max(kColumn, text.size() + 1), ' ');
  return text + wrapped(std::string(text.size(), ' ') + command->get_description(), kColumn).substr(text.size());
}

LiveBlock::LiveBlock() : terminal_(isatty(STDOUT_FILENO) == 1) {
  if (terminal_) fmt::print("\x1b[?25l");
}

LiveBlock::~LiveBlock() {
  if (!terminal_) return;
  fmt::print("\x1b[?25h");
  std::fflush(stdout);
}

void LiveBlock::show(const std::string& text) {
  if (!terminal_) {
    fmt::print("{}", text);
    std::fflush(stdout);
    return;
  }
  std::string out;
  if (lines_ > 0) out = fmt::format("\x1b[{}A", lines_);
  for (std::size_t at = 0; at < text.size();) {
    const std::size_t end = std::min(text.find('\n', at), text.size());
    out += text.substr(at, end - at);
    out += "\x1b[K\n";
    at = end + 1;
  }
  out += "\x1b[J";  // what the text before had below
  lines_ = rows_of(text);
  fmt::print("{}", out);
  std::fflush(stdout);
}

std::size_t LiveBlock::columns() {
  winsize size{};
  if (ioctl(STDOUT_FILENO, TIOCGWINSZ, &size) == 0 && size.ws_col > 0) return size.ws_col;
  return kWidth + 1;
}

bool LiveBlock::utf8() {
  for (const char* name : {"LC_ALL", "LC_CTYPE", "LANG"}) {
    const char* value = std::getenv(name);
    if (value == nullptr || *value == '\0') continue;
    const std::string_view locale = value;
    return locale.find("UTF-8") != std::string_view::npos || locale.find("utf8") != std::string_view::npos;
  }
  return false;
}

void catch_interrupts() {
  struct sigaction action {};
  action.sa_handler = [](int) { interrupt_seen = true; };
  sigaction(SIGINT, &action, nullptr);
  sigaction(SIGTERM, &action, nullptr);
}

bool interrupted() noexcept { return interrupt_seen; }

}  // namespace mrr::cli
