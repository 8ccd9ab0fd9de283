// Room: sim_vcan/plant. What the emulator knows beyond the robot description: the truth that a real robot only
// estimates. Host only. Uses common/ and module_fw/joint_io.h; never supervisor/: robot and world must not be right by
// sharing a bug.
#pragma once

#include <array>
#include <filesystem>
#include <string>
#include <vector>

#include "common/robot/robot.h"

namespace mrr::sim {

/// LuGre friction of the motor side, joint-side units (Canudas de Wit 1995). Its steady state is theory's equation (5):
/// [f_c + (f_s - f_c) exp(-f_tau v^2)] sgn v + b v.
struct LugreFriction {
  double bristle_stiffness_nm_rad = 0.0;  ///< sigma_0; 0: no dry friction
  double bristle_damping_nm_s_rad = 0.0;  ///< sigma_1 at rest, fades as exp(-f_tau v^2)
  std::array<double, 2> coulomb_nm{};     ///< f_c for motion in the positive, in the negative direction
  std::array<double, 2> static_nm{};      ///< f_s, likewise
  double stribeck_decay_s2_rad2 = 0.0;    ///< f_tau
  double viscous_nm_s_rad = 0.0;          ///< b
  double ripple = 0.0;                    ///< dry friction varies by +- this share, twice per motor turn
};

/// Harmonic drive as a torsion spring with damping, joint side.
struct SpringDescription {
  std::array<double, 3> stiffness_nm_rad{};  ///< K1, K2, K3
  std::array<double, 2> break_nm{};          ///< torque where K1 ends, where K2 ends
  double damping_nm_s_rad = 12.0;
};

struct DriveTruth {
  std::array<double, 2> torque_constant_nm_a{};  ///< motor side, efficiency included: for positive, negative torque
  double current_bandwidth_hz = 600.0;
  double brake_torque_nm = 0.0;  ///< joint side
  double brake_release_s = 0.0;
  double brake_engage_s = 0.0;
  double short_resistance_ohm = 1.0;  ///< stage off and brake line down: the windings are shorted over it; 0: open
  double ambient_c = 25.0;
  double bus_voltage_v = 48.0;
  double supply_resistance_ohm = 0.05;  ///< the bus sags by this times the current
};

struct SensorTruth {
  double torque_noise_nm = 0.07;  ///< rms, per sample
  double torque_bandwidth_hz = 200.0;
  double torque_drift_nm = 0.2;       ///< standard deviation of a slow wander
  double torque_drift_time_s = 60.0;  ///< its correlation time
  double torque_gain_error = 0.0;     ///< share
  double torque_offset_nm = 0.0;
  double current_noise_a = 0.01;  ///< rms, per sample
  double current_offset_a = 0.0;
  double encoder_offset_rad = 0.0;        ///< joint side: the encoder reads this much too high
  double home_switch_offset_rad = 0.0;    ///< the switch's edge is this much beyond where it should be
  double limit_switch_margin_rad = 0.02;  ///< limit switches close this far outside the joint's limits
};

struct JointTruth {
  LugreFriction friction;
  SpringDescription spring;
  DriveTruth drive;
  SensorTruth sensor;
};

/// Rubber face of the hammer: F = k d (1 + c d'), never pulling (Hunt and Crossley 1975).
struct FaceDescription {
  double stiffness_n_m = 8000.0;
  double damping_s_m = 1.8;
};

/// Nail and board. The nail has no mass: d' = max(0, (F - R) / c_v), R = R0 + dR/dd d, d the depth already driven.
struct BoardDescription {
  std::string name = "styrofoam";
  double nail_length_m = 0.04;               ///< head above the board when the depth is 0
  double nail_resistance_n = 3.8;            ///< R0; a board which no nail enters has a very large one
  double nail_resistance_slope_n_m = 113.0;  ///< dR/dd
  double nail_damping_n_s_m = 11.6;          ///< c_v
  double surface_stiffness_n_m = 2.0e4;      ///< face on the bare board, rubber and board together
  double surface_damping_s_m = 1.8;
  double half_width_m = 0.15;  ///< the board reaches this far from the nail
};

/// How far a seeded plant may differ from the description: each value is drawn uniformly within +- these. Seed 0:
/// nominal.
struct PerturbationDescription {
  double friction_share = 0.05;  ///< f_c and f_s together, b likewise, per joint
  double torque_constant_share = 0.02;
  double spring_share = 0.05;
  double link_mass_share = 0.01;   ///< mass and inertia together
  double resistance_share = 0.05;  ///< R0, slope and c_v together
  double torque_offset_nm = 0.1;
  double torque_gain_share = 0.01;
  double current_offset_a = 0.01;
  double encoder_offset_rad = 5e-5;
  double home_switch_offset_rad = 5e-4;
  double nail_height_m = 5e-4;
  double nail_lateral_m = 5e-4;  ///< each of two directions in the board's plane
};

struct PlantDescription {
  std::vector<JointTruth> joints;  ///< as many as the robot has
  FaceDescription face;
  BoardDescription board;
  PerturbationDescription perturbation;
  bool rotor_coupling =
      true;  ///< spinning rotors feel and turn the links they sit in (symmetric, with gyroscopic terms)
  double stop_margin_rad = 0.06;  ///< hard end stops this far outside the joint limits
  double stop_stiffness_nm_rad = 5000.0;
  double stop_damping_nm_s_rad = 50.0;
};

/// What follows from the robot description alone: its own friction, spring and torque constants, a Styrofoam board.
PlantDescription default_plant(const RobotDescription& robot);

/// default_plant() changed by robot.source/plant.yaml (if there is one) and by the board's file.
/// Throws DescriptionError naming file, key, value, unit and allowed range.
PlantDescription load_plant(const RobotDescription& robot, const std::filesystem::path& board_yaml);

}  // namespace mrr::sim
