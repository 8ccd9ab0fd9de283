#include "common/rpc/runtime_dir.h"

#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <cstring>

#include "common/rpc/message.h"

namespace mrr::rpc {

namespace fs = std::filesystem;

fs::path runtime_dir_name() {
  if (const char* ours = std::getenv("MRR_RUNTIME_DIR"); ours != nullptr && *ours != '\0') return ours;
  if (const char* users = std::getenv("XDG_RUNTIME_DIR"); users != nullptr && *users != '\0') {
    std::error_code ignored;
    if (fs::is_directory(users, ignored)) return fs::path(users) / "mrr";
  }
  return fmt::format("/tmp/mrr-{}", geteuid());
}

fs::path runtime_dir() {
  const fs::path folder = runtime_dir_name();
  if (mkdir(folder.c_str(), 0700) != 0 && errno != EEXIST) {
    throw ConnectionError(fmt::format("{}: the runtime folder cannot be made: {}; set MRR_RUNTIME_DIR to another one",
                                      folder.string(), std::strerror(errno)));
  }
  struct stat status {};
  if (lstat(folder.c_str(), &status) != 0) {
    throw ConnectionError(
        fmt::format("{}: {}; set MRR_RUNTIME_DIR to another folder", folder.string(), std::strerror(errno)));
  }
  if (!S_ISDIR(status.st_mode)) {
    throw ConnectionError(
        fmt::format("{}: is not a folder; remove it, or set MRR_RUNTIME_DIR to another one", folder.string()));
  }
  if (status.st_uid != geteuid()) {
    throw ConnectionError(fmt::format("{}: belongs to user {}, not to user {}; set MRR_RUNTIME_DIR to another folder",
                                      folder.string(), status.st_uid, geteuid()));
  }
  if ((status.st_mode & 077) != 0) {
    throw ConnectionError(fmt::format("{}: has mode {:04o}, open to other users; run chmod 0700 on it", folder.string(),
                                      status.st_mode & 07777));
  }
  return folder;
}

fs::path socket_path(const std::string& given, const std::string& name) {
  return given.empty() ? runtime_dir_name() / name : fs::path(given);
}

}  // namespace mrr::rpc
