// Room: cli. Files that appear whole or not at all.
#pragma once

#include <filesystem>
#include <functional>
#include <iosfwd>

#include "common/robot/places.h"

namespace mrr::cli {

using mrr::data_root;
using mrr::find_board;
using mrr::find_robot;

/// Writes through a temporary file in the same folder, renamed into place when `write` has succeeded.
void write_whole(const std::filesystem::path& file, const std::function<void(std::ostream&)>& write);

}  // namespace mrr::cli
