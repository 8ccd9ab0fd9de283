// Room: common/robot. Values of a robot.yaml changed in place: comments, order and layout stay. Host only.
// Touches the file only in replace_robot_yaml(), and then whole or not at all.
#pragma once

#include <filesystem>
#include <span>
#include <string>

namespace mrr {

/// One value of a joint: `joints.JOINT.SECTION.KEY` becomes `value`, text with its unit.
struct JointEdit {
  std::string joint;
  std::string section;
  std::string key;
  std::string value;
};

/// `text` of `file` with these values. A section that is not there is added below the joint's node_id.
/// Throws DescriptionError: the text is no robot.yaml, or a value cannot be changed in place (it is shared with another
/// joint by an alias, or its section is there without it); the sentence says what to do.
[[nodiscard]] std::string with_values(const std::string& text, const std::filesystem::path& file,
                                      std::span<const JointEdit> edits);

/// Replaces robot.yaml of this directory by `text` if the robot is usable with it; else throws DescriptionError and
/// leaves the file. `before`: what the file must still say, lest somebody else's change is lost.
void replace_robot_yaml(const std::filesystem::path& directory, const std::string& before, const std::string& text);

}  // namespace mrr
