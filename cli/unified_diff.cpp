#include "cli/unified_diff.h"

#include <fmt/format.h>

#include <algorithm>
#include <string_view>
#include <vector>

namespace mrr::cli {

namespace {

constexpr std::size_t kContext = 3;

std::vector<std::string_view> lines_of(const std::string& text) {
  std::vector<std::string_view> lines;
  for (std::size_t at = 0; at < text.size();) {
    const std::size_t end = std::min(text.find('\n', at), text.size());
    lines.push_back(std::string_view(text).substr(at, end - at));
    at = end + 1;
  }
  return lines;
}

struct Line {
  char mark;  // ' ', '-', '+'
  std::string_view text;
};

/// By the longest common subsequence; descriptions have some hundred lines.
std::vector<Line> compared(const std::vector<std::string_view>& a, const std::vector<std::string_view>& b) {
  std::vector<std::vector<std::size_t>> common(a.size() + 1, std::vector<std::size_t>(b.size() + 1, 0));
  for (std::size_t i = a.size(); i-- > 0;) {
    for (std::size_t k = b.size(); k-- > 0;) {
      common[i][k] = a[i] == b[k] ? common[i + 1][k + 1] + 1 : std::max(common[i + 1][k], common[i][k + 1]);
    }
  }
  std::vector<Line> lines;
  std::size_t i = 0;
  std::size_t k = 0;
  while (i < a.size() || k < b.size()) {
    if (i < a.size() && k < b.size() && a[i] == b[k]) {
      lines.push_back({' ', a[i++]});
      ++k;
    } else if (i < a.size() && (k == b.size() || common[i + 1][k] >= common[i][k + 1])) {
      lines.push_back({'-', a[i++]});
    } else {
      lines.push_back({'+', b[k++]});
    }
  }
  return lines;
}

}  // namespace

std::string unified_diff(const std::string& before, const std::string& after, const std::string& name, bool colour) {
  if (before == after) return {};
  const std::vector<Line> lines = compared(lines_of(before), lines_of(after));
  const auto changed = [&](std::size_t i) { return lines[i].mark != ' '; };
  std::string out = fmt::format("--- {}\n+++ {}\n", name, name);
  std::size_t old_line = 1;
  std::size_t new_line = 1;
  for (std::size_t at = 0; at < lines.size();) {
    // A hunk: from a little before a change until nothing changes for twice as much.
    std::size_t first = at;
    while (first < lines.size() && !changed(first)) ++first;
    if (first == lines.size()) break;
    const std::size_t begin = first - std::min(first - at, kContext);
    old_line += begin - at;
    new_line += begin - at;
    std::size_t end = first;
    for (std::size_t i = first; i < lines.size() && i <= end + 2 * kContext; ++i) {
      if (changed(i)) end = i;
    }
    end = std::min(end + 1 + kContext, lines.size());
    std::size_t removed = 0;
    std::size_t added = 0;
    std::string hunk;
    for (std::size_t i = begin; i < end; ++i) {
      const Line& line = lines[i];
      removed += line.mark != '+' ? 1 : 0;
      added += line.mark != '-' ? 1 : 0;
      const char* paint = !colour || line.mark == ' ' ? "" : line.mark == '-' ? "\x1b[31m" : "\x1b[32m";
      hunk += fmt::format("{}{}{}{}\n", paint, line.mark, line.text, *paint == '\0' ? "" : "\x1b[0m");
    }
    out += fmt::format("@@ -{},{} +{},{} @@\n{}", old_line, removed, new_line, added, hunk);
    old_line += removed;
    new_line += added;
    at = end;
  }
  return out;
}

}  // namespace mrr::cli
