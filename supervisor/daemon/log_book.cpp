#include "supervisor/daemon/log_book.h"

#include <fmt/format.h>
#include <spdlog/sinks/stdout_sinks.h>

#include <cstdlib>

namespace mrr::sup {

namespace {

/// Priorities of sd-daemon(3).
int priority(spdlog::level::level_enum level) noexcept {
  if (level >= spdlog::level::critical) return 2;
  if (level == spdlog::level::err) return 3;
  if (level == spdlog::level::warn) return 4;
  if (level == spdlog::level::info) return 6;
  return 7;
}

}  // namespace

const char* level_name(spdlog::level::level_enum level) noexcept {
  if (level >= spdlog::level::err) return "error";
  if (level == spdlog::level::warn) return "warning";
  if (level == spdlog::level::info) return "info";
  return "debug";
}

LogBook::LogBook(spdlog::level::level_enum level)
    : logger_(std::make_shared<spdlog::logger>("mrr_supervisor", std::make_shared<spdlog::sinks::stderr_sink_mt>())),
      journal_(std::getenv("JOURNAL_STREAM") != nullptr) {
  logger_->set_level(level);
  logger_->set_pattern(journal_ ? "%v" : "%Y-%m-%d %H:%M:%S.%e mrr_supervisor %l: %v");
  logger_->flush_on(spdlog::level::debug);
}

void LogBook::say(spdlog::level::level_enum level, const std::string& text) {
  logger_->log(level, "{}", journal_ ? fmt::format("<{}>{}", priority(level), text) : text);
  lines_.push_back({time_s_, level, text});
  if (lines_.size() > kLines) lines_.pop_front();
}

}  // namespace mrr::sup
