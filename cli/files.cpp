#include "cli/files.h"

#include <fmt/format.h>

#include <fstream>
#include <string>

#include "common/robot/errors.h"

namespace mrr::cli {

namespace fs = std::filesystem;

void write_whole(const fs::path& file, const std::function<void(std::ostream&)>& write) {
  const fs::path partial = file.string() + ".partial";
  {
    std::ofstream out(partial, std::ios::binary | std::ios::trunc);
    if (!out)
      throw DescriptionError(fmt::format("{}: cannot be written; check the folder and its permissions", file.string()));
    write(out);
    out.flush();
    if (!out) {
      std::error_code ignored;
      fs::remove(partial, ignored);
      throw DescriptionError(fmt::format("{}: writing failed; is the disk full?", file.string()));
    }
  }
  std::error_code error;
  fs::rename(partial, file, error);
  if (error) {
    std::error_code ignored;
    fs::remove(partial, ignored);
    throw DescriptionError(fmt::format("{}: cannot be put in place: {}", file.string(), error.message()));
  }
}

}  // namespace mrr::cli
