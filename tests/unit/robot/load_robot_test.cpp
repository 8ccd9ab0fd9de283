#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <regex>
#include <sstream>
#include <string>
#include <vector>

#include "common/robot/robot.h"
#include "tests/unit/robot/sentence.h"

namespace mrr {
namespace {

using test::complaint;
using test::expect_one_sentence;
using test::SpoiledRobot;
using testing::HasSubstr;

constexpr const char* kYaml = "robot.yaml";
constexpr const char* kUrdf = "robot.urdf";

RobotDescription load_example(const std::string& name) {
  return load_robot(std::filesystem::path(MRR_SOURCE_DIR) / "robots" / name);
}

/// Link frames in the base frame, by plain composition.
struct Pose {
  Eigen::Matrix3d R = Eigen::Matrix3d::Identity();
  Eigen::Vector3d p = Eigen::Vector3d::Zero();
};

std::vector<Pose> forward(const RobotDescription& robot, const std::vector<double>& q) {
  std::vector<Pose> poses;
  Pose at;
  for (std::size_t i = 0; i < robot.joints.size(); ++i) {
    const JointDescription& joint = robot.joints[i];
    at.p += at.R * joint.offset.translation_m;
    at.R = at.R * joint.offset.rotation * Eigen::AngleAxisd(q[i], joint.axis).toRotationMatrix();
    poses.push_back(at);
  }
  return poses;
}

Pose face_pose(const RobotDescription& robot, const std::vector<double>& q) {
  const Pose last = forward(robot, q).back();
  return {last.R * robot.hammer.face.rotation, last.p + last.R * robot.hammer.face.translation_m};
}

/// Mass matrix (without rotors) and gravity torque from the kinetic and potential energy of the links.
struct Dynamics {
  Eigen::MatrixXd M;
  Eigen::VectorXd gravity_nm;
};

Dynamics dynamics(const RobotDescription& robot, const std::vector<double>& q) {
  const auto poses = forward(robot, q);
  const Eigen::Index n = robot.dof();
  Dynamics d{Eigen::MatrixXd::Zero(n, n), Eigen::VectorXd::Zero(n)};
  for (std::size_t k = 0; k < poses.size(); ++k) {
    const LinkDescription& link = robot.joints[k].link;
    const Eigen::Vector3d com = poses[k].p + poses[k].R * link.com_m;
    Eigen::MatrixXd Jv = Eigen::MatrixXd::Zero(3, n);
    Eigen::MatrixXd Jw = Eigen::MatrixXd::Zero(3, n);
    for (std::size_t i = 0; i <= k; ++i) {
      const Eigen::Vector3d z = poses[i].R * robot.joints[i].axis;
      Jv.col(static_cast<Eigen::Index>(i)) = z.cross(com - poses[i].p);
      Jw.col(static_cast<Eigen::Index>(i)) = z;
    }
    d.M += link.mass_kg * Jv.transpose() * Jv +
           Jw.transpose() * poses[k].R * link.inertia_kg_m2 * poses[k].R.transpose() * Jw;
    d.gravity_nm -= link.mass_kg * Jv.transpose() * robot.gravity_m_s2;
  }
  return d;
}

// Numbers of the reference arm (its Denavit-Hartenberg frames evaluated independently), at two poses.
TEST(Mrr3, HasTheDynamicsOfTheReferenceArm) {
  const RobotDescription robot = load_example("mrr3");
  struct Case {
    std::vector<double> q;
    Eigen::Vector3d tip_m;
    Eigen::Matrix3d M;
    Eigen::Vector3d gravity_nm;
  };
  Eigen::Matrix3d M_home;
  M_home << 1.17625, 0, 0, 0, 1.15925, 0.5055, 0, 0.5055, 0.3725;
  Eigen::Matrix3d M_bent;
  M_bent << 0.914073761185, 0, 0, 0, 1.0479777018, 0.449863850899, 0, 0.449863850899, 0.3725;
  for (const Case& c : {Case{{0, 0, 0}, {0.76, 0, 0.48}, M_home, {0, 13.68495, 3.4335}},
                        Case{{0.35, 0.6, -0.95},
                             {0.629933162707, 0.229943554227, 0.564262973057},
                             M_bent,
                             {0, 11.686222999, 3.22533620956}}}) {
    EXPECT_LT((face_pose(robot, c.q).p - c.tip_m).norm(), 1e-11);
    const Dynamics d = dynamics(robot, c.q);
    EXPECT_LT((d.M - c.M).norm(), 1e-9) << d.M;
    EXPECT_LT((d.gravity_nm - c.gravity_nm).norm(), 1e-9) << d.gravity_nm;
  }
  EXPECT_NEAR(robot.joints[0].reflected_inertia_kg_m2(), 0.2971752, 1e-12);
  EXPECT_NEAR(robot.joints[2].reflected_inertia_kg_m2(), 0.1713768, 1e-12);
}

TEST(Mrr3, FaceLooksDownAtHomeAndReachesTheNailAllTheWay) {
  const RobotDescription robot = load_example("mrr3");
  const Pose home = face_pose(robot, {0, 0, 0});
  EXPECT_LT((home.R.col(2) + Eigen::Vector3d::UnitZ()).norm(), 1e-12);
  for (double above_m = robot.task.nail_height_m; above_m > -1e-9; above_m -= 0.005) {
    const Eigen::Vector3d head = robot.task.nail_position_m + above_m * robot.task.normal;
    const double dz = head.z() - 0.48;
    const double distance = std::hypot(head.x(), dz);
    ASSERT_LT(distance, 0.76);
    for (double sign : {-1.0, 1.0}) {
      const double half_bend = sign * std::acos(distance / 0.76);
      const std::vector<double> q = {0.0, std::atan2(dz, head.x()) + half_bend, -2.0 * half_bend};
      const Pose face = face_pose(robot, q);
      EXPECT_LT((face.p - head).norm(), 1e-12);
      EXPECT_LT(std::acos(-face.R.col(2).dot(robot.task.normal)), robot.hammer.max_tilt_rad) << above_m;
    }
  }
}

TEST(Mrr3, DefaultGainsFollowFromLambdaAndTheRotor) {
  const RobotDescription robot = load_example("mrr3");
  for (const auto& joint : robot.joints) {
    const double J = joint.reflected_inertia_kg_m2();
    EXPECT_DOUBLE_EQ(joint.control.position_gain_nm_rad, 50.0 * 50.0 * J);
    EXPECT_DOUBLE_EQ(joint.control.velocity_gain_nm_s_rad, 2.0 * 50.0 * J);
  }
  const SpoiledRobot own;
  own.replace("robot.yaml", "lambda: 50 1/s ",
              "lambda: 50 1/s\n      position_gain: 414 Nm/rad\n      velocity_gain: 29 Nm s/rad ");
  const RobotDescription other = load_robot(own.directory());
  EXPECT_EQ(other.joints[0].control.position_gain_nm_rad, 414.0);
  EXPECT_EQ(other.joints[0].control.velocity_gain_nm_s_rad, 29.0);
}

TEST(Mrr3, ReadsEveryGroupOfValues) {
  const RobotDescription r = load_example("mrr3");
  EXPECT_EQ(r.name, "mrr3");
  ASSERT_EQ(r.dof(), 3);
  EXPECT_EQ(r.bus.interface, "vcan0");
  EXPECT_FALSE(r.bus.fd);
  EXPECT_EQ(r.bus.bit_rate, 1e6);
  EXPECT_EQ(r.bus.knot_rate_hz, 250.0);
  const JointDescription& j = r.joints[1];
  EXPECT_EQ(j.name, "joint_2");
  EXPECT_EQ(j.node_id, 3);
  EXPECT_EQ(j.selection_bit, 1);
  EXPECT_EQ(j.transmission.type, "SHD-17");
  EXPECT_EQ(j.transmission.momentary_peak_nm, 71.0);
  EXPECT_EQ(j.transmission.stiffness_nm_rad[2], 1.3e4);
  EXPECT_EQ(j.transmission.stiffness_break_nm[0], 3.9);
  EXPECT_NEAR(j.motor.max_velocity_rad_s, 2000.0 * std::numbers::pi / 30.0, 1e-9);
  EXPECT_EQ(j.friction.stribeck_decay_s2_rad2, 1111.0);
  EXPECT_EQ(j.control.compensator.integral_gain, (std::array<double, 4>{10, 300, 300, 0}));
  EXPECT_EQ(j.control.compensator.robust_width, (std::array<double, 4>{0.1, 0.1, 0.1, 2}));
  EXPECT_TRUE(j.control.compensator.enabled);
  EXPECT_DOUBLE_EQ(j.control.passive_blend_s, 0.003);
  EXPECT_TRUE(j.sensors.torque_sensor);
  EXPECT_EQ(j.sensors.torque_full_scale_nm, 100.0);
  EXPECT_EQ(j.homing.direction, 1);
  EXPECT_DOUBLE_EQ(j.brake.release_s, 0.05);
  EXPECT_EQ(j.limits.lower_rad, -1.6);
  EXPECT_DOUBLE_EQ(r.hammer.face_radius_m, 0.012);
}

TEST(LoadRobot, ReadsHomingWatchdogsSoftLimitsAndCalibration) {
  const SpoiledRobot robot;
  const JointDescription standard = load_robot(robot.directory()).joints[0];
  EXPECT_EQ(standard.homing.method, HomingMethod::on_switch);
  EXPECT_EQ(standard.homing.max_travel_rad, 0.0);
  EXPECT_FALSE(standard.homing.index_position_rad.has_value());
  EXPECT_EQ(standard.watchdog.heartbeat, SilenceReaction::stop);
  robot.replace(
      kYaml, "      timeout: 90 s ",
      "      max_travel: 5 rad\n      max_torque: 60 Nm\n      index_position: -2.81 rad\n      timeout: 90 s ");
  robot.replace(kYaml, "      acceleration: 25 rad/s^2 ",
                "      lower: -150 deg\n      upper: 2.5 rad\n      acceleration: 25 rad/s^2 ");
  robot.replace(
      kYaml, "    homing:\n",
      "    calibration: {torque_offset: -300 mNm}\n"
      "    watchdog:\n      knots: {missing: 3, reaction: damp}\n"
      "      torque_target: {timeout: 0.2 s, reaction: stop}\n      heartbeat: {timeout: 1 s, reaction: hold}\n"
      "      sync: {timeout: 40 ms, reaction: report}\n      bus_off: {reaction: damp}\n"
      "      in_torque_mode: {heartbeat: hold, bus_off: report}\n"
      "      while_passive: {knots_timeout: 80 ms, knots: hold, heartbeat: stop, sync: damp, bus_off: hold}\n"
      "    homing:\n");
  const JointDescription j = load_robot(robot.directory()).joints[0];
  EXPECT_EQ(j.homing.max_travel_rad, 5.0);
  EXPECT_EQ(j.homing.max_torque_nm, 60.0);
  EXPECT_EQ(j.homing.index_position_rad, -2.81);
  EXPECT_NEAR(j.limits.lower_rad, -150.0 * std::numbers::pi / 180.0, 1e-12);
  EXPECT_EQ(j.limits.upper_rad, 2.5);
  EXPECT_EQ(j.torque_offset_nm, -0.3);
  EXPECT_EQ(j.watchdog.missing_knots, 3);
  EXPECT_EQ(j.watchdog.knots, SilenceReaction::damp);
  EXPECT_EQ(j.watchdog.torque_target_s, 0.2);
  EXPECT_EQ(j.watchdog.torque_target, SilenceReaction::stop);
  EXPECT_EQ(j.watchdog.heartbeat_s, 1.0);
  EXPECT_EQ(j.watchdog.heartbeat, SilenceReaction::hold);
  EXPECT_EQ(j.watchdog.sync_s, 0.04);
  EXPECT_EQ(j.watchdog.sync, SilenceReaction::report);
  EXPECT_EQ(j.watchdog.bus_off, SilenceReaction::damp);
  EXPECT_EQ(standard.watchdog.passive_heartbeat, SilenceReaction::report);
  EXPECT_EQ(j.watchdog.torque_heartbeat, SilenceReaction::hold);
  EXPECT_EQ(j.watchdog.torque_bus_off, SilenceReaction::report);
  EXPECT_EQ(j.watchdog.passive_knots_s, 0.08);
  EXPECT_EQ(j.watchdog.passive_knots, SilenceReaction::hold);
  EXPECT_EQ(j.watchdog.passive_heartbeat, SilenceReaction::stop);
  EXPECT_EQ(j.watchdog.passive_sync, SilenceReaction::damp);
  EXPECT_EQ(j.watchdog.passive_bus_off, SilenceReaction::hold);
}

TEST(LoadRobot, SaysWhenItsFilesHaveChanged) {
  const SpoiledRobot robot;
  const RobotDescription description = load_robot(robot.directory());
  EXPECT_FALSE(source_changed(description));
  EXPECT_FALSE(source_changed(RobotDescription{}));
  const std::string before = robot.text(kYaml);
  robot.replace(kYaml, "coulomb: 30.5 Nm", "coulomb: 30.6 Nm");
  EXPECT_TRUE(source_changed(description));
  robot.set_text(kYaml, before);
  EXPECT_FALSE(source_changed(description));
  std::filesystem::remove(robot.directory() / "robot.urdf");
  EXPECT_TRUE(source_changed(description));
}

TEST(Arm7, ReachesItsNailComfortably) {
  const RobotDescription robot = load_example("arm7");
  ASSERT_EQ(robot.dof(), 7);
  double mass_kg = 0.0;
  for (const auto& joint : robot.joints) mass_kg += joint.link.mass_kg;
  EXPECT_NEAR(mass_kg, 15.5, 1e-9) << "the hammer is part of link 7";
  EXPECT_NEAR(robot.joints[6].link.mass_kg, 1.3, 1e-12);
  const std::vector<double> q = {0, 0.78830948, 0, 1.88048476, 0, -1.09799791, 0};
  const Pose face = face_pose(robot, q);
  const Eigen::Vector3d head = robot.task.nail_position_m + robot.task.nail_height_m * robot.task.normal;
  EXPECT_LT((face.p - head).norm(), 1e-6);
  EXPECT_LT((face.R.col(2) + robot.task.normal).norm(), 1e-6);
  // Room on both sides of every joint, and gravity well below the torque limits.
  const Dynamics d = dynamics(robot, q);
  for (std::size_t i = 0; i < q.size(); ++i) {
    const JointLimits& limits = robot.joints[i].limits;
    EXPECT_GT(q[i] - limits.lower_rad, 0.5);
    EXPECT_GT(limits.upper_rad - q[i], 0.5);
    EXPECT_LT(std::abs(d.gravity_nm(static_cast<Eigen::Index>(i))), 0.5 * limits.torque_nm);
  }
}

TEST(LoadRobot, GivesTheSameEveryTime) {
  for (const char* name : {"mrr3", "arm7"}) {
    const RobotDescription a = load_example(name);
    for (int i = 0; i < 5; ++i) {
      const RobotDescription b = load_example(name);
      ASSERT_EQ(a.dof(), b.dof());
      for (std::size_t k = 0; k < a.joints.size(); ++k) {
        EXPECT_EQ(a.joints[k].name, b.joints[k].name);
        EXPECT_EQ(a.joints[k].link.inertia_kg_m2, b.joints[k].link.inertia_kg_m2);
        EXPECT_EQ(a.joints[k].link.com_m, b.joints[k].link.com_m);
        EXPECT_EQ(a.joints[k].offset.rotation, b.joints[k].offset.rotation);
        EXPECT_EQ(a.joints[k].control.position_gain_nm_rad, b.joints[k].control.position_gain_nm_rad);
      }
      EXPECT_EQ(a.hammer.face.rotation, b.hammer.face.rotation);
    }
  }
}

TEST(Documentation, ExplainsEveryKeyOfTheExamples) {
  const std::string page = test::read_text(std::filesystem::path(MRR_SOURCE_DIR) / "docs" / "robot_description.md");
  const std::regex key("([a-z_][a-z_0-9]*):[ \n]");
  for (const char* robot : {"mrr3", "arm7"}) {
    std::string yaml = test::read_text(std::filesystem::path(MRR_SOURCE_DIR) / "robots" / robot / "robot.yaml");
    yaml = std::regex_replace(yaml, std::regex("#[^\n]*"), "");
    for (std::sregex_iterator it(yaml.begin(), yaml.end(), key), end; it != end; ++it) {
      const std::string name = (*it)[1].str();
      if (name.starts_with("joint_")) continue;
      const bool explained =
          page.find("`" + name + "`") != std::string::npos || page.find("." + name + "`") != std::string::npos;
      EXPECT_TRUE(explained) << name;
    }
  }
}

struct Spoil {
  const char* name;
  const char* file;
  const char* from;
  const char* to;
  std::vector<std::string> says;
  const char* blamed = nullptr;  ///< the file the sentence names, if not the spoiled one
};

void PrintTo(const Spoil& spoil, std::ostream* os) { *os << spoil.name; }

class BadRobot : public testing::TestWithParam<Spoil> {};

TEST_P(BadRobot, IsOneClearSentence) {
  const Spoil& spoil = GetParam();
  const SpoiledRobot robot;
  robot.replace(spoil.file, spoil.from, spoil.to);
  const std::string text = complaint([&] { return load_robot(robot.directory()); });
  expect_one_sentence(text);
  EXPECT_THAT(text, HasSubstr((robot.directory() / (spoil.blamed != nullptr ? spoil.blamed : spoil.file)).string()));
  for (const std::string& fragment : spoil.says) EXPECT_THAT(text, HasSubstr(fragment));
}

const std::vector<Spoil> kSpoils = {
    // robot.yaml: form
    {"missing_key",
     kYaml,
     "      rated: 47 Nm",
     "",
     {"joints.joint_1.transmission.rated is missing; add it as a torque"}},
    {"missing_section",
     kYaml,
     "    brake:\n      release",
     "    brakes:\n      release",
     {"joints.joint_1.brake is missing; is 'brakes' a misspelling"}},
    {"misspelt_optional",
     kYaml,
     "max_swings",
     "max_swing",
     {"task.max_swing is not a known key; did you mean 'max_swings'?"}},
    {"unknown_key", kYaml, "gravity:", "colour: red\ngravity:", {"colour is not a known key", "line 5"}},
    {"unknown_joint_key",
     kYaml,
     "    node_id: 3",
     "    node_id: 3\n    weight: 3 kg",
     {"joints.joint_2.weight is not a known key"}},
    {"key_twice", kYaml, "    node_id: 3", "    node_id: 3\n    node_id: 3", {"joints.joint_2.node_id is given twice"}},
    {"wrong_unit", kYaml, "rated: 47 Nm", "rated: 47 A", {"'A' is the unit of a current; give a torque in Nm or mNm"}},
    {"missing_unit", kYaml, "rated: 47 Nm", "rated: 47", {"needs a unit: write Nm or mNm"}},
    {"unknown_unit",
     kYaml,
     "knot_rate: 250 Hz",
     "knot_rate: 250 Herz",
     {"'Herz' is not a known unit", "Hz, kHz or MHz"}},
    {"nan", kYaml, "rated: 47 Nm", "rated: nan Nm", {"must be finite"}},
    {"infinite", kYaml, "viscous: 8 Nm", "viscous: inf Nm", {"must be finite"}},
    {"word_for_number",
     kYaml,
     "gear_ratio: 133",
     "gear_ratio: many",
     {"must be a plain number above 1 and at most 1000"}},
    {"two_gravity_numbers", kYaml, "0 0 -9.81", "0 -9.81", {"must hold 3 numbers", "not 2"}},
    {"broken_yaml", kYaml, "bus:", "bus: [", {"not valid YAML"}},
    {"tab", kYaml, "  fd:", "\tfd:", {"not valid YAML"}},
    {"list_for_section", kYaml, "brake: {release: 50 ms, engage: 30 ms}", "brake: [50 ms]", {"must be a section"}},
    // robot.yaml: ranges
    {"negative_torque", kYaml, "rated: 47 Nm", "rated: -47 Nm", {"is '-47 Nm', but must be above 0 Nm"}},
    {"negative_rotor", kYaml, "rotor_inertia: 0.168e-4", "rotor_inertia: -0.168e-4", {"must be above 0 kg m^2"}},
    {"gear_of_one", kYaml, "gear_ratio: 133", "gear_ratio: 1", {"must be above 1"}},
    {"node_id_low", kYaml, "node_id: 3", "node_id: 1", {"must be a whole number from 2 to 127"}},
    {"node_id_high", kYaml, "node_id: 3", "node_id: 128", {"must be a whole number from 2 to 127"}},
    {"node_id_fraction", kYaml, "node_id: 3", "node_id: 3.5", {"must be a whole number from 2 to 127"}},
    {"selection_bit_high", kYaml, "selection_bit: 1", "selection_bit: 32", {"must be a whole number from 0 to 31"}},
    {"passive_share", kYaml, "passive_compensation: 0.75", "passive_compensation: 0.9", {"at least 0 and below 0.9"}},
    {"feedforward_share", kYaml, "friction_feedforward: 1.0", "friction_feedforward: 1.3", {"at most 1.2"}},
    {"direction", kYaml, "direction: negative", "direction: left", {"must be one of: negative, positive"}},
    {"flag", kYaml, "fd: false", "fd: maybe", {"must be true or false"}},
    {"zero_normal", kYaml, "normal: 0 0 1", "normal: 0 0 0", {"task.normal is '0 0 0', but must have a direction"}},
    {"interface_name", kYaml, "interface: vcan0", "interface: a_name_that_is_too_long", {"at most 15 characters"}},
    // robot.yaml: across keys
    {"duplicate_node_id",
     kYaml,
     "node_id: 3",
     "node_id: 2",
     {"joints.joint_2.node_id is '2'", "'joint_1' has the same"}},
    {"duplicate_bit",
     kYaml,
     "selection_bit: 1",
     "selection_bit: 0",
     {"joints.joint_2.selection_bit is '0'", "'joint_1'"}},
    {"rated_over_repeated",
     kYaml,
     "rated: 47 Nm",
     "rated: 110 Nm",
     {"repeated_peak is '110 Nm', but must be above the rated"}},
    {"repeated_over_momentary",
     kYaml,
     "momentary_peak: 184 Nm",
     "momentary_peak: 100 Nm",
     {"must be above the repeated peak"}},
    {"static_below_coulomb",
     kYaml,
     "static: 36.2 Nm",
     "static: 30 Nm",
     {"must not be below the Coulomb friction of 30.5 Nm"}},
    {"passive_over_coulomb",
     kYaml,
     "passive_compensation: 0.75",
     "passive_compensation: 0.88",
     {"31.9 Nm, which must stay below the Coulomb friction of 30.5 Nm"}},
    {"effort_over_momentary",
     kYaml,
     "repeated_peak: 110 Nm            # [C]\n      momentary_peak: 184 Nm",
     "repeated_peak: 90 Nm\n      momentary_peak: 105 Nm",
     {"effort limit of 110 Nm must not be above it"}},
    {"falling_stiffness", kYaml, "2.7e4 3.7e4 4.7e4", "2.7e4 4.7e4 3.7e4", {"must not fall from K1 to K3"}},
    {"breaks_order",
     kYaml,
     "stiffness_breaks: 14 48",
     "stiffness_breaks: 48 14",
     {"first break must be below the second"}},
    {"continuous_over_peak", kYaml, "continuous_current: 2.4 A", "continuous_current: 6 A", {"peak current of 5.8 A"}},
    {"sensor_below_peak",
     kYaml,
     "current_full_scale: 8 A",
     "current_full_scale: 5 A",
     {"motor's peak current of 5.8 A"}},
    {"torque_sensor_small", kYaml, "full_scale: 200 Nm", "full_scale: 100 Nm", {"repeated peak torque of 110 Nm"}},
    {"weak_motor",
     kYaml,
     "peak_current: 5.8 A",
     "peak_current: 5 A",
     {"95.76 Nm at the joint", "effort limit is 110 Nm"}},
    {"slow_motor", kYaml, "max_velocity: 2000 rpm", "max_velocity: 1000 rpm", {"velocity limit of 1.5 rad/s"}},
    {"knots_not_dividing", kYaml, "knot_rate: 250 Hz", "knot_rate: 300 Hz", {"must divide the loop rate of 1000 Hz"}},
    {"loop_period", kYaml, "loop_rate: 1 kHz", "loop_rate: 1500 Hz", {"whole microseconds"}},
    {"chattering_gains",
     kYaml,
     "gain: 4, width: 0.3}",
     "gain: 4, width: 0.03}",
     {"compensator", "loop rate allows 250 1/s"}},
    {"blend_over_lead",
     kYaml,
     "switch_lead: 12 ms",
     "switch_lead: 2 ms",
     {"must be longer than joint 'joint_1' needs"}},
    {"homing_timeout", kYaml, "timeout: 90 s", "timeout: 20 s", {"search through the whole travel takes 29 s"}},
    {"homing_switch_outside", kYaml, "switch_position: -2.8 rad", "switch_position: -3 rad", {"at least -2.9 rad"}},
    {"homing_method",
     kYaml,
     "      timeout: 90 s ",
     "      method: index\n      timeout: 90 s ",
     {"joints.joint_1.homing.method"}},
    {"homing_here_with_absolute_encoder",
     kYaml,
     "      timeout: 90 s ",
     "      method: here\n      timeout: 90 s ",
     {"a joint with an absolute encoder knows where it is"}},
    {"homing_torque_cap",
     kYaml,
     "      timeout: 90 s ",
     "      max_torque: 200 Nm\n      timeout: 90 s ",
     {"at most 110 Nm"}},
    {"homing_travel_cap",
     kYaml,
     "      timeout: 90 s ",
     "      max_travel: 3 s\n      timeout: 90 s ",
     {"give an angle"}},
    {"homing_index_behind_the_switch",
     kYaml,
     "      timeout: 90 s ",
     "      index_position: -2.7 rad\n      timeout: 90 s ",
     {"beyond switch_position in the direction"}},
    {"homing_index_outside",
     kYaml,
     "      timeout: 90 s ",
     "      index_position: -3 rad\n      timeout: 90 s ",
     {"at least -2.9 rad"}},
    {"watchdog_reaction",
     kYaml,
     "    homing:\n      switch_position: -2.8 rad",
     "    watchdog: {heartbeat: {reaction: panic}}\n    homing:\n      switch_position: -2.8 rad",
     {"joints.joint_1.watchdog.heartbeat.reaction"}},
    {"watchdog_knots_only_reported",
     kYaml,
     "    homing:\n      switch_position: -2.8 rad",
     "    watchdog: {knots: {reaction: report}}\n    homing:\n      switch_position: -2.8 rad",
     {"hold, stop"}},
    {"watchdog_heartbeat_too_short",
     kYaml,
     "    homing:\n      switch_position: -2.8 rad",
     "    watchdog: {heartbeat: {timeout: 20 ms}}\n    homing:\n      switch_position: -2.8 rad",
     {"at least 0.15 s"}},
    {"watchdog_sync_within_a_period",
     kYaml,
     "    homing:\n      switch_position: -2.8 rad",
     "    watchdog: {sync: {timeout: 5 ms}}\n    homing:\n      switch_position: -2.8 rad",
     {"less than two SYNC periods of 4 ms"}},
    {"watchdog_missing_knots",
     kYaml,
     "    homing:\n      switch_position: -2.8 rad",
     "    watchdog: {knots: {missing: 0}}\n    homing:\n      switch_position: -2.8 rad",
     {"1"}},
    {"torque_offset_unit",
     kYaml,
     "    homing:\n      switch_position: -2.8 rad",
     "    calibration: {torque_offset: 0.1 A}\n    homing:\n      switch_position: -2.8 rad",
     {"give a torque"}},
    {"soft_limit_beyond_the_urdf",
     kYaml,
     "      acceleration: 25 rad/s^2 ",
     "      lower: -3 rad\n      acceleration: 25 rad/s^2 ",
     {"at least -2.9 rad"}},
    {"soft_limits_swapped",
     kYaml,
     "      acceleration: 25 rad/s^2 ",
     "      lower: 1 rad\n      upper: 0.5 rad\n      acceleration: 25 rad/s^2 ",
     {"above the lower limit of 1 rad"}},
    {"park_outside_soft_limits",
     kYaml,
     "      acceleration: 25 rad/s^2 ",
     "      lower: 0.2 rad\n      acceleration: 25 rad/s^2 ",
     {"without 'park' the joint rests at 0 rad"}},
    {"many_counts", kYaml, "encoder_counts: 16384", "encoder_counts: 67108864", {"32-bit count"}},
    {"unknown_hammer", kYaml, "link: hammer_face", "link: sickle", {"the URDF has no link of that name"}},
    {"hammer_not_at_tip",
     kYaml,
     "link: hammer_face",
     "link: link_2",
     {"must be fixed to the last moving link, 'link_3'"}},
    {"joint_not_in_urdf", kYaml, "  joint_2:", "  joint_x:", {"joints.joint_x", "it has joint_1, joint_2, joint_3"}},
    // robot.urdf
    {"joint_not_in_yaml",
     kUrdf,
     "joint name=\"joint_2\"",
     "joint name=\"elbow\"",
     {"joints.joint_2", "it has joint_1, elbow, joint_3"},
     kYaml},
    {"broken_xml", kUrdf, "</robot>", "</robo", {"not well-formed XML"}},
    {"not_a_urdf", kUrdf, "<robot name=\"mrr3\">", "<machine name=\"mrr3\">", {"not well-formed XML"}},
    {"prismatic",
     kUrdf,
     "type=\"revolute\"",
     "type=\"prismatic\"",
     {"line 12", "joint 'joint_1' is prismatic, but only revolute"}},
    {"continuous",
     kUrdf,
     "type=\"revolute\"",
     "type=\"continuous\"",
     {"joint 'joint_1' is continuous; make it revolute"}},
    {"floating", kUrdf, "type=\"fixed\"", "type=\"floating\"", {"joint 'hammer_mount' is floating"}},
    {"mimic",
     kUrdf,
     "<axis xyz=\"0 0 1\"/>",
     "<axis xyz=\"0 0 1\"/><mimic joint=\"joint_2\"/>",
     {"joint 'joint_1' mimics"}},
    {"zero_axis", kUrdf, "<axis xyz=\"0 0 1\"/>", "<axis xyz=\"0 0 0\"/>", {"joint 'joint_1' has a zero axis"}},
    {"no_axis", kUrdf, "<axis xyz=\"0 0 1\"/>", "", {"joint 'joint_1' has no <axis>"}},
    {"axis_of_two", kUrdf, "<axis xyz=\"0 0 1\"/>", "<axis xyz=\"0 1\"/>", {"must be three finite numbers"}},
    {"no_limit",
     kUrdf,
     "<limit lower=\"-2.9\" upper=\"2.9\" velocity=\"1.5\" effort=\"110\"/>",
     "",
     {"joint 'joint_1' has no <limit>"}},
    {"no_effort", kUrdf, " effort=\"110\"", "", {"joint 'joint_1' lacks the attribute 'effort'"}},
    {"limits_swapped",
     kUrdf,
     "lower=\"-2.9\" upper=\"2.9\"",
     "lower=\"2.9\" upper=\"-2.9\"",
     {"lower not below upper"}},
    {"limits_in_degrees", kUrdf, "lower=\"-2.9\" upper=\"2.9\"", "lower=\"-166\" upper=\"166\"", {"beyond two turns"}},
    {"zero_velocity", kUrdf, "velocity=\"1.5\"", "velocity=\"0\"", {"not above 0 rad/s"}},
    {"nan_limit", kUrdf, "velocity=\"1.5\"", "velocity=\"nan\"", {"velocity='nan'", "one finite number"}},
    {"junk_number", kUrdf, "velocity=\"1.5\"", "velocity=\"1.5x\"", {"velocity='1.5x'", "one finite number"}},
    {"effort_over_motor", kUrdf, "effort=\"110\"", "effort=\"112\"", {"peak_current", "effort limit is 112"}, kYaml},
    {"effort_below_friction",
     kUrdf,
     "effort=\"110\"",
     "effort=\"36\"",
     {"friction.static", "the joint never moves"},
     kYaml},
    {"no_inertial",
     kUrdf,
     "<inertial>\n      <origin xyz=\"0 0 0.24\" rpy=\"0 0 0\"/>\n      <mass value=\"3.5\"/>\n      <inertia "
     "ixx=\"0.25\" "
     "ixy=\"0\" ixz=\"0\" iyy=\"0.25\" iyz=\"0\" izz=\"0.017\"/>\n    </inertial>",
     "",
     {"link 'link_1' moves with joint 'joint_1' but has no <inertial>"}},
    {"negative_mass",
     kUrdf,
     "<mass value=\"3.5\"/>",
     "<mass value=\"-3.5\"/>",
     {"link 'link_1' has a mass of -3.5 kg"}},
    {"zero_mass", kUrdf, "<mass value=\"3.5\"/>", "<mass value=\"0\"/>", {"link 'link_1' has a mass of 0 kg"}},
    {"no_mass", kUrdf, "<mass value=\"3.5\"/>", "", {"link 'link_1' has an <inertial> without <mass>"}},
    {"word_mass", kUrdf, "<mass value=\"3.5\"/>", "<mass value=\"heavy\"/>", {"value='heavy'"}},
    {"no_ixy", kUrdf, "ixy=\"0\" ", "", {"link 'link_1' lacks the attribute 'ixy'"}},
    {"negative_inertia", kUrdf, "izz=\"0.017\"", "izz=\"-0.017\"", {"link 'link_1'", "principal moment of -0.017"}},
    {"triangle", kUrdf, "ixx=\"0.25\"", "ixx=\"0.27\"", {"link 'link_1'", "larger than the sum of the others"}},
    {"indefinite", kUrdf, "ixy=\"0\"", "ixy=\"0.3\"", {"link 'link_1'", "principal moment"}},
    {"link_twice",
     kUrdf,
     "<link name=\"base\"/>",
     "<link name=\"base\"/><link name=\"base\"/>",
     {"link 'base' is given twice"}},
    {"joint_twice", kUrdf, "<joint name=\"joint_2\"", "<joint name=\"joint_1\"", {"joint 'joint_1' is given twice"}},
    {"unknown_parent",
     kUrdf,
     "<parent link=\"link_1\"/>",
     "<parent link=\"nobody\"/>",
     {"'nobody' as parent, but there is no such link"}},
    {"no_child", kUrdf, "<child link=\"link_2\"/>", "", {"joint 'joint_2' has no <child>"}},
    {"two_parents",
     kUrdf,
     "<child link=\"link_3\"/>",
     "<child link=\"link_2\"/>",
     {"link 'link_2' is the child of two joints"}},
    {"branch",
     kUrdf,
     "<parent link=\"link_2\"/>",
     "<parent link=\"link_1\"/>",
     {"branches off beside", "one serial chain"}},
    {"loop", kUrdf, "<parent link=\"base\"/>", "<parent link=\"link_3\"/>", {"hangs in a loop of joints"}},
    {"loop_beside",
     kUrdf,
     "<link name=\"base\"/>",
     "<link name=\"base\"/><link name=\"a\"/><link name=\"b\"/><joint name=\"ab\" type=\"fixed\"><parent "
     "link=\"a\"/><child "
     "link=\"b\"/></joint><joint name=\"ba\" type=\"fixed\"><parent link=\"b\"/><child link=\"a\"/></joint>",
     {"link 'a' hangs in a loop of joints"}},
    {"two_roots",
     kUrdf,
     "<link name=\"base\"/>",
     "<link name=\"base\"/><link name=\"stray\"/>",
     {"the URDF cannot be used"}},
    {"no_robot_name", kUrdf, "<robot name=\"mrr3\">", "<robot>", {"the robot lacks the attribute 'name'"}},
    {"no_joint_type", kUrdf, " type=\"revolute\"", "", {"joint 'joint_1' lacks the attribute 'type'"}},
    {"bad_origin", kUrdf, "<origin xyz=\"0 0 0.48\"", "<origin xyz=\"0 0 up\"", {"joint 'joint_2' has xyz='0 0 up'"}},
};

INSTANTIATE_TEST_SUITE_P(Table, BadRobot, testing::ValuesIn(kSpoils),
                         [](const auto& param) { return std::string(param.param.name); });

TEST(LoadRobot, AbsentFilesAreOneSentence) {
  expect_one_sentence(complaint([] { return load_robot("/nowhere/at/all"); }));
  const SpoiledRobot robot;
  std::filesystem::remove(robot.directory() / "robot.yaml");
  const std::string no_yaml = complaint([&] { return load_robot(robot.directory()); });
  expect_one_sentence(no_yaml);
  EXPECT_THAT(no_yaml, HasSubstr("robot.yaml: there is no such file"));
  std::filesystem::remove(robot.directory() / "robot.urdf");
  expect_one_sentence(complaint([&] { return load_robot(robot.directory()); }));
  robot.set_text("robot.urdf", "");
  expect_one_sentence(complaint([&] { return load_robot(robot.directory()); }));
}

std::vector<std::string> lines_of(const std::string& text) {
  std::vector<std::string> lines;
  std::istringstream stream(text);
  for (std::string line; std::getline(stream, line);) lines.push_back(line);
  return lines;
}

std::string joined(const std::vector<std::string>& lines) {
  std::string text;
  for (const auto& line : lines) text += line + "\n";
  return text;
}

class EveryLine : public testing::TestWithParam<const char*> {};

TEST_P(EveryLine, OfTheYamlIsReadSoNoKeyCanBeMisspelt) {
  const SpoiledRobot robot(GetParam());
  const auto lines = lines_of(robot.text("robot.yaml"));
  const std::regex key("^( *)([a-z_0-9]+):(.*)$");
  int tried = 0;
  for (std::size_t i = 0; i < lines.size(); ++i) {
    std::smatch match;
    if (!std::regex_match(lines[i], match, key)) continue;
    auto spoiled = lines;
    spoiled[i] = match[1].str() + match[2].str() + "x:" + match[3].str();
    robot.set_text("robot.yaml", joined(spoiled));
    SCOPED_TRACE(lines[i]);
    const std::string text = complaint([&] { return load_robot(robot.directory()); });
    expect_one_sentence(text);
    EXPECT_THAT(text, HasSubstr(match[2].str()));
    ++tried;
  }
  EXPECT_GT(tried, 80);
}

TEST_P(EveryLine, WithAUnitRefusesAnotherOneAndNan) {
  const SpoiledRobot robot(GetParam());
  const auto lines = lines_of(robot.text("robot.yaml"));
  const std::regex quantity("^( *[a-z_0-9]+: +)((?:-?[0-9][^ ]* )+)([A-Za-z1][^ #]*( [a-z]+[^ #]*)*)( *#.*)?$");
  int tried = 0;
  for (std::size_t i = 0; i < lines.size(); ++i) {
    std::smatch match;
    if (!std::regex_match(lines[i], match, quantity)) continue;
    for (const std::string& value :
         {match[2].str() + "parsec", match[2].str(), "nan " + match[3].str(), "-1e9 " + match[3].str()}) {
      auto spoiled = lines;
      spoiled[i] = match[1].str() + value;
      robot.set_text("robot.yaml", joined(spoiled));
      SCOPED_TRACE(spoiled[i]);
      expect_one_sentence(complaint([&] { return load_robot(robot.directory()); }));
    }
    ++tried;
  }
  EXPECT_GT(tried, 50);
}

TEST_P(EveryLine, MayGoMissingWithoutACrash) {
  const SpoiledRobot robot(GetParam());
  int refused = 0;
  for (const char* file : {"robot.yaml", "robot.urdf"}) {
    const std::string good = robot.text(file);
    const auto lines = lines_of(good);
    for (std::size_t i = 0; i < lines.size(); ++i) {
      auto spoiled = lines;
      spoiled.erase(spoiled.begin() + static_cast<std::ptrdiff_t>(i));
      robot.set_text(file, joined(spoiled));
      SCOPED_TRACE(lines[i]);
      // Either a whole robot (a comment, an optional key) or one sentence; any other exception fails the test.
      const std::string text = complaint([&] { return load_robot(robot.directory()); });
      if (text.empty()) continue;
      expect_one_sentence(text);
      ++refused;
    }
    robot.set_text(file, good);
  }
  EXPECT_GT(refused, 100);
}

TEST_P(EveryLine, MayBeCutOffThereWithoutACrash) {
  const SpoiledRobot robot(GetParam());
  for (const char* file : {"robot.yaml", "robot.urdf"}) {
    const std::string good = robot.text(file);
    for (std::size_t size = 0; size + 20 < good.size(); size += 37) {
      robot.set_text(file, good.substr(0, size));
      SCOPED_TRACE(size);
      expect_one_sentence(complaint([&] { return load_robot(robot.directory()); }));
    }
    robot.set_text(file, good);
  }
}

INSTANTIATE_TEST_SUITE_P(Robots, EveryLine, testing::Values("mrr3", "arm7"),
                         [](const auto& param) { return std::string(param.param); });

}  // namespace
}  // namespace mrr
