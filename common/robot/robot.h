// Room: common/robot. The robot description: URDF + YAML, checked once at the edge, immutable afterwards. Host only.
// Cores never see text; what a core needs is copied from here into its own configuration.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

namespace mrr {

inline constexpr int kMaxJoints = 16;

/// A rigid link, its frame attached at its proximal joint (URDF convention: the joint's own frame).
struct LinkDescription {
  std::string name;
  double mass_kg = 0.0;
  Eigen::Vector3d com_m = Eigen::Vector3d::Zero();          ///< centre of mass, link frame
  Eigen::Matrix3d inertia_kg_m2 = Eigen::Matrix3d::Zero();  ///< about the centre of mass, link-frame axes
};

/// Fixed transform from the parent link's frame to the joint's frame at q = 0.
struct FrameOffset {
  Eigen::Matrix3d rotation = Eigen::Matrix3d::Identity();  ///< parent <- joint
  Eigen::Vector3d translation_m = Eigen::Vector3d::Zero();
};

/// Harmonic drive: catalogue ratings and torsional stiffness, all at the output (joint) side.
struct TransmissionDescription {
  std::string type;         ///< e.g. "SHD-17"
  double gear_ratio = 0.0;  ///< motor turns per joint turn, > 1
  double rated_nm = 0.0;
  double repeated_peak_nm = 0.0;
  double momentary_peak_nm = 0.0;
  std::array<double, 3> stiffness_nm_rad{};    ///< K1, K2, K3
  std::array<double, 2> stiffness_break_nm{};  ///< torque where K1 ends, where K2 ends
};

struct MotorDescription {
  double rotor_inertia_kg_m2 = 0.0;            ///< at the motor shaft
  double torque_constant_positive_nm_a = 0.0;  ///< motor side, efficiency included, for positive torque
  double torque_constant_negative_nm_a = 0.0;
  double peak_current_a = 0.0;
  double continuous_current_a = 0.0;
  double thermal_time_constant_s = 0.0;  ///< winding, for the I^2 t model
  double max_winding_temperature_c = 0.0;
  double max_velocity_rad_s = 0.0;  ///< motor shaft
};

/// Identified friction, joint side (theory: equation 5).
struct FrictionDescription {
  double coulomb_nm = 0.0;
  double static_nm = 0.0;
  double stribeck_decay_s2_rad2 = 0.0;  ///< f_tau
  double viscous_nm_s_rad = 0.0;
};

/// Decomposition-based compensator, order of the vectors: viscous b, Coulomb f_c, static f_s, Stribeck f_tau.
struct CompensatorDescription {
  bool enabled = true;
  std::array<double, 4> integral_gain{};   ///< K_i
  std::array<double, 4> integral_limit{};  ///< u_max
  std::array<double, 4> robust_gain{};     ///< rho
  std::array<double, 4> robust_width{};    ///< eps
  double position_gain_nm = 0.0;           ///< rho_q
  double position_width_rad_s = 0.0;       ///< eps_q
};

struct ControlDescription {
  double lambda_1_s = 0.0;
  double position_gain_nm_rad = 0.0;    ///< K_P; default lambda^2 J
  double velocity_gain_nm_s_rad = 0.0;  ///< K_D; default 2 lambda J
  bool friction_by_reference = false;   ///< fed forward in the direction of the set points, not of the motion
  double friction_feedforward = 1.0;    ///< share of the identified friction fed forward, 0-1.2
  CompensatorDescription compensator;
  double passive_compensation = 0.0;  ///< f_m / f_s, 0 <= . < 0.9; 0: passive without compensation
  double passive_blend_s = 0.003;     ///< time in which active torque fades into passive torque
  /// A sensed load further than this from the model torque is contact: the joint yields to it instead of carrying it.
  double carried_departure_nm = 0.0;        ///< default a quarter of the rated torque
  double resume_torque_slew_nm_s = 2000.0;  ///< coming back to active
  double max_passive_s = 0.5;               ///< the module returns to active by itself after this
  double max_passive_travel_rad = 0.35;     ///< ... or after this much motion
};

struct SensorsDescription {
  std::int32_t encoder_counts_per_turn = 0;  ///< motor turn
  bool encoder_absolute = false;             ///< multi-turn absolute: no homing needed
  bool torque_sensor = false;
  double torque_full_scale_nm = 0.0;
  double torque_bandwidth_hz = 0.0;
  double torque_noise_nm = 0.0;       ///< rms, specification
  double current_full_scale_a = 0.0;  ///< of the sensor and of the power stage's set point
};

struct JointLimits {
  double lower_rad = 0.0;  ///< soft: targets and set points stay within; default the URDF's
  double upper_rad = 0.0;
  double velocity_rad_s = 0.0;  ///< from the URDF
  double torque_nm = 0.0;       ///< from the URDF (effort): commanded joint-side torque
  double acceleration_rad_s2 = 0.0;
  double jerk_rad_s3 = 0.0;  ///< default: reaches the acceleration limit in 5 ms
  double following_error_rad = 0.0;
  double following_error_time_s = 0.0;
};

enum class HomingMethod : std::uint8_t {
  on_switch,  ///< searched for, and met slowly
  here,       ///< where the joint stands is zero
};

struct HomingDescription {
  HomingMethod method = HomingMethod::on_switch;
  double switch_position_rad = 0.0;  ///< where the home switch's edge is, and what the joint reads there
  int direction = -1;                ///< -1 or +1: which way the search starts
  double fast_rad_s = 0.0;
  double slow_rad_s = 0.0;
  double timeout_s = 0.0;
  double max_travel_rad = 0.0;               ///< 0: not capped
  double max_torque_nm = 0.0;                ///< beyond what the joint carries; 0: not capped
  std::optional<double> index_position_rad;  ///< given: goes on to the encoder's index pulse, which is there
};

/// What a joint does about a source that fell silent; numbers as in objects 2131h to 2133h.
enum class SilenceReaction : std::uint8_t {
  report = 0,  ///< says so and goes on
  hold = 2,    ///< controlled stop, holds under torque
  stop = 3,    ///< controlled stop, brake, FAULT
  damp = 4,    ///< works against its velocity, brake, FAULT
};

/// How long a source may be silent, and what then.
struct WatchdogDescription {
  int missing_knots = 2;  ///< in a row
  SilenceReaction knots = SilenceReaction::hold;
  double torque_target_s = 0.1;  ///< torque mode; 0: not watched
  SilenceReaction torque_target = SilenceReaction::hold;
  double heartbeat_s = 0.5;  ///< of the supervisor
  SilenceReaction heartbeat = SilenceReaction::stop;
  double sync_s = 0.05;  ///< while led by knots; 0: not watched
  SilenceReaction sync = SilenceReaction::stop;
  SilenceReaction bus_off = SilenceReaction::stop;
  SilenceReaction torque_heartbeat = SilenceReaction::stop;  ///< in torque mode
  SilenceReaction torque_bus_off = SilenceReaction::stop;
  double passive_knots_s = 0.0;  ///< while passive; 0: not watched
  SilenceReaction passive_knots = SilenceReaction::report;
  SilenceReaction passive_heartbeat = SilenceReaction::report;
  SilenceReaction passive_sync = SilenceReaction::report;
  SilenceReaction passive_bus_off = SilenceReaction::report;
};

struct BrakeDescription {
  double release_s = 0.0;  ///< dwell from releasing to free
  double engage_s = 0.0;
};

/// Joint i turns about `axis`, fixed in its own frame; link i moves with it.
struct JointDescription {
  std::string name;
  FrameOffset offset;                               ///< parent link frame -> joint frame
  Eigen::Vector3d axis = Eigen::Vector3d::UnitZ();  ///< unit, joint frame
  LinkDescription link;
  JointLimits limits;
  TransmissionDescription transmission;
  MotorDescription motor;
  FrictionDescription friction;
  ControlDescription control;
  SensorsDescription sensors;
  HomingDescription homing;
  BrakeDescription brake;
  WatchdogDescription watchdog;
  double torque_offset_nm = 0.0;   ///< what the torque sensor reads too high, as calibrated
  double park_rad = 0.0;           ///< where the joint rests, brake engaged, when the robot is off
  std::uint8_t node_id = 0;        ///< CANopen node id, 2-127
  std::uint8_t selection_bit = 0;  ///< bit in the 32-bit selection mask

  /// Deceleration of controlled stops, of the module and of the supervisor alike: gentle, because the arm's weight is
  /// carried besides.
  [[nodiscard]] double stop_deceleration_rad_s2() const { return 0.4 * limits.acceleration_rad_s2; }
  /// Reflected rotor inertia gamma^2 I_r, kg m^2.
  [[nodiscard]] double reflected_inertia_kg_m2() const {
    return transmission.gear_ratio * transmission.gear_ratio * motor.rotor_inertia_kg_m2;
  }
};

/// The hammer face: a frame fixed in the last link; its z axis points out of the face, towards what is struck.
struct HammerDescription {
  FrameOffset face;
  double face_radius_m = 0.0;
  double max_tilt_rad = 0.0;  ///< largest angle between face axis and nail axis at impact
};

struct BusDescription {
  std::string interface;  ///< e.g. "vcan0"
  bool fd = false;
  double bit_rate = 1e6;
  double data_bit_rate = 5e6;    ///< FD only
  double knot_rate_hz = 250.0;   ///< SYNC and set-point knots
  double loop_rate_hz = 1000.0;  ///< control loop of the modules
  double max_load = 0.8;         ///< share of the bit rate that may be planned
};

/// The nail and how hard it may be hit; where it really is, the emulator perturbs.
struct TaskDescription {
  Eigen::Vector3d nail_position_m = Eigen::Vector3d::Zero();  ///< where the nail enters the board, base frame
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();          ///< unit, from the board into the robot's space
  double nail_height_m = 0.04;                                ///< head above the board at the start
  double flush_tolerance_m = 0.0005;
  int max_swings = 20;
  int still_swings = 3;                      ///< stop after this many swings which moved nothing
  double still_tolerance_m = 0.0015;         ///< smallest motion of the head that can be told; less is not moving
  double impacts_over_momentary_peak = 1e4;  ///< N of equation 59
  double assumed_contact_s = 0.05;           ///< t_s before anything was learnt
  double back_swing_rad = 0.6;               ///< largest joint travel of the back-swing
  double max_speed_share = 1.0;              ///< of the speed that the limits allow
  double switch_lead_s = 0.012;              ///< planned time from the passive switch to contact
};

struct RobotDescription {
  std::string name;
  std::filesystem::path source;                   ///< the directory it was read from
  std::uint64_t source_hash = 0;                  ///< of the files there, when they were read
  Eigen::Vector3d gravity_m_s2{0.0, 0.0, -9.81};  ///< base frame
  std::vector<JointDescription> joints;           ///< from base to tip
  HammerDescription hammer;
  BusDescription bus;
  TaskDescription task;

  [[nodiscard]] int dof() const { return static_cast<int>(joints.size()); }
};

/// Reads `directory`/robot.urdf and `directory`/robot.yaml, checks everything.
/// Throws DescriptionError (common/robot/errors.h) naming file, line, key, value, unit and allowed range.
[[nodiscard]] RobotDescription load_robot(const std::filesystem::path& directory);
/// The same with `yaml` in place of what robot.yaml says: would it be usable?
[[nodiscard]] RobotDescription load_robot(const std::filesystem::path& directory, const std::string& yaml);
/// The files it was read from say something else by now, or are gone. False for one that came from no file.
[[nodiscard]] bool source_changed(const RobotDescription& robot);
/// A joint as messages name it: "joint 2 (shoulder)", counted from 1 at the base.
[[nodiscard]] std::string joint_words(const RobotDescription& robot, int joint);

}  // namespace mrr
