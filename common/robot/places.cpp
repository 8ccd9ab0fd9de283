#include "common/robot/places.h"

#include <fmt/format.h>

#include <string>

#include "common/robot/errors.h"

namespace mrr {

namespace fs = std::filesystem;

fs::path data_root() {
  std::error_code error;
  const fs::path program = fs::read_symlink("/proc/self/exe", error);
  for (fs::path folder = program.parent_path(); !folder.empty(); folder = folder.parent_path()) {
    for (const fs::path& root : {folder, folder / "share" / "mrr"}) {
      if (fs::is_directory(root / "robots" / "boards") && fs::is_regular_file(root / "tools" / "report.py"))
        return root;
    }
    if (folder == folder.root_path()) break;
  }
  throw DescriptionError(
      fmt::format("{}: no folder above it holds robots/ and tools/; run it from a checkout or an "
                  "installation",
                  program.string()));
}

fs::path find_robot(const fs::path& path) {
  if (path.empty()) throw DescriptionError("--robot is empty; give a folder that holds robot.urdf and robot.yaml");
  if (fs::is_directory(path)) return path;
  const fs::path root = data_root();
  for (const fs::path& shipped : {root / path, root / "robots" / path}) {
    if (path.is_relative() && fs::is_directory(shipped)) return shipped;
  }
  std::string names;
  for (const fs::directory_entry& entry : fs::directory_iterator(root / "robots")) {
    if (fs::is_regular_file(entry.path() / "robot.urdf")) {
      names += (names.empty() ? "" : ", ") + entry.path().filename().string();
    }
  }
  throw DescriptionError(fmt::format(
      "{}: no such robot; give a folder that holds robot.urdf and robot.yaml, or one of: {}", path.string(), names));
}

fs::path find_board(const std::string& name_or_path) {
  if (name_or_path.empty()) throw DescriptionError("--board is empty; give a board's name or its YAML file");
  if (fs::is_regular_file(name_or_path)) return name_or_path;
  const fs::path boards = data_root() / "robots" / "boards";
  fs::path shipped = boards / (name_or_path + ".yaml");
  if (fs::is_regular_file(shipped)) return shipped;
  std::string names;
  for (const fs::directory_entry& entry : fs::directory_iterator(boards)) {
    if (entry.path().extension() == ".yaml") names += (names.empty() ? "" : ", ") + entry.path().stem().string();
  }
  throw DescriptionError(
      fmt::format("{}: no such board; give the path of a board's YAML file or one of: {}", name_or_path, names));
}

}  // namespace mrr
