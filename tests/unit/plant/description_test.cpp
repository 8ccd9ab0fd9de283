// plant.yaml and the boards: what is read, what is kept from the robot, what is refused.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>

#include "common/robot/errors.h"
#include "sim_vcan/plant/plant.h"
#include "tests/unit/plant/reference_arm.h"

namespace mrr::sim::test {
namespace {

const std::filesystem::path kRobots = std::filesystem::path(MRR_SOURCE_DIR) / "robots";

TEST(PlantDescriptionFiles, TheReferenceArmsArePresentAndComplete) {
  const RobotDescription robot = load_robot(kRobots / "mrr3");
  const PlantDescription plant = load_plant(robot, kRobots / "boards" / "styrofoam.yaml");
  ASSERT_EQ(plant.joints.size(), 3U);
  EXPECT_EQ(plant.joints[0].friction.static_nm, (std::array{36.3, 36.2}));
  EXPECT_EQ(plant.joints[0].friction.coulomb_nm, (std::array{30.5, 30.5}));  // as robot.yaml has it
  EXPECT_EQ(plant.joints[1].spring.stiffness_nm_rad, robot.joints[1].transmission.stiffness_nm_rad);
  EXPECT_EQ(plant.joints[1].spring.damping_nm_s_rad, 12.0);
  EXPECT_EQ(plant.joints[2].drive.torque_constant_nm_a, (std::array{0.19, 0.25}));
  EXPECT_EQ(plant.board.name, "styrofoam");
  EXPECT_EQ(plant.board.nail_length_m, 0.04);
  EXPECT_GT(plant.joints[1].friction.bristle_stiffness_nm_rad, 0.0);
  Plant world(robot, plant, 1);
  world.step(milliseconds(10));

  const PlantDescription hard = load_plant(robot, kRobots / "boards" / "hardwood.yaml");
  EXPECT_GE(hard.board.nail_resistance_n, 1000.0);
  EXPECT_EQ(hard.face.stiffness_n_m, plant.face.stiffness_n_m);
}

TEST(PlantDescriptionFiles, TheSevenJointArmRuns) {
  const RobotDescription robot = load_robot(kRobots / "arm7");
  Plant world(robot, load_plant(robot, kRobots / "boards" / "styrofoam.yaml"), 1);
  ASSERT_EQ(world.dof(), 7);
  const PerJoint start{};
  world.reset(std::span(start).first(7), 0.04);
  world.step(milliseconds(200));
  for (std::size_t i = 0; i < 7; ++i) EXPECT_NEAR(world.truth().link_position_rad[i], 0.0, 1e-5);  // its brakes hold it
}

// The friction that a module compensates must stay below the true one, whatever the seed: a passive joint never drives.
TEST(PlantDescriptionFiles, TrueFrictionIsAbovePassiveCompensation) {
  for (const char* name : {"mrr3", "arm7"}) {
    const RobotDescription robot = load_robot(kRobots / name);
    const PlantDescription description = load_plant(robot, kRobots / "boards" / "styrofoam.yaml");
    for (std::uint64_t seed = 0; seed < 50; ++seed) {
      const Plant plant(robot, description, seed);
      for (std::size_t i = 0; i < robot.joints.size(); ++i) {
        const auto& joint = robot.joints[i];
        for (const double truth : plant.actual_description().joints[i].friction.coulomb_nm) {
          EXPECT_GT(truth, joint.control.passive_compensation * joint.friction.static_nm) << name << " " << joint.name;
        }
      }
    }
  }
}

class Broken : public testing::Test {
 protected:
  void SetUp() override {
    std::string name = (std::filesystem::temp_directory_path() / "mrr_plant_XXXXXX").string();
    ASSERT_NE(mkdtemp(name.data()), nullptr);
    folder_ = name;
  }
  void TearDown() override { std::filesystem::remove_all(folder_); }
  std::string error_of(const std::string& plant_yaml, const std::string& board_yaml) {
    std::ofstream(folder_ / "plant.yaml") << plant_yaml;
    std::ofstream(folder_ / "board.yaml") << board_yaml;
    RobotDescription robot = reference_arm();
    robot.source = folder_;
    try {
      load_plant(robot, folder_ / "board.yaml");
    } catch (const DescriptionError& error) {
      return error.what();
    }
    return "";
  }
  std::filesystem::path folder_;
  static constexpr const char* kBoard =
      "name: soft\n"
      "nail: {length: 40 mm, resistance: 4 N, resistance_slope: 100 N/m, damping: 12 N s/m}\n"
      "surface: {stiffness: 7000 N/m, damping: 1 s/m, half_width: 150 mm}\n";
};

TEST_F(Broken, GoodFilesPass) { EXPECT_EQ(error_of("rotor_coupling: false\n", kBoard), ""); }

TEST_F(Broken, WrongOnesAreOneSentenceWithFileKeyAndValue) {
  using testing::AllOf;
  using testing::HasSubstr;
  EXPECT_THAT(error_of("joints: {joint_1: {friction: {coulomb: 40 40 Nm}}}\n", kBoard),
              AllOf(HasSubstr("plant.yaml"), HasSubstr("joint_1.friction")));  // above the static friction
  EXPECT_THAT(error_of("joints: {joint_9: {friction: {ripple: 0.1}}}\n", kBoard), HasSubstr("joint_9"));
  EXPECT_THAT(error_of("face: {stiffness: 8000 Nm}\n", kBoard),
              AllOf(HasSubstr("face.stiffness"), HasSubstr("8000 Nm")));
  EXPECT_THAT(error_of("face: {stifness: 8000 N/m}\n", kBoard), HasSubstr("stiffness"));
  EXPECT_THAT(error_of("perturbation: {friction: 0.9}\n", kBoard), HasSubstr("perturbation.friction"));
  EXPECT_THAT(error_of("rotor_coupling: true\n", "name: soft\n"), AllOf(HasSubstr("board.yaml"), HasSubstr("nail")));
}

}  // namespace
}  // namespace mrr::sim::test
