// Room: cli. What differs between two texts, as `diff -u` shows it. Touches nothing.
#pragma once

#include <string>

namespace mrr::cli {

/// Empty if they are the same. `colour`: removed lines red, added ones green, as terminals understand it.
[[nodiscard]] std::string unified_diff(const std::string& before, const std::string& after, const std::string& name,
                                       bool colour);

}  // namespace mrr::cli
