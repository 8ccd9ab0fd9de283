// Room: supervisor/impact. What a blow does to the arm, predicted by one of three models: of an instant, over a finite
// time in closed form, or resolved in time. May touch common/, supervisor/model. Nothing here allocates or throws but
// what says so.
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <string>

#include "supervisor/impact/external.h"
#include "supervisor/impact/swing_policy.h"
#include "supervisor/model/chain.h"

namespace mrr::sup {

/// What the hammer's face and what it strikes do. F = k d (1 + c d') on the robot along the normal, never pulling, d
/// the compression of the rubber (Hunt and Crossley 1975). A nail gives way with (F - R) / c_v while F exceeds
/// R = R0 + slope * (driven in this blow); with its head flush it gives way no more.
struct ContactLaw {
  double face_stiffness_n_m = 8000.0;                                  ///< k, > 0
  double face_damping_s_m = 1.8;                                       ///< c, >= 0
  double nail_resistance_n = std::numeric_limits<double>::infinity();  ///< R0; infinite: it does not move
  double nail_resistance_slope_n_m = 0.0;                              ///< >= 0
  double nail_damping_n_s_m = 12.0;                                    ///< c_v, > 0
  double nail_room_m = std::numeric_limits<double>::infinity();        ///< head to flush, >= 0
};

/// Reference of the active joints around the blow: q_d = q + q' s(t), one line in joint space, t = 0 at the planned
/// contact. s: from rest at -travel_s in approach_s to (0, 1, 0); to rest at stop_s/2 as 1 - 3x^2 + 2x^3; back to
/// -travel_s, rest to rest, in return_s. (Quintics, as the planner makes them.)
struct ReferenceProfile {
  double travel_s = 0.3;    ///< back-swing over speed, > 0
  double approach_s = 0.4;  ///< > 0
  double stop_s = 0.05;     ///< > 0
  double return_s = 0.8;    ///< > 0

  struct Point {
    double s = 0.0;  ///< s
    double v = 0.0;  ///< 1
    double a = 0.0;  ///< 1/s
  };
  [[nodiscard]] Point at(double t_s) const noexcept;
};

/// The drive of one joint as the robot knows it; joint side.
struct JointDrive {
  double rotor_inertia_kg_m2 = 0.0;  ///< gamma^2 I_r
  double position_gain_nm_rad = 0.0;
  double velocity_gain_nm_s_rad = 0.0;
  double lambda_1_s = 0.0;
  double carried_departure_nm = std::numeric_limits<double>::infinity();  ///< of the sensed load from the model's
  double friction_feedforward = 1.0;
  double still_velocity_rad_s = 0.01;  ///< slower: friction is fed forward in the direction of the reference
  CompensatorDescription compensator;
  FrictionDescription friction;
  double presliding_rad = 3e-4;         ///< elastic give of friction before it slides
  double compensation_nm = 0.0;         ///< f_m of the passive law in motion
  double static_compensation_nm = 0.0;  ///< ... and at rest
  double sensed_dead_band_nm = 1.0;     ///< at rest a trend lasts until the sensed torque is below it
  double sensed_trend_nm = 1.5;         ///< ... and begins above this
  double blend_s = 0.003;               ///< active torque fades into passive torque
  double resume_slew_nm_s = 2000.0;
  double stop_deceleration_rad_s2 = 10.0;
  double return_speed_rad_s = 0.8;  ///< of the unhurried way back
  double return_acceleration_rad_s2 = 10.0;
  std::array<double, 2> torque_limit_nm{};     ///< largest motor torque in positive, in negative direction
  std::array<double, 3> stiffness_nm_rad{};    ///< K1, K2, K3
  std::array<double, 2> stiffness_break_nm{};  ///< where K1 ends, where K2 ends
  double damping_nm_s_rad = 12.0;              ///< of the transmission
  bool torque_sensor = true;
  double sensor_bandwidth_hz = 200.0;
  double current_bandwidth_hz = 600.0;
};

/// An arm with its drives, ready to be struck with. Copies everything; small enough to live where it is used.
struct StrikeArm {
  /// Of a description; throws DescriptionError as Chain does.
  explicit StrikeArm(const RobotDescription& robot);

  Chain chain;
  std::array<JointDrive, kMaxJoints> drive{};
  double tick_s = 1e-3;          ///< of the control loops
  double knot_s = 4e-3;          ///< of the set points
  double lead_s = 0.012;         ///< TaskDescription::switch_lead_s: a face this near pulls the switch
  double face_radius_m = 0.012;  ///< a head further than this from the face's centre is not struck
  double sinking_share = kStillFast;
};

enum class PredictionModel : std::uint8_t {
  instant,      ///< (27)-(53): the impulse of an instant, active joints as extra inertia; microseconds
  finite_time,  ///< and what control, gravity and friction do while the contact lasts, in closed form
  resolved,     ///< links, springs, rotors, control, friction and contact law integrated over the contact
};
[[nodiscard]] const char* describe(PredictionModel model) noexcept;

struct PredictInput {
  JointVector q;                                      ///< rad, at contact
  JointVector qd;                                     ///< rad/s, just before
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();  ///< unit, from the surface into the robot, base frame
  /// free: passive; controlled: active, under its control law; held: does not move whatever happens.
  std::array<JointHold, kMaxJoints> joints{};
  ContactLaw contact;
  ReferenceProfile reference;
  double switch_lead_s = 0.012;  ///< from the switch to the planned contact, >= 0
  double passive_s = 0.2;        ///< from the switch on, > 0: then passive joints come back
  /// Where the face is when the reference is at q, above the head along the normal, m: 0 as planned.
  double early_m = 0.0;
  /// Resolved model only: so many robots of this description are struck with, the first exactly as described, the
  /// others as far from it as robots are (kRobotsDiffer). The blow given is the one nearest the middle of all. 1 to
  /// kMostRobots.
  int robots = 1;
  RotorModel rotor_model = RotorModel::sym;
  Formulation formulation = Formulation::corrected;  ///< of the instant model's internal impulses
  /// Instant model only: e, M* and t_s. NaN: from the contact law, struck with the effective mass.
  double restitution = std::numeric_limits<double>::quiet_NaN();
  double nail_mass_kg = std::numeric_limits<double>::infinity();
  double contact_s = std::numeric_limits<double>::quiet_NaN();
};

inline constexpr int kMostRobots = 32;

/// How far one robot and one nail are from their description, either way: shares, and m.
struct RobotsDiffer {
  double friction = 0.08;
  double motor_torque = 0.02;
  double spring = 0.05;
  double link_mass = 0.01;
  double nail_resistance = 0.05;
  double nail_height_m = 5e-4;
};
inline constexpr RobotsDiffer kRobotsDiffer;

/// When a blow is over: its force has been below this share of its peak for this long, as a force sensor with a
/// threshold has it. An arm that then rests on the nail until it is called back is no longer the blow.
inline constexpr double kBlowOverShare = 0.1;
inline constexpr double kBlowOver_s = 5e-3;

/// A blow as predicted. Impulses of joints are integrals over the contact of what the transmission carries.
struct Prediction {
  bool feasible = false;  ///< false: input that is not usable, or nothing yields; the other fields are then zero
  bool approaching = false;
  double impulse_n_s = 0.0;  ///< on the robot along +normal
  double contact_s = 0.0;
  double start_s = 0.0;  ///< of the contact, after the planned instant
  double peak_force_n = 0.0;
  double penetration_m = 0.0;     ///< by which the nail goes deeper
  double speed_before_m_s = 0.0;  ///< of the face along -normal, as it touches
  double speed_after_m_s = 0.0;
  double effective_mass_kg = 0.0;
  JointVector delta_qd;           ///< of the links, rad/s
  JointVector axis_impulse_nm_s;  ///< what link i gives link i-1 about the axis, all of it; signed
  JointVector blow_impulse_nm_s;  ///< the blow's part: less what carrying the arm's weight takes for so long
  JointVector carried_before_nm;  ///< torque as the contact begins, same sign
  JointVector peak_torque_nm;     ///< largest magnitude during contact
  /// Smallest and largest over PredictInput::robots; with one robot the value itself.
  double impulse_low_n_s = 0.0;
  double impulse_high_n_s = 0.0;
  JointVector axis_impulse_low_nm_s, axis_impulse_high_nm_s;
  JointVector peak_torque_low_nm, peak_torque_high_nm;
  /// Smallest and largest are the value itself.
  void as_one_robot() noexcept {
    impulse_low_n_s = impulse_high_n_s = impulse_n_s;
    axis_impulse_low_nm_s = axis_impulse_high_nm_s = axis_impulse_nm_s;
    peak_torque_low_nm = peak_torque_high_nm = peak_torque_nm;
  }
  /// The blow's part in full: link i on link i-1, at the centre of joint i, base frame; its axis component is
  /// `blow_impulse_nm_s`.
  std::array<WrenchImpulse, kMaxJoints> wrench = [] {
    std::array<WrenchImpulse, kMaxJoints> none;
    none.fill(WrenchImpulse::none());
    return none;
  }();
};

/// Empty if `input` can be used with `arm` by `model`; else one sentence naming field, value, unit and what is allowed.
/// Allocates.
[[nodiscard]] std::string validate_input(const StrikeArm& arm, const PredictInput& input, PredictionModel model);

/// Unusable input gives `feasible == false`, never NaN. The default model is the one measured best.
[[nodiscard]] Prediction predict(const StrikeArm& arm, const PredictInput& input,
                                 PredictionModel model = PredictionModel::resolved) noexcept;

/// A mass against the contact law, pressed by a constant force: what the finite-time model takes the blow's shape from.
struct LumpedBlow {
  double impulse_n_s = 0.0;
  double contact_s = 0.0;
  double peak_force_n = 0.0;
  double penetration_m = 0.0;
  double speed_after_m_s = 0.0;  ///< along -normal
};
/// `push_n` along -normal; may be negative. Ends with the contact or after `longest_s`.
[[nodiscard]] LumpedBlow lumped_blow(const ContactLaw& law, double mass_kg, double speed_m_s, double push_n,
                                     double longest_s = 0.4) noexcept;

}  // namespace mrr::sup
