// Room: cli. Text for terminals: wrapping that keeps a number and its unit together, help in 80 columns, live blocks.
// May touch the terminal, and CLI11 for its help.
#pragma once

#include <CLI/CLI.hpp>
#include <cstddef>
#include <string>

namespace mrr::cli {

/// Widest line written for people.
inline constexpr std::size_t kWidth = 79;

/// Breaks `text` at blanks so that no line is wider than `width`; continued lines are indented. A number stays with its
/// unit ("2.94 N s"). Ends with a newline.
[[nodiscard]] std::string wrapped(const std::string& text, std::size_t indent, std::size_t width = kWidth);

/// Columns that a terminal shows for UTF-8 text without wide characters.
[[nodiscard]] std::size_t shown_width(const std::string& text);

/// Help of every command, in kWidth columns.
class HelpFormatter : public CLI::Formatter {
 public:
  std::string make_option(const CLI::Option* option, bool positional) const override;
  std::string make_description(const CLI::App* app) const override;
  std::string make_usage(const CLI::App* app, std::string name) const override;
  std::string make_footer(const CLI::App* app) const override;
  std::string make_subcommand(const CLI::App* command) const override;
};

/// Text that replaces itself on a terminal. In a pipe it is written once each time, one after the other.
class LiveBlock {
 public:
  LiveBlock();
  ~LiveBlock();  ///< leaves the last text, and the cursor below it
  LiveBlock(const LiveBlock&) = delete;
  LiveBlock& operator=(const LiveBlock&) = delete;
  void show(const std::string& text);
  [[nodiscard]] bool terminal() const noexcept { return terminal_; }
  /// Columns of the terminal; kWidth + 1 in a pipe.
  [[nodiscard]] static std::size_t columns();
  /// The locale writes UTF-8.
  [[nodiscard]] static bool utf8();

 private:
  bool terminal_;
  std::size_t lines_ = 0;
};

/// Ctrl-C becomes a question instead of the end of the program, from the first call on.
void catch_interrupts();
[[nodiscard]] bool interrupted() noexcept;

}  // namespace mrr::cli
