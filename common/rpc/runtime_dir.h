// Room: common/rpc. Where the programs of one user find each other's sockets, pid files and logs.
// Host only; may touch the file system.
#pragma once

#include <filesystem>
#include <string>

namespace mrr::rpc {

/// $MRR_RUNTIME_DIR, else $XDG_RUNTIME_DIR/mrr if that folder is there, else /tmp/mrr-UID. Only the name: makes
/// nothing.
[[nodiscard]] std::filesystem::path runtime_dir_name();

/// The same, made with mode 0700 if it is not there. Throws ConnectionError if it cannot be made, belongs to another
/// user, is a link, or is open to others.
std::filesystem::path runtime_dir();

/// `given` if not empty, else `name` (such as "supervisor.sock") in runtime_dir_name(). Makes nothing.
[[nodiscard]] std::filesystem::path socket_path(const std::string& given, const std::string& name);

}  // namespace mrr::rpc
