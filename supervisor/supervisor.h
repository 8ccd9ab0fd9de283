// Room: supervisor. The robot's core as an object that is stepped: bring-up, streaming, arming the switch, watching the
// blow, coming back. May touch common, can_protocol and the parts of this room. No I/O, no clock; no heap in step().
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>

#include "can_protocol/client.h"
#include "common/core/containers.h"
#include "common/core/time.h"
#include "common/robot/robot.h"
#include "supervisor/master/calibration.h"
#include "supervisor/master/node_proxy.h"
#include "supervisor/model/chain.h"
#include "supervisor/strike/contact_observer.h"
#include "supervisor/strike/planner.h"
#include "supervisor/strike/switch_condition.h"

namespace mrr::sup {

/// Times that are policy, not physics.
struct SupervisorConfig {
  Duration step = milliseconds(1);                             ///< SYNC goes out every knot period, a multiple of it
  std::array<std::uint32_t, kMaxJoints> configuration_hash{};  ///< expected of each module
  Duration dwell = milliseconds(200);                          ///< at rest before a swing
  Duration arm_ahead = milliseconds(400);           ///< the selection is armed this long before it takes effect
  Duration acknowledge_before = milliseconds(160);  ///< not acknowledged by then: the swing is aborted
  bool start_disabled = false;  ///< activity is `disabled` until somebody enables, not `bringing_up`
};

enum class Activity : std::uint8_t {
  bringing_up,  ///< not all joints are enabled
  holding,
  approaching,  ///< to the back-swing start
  dwelling,
  swinging,
  resuming,  ///< passive joints come back
  returning,
  stopping,     ///< a swing was aborted
  faulted,      ///< a joint reports a fault or is lost; the others hold
  moving,       ///< from rest to rest, as asked
  homing,       ///< one joint looks for its switch, the others hold
  passive,      ///< some joints were let go, the others hold
  disabled,     ///< nobody is wanted enabled
  calibrating,  ///< one joint calibrates itself, the others hold
};
[[nodiscard]] const char* describe(Activity activity) noexcept;
/// A motion, or joints that are let go, is under way. Not so: a faulted robot, which may still be stopping.
[[nodiscard]] bool moves(Activity activity) noexcept;

enum class EventKind : std::uint8_t {
  node_stage,    ///< joint, value: NodeStage
  node_problem,  ///< joint, value: NodeProblem
  all_enabled,
  approach_began,
  swing_began,
  selection_armed,  ///< value: sequence
  selection_acknowledged,
  selection_pulled,  ///< `now` was sent: contact comes earlier than armed for
  selection_cancelled,
  joint_passive,  ///< joint: seen in its mode display
  contact_began,
  contact_ended,
  joints_active,
  swing_ended,
  swing_aborted,  ///< value: AbortReason
  fault,          ///< joint, value: emergency code
  disabled,
  motion_began,
  motion_ended,
  homing_began,          ///< joint
  homing_ended,          ///< joint, value: ActionState
  joint_active,          ///< joint: back from passive
  command_ended,         ///< joint, value: number of the command, detail: CommandFailure
  calibration_began,     ///< joint, value: CalibrationKind
  calibration_progress,  ///< joint, value: percent
  calibration_ended,     ///< joint, value: ActionState
};
[[nodiscard]] const char* describe(EventKind kind) noexcept;

struct Event {
  Time at;
  EventKind kind{};
  int joint = -1;  ///< 0-based; -1: the robot
  std::uint32_t value = 0;
  std::uint32_t detail = 0;
};
using EventQueue = StaticVector<Event, 64>;

enum class AbortReason : std::uint8_t {
  none,
  not_acknowledged,  ///< a module did not acknowledge the selection in time
  not_following,     ///< a joint that should follow its knots does not
  condition,         ///< the approach was not the planned one; see SwingOutcome::switch_state
  joint_fault,
  stop_requested,
};
[[nodiscard]] const char* describe(AbortReason reason) noexcept;

/// What the robot itself saw of a swing.
struct SwingOutcome {
  bool done = false;
  AbortReason aborted = AbortReason::none;
  ContactReport contact;     ///< phase none: nothing was hit
  SwitchState switch_state;  ///< when the switch was decided
  bool pulled = false;       ///< the switch was pulled before its armed time
  Time began;                ///< trajectory time zero, supervisor's clock
  Time planned_contact;
  Time switch_effective;                               ///< armed for, supervisor's clock
  std::array<Time, kMaxJoints> passive_seen{};         ///< SYNC at which the joint showed passive; ns < 0: never
  std::array<double, kMaxJoints> peak_torque_nm{};     ///< joint torque sensors at the knot rate, during contact
  std::array<double, kMaxJoints> axis_impulse_nm_s{};  ///< the same, summed over the contact; signed
  bool torque_sensed = true;  ///< no joint said meanwhile that it went by the model for want of its sensor
};

/// One swing as the cycle needs it; copied in by execute().
struct SwingProgram {
  JointTrajectory approach;
  JointTrajectory strike;
  Duration contact_time;
  Duration switch_time;
  Duration passive_time;
  std::uint32_t passive = 0;  ///< bit i: joint i
  Eigen::Vector3d head_position_m = Eigen::Vector3d::Zero();
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();
  double board_distance_m = 0.0;  ///< head to board: a passive arm that sinks with the nail is caught before
  double speed_m_s = 0.0;         ///< planned, of the face at impact
  JointVector q_back_swing;
};
[[nodiscard]] SwingProgram program_of(const StrikePlan& plan);

enum class Refusal : std::uint8_t {
  none,
  not_ready,
  wrong_start,
  not_usable,
  unknown_joint,
  joint_unavailable,  ///< not enabled
  not_passive,
};
[[nodiscard]] const char* describe(Refusal refusal) noexcept;

enum class CommandKind : std::uint8_t { none, enable, disable, home, move, passive, active, stop, reset, calibrate };
[[nodiscard]] const char* describe(CommandKind kind) noexcept;

enum class CommandState : std::uint8_t { none, running, done, failed };
[[nodiscard]] const char* describe(CommandState state) noexcept;

enum class CommandFailure : std::uint8_t {
  none,
  superseded,  ///< another command came
  stopped,
  joint_fault,
  timed_out,
  homing_failed,
  refused_by_joint,
  not_following,
  joint_refused,       ///< it must not be used: another protocol or configuration
  calibration_failed,  ///< see Supervisor::calibration()
};
[[nodiscard]] const char* describe(CommandFailure failure) noexcept;

/// The last command, and what became of it. Commands end by themselves; one ends when the next comes.
struct CommandStatus {
  std::uint32_t number = 0;  ///< counts up from 1
  CommandKind kind = CommandKind::none;
  int joint = -1;
  CommandState state = CommandState::none;
  CommandFailure failure = CommandFailure::none;
  Time since;
};

/// What a hammering session needs of a robot: the supervisor itself, or its shadow in another thread.
class RobotPort {
 public:
  virtual ~RobotPort() = default;
  /// Bring all joints up and enable them; false: stop, then let go of them with their brakes on.
  virtual void enable(bool wanted) = 0;
  /// Run a swing. Accepted only when holding, and only if it starts where the robot is.
  [[nodiscard]] virtual Refusal execute(const StrikePlan& plan) = 0;
  [[nodiscard]] virtual Activity activity() const = 0;
  [[nodiscard]] virtual const SwingOutcome& outcome() const = 0;
  /// Where the joints are told to be, rad.
  [[nodiscard]] virtual JointVector reference_position() const = 0;
  [[nodiscard]] virtual NodeReport report(int joint) const = 0;
};

class Supervisor final : public RobotPort {
 public:
  /// Checks the bus budget and the model against KDL; throws DescriptionError naming what does not fit.
  Supervisor(const RobotDescription& robot, const SupervisorConfig& config);

  /// One step of `config.step`. Frames that arrived since the last one, stamped on the same clock as `now`. A step that
  /// could not be made in time is left out: `now` stays a multiple of `config.step` after the first.
  void step(Time now, std::span<const can::ReceivedFrame> received, can::TransmitQueue& tx) noexcept;

  void enable(bool wanted) noexcept override;
  [[nodiscard]] Refusal execute(const StrikePlan& plan) noexcept override;
  /// Controlled stop, then hold. While joints are passive, once they are back.
  void stop() noexcept;
  /// Acknowledge the faults there are now; joints are brought up again, as soon as all are at rest, and held where they
  /// are. Until then a joint that was lost and came back stays braked. Refused nodes are asked again.
  void recover() noexcept;
  /// A motion from rest to rest, planned by plan_move(). Accepted only when holding, and if it starts where the robot
  /// is.
  [[nodiscard]] Refusal move(const JointTrajectory& motion) noexcept;
  /// Homing of one joint, the others hold. Accepted when nobody moves and the joint is enabled.
  [[nodiscard]] Refusal home(int joint) noexcept;
  /// One joint calibrates itself, the others hold. Accepted only when holding.
  [[nodiscard]] Refusal calibrate(int joint, const CalibrationSettings& settings) noexcept;
  /// The last calibration, also while it goes on.
  [[nodiscard]] const CalibrationReport& calibration() const noexcept { return calibration_.report(); }
  /// Let one more joint go passive now; it comes back by itself after its longest time or travel. Accepted when holding
  /// or when others are passive already.
  [[nodiscard]] Refusal set_passive(int joint) noexcept;
  /// Back to active, to hold where it is.
  [[nodiscard]] Refusal set_active(int joint) noexcept;
  [[nodiscard]] const CommandStatus& command() const noexcept { return command_status_; }
  /// Joints that were let go by set_passive(), bit i: joint i.
  [[nodiscard]] std::uint32_t let_go() const noexcept { return let_go_; }

  [[nodiscard]] Activity activity() const noexcept override { return activity_; }
  [[nodiscard]] const Chain& chain() const noexcept { return chain_; }
  [[nodiscard]] const NodeProxy& node(int joint) const noexcept { return nodes_[at(joint)]; }
  [[nodiscard]] const SwingOutcome& outcome() const noexcept override { return outcome_; }
  [[nodiscard]] JointVector reference_position() const noexcept override { return reference_.q; }
  [[nodiscard]] NodeReport report(int joint) const noexcept override { return nodes_[at(joint)].report(); }
  /// Where the joints are told to be, by the last knot sent.
  [[nodiscard]] const JointMotion& reference() const noexcept { return reference_; }
  /// Measured, rad.
  [[nodiscard]] JointVector measured_position() const noexcept;
  /// Events since the caller last cleared them; when full, later ones are dropped and counted.
  [[nodiscard]] EventQueue& events() noexcept { return events_; }
  [[nodiscard]] std::uint32_t dropped_events() const noexcept { return dropped_events_; }
  [[nodiscard]] const ContactObserver& observer() const noexcept { return observer_; }

 private:
  static constexpr std::size_t at(int i) noexcept { return static_cast<std::size_t>(i); }
  void emit(EventKind kind, int joint = -1, std::uint32_t value = 0, std::uint32_t detail = 0) noexcept;
  [[nodiscard]] bool may_sync() const noexcept;
  [[nodiscard]] bool sync_due() const noexcept;
  void watch_nodes() noexcept;
  void recover_if_asked() noexcept;
  void enter_faulted() noexcept;
  void disable_if_asked() noexcept;
  void begin_command(CommandKind kind, int joint = -1) noexcept;
  void end_command(CommandFailure failure) noexcept;
  void end_command_of(CommandKind kind, CommandFailure failure) noexcept;
  void give_up_missing() noexcept;
  void advance_command() noexcept;
  [[nodiscard]] bool only_refused_are_missing() const noexcept;
  void advance_homing() noexcept;
  void advance_calibration() noexcept;
  void stop_action() noexcept;
  void tell_action_ended() noexcept;
  void advance_let_go() noexcept;
  void take_back() noexcept;
  [[nodiscard]] bool coming_back() const noexcept;
  [[nodiscard]] bool is_joint(int joint) const noexcept { return joint >= 0 && joint < dof_; }
  [[nodiscard]] bool at_rest_now() const noexcept;
  [[nodiscard]] bool acting_now() const noexcept;
  [[nodiscard]] bool blow_over() const noexcept;
  [[nodiscard]] bool too_late_to_cancel() const noexcept;
  void close_swing() noexcept;
  void stop_now() noexcept;
  void on_sync(can::TransmitQueue& tx) noexcept;
  void on_cycle() noexcept;
  void advance_activity() noexcept;
  void advance_selection(can::TransmitQueue& tx) noexcept;
  void stream_knots(can::TransmitQueue& tx) noexcept;
  void begin_motion(const JointTrajectory& trajectory, Activity activity) noexcept;
  [[nodiscard]] bool pull_due() const noexcept;
  void pull_selection(can::TransmitQueue& tx) noexcept;
  void begin_resume() noexcept;
  void begin_return() noexcept;
  void abort_swing(AbortReason reason) noexcept;
  void finish_swing() noexcept;
  [[nodiscard]] JointTrajectory stopping_motion() const noexcept;
  void withdraw_selection() noexcept;
  void send_selection(std::uint32_t passive, can::SelectionAction action, Time effective) noexcept;
  [[nodiscard]] std::uint32_t wire_mask(std::uint32_t passive) const noexcept;
  [[nodiscard]] bool acknowledged(const NodeProxy& node) const noexcept;
  [[nodiscard]] Time knot_time(std::int64_t knot) const noexcept { return first_sync_ + sync_period_ * knot; }
  [[nodiscard]] bool motion_ended() const noexcept;
  [[nodiscard]] bool sinking() const noexcept;
  /// All joints but those in `except` (bit i) are led by knots.
  [[nodiscard]] bool all_follow(std::uint32_t except = 0) const noexcept;

  RobotDescription robot_;
  SupervisorConfig config_;
  Chain chain_;
  MotionLimits limits_;
  int dof_;
  Duration sync_period_;
  int steps_per_sync_;
  std::array<NodeProxy, kMaxJoints> nodes_;
  std::array<NodeStage, kMaxJoints> shown_stage_{};
  std::array<NodeProblem, kMaxJoints> shown_problem_{};

  Time now_;
  Time started_;
  std::int64_t step_count_ = 0;
  std::int64_t sync_ = -1;  // index of the last SYNC; knot k is reached at SYNC k
  Time first_sync_;
  Time synced_;  // when the last SYNC went out, which may be a cycle late: joints sampled then
  Time last_heartbeat_;
  bool cycle_seen_ = false;
  bool wanted_ = false;
  bool disable_wanted_ = false;
  bool stop_wanted_ = false;
  bool recover_wanted_ = false;

  Activity activity_ = Activity::bringing_up;
  Time activity_since_;
  JointTrajectory motion_;
  std::int64_t motion_start_ = 0;  // knot at which motion_ is at t = 0
  std::int64_t last_knot_ = 0;     // the last one sent; reference_ is what it said
  JointMotion reference_;
  std::uint32_t detached_ = 0;  // joints that motion_ no longer leads: they stay where they took over
  std::uint32_t held_ = 0;      // joints that failed: not enabled again before recover()
  std::uint32_t given_up_ = 0;  // joints that were not enabled when bring-up failed: not before somebody asks again
  std::uint32_t let_go_ = 0;    // passive by set_passive()
  int acting_joint_ = -1;       // homes or calibrates, or did so last
  CalibrationRun calibration_;
  std::uint8_t shown_progress_ = 0;
  CommandStatus command_status_;
  std::uint16_t knot_sequence_ = 0;
  SwingProgram program_;
  std::optional<SwitchCondition> condition_;
  ContactObserver observer_;
  ContactSample sample_;
  SwingOutcome outcome_;
  bool swing_open_ = false;  // executed, not done
  ContactPhase contact_phase_ = ContactPhase::none;
  int astray_cycles_ = 0;

  enum class Selection : std::uint8_t { none, waiting, armed, in_force, releasing };
  Selection selection_ = Selection::none;
  can::SelectionCommand command_;
  bool command_pending_ = false;  // repeated every SYNC until acknowledged
  std::uint8_t selection_sequence_ = 0;
  bool acknowledged_ = false;

  EventQueue events_;
  std::uint32_t dropped_events_ = 0;
};

}  // namespace mrr::sup
