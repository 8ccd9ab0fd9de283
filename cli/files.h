// Room: cli. Where robots, boards and tools are found, and files that appear whole or not at all.
#pragma once

#include <filesystem>
#include <functional>
#include <iosfwd>

namespace mrr::cli {

/// The folder that holds robots/ and tools/: beside the program's sources, or share/mrr of an installation.
/// Throws DescriptionError if there is none.
std::filesystem::path data_root();

/// `path` as given if it exists, else below data_root(). Throws DescriptionError naming both places tried.
std::filesystem::path find_robot(const std::filesystem::path& path);

/// A name such as "styrofoam" (robots/boards/NAME.yaml below data_root()), or the path of a YAML file.
std::filesystem::path find_board(const std::string& name_or_path);

/// Writes through a temporary file in the same folder, renamed into place when `write` has succeeded.
void write_whole(const std::filesystem::path& file, const std::function<void(std::ostream&)>& write);

}  // namespace mrr::cli
