#include "common/robot/edit_robot.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <vector>

#include "common/robot/robot.h"
#include "tests/unit/robot/sentence.h"

namespace mrr {
namespace {

using test::complaint;
using test::expect_one_sentence;
using test::SpoiledRobot;
using testing::HasSubstr;

std::string edited(const SpoiledRobot& robot, const std::vector<JointEdit>& edits) {
  return with_values(robot.text("robot.yaml"), robot.directory() / "robot.yaml", edits);
}

/// Lines of `b` that differ from those of `a`; both have as many.
std::vector<std::string> changed_lines(const std::string& a, const std::string& b) {
  std::istringstream as(a);
  std::istringstream bs(b);
  std::vector<std::string> lines;
  for (std::string x, y; std::getline(as, x) && std::getline(bs, y);) {
    if (x != y) lines.push_back(y);
  }
  return lines;
}

TEST(EditRobot, ChangesTheValueAndNothingElse) {
  const SpoiledRobot robot;
  const std::string before = robot.text("robot.yaml");
  const std::string after = edited(robot, {{"joint_1", "friction", "coulomb", "27.25 Nm"},
                                           {"joint_3", "motor", "torque_constant_negative", "0.26 Nm/A"}});
  EXPECT_THAT(changed_lines(before, after), testing::ElementsAre("      coulomb: 27.25 Nm                # [I]",
                                                                 "      torque_constant_negative: 0.26 Nm/A"));
  replace_robot_yaml(robot.directory(), before, after);
  const RobotDescription changed = load_robot(robot.directory());
  EXPECT_EQ(changed.joints[0].friction.coulomb_nm, 27.25);
  EXPECT_EQ(changed.joints[1].friction.coulomb_nm, 3.9);
  EXPECT_EQ(changed.joints[2].motor.torque_constant_negative_nm_a, 0.26);
}

TEST(EditRobot, AddsASectionThatIsNotThereBelowTheNodeId) {
  const SpoiledRobot robot;
  std::string text = edited(robot, {{"joint_2", "calibration", "torque_offset", "0.310 Nm"}});
  EXPECT_THAT(text, HasSubstr("    node_id: 3\n    calibration: {torque_offset: 0.310 Nm}\n    selection_bit: 1\n"));
  robot.set_text("robot.yaml", text);
  EXPECT_EQ(load_robot(robot.directory()).joints[1].torque_offset_nm, 0.31);
  // A second time it is there, and in flow style.
  text = edited(robot, {{"joint_2", "calibration", "torque_offset", "-0.5 Nm"}});
  EXPECT_THAT(text, HasSubstr("    calibration: {torque_offset: -0.5 Nm}\n"));
}

TEST(EditRobot, RefusesWhatItCannotChangeForOneJointAlone) {
  const SpoiledRobot robot;
  const auto refusal = [&](const JointEdit& edit) {
    const std::string text = complaint([&] { return edited(robot, {edit}); });
    expect_one_sentence(text);
    return text;
  };
  EXPECT_THAT(refusal({"joint_2", "sensors", "current_full_scale", "5 A"}),
              HasSubstr("shared with 'joint_3' by an alias; write the section out"));
  EXPECT_THAT(refusal({"joint_3", "sensors", "current_full_scale", "5 A"}), HasSubstr("shared with 'joint_2'"));
  EXPECT_THAT(refusal({"joint_9", "friction", "coulomb", "5 Nm"}), HasSubstr("there is no joints.joint_9"));
  EXPECT_THAT(refusal({"joint_1", "friction", "colour", "5 Nm"}), HasSubstr("has no 'colour'"));
  robot.replace("robot.yaml", "coulomb: 30.5 Nm", "coulomb: '30.5 Nm'");
  EXPECT_NE(complaint([&] { return edited(robot, {{"joint_1", "friction", "coulomb", "5 Nm"}}); }), "");
  robot.set_text("robot.yaml", "joints: [");
  EXPECT_THAT(complaint([&] {
                return edited(robot, {{"joint_1", "friction", "coulomb", "5 Nm"}});
              }),
              HasSubstr("it is no YAML"));
}

TEST(EditRobot, WritesNothingThatIsNotARobotNorOverSomebodyElsesChange) {
  const SpoiledRobot robot;
  const std::string before = robot.text("robot.yaml");
  // Less than passive_compensation compensates.
  const std::string weak = edited(robot, {{"joint_1", "friction", "coulomb", "20 Nm"}});
  const std::string text = complaint([&] {
    replace_robot_yaml(robot.directory(), before, weak);
    return 0;
  });
  expect_one_sentence(text);
  EXPECT_THAT(text, HasSubstr("passive_compensation"));
  EXPECT_EQ(robot.text("robot.yaml"), before);
  const std::string good = edited(robot, {{"joint_1", "friction", "coulomb", "30 Nm"}});
  robot.replace("robot.yaml", "coulomb: 3.9 Nm", "coulomb: 3.8 Nm");
  const std::string theirs = robot.text("robot.yaml");
  EXPECT_THAT(complaint([&] {
                replace_robot_yaml(robot.directory(), before, good);
                return 0;
              }),
              HasSubstr("changed meanwhile"));
  EXPECT_EQ(robot.text("robot.yaml"), theirs);
}

TEST(EditRobot, KeepsModeAndLinkAndLeavesNoOtherFile) {
  const SpoiledRobot robot;
  const std::string before = robot.text("robot.yaml");
  const std::filesystem::path real = robot.directory() / "real.yaml";
  std::filesystem::rename(robot.directory() / "robot.yaml", real);
  std::filesystem::create_symlink("real.yaml", robot.directory() / "robot.yaml");
  ASSERT_EQ(::chmod(real.c_str(), 0640), 0);
  replace_robot_yaml(robot.directory(), before, edited(robot, {{"joint_1", "friction", "coulomb", "30 Nm"}}));
  EXPECT_TRUE(std::filesystem::is_symlink(robot.directory() / "robot.yaml"));
  EXPECT_THAT(test::read_text(real), HasSubstr("coulomb: 30 Nm"));
  struct stat status {};
  ASSERT_EQ(::stat(real.c_str(), &status), 0);
  EXPECT_EQ(status.st_mode & 0777U, 0640U);
  int files = 0;
  for (const auto& entry : std::filesystem::directory_iterator(robot.directory()))
    files += entry.is_regular_file() ? 1 : 0;
  EXPECT_EQ(files, 3) << "robot.urdf, real.yaml and the link to it";
}

}  // namespace
}  // namespace mrr
