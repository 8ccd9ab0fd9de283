// Room: supervisor/strike. Plans one blow: pose, speed, which joints go passive, trajectories. Everything it weighed is
// in the plan, for printing. May touch common/, supervisor/model, supervisor/impact. Not for the cycle: allocates.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "common/robot/errors.h"
#include "supervisor/impact/external.h"
#include "supervisor/impact/limits.h"
#include "supervisor/impact/prediction.h"
#include "supervisor/model/chain.h"
#include "supervisor/strike/inverse_kinematics.h"
#include "supervisor/strike/trajectory.h"

namespace mrr::sup {

/// Which joints may go passive.
enum class PassiveMode : std::uint8_t {
  planned,  ///< of all sets the one with the lowest predicted peaks, see docs/strike.md
  never,    ///< all stay active: the comparison
  always,   ///< all go passive
};

/// By what poses are ranked (theory: measures).
enum class StrikeMeasure : std::uint8_t {
  load_ratio,       ///< largest load over rated limit per newton second; smallest wins. The default
  internal_impact,  ///< w_ii (55), largest wins, as the reference has it. Protects nothing
  effective_mass,   ///< 1/(n^T W n), largest wins
};

/// What is to be struck, what is known of it, and how to choose.
struct PlanInput {
  Eigen::Vector3d head_position_m = Eigen::Vector3d::Zero();      ///< estimated centre of the nail's head, base frame
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();              ///< unit, from the board into the robot's space
  double board_distance_m = 0.0;                                  ///< head to flush, >= 0
  double restitution = 1.0;                                       ///< e, 0..1
  double nail_mass_kg = std::numeric_limits<double>::infinity();  ///< M*, > 0, infinite: rigid
  double contact_duration_s = 0.05;                               ///< t_s, > 0
  double follow_through_m = 0.005;                                ///< how far past the head the reference goes, >= 0
  ContactLaw contact;  ///< rubber and nail as far as they are known, for the prediction over the contact
  PassiveMode mode = PassiveMode::planned;
  std::optional<std::uint32_t> passive;  ///< this selection and no other, bit i = joint i; `mode` is then not looked at
  Formulation formulation = Formulation::corrected;
  StrikeMeasure measure = StrikeMeasure::load_ratio;
  RotorModel rotors = RotorModel::sym;
  JointVector start;         ///< present position, rad
  double speed_share = 1.0;  ///< of the speed the limits allow, times TaskDescription::max_speed_share; 0..1
  /// >= 1: times the speed of (59), which takes every blow for a momentary-torque event. More than 1 is for loads that
  /// were seen to be far below: motor and description still bound the speed, and predicted peaks the choice.
  double speed_factor = 1.0;
  /// > 0: not as fast as the limits allow, but the slowest blow that drives the nail this far, by P t_s / M* (33),
  /// (34), with the M* and t_s given here. A nail that was never seen to move (M* infinite) is struck as fast as
  /// allowed.
  double wanted_penetration_m = 0.0;
  std::uint64_t seed = 1;  ///< of the inverse kinematics and of the search along the null space
};

/// Empty if `input` can be planned with; else one sentence naming the field, its value, unit and what is allowed.
[[nodiscard]] std::string validate_input(const RobotDescription& robot, const PlanInput& input);

/// Loads of one joint, Nm s, magnitudes.
struct JointLoad {
  double free_nm_s = 0.0;                        ///< all joints free
  double held_nm_s = 0.0;                        ///< this one held, the others free
  double planned_nm_s = 0.0;                     ///< passive ones free, active ones controlled
  ImpulseLimits limits;                          ///< for the contact duration, half-sine
  ModeDecision decision = ModeDecision::active;  ///< by the table of docs/strike.md
  double controlled_inertia_kg_m2 = 0.0;         ///< K_D t/2 + K_P t^2/6, what `planned` adds to an active joint
  double qd_limit_rad_s = 0.0;                   ///< at impact, (59)
};

/// One selection of passive joints that was weighed at the chosen pose and speed.
struct SelectionCandidate {
  std::uint32_t passive = 0;  ///< bit i = joint i (joint order)
  /// By what the next two were predicted: resolved for the lightest, finite-time for the others, instant with the
  /// reference's equations as printed.
  PredictionModel model = PredictionModel::instant;
  bool feasible = false;            ///< nothing above a repeated peak, no passive joint falls out of its travel
  double load_ratio_per_n_s = 0.0;  ///< largest load over rated per newton second: of peaks; instant: of impulses
  double impulse_n_s = 0.0;         ///< on the nail
  double switch_lead_s = 0.0;       ///< from the switch to the planned contact; not of the instant
  double passive_s = 0.0;           ///< from the switch on, at most; not of the instant
  std::string note;                 ///< why it lost, or "chosen"
};

/// One pose that was weighed.
struct PoseCandidate {
  JointVector q;
  double tilt_rad = 0.0;
  double lateral_m = 0.0;
  double speed_m_s = 0.0;
  std::uint32_t passive = 0;
  double measure = 0.0;
  JointVector load_share;       ///< predicted axis impulse of each joint over its rated limit
  double impulse_n_s = 0.0;     ///< predicted, of the instant
  double back_swing_rad = 0.0;  ///< room: how far the joint that travels most can go back, at most what the task asks
  double swing_s = 0.0;         ///< from the back-swing to contact, if torques allow (the chosen one's is exact)
  bool feasible = false;
  std::string note;  ///< why it lost, or "chosen"
};

struct StrikePlan {
  // The blow.
  JointVector q_impact;   ///< rad
  JointVector qd_impact;  ///< rad/s
  Eigen::Vector3d head_position_m = Eigen::Vector3d::Zero();
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();
  double board_distance_m = 0.0;   ///< head to flush, as requested
  double speed_m_s = 0.0;          ///< of the face along -normal at impact
  double lateral_speed_m_s = 0.0;  ///< at right angles to it
  double tilt_rad = 0.0;
  double lateral_m = 0.0;        ///< how far off the head's centre the face is aimed (0 unless out of reach)
  double speed_reduction = 1.0;  ///< < 1: the limits of the gears made the blow slower

  // Modes and loads.
  std::uint32_t passive = 0;  ///< bit i = joint i passive at impact (joint order, not selection bits)
  std::array<JointLoad, kMaxJoints> loads{};
  ImpactPrediction prediction;  ///< as planned
  double impulse_n_s = 0.0;     ///< predicted, as planned, over the contact: with what drive and weight press meanwhile
  Prediction blow;              ///< of the resolved model, as planned; not feasible with `as_printed`
  double weight_force_n = 0.0;  ///< of passive joints, on the nail along -normal while the contact lasts
  double effective_mass_kg = 0.0;  ///< 1/(n^T W n), as planned
  StrikeMeasure measure = StrikeMeasure::load_ratio;
  double measure_value = 0.0;

  // Motion. All times are whole knots except `switch_time`.
  JointTrajectory approach;         ///< start -> back-swing start, rest to rest
  JointTrajectory strike;           ///< back-swing start -> impact -> stop past the head -> back-swing start
  Duration contact_time;            ///< within `strike`: the impact state
  Duration stop_time;               ///< within `strike`: at rest past the head
  Duration switch_time;             ///< within `strike`: contact - lead; blend finished before contact
  Duration passive_time;            ///< how long the passive phase may last, from the switch on
  JointVector q_back_swing;         ///< back-swing start, rad
  JointVector q_stop;               ///< rad
  double back_swing_rad = 0.0;      ///< largest joint travel
  double follow_through_m = 0.0;    ///< of the reference past the head; >= the request's unless capped
  std::string follow_through_note;  ///< empty, or why it is not the one asked for

  // The reasons.
  std::vector<PoseCandidate> poses;            ///< best first
  std::vector<SelectionCandidate> selections;  ///< at the chosen pose, the chosen first, then the lightest; at most 16
  int selections_weighed = 0;                  ///< at the chosen pose
  std::string why;                             ///< one sentence
};

/// Plans the blow (theory: the strike). Deterministic. Throws PlanError with one clear sentence.
[[nodiscard]] StrikePlan plan(const RobotDescription& robot, const Chain& chain, const PlanInput& input);

/// Joint velocity that moves the face along -normal, at 1 m/s: the least total motion of joints, each relative to its
/// limit, sideways motion penalised softly so that a singular (stretched) pose stays well behaved. Zero if the face
/// cannot move that way. `qd_limits`: > 0, rad/s.
[[nodiscard]] JointVector unit_strike_velocity(const Jacobian& J_h, const Eigen::Vector3d& normal,
                                               const JointVector& qd_limits) noexcept;

/// A planned blow as the prediction models take it.
[[nodiscard]] PredictInput predict_input(const StrikePlan& plan, const ContactLaw& contact) noexcept;

[[nodiscard]] const char* describe(StrikeMeasure measure) noexcept;
[[nodiscard]] const char* unit_of(StrikeMeasure measure) noexcept;

/// The plan as text for a terminal: poses ranked, joints, selections, motion; units in every table.
[[nodiscard]] std::string report(const RobotDescription& robot, const StrikePlan& plan);

}  // namespace mrr::sup
