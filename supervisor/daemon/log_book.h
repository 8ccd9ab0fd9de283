// Room: supervisor/daemon. What the daemon says: to the terminal or the journal, and the last lines of it to clients.
// Host only; never from the real-time thread.
#pragma once

#include <spdlog/spdlog.h>

#include <deque>
#include <memory>
#include <string>

namespace mrr::sup {

struct LogLine {
  double time_s = 0.0;  ///< the supervisor's clock
  spdlog::level::level_enum level{};
  std::string text;
};

class LogBook {
 public:
  static constexpr std::size_t kLines = 1000;

  /// To stderr. Under systemd (JOURNAL_STREAM is set) lines carry a priority such as <6> and no time: the journal has
  /// its own.
  explicit LogBook(spdlog::level::level_enum level);

  /// Of the lines to come.
  void set_time(double time_s) noexcept { time_s_ = time_s; }
  void say(spdlog::level::level_enum level, const std::string& text);
  void info(const std::string& text) { say(spdlog::level::info, text); }
  void warn(const std::string& text) { say(spdlog::level::warn, text); }
  void error(const std::string& text) { say(spdlog::level::err, text); }
  [[nodiscard]] const std::deque<LogLine>& lines() const noexcept { return lines_; }

 private:
  std::shared_ptr<spdlog::logger> logger_;
  bool journal_;
  double time_s_ = 0.0;
  std::deque<LogLine> lines_;
};

/// "debug", "info", "warning", "error".
[[nodiscard]] const char* level_name(spdlog::level::level_enum level) noexcept;

}  // namespace mrr::sup
