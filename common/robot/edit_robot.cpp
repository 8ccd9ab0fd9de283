#include "common/robot/edit_robot.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>
#include <yaml-cpp/yaml.h>

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <sstream>

#include "common/robot/errors.h"
#include "common/robot/robot.h"

namespace mrr {

namespace {

std::string path_of(const JointEdit& edit) {
  return fmt::format("joints.{}.{}.{}", edit.joint, edit.section, edit.key);
}

bool same_place(const YAML::Node& a, const YAML::Node& b) { return a.Mark().pos == b.Mark().pos; }

/// The value's text is that of the file, at this place: plain, on one line, and of nobody else.
std::string replaced(const std::string& text, const std::string& file, const YAML::Node& joints,
                     const JointEdit& edit) {
  const auto refuse = [&](const std::string& why) { return description_error(file, path_of(edit) + " " + why); };
  const YAML::Node value = joints[edit.joint][edit.section][edit.key];
  for (const auto& other : joints) {
    if (other.first.Scalar() == edit.joint || !other.second.IsMap()) continue;
    const YAML::Node section = other.second[edit.section];
    if (section && section.IsMap() && section[edit.key] && same_place(section[edit.key], value)) {
      throw refuse(fmt::format("is shared with '{}' by an alias; write the section out for each of the two first",
                               other.first.Scalar()));
    }
  }
  const std::string was = value.IsScalar() ? value.Scalar() : "";
  const auto at = static_cast<std::size_t>(value.Mark().pos);
  if (was.empty() || text.compare(at, was.size(), was) != 0) {
    throw refuse(fmt::format("is not written as plain text on one line; set it to {} by hand", edit.value));
  }
  std::string tail = text.substr(at + was.size());
  // A comment behind it stays in its column where it can.
  const std::size_t blanks = std::min(tail.find_first_not_of(' '), tail.size());
  if (blanks > 0 && blanks < tail.size() && tail[blanks] == '#') {
    const std::size_t column = was.size() + blanks;
    const std::size_t gap = column > edit.value.size() ? column - edit.value.size() : 1;
    tail = std::string(gap, ' ') + tail.substr(blanks);
  }
  return text.substr(0, at) + edit.value + tail;
}

/// A new section, on a line of its own below the joint's node_id.
std::string inserted(const std::string& text, const std::string& file, const YAML::Node& joint, const JointEdit& edit) {
  const YAML::Node id = joint["node_id"];
  const auto at = id ? static_cast<std::size_t>(id.Mark().pos) : 0;
  const std::size_t begin = text.rfind('\n', at) + 1;
  const std::size_t end = std::min(text.find('\n', at), text.size());
  const std::size_t indent = text.find_first_not_of(' ', begin) - begin;
  if (!id || text.compare(begin + indent, 8, "node_id:") != 0) {
    throw description_error(file,
                            fmt::format("joints.{} has no line 'node_id: ...' to add 'calibration' below; add {} = "
                                        "{} by hand",
                                        edit.joint, path_of(edit), edit.value));
  }
  const std::string line =
      fmt::format("\n{}{}: {{{}: {}}}", std::string(indent, ' '), edit.section, edit.key, edit.value);
  return text.substr(0, end) + line + text.substr(end);
}

std::string whole(const std::filesystem::path& file) {
  std::ifstream in(file, std::ios::binary);
  std::ostringstream text;
  text << in.rdbuf();
  if (!in) throw description_error(file.string(), fmt::format("it cannot be read ({})", std::strerror(errno)));
  return text.str();
}

}  // namespace

std::string with_values(const std::string& text, const std::filesystem::path& file, std::span<const JointEdit> edits) {
  const std::string name = file.string();
  std::string result = text;
  for (const JointEdit& edit : edits) {
    try {
      const YAML::Node joints = YAML::Load(result)["joints"];
      if (!joints || !joints.IsMap() || !joints[edit.joint] || !joints[edit.joint].IsMap()) {
        throw description_error(
            name, fmt::format("there is no joints.{}; give the file the robot was read from", edit.joint));
      }
      const YAML::Node section = joints[edit.joint][edit.section];
      if (!section) {
        result = inserted(result, name, joints[edit.joint], edit);
      } else if (section.IsMap() && section[edit.key]) {
        result = replaced(result, name, joints, edit);
      } else {
        throw description_error(name, fmt::format("joints.{}.{} has no '{}'; add '{}: {}' by hand", edit.joint,
                                                  edit.section, edit.key, edit.key, edit.value));
      }
    } catch (const YAML::Exception& error) {
      throw description_error(name, fmt::format("it is no YAML: {}", error.what()));
    }
  }
  return result;
}

void replace_robot_yaml(const std::filesystem::path& directory, const std::string& before, const std::string& text) {
  // What a link points at is replaced, not the link.
  const std::filesystem::path file = std::filesystem::weakly_canonical(directory / "robot.yaml");
  if (whole(file) != before) {
    throw description_error(file.string(), "it was changed meanwhile; nothing was written, run the command again");
  }
  (void)load_robot(directory, text);
  const auto failed = [&](const char* what) {
    return description_error(file.string(),
                             fmt::format("it cannot be {} ({}); nothing was changed", what, std::strerror(errno)));
  };
  std::string temporary = (file.parent_path() / ".robot.yaml.XXXXXX").string();
  const int fd = ::mkstemp(temporary.data());
  if (fd < 0) throw failed("written");
  struct stat status {};
  bool good = ::stat(file.c_str(), &status) == 0 && ::fchmod(fd, status.st_mode & 07777U) == 0;
  for (std::size_t at = 0; good && at < text.size();) {
    const ssize_t n = ::write(fd, text.data() + at, text.size() - at);
    good = n > 0;
    if (good) at += static_cast<std::size_t>(n);
  }
  good = good && ::fsync(fd) == 0;
  good = ::close(fd) == 0 && good;
  if (good && ::rename(temporary.c_str(), file.c_str()) == 0) return;
  const DescriptionError error = failed("replaced");
  ::unlink(temporary.c_str());
  throw error;
}

}  // namespace mrr
