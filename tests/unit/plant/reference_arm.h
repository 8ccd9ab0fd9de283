// Room: tests/unit/plant. The reference arm of theory's Table 3 as a description made by hand, for tests of the
// emulator. Uses common/robot and sim_vcan/plant only.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <string>
#include <vector>

#include "common/robot/robot.h"
#include "sim_vcan/plant/plant.h"

namespace mrr::sim::test {

/// Joint 1 about the vertical, joints 2 and 3 about horizontal axes; at q = 0 the arm points along +x at z = 0.48 m,
/// and positive q2, q3 raise the tip. Hammer face at the tip, looking down. The nail stands under the tip, its head at
/// the face when it is 40 mm proud.
inline RobotDescription reference_arm() {
  RobotDescription robot;
  robot.name = "reference_arm";
  const auto diagonal = [](double x, double y, double z) -> Eigen::Matrix3d {
    return Eigen::Vector3d(x, y, z).asDiagonal();
  };
  for (int i = 0; i < 3; ++i) {
    JointDescription joint;
    joint.name = "joint_" + std::to_string(i + 1);
    joint.axis = i == 0 ? Eigen::Vector3d(0, 0, 1) : Eigen::Vector3d(0, -1, 0);
    joint.offset.translation_m = i == 0   ? Eigen::Vector3d(0, 0, 0)
                                 : i == 1 ? Eigen::Vector3d(0, 0, 0.48)
                                          : Eigen::Vector3d(0.38, 0, 0);
    joint.link.mass_kg = i == 2 ? 1.0 : 3.5;
    joint.link.com_m = i == 0   ? Eigen::Vector3d(0, 0, 0.24)
                       : i == 1 ? Eigen::Vector3d(0.19, 0, 0)
                                : Eigen::Vector3d(0.35, 0, 0);
    // About the vertical joint 1 the first link has 0.017: with 0.25 + 0.017 the arm's M(0,0) is the reference's.
    joint.link.inertia_kg_m2 = i == 0 ? diagonal(0.25, 0.25, 0.017) : diagonal(0.017, 0.25, 0.25);
    joint.limits = {-2.4, 2.4, 2.0, i == 0 ? 110.0 : 45.0, 25.0, 0.3, 0.1};
    const bool base = i == 0;
    joint.transmission.type = base ? "SHD-25" : "SHD-17";
    joint.transmission.gear_ratio = base ? 133.0 : 101.0;
    joint.transmission.rated_nm = base ? 47.0 : 16.0;
    joint.transmission.repeated_peak_nm = base ? 110.0 : 37.0;
    joint.transmission.momentary_peak_nm = base ? 184.0 : 71.0;
    joint.transmission.stiffness_nm_rad = base ? std::array{2.7e4, 3.7e4, 4.7e4} : std::array{8.4e3, 9.4e3, 1.3e4};
    joint.transmission.stiffness_break_nm = base ? std::array{14.0, 48.0} : std::array{3.9, 12.0};
    joint.motor.rotor_inertia_kg_m2 = 0.168e-4;
    joint.motor.torque_constant_positive_nm_a = base ? 19.1 / 133.0 : 0.21;
    joint.motor.torque_constant_negative_nm_a = base ? 25.4 / 133.0 : 0.23;
    joint.motor.peak_current_a = base ? 6.0 : 2.2;
    joint.motor.continuous_current_a = base ? 3.0 : 1.0;
    joint.motor.thermal_time_constant_s = 60.0;
    joint.motor.max_winding_temperature_c = 120.0;
    joint.motor.max_velocity_rad_s = 500.0;
    joint.friction =
        base ? FrictionDescription{30.5, 36.2, 400.0, 8.0} : FrictionDescription{3.9, 4.6, 1.0 / (0.03 * 0.03), 2.0};
    joint.sensors.encoder_counts_per_turn = 16384;
    joint.sensors.encoder_absolute = true;
    joint.sensors.torque_sensor = true;
    joint.sensors.torque_full_scale_nm = base ? 200.0 : 100.0;
    joint.sensors.torque_bandwidth_hz = 200.0;
    joint.sensors.torque_noise_nm = 0.07;
    joint.sensors.current_full_scale_a = 10.0;
    joint.homing.switch_position_rad = -1.0;
    joint.brake = {0.05, 0.05};
    robot.joints.push_back(joint);
  }
  robot.hammer.face.translation_m = {0.38, 0, 0};
  robot.hammer.face.rotation << 1, 0, 0, 0, -1, 0, 0, 0, -1;  // z out of the face: down
  robot.hammer.face_radius_m = 0.012;
  robot.hammer.max_tilt_rad = 0.14;
  robot.task.nail_position_m = {0.76, 0, 0.44};
  robot.task.nail_height_m = 0.04;
  return robot;
}

/// The plant with springs alone: no friction, no damping, no brake, no noise, no contact in reach.
inline PlantDescription conservative_plant(const RobotDescription& robot) {
  PlantDescription plant = default_plant(robot);
  for (JointTruth& joint : plant.joints) {
    joint.friction = {};
    joint.spring.damping_nm_s_rad = 0.0;
    joint.drive.brake_torque_nm = 0.0;
    joint.sensor = {.torque_noise_nm = 0.0, .torque_drift_nm = 0.0, .current_noise_a = 0.0};
  }
  plant.stop_stiffness_nm_rad = 0.0;
  plant.stop_damping_nm_s_rad = 0.0;
  return plant;
}

/// Current that gives this joint torque, as a duty for the power stage; the brake released.
inline fw::ActuatorCommand torque_command(const Plant& plant, int joint, double torque_nm) {
  const auto i = static_cast<std::size_t>(joint);
  const JointDescription& description = plant.actual_robot().joints[i];
  const auto& constant = plant.actual_description().joints[i].drive.torque_constant_nm_a;
  const double current = torque_nm / (description.transmission.gear_ratio * constant[torque_nm >= 0.0 ? 0 : 1]);
  const double counts = current / description.sensors.current_full_scale_a * 32767.0;
  return {static_cast<std::int16_t>(std::lround(std::clamp(counts, -32767.0, 32767.0))), true, true};
}

}  // namespace mrr::sim::test
