// Room: common/robot. Where robots, boards and tools are found. Host only; looks at the file system.
#pragma once

#include <filesystem>
#include <string>

namespace mrr {

/// The folder that holds robots/ and tools/: beside the program's sources, or share/mrr of an installation.
/// Throws DescriptionError if there is none.
std::filesystem::path data_root();

/// `path` as given if it exists, else below data_root(). Throws DescriptionError naming both places tried.
std::filesystem::path find_robot(const std::filesystem::path& path);

/// A name such as "styrofoam" (robots/boards/NAME.yaml below data_root()), or the path of a YAML file.
std::filesystem::path find_board(const std::string& name_or_path);

}  // namespace mrr
