#include "supervisor/supervisor.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "common/robot/errors.h"
#include "supervisor/impact/swing_policy.h"
#include "supervisor/master/bus_budget.h"
#include "supervisor/model/kdl_reference.h"

namespace mrr::sup {

namespace {

constexpr std::int8_t kModePassive = -1;
constexpr std::int64_t kKnotsAhead = 2;               // knot sent at SYNC k is latched at k+1 and reached at k+2
constexpr Duration kListenFirst = milliseconds(150);  // for modules that boot together with the supervisor
constexpr Duration kHeartbeatPeriod = milliseconds(50);
constexpr double kReturnShare = 0.4;    // of the limits, for the unhurried way back
constexpr double kEchoStep_rad = 4e-3;  // within the modules' resynchronisation window
constexpr double kStartTolerance_rad = 1e-3;
constexpr double kSelfCheckTolerance = 1e-9;
constexpr double kContactGate_m = 0.015;  // how far off the head's height may have been estimated
/// SYNCs between arming and the half turn of the SYNC counter.
constexpr int kCounterMargin = 10;
/// A SYNC goes out this part of its period late at the latest.
constexpr std::int64_t kLatestSyncShare = 4;
/// A joint that ignores its knots for this long is not doing what it is told.
constexpr int kAstrayCycles = 3;
/// A selection by hand that is not acknowledged by then is taken back.
constexpr Duration kSelectTimeout = milliseconds(300);
/// Beyond the module's own timeout, for stopping and the way back to set points.
constexpr Duration kActionGrace = milliseconds(3000);
constexpr Duration kIdentificationLimit = milliseconds(600'000);
constexpr Duration kCalibrationLimit = milliseconds(30'000);
constexpr Duration kCommandTimeout = milliseconds(8000);

// Reports a fault, or fell silent.
bool unusable(NodeStage stage) noexcept { return stage == NodeStage::faulted || stage == NodeStage::lost; }

// What no joint of a robot that was brought up may be: a fault, silence, or a boot that made it forget everything.
bool out_of_action(NodeStage stage) noexcept {
  return stage != NodeStage::idle && stage != NodeStage::enabling && stage != NodeStage::enabled;
}

std::uint8_t sync_counter(std::int64_t sync) noexcept {
  return static_cast<std::uint8_t>(sync % kSyncCounterOverflow + 1);
}

}  // namespace

const char* describe(Activity activity) noexcept {
  switch (activity) {
    case Activity::bringing_up:
      return "bringing up";
    case Activity::holding:
      return "holding";
    case Activity::approaching:
      return "approaching";
    case Activity::dwelling:
      return "dwelling";
    case Activity::swinging:
      return "swinging";
    case Activity::resuming:
      return "resuming";
    case Activity::returning:
      return "returning";
    case Activity::stopping:
      return "stopping";
    case Activity::faulted:
      return "faulted";
    case Activity::moving:
      return "moving";
    case Activity::homing:
      return "homing";
    case Activity::passive:
      return "passive";
    case Activity::disabled:
      return "disabled";
    case Activity::calibrating:
      return "calibrating";
  }
  return "?";
}

bool moves(Activity activity) noexcept {
  switch (activity) {
    case Activity::approaching:
    case Activity::dwelling:
    case Activity::swinging:
    case Activity::resuming:
    case Activity::returning:
    case Activity::stopping:
    case Activity::moving:
    case Activity::homing:
    case Activity::passive:
    case Activity::calibrating:
      return true;
    case Activity::bringing_up:
    case Activity::holding:
    case Activity::faulted:
    case Activity::disabled:
      return false;
  }
  return false;
}

const char* describe(EventKind kind) noexcept {
  switch (kind) {
    case EventKind::node_stage:
      return "node stage";
    case EventKind::node_problem:
      return "node problem";
    case EventKind::all_enabled:
      return "all joints enabled";
    case EventKind::approach_began:
      return "approach began";
    case EventKind::swing_began:
      return "swing began";
    case EventKind::selection_armed:
      return "selection armed";
    case EventKind::selection_acknowledged:
      return "selection acknowledged";
    case EventKind::selection_pulled:
      return "selection pulled ahead";
    case EventKind::selection_cancelled:
      return "selection cancelled";
    case EventKind::joint_passive:
      return "joint passive";
    case EventKind::contact_began:
      return "contact began";
    case EventKind::contact_ended:
      return "contact ended";
    case EventKind::joints_active:
      return "joints active";
    case EventKind::swing_ended:
      return "swing ended";
    case EventKind::swing_aborted:
      return "swing aborted";
    case EventKind::fault:
      return "fault";
    case EventKind::disabled:
      return "disabled";
    case EventKind::motion_began:
      return "motion began";
    case EventKind::motion_ended:
      return "motion ended";
    case EventKind::homing_began:
      return "homing began";
    case EventKind::homing_ended:
      return "homing ended";
    case EventKind::joint_active:
      return "joint active";
    case EventKind::command_ended:
      return "command ended";
    case EventKind::calibration_began:
      return "calibration began";
    case EventKind::calibration_progress:
      return "calibration progress";
    case EventKind::calibration_ended:
      return "calibration ended";
  }
  return "?";
}

const char* describe(AbortReason reason) noexcept {
  switch (reason) {
    case AbortReason::none:
      return "not aborted";
    case AbortReason::not_acknowledged:
      return "a joint did not acknowledge the mode switch in time";
    case AbortReason::not_following:
      return "a joint stopped following its set points";
    case AbortReason::condition:
      return "the approach was not the planned one";
    case AbortReason::joint_fault:
      return "a joint reported a fault or was lost";
    case AbortReason::stop_requested:
      return "a stop was asked for";
  }
  return "?";
}

const char* describe(Refusal refusal) noexcept {
  switch (refusal) {
    case Refusal::none:
      return "accepted";
    case Refusal::not_ready:
      return "the robot is not holding still with all joints enabled";
    case Refusal::wrong_start:
      return "the motion does not start where the robot is";
    case Refusal::not_usable:
      return "the motion is empty, not finite, or of another robot";
    case Refusal::unknown_joint:
      return "there is no such joint";
    case Refusal::joint_unavailable:
      return "the joint is not enabled";
    case Refusal::not_passive:
      return "the joint is not passive";
  }
  return "?";
}

const char* describe(CommandKind kind) noexcept {
  switch (kind) {
    case CommandKind::none:
      return "none";
    case CommandKind::enable:
      return "enable";
    case CommandKind::disable:
      return "disable";
    case CommandKind::home:
      return "home";
    case CommandKind::move:
      return "move";
    case CommandKind::passive:
      return "passive";
    case CommandKind::active:
      return "active";
    case CommandKind::stop:
      return "stop";
    case CommandKind::reset:
      return "reset";
    case CommandKind::calibrate:
      return "calibrate";
  }
  return "?";
}

const char* describe(CommandState state) noexcept {
  switch (state) {
    case CommandState::none:
      return "none";
    case CommandState::running:
      return "running";
    case CommandState::done:
      return "done";
    case CommandState::failed:
      return "failed";
  }
  return "?";
}

const char* describe(CommandFailure failure) noexcept {
  switch (failure) {
    case CommandFailure::none:
      return "done";
    case CommandFailure::superseded:
      return "another command came before it was done";
    case CommandFailure::stopped:
      return "a stop was asked for";
    case CommandFailure::joint_fault:
      return "a joint reported a fault or was lost";
    case CommandFailure::timed_out:
      return "it was not done in time";
    case CommandFailure::homing_failed:
      return "the joint did not find its switch";
    case CommandFailure::refused_by_joint:
      return "the joint refused";
    case CommandFailure::not_following:
      return "a joint stopped following its set points";
    case CommandFailure::joint_refused:
      return "a joint must not be used";
    case CommandFailure::calibration_failed:
      return "the calibration failed";
  }
  return "?";
}

SwingProgram program_of(const StrikePlan& plan) {
  return {.approach = plan.approach,
          .strike = plan.strike,
          .contact_time = plan.contact_time,
          .switch_time = plan.switch_time,
          .passive_time = plan.passive_time,
          .passive = plan.passive,
          .head_position_m = plan.head_position_m,
          .normal = plan.normal,
          .board_distance_m = plan.board_distance_m,
          .speed_m_s = plan.speed_m_s,
          .q_back_swing = plan.q_back_swing};
}

Supervisor::Supervisor(const RobotDescription& robot, const SupervisorConfig& config)
    : robot_(robot),
      config_(config),
      chain_(robot),
      limits_(motion_limits(robot)),
      dof_(robot.dof()),
      sync_period_(seconds(1.0 / robot.bus.knot_rate_hz)),
      steps_per_sync_(static_cast<int>(sync_period_ / config.step)),
      observer_(robot, chain_) {
  require_fits(robot, bus_budget(robot));
  if (steps_per_sync_ < 1 || (sync_period_ % config.step).ns != 0) {
    throw DescriptionError(
        fmt::format("{}: bus.knot_rate: a knot period of {:.3f} ms is not a multiple of the "
                    "supervisor's step of {:.3f} ms",
                    (robot.source / "robot.yaml").string(), sync_period_.seconds() * 1e3, config.step.seconds() * 1e3));
  }
  // The modules tell a SYNC to come from one gone by by the nearer way round the counter.
  config_.arm_ahead = std::min(config_.arm_ahead, sync_period_ * (kSyncCounterOverflow / 2 - kCounterMargin));
  if (!(config_.arm_ahead > config_.acknowledge_before)) {
    throw DescriptionError(fmt::format(
        "{}: bus.knot_rate: {:g} Hz is too fast: a switch can be armed {:.0f} ms ahead at most, and must be "
        "acknowledged {:.0f} ms ahead; lower bus.knot_rate",
        (robot.source / "robot.yaml").string(), robot.bus.knot_rate_hz, config_.arm_ahead.seconds() * 1e3,
        config_.acknowledge_before.seconds() * 1e3));
  }
  const double difference = model_self_check(robot);
  if (!(difference <= kSelfCheckTolerance)) {
    throw DescriptionError(
        fmt::format("{}: the model disagrees with KDL by {:.2e} (relative); this is a defect in "
                    "MRR or a description neither can represent",
                    robot.name, difference));
  }
  for (int i = 0; i < dof_; ++i) {
    const JointDescription& joint = robot.joints[at(i)];
    NodeSettings settings;
    settings.node_id = joint.node_id;
    settings.configuration_hash = config.configuration_hash[at(i)];
    settings.rated_torque_nm = joint.transmission.rated_nm;
    settings.sync_period = sync_period_;
    settings.heartbeat_timeout = seconds(joint.watchdog.heartbeat_s);
    nodes_[at(i)] = NodeProxy(settings);
  }
  reference_ = at_rest(JointVector::Zero(dof_));
  motion_ = JointTrajectory(reference_);  // while disabled it is sampled too, and an empty one has no joints
  sample_ = {JointVector::Zero(dof_), JointVector::Zero(dof_), JointVector::Zero(dof_)};
  outcome_.done = false;
  if (config_.start_disabled) activity_ = Activity::disabled;
}

void Supervisor::emit(EventKind kind, int joint, std::uint32_t value, std::uint32_t detail) noexcept {
  if (!events_.push_back({now_, kind, joint, value, detail})) ++dropped_events_;
}

JointVector Supervisor::measured_position() const noexcept {
  JointVector q(dof_);
  for (int i = 0; i < dof_; ++i) q[i] = nodes_[at(i)].measured().position_rad;
  return q;
}

bool Supervisor::all_follow(std::uint32_t except) const noexcept {
  for (int i = 0; i < dof_; ++i) {
    if (((except >> static_cast<unsigned>(i)) & 1U) != 0) continue;
    const NodeProxy& node = nodes_[at(i)];
    if (node.stage() != NodeStage::enabled || !node.measured().follows_knots()) return false;
  }
  return true;
}

bool Supervisor::motion_ended() const noexcept {
  return sync_ >= motion_start_ && sync_period_ * (sync_ - motion_start_) >= motion_.duration();
}

// Whether the passive arm must be caught now to come to rest before the board: the face is past the head by more than
// its rubber gives, and has hardly slowed down. On a nail that does not move the blow ends by itself.
bool Supervisor::sinking() const noexcept {
  const ChainPose pose = chain_.pose(sample_.q);
  const Jacobian J_h = chain_.jacobian(pose);
  const double depth_m = (program_.head_position_m - pose.face.position_m).dot(program_.normal);
  if (!(depth_m >= kRubberGives_m)) return false;
  const double speed_m_s = -(J_h * sample_.qd).head<3>().dot(program_.normal);
  if (!(speed_m_s > kStillFast * program_.speed_m_s)) return false;
  double deceleration_m_s2 = std::numeric_limits<double>::infinity();
  for (int i = 0; i < dof_; ++i) {
    if (((program_.passive >> static_cast<unsigned>(i)) & 1U) == 0) continue;
    const double arm_m = std::abs(J_h.col(i).head<3>().dot(program_.normal));
    if (arm_m < kLeastLever_m) continue;  // this joint does not move the face along the nail
    deceleration_m_s2 = std::min(deceleration_m_s2, arm_m * robot_.joints[at(i)].stop_deceleration_rad_s2());
  }
  // The samples are a SYNC old, and the modules hear of it a frame later.
  const double delay_s = 1.5 * sync_period_.seconds();
  const double stopping_m = speed_m_s * (delay_s + 0.5 * speed_m_s / deceleration_m_s2);
  return depth_m + stopping_m >= program_.board_distance_m;
}

std::uint32_t Supervisor::wire_mask(std::uint32_t passive) const noexcept {
  std::uint32_t active = 0xFFFF'FFFFU;
  for (int i = 0; i < dof_; ++i) {
    if ((passive >> static_cast<unsigned>(i)) & 1U) active &= ~(1U << robot_.joints[at(i)].selection_bit);
  }
  return active;
}

void Supervisor::step(Time now, std::span<const can::ReceivedFrame> received, can::TransmitQueue& tx) noexcept {
  now_ = now;
  for (const can::ReceivedFrame& frame : received) {
    for (int i = 0; i < dof_; ++i) nodes_[at(i)].receive(frame);
  }
  for (int i = 0; i < dof_; ++i) {
    nodes_[at(i)].want_enabled(wanted_ && (((held_ | given_up_) >> static_cast<unsigned>(i)) & 1U) == 0);
    nodes_[at(i)].step(now, tx);
  }
  if (calibration_.running()) calibration_.step(now, nodes_[at(acting_joint_)]);
  if (step_count_ == 0 || now - last_heartbeat_ >= kHeartbeatPeriod) {
    last_heartbeat_ = now;
    (void)tx.push_back(can::heartbeat_frame(can::kSupervisorNodeId, can::NmtState::operational));
  }
  watch_nodes();
  if (!cycle_seen_) on_cycle();
  if (pull_due()) pull_selection(tx);
  if (step_count_ == 0) started_ = now;
  if (sync_due()) on_sync(tx);
  disable_if_asked();
  advance_command();
  ++step_count_;
}

// SYNC carries a counter that modules learn to expect during bring-up: it starts when those that are there know.
bool Supervisor::may_sync() const noexcept {
  if (sync_ >= 0) return true;
  if (now_ - started_ < kListenFirst) return false;
  bool any = false;
  for (int i = 0; i < dof_; ++i) {
    const NodeStage stage = nodes_[at(i)].stage();
    if (stage == NodeStage::identifying || stage == NodeStage::configuring) return false;
    any = any || stage == NodeStage::starting;
  }
  return any;
}

void Supervisor::watch_nodes() noexcept {
  bool failed = false;
  bool fell = false;
  for (int i = 0; i < dof_; ++i) {
    const NodeProxy& node = nodes_[at(i)];
    const bool out = out_of_action(node.stage());
    const bool was_up =
        activity_ != Activity::bringing_up && activity_ != Activity::faulted && activity_ != Activity::disabled;
    if (node.stage() != shown_stage_[at(i)]) {
      const bool fell_now = out && shown_stage_[at(i)] == NodeStage::enabled && wanted_;
      fell = fell || fell_now;
      shown_stage_[at(i)] = node.stage();
      emit(EventKind::node_stage, i, static_cast<std::uint32_t>(node.stage()));
      if (unusable(node.stage()) || (out && (was_up || fell_now))) {
        emit(EventKind::fault, i, node.problem_detail());
      }
      // Whatever has become of it until then: nobody but recover() enables it again.
      if (out && (was_up || fell_now || activity_ == Activity::faulted)) held_ |= 1U << static_cast<unsigned>(i);
    }
    if (node.problem() != shown_problem_[at(i)]) {
      shown_problem_[at(i)] = node.problem();
      emit(EventKind::node_problem, i, static_cast<std::uint32_t>(node.problem()));
    }
    failed = failed || out;
  }
  recover_if_asked();
  switch (activity_) {
    case Activity::disabled:
    case Activity::faulted:
      break;
    case Activity::bringing_up:
      // Old motions died with the fault or were never there: each joint was led from where it said it was.
      if (fell) {
        enter_faulted();
      } else if (all_follow()) {
        reference_ = at_rest(reference_.q);
        begin_motion(JointTrajectory(reference_), Activity::holding);
        emit(EventKind::all_enabled);
      }
      break;
    case Activity::holding:
    case Activity::approaching:
    case Activity::dwelling:
    case Activity::swinging:
    case Activity::resuming:
    case Activity::returning:
    case Activity::stopping:
    case Activity::moving:
    case Activity::homing:
    case Activity::passive:
    case Activity::calibrating:
      if (failed) {
        enter_faulted();
      } else if (!all_follow() && activity_ == Activity::holding) {
        activity_ = Activity::bringing_up;
      }
      break;
  }
}

// A switch that is armed is withdrawn only if the arm can then come to rest before the head: later it is better struck
// passive than stiff.
bool Supervisor::too_late_to_cancel() const noexcept {
  return outcome_.switch_effective - now_ <= config_.acknowledge_before;
}

void Supervisor::enter_faulted() noexcept {
  // Nobody lets go for a blow that will not be, and nobody stays let go.
  const bool passive_now = selection_ == Selection::in_force || let_go_ != 0;
  if (selection_ == Selection::armed && too_late_to_cancel()) {
    // It comes into force, and is released when the blow is over.
  } else {
    if (selection_ == Selection::armed) send_selection(0, can::SelectionAction::cancel, now_);
    if (passive_now) send_selection(0, can::SelectionAction::now, now_);
    selection_ = Selection::none;
  }
  let_go_ = 0;
  if (activity_ == Activity::homing || activity_ == Activity::calibrating) {
    stop_action();
    tell_action_ended();
  }
  begin_motion(stopping_motion(), Activity::faulted);
  if (swing_open_) {
    outcome_.aborted = AbortReason::joint_fault;
    close_swing();
    emit(EventKind::swing_aborted, -1, static_cast<std::uint32_t>(AbortReason::joint_fault));
  }
  end_command(CommandFailure::joint_fault);
}

void Supervisor::recover_if_asked() noexcept {
  if (!recover_wanted_) return;
  // The other joints come to rest first: bring-up leads nobody who moves.
  if (activity_ == Activity::faulted && !at_rest_now()) return;
  recover_wanted_ = false;
  if (activity_ != Activity::faulted && activity_ != Activity::bringing_up && activity_ != Activity::disabled) return;
  held_ = 0;
  given_up_ = 0;
  for (int i = 0; i < dof_; ++i) nodes_[at(i)].reset_fault();
  if (activity_ != Activity::disabled) activity_ = Activity::bringing_up;
}

// No set point leads that joint: it moves until it says that it is back in their mode.
bool Supervisor::acting_now() const noexcept { return acting_joint_ >= 0 && nodes_[at(acting_joint_)].acts(); }

void Supervisor::stop_action() noexcept {
  calibration_.stop(nodes_[at(acting_joint_)]);
  nodes_[at(acting_joint_)].stop_action();
}

void Supervisor::tell_action_ended() noexcept {
  const bool homes = activity_ == Activity::homing;
  const ActionState state = homes ? nodes_[at(acting_joint_)].action() : calibration_.report().state;
  emit(homes ? EventKind::homing_ended : EventKind::calibration_ended, acting_joint_,
       static_cast<std::uint32_t>(state));
}

bool Supervisor::at_rest_now() const noexcept {
  if (activity_ == Activity::faulted) {
    return sync_ < 0 || (motion_ended() && selection_ == Selection::none && !acting_now());
  }
  return !moves(activity_);
}

void Supervisor::enable(bool wanted) noexcept {
  if (!wanted) {
    begin_command(CommandKind::disable);
    disable_wanted_ = true;
    stop_wanted_ = sync_ >= 0;
    return;
  }
  begin_command(CommandKind::enable);
  disable_wanted_ = false;
  wanted_ = true;
  given_up_ = 0;
  if (activity_ == Activity::disabled) activity_ = Activity::bringing_up;
}

void Supervisor::disable_if_asked() noexcept {
  if (!disable_wanted_ || stop_wanted_ || !at_rest_now()) return;
  disable_wanted_ = false;
  wanted_ = false;
  held_ = 0;
  given_up_ = 0;
  activity_ = Activity::disabled;
  emit(EventKind::disabled);
}

void Supervisor::stop() noexcept {
  // Asked again and again it is one stop.
  if (!(command_status_.kind == CommandKind::stop && command_status_.state == CommandState::running)) {
    begin_command(CommandKind::stop);
  }
  if (activity_ == Activity::bringing_up) give_up_missing();
  stop_wanted_ = sync_ >= 0;
}

void Supervisor::recover() noexcept {
  begin_command(CommandKind::reset);
  recover_wanted_ = true;
}

Refusal Supervisor::move(const JointTrajectory& motion) noexcept {
  if (activity_ != Activity::holding || disable_wanted_) return Refusal::not_ready;
  if (motion.dof() != dof_ || !(motion.duration() > Duration{})) return Refusal::not_usable;
  if (!((motion.start().q - reference_.q).cwiseAbs().maxCoeff() <= kStartTolerance_rad)) return Refusal::wrong_start;
  begin_command(CommandKind::move);
  begin_motion(motion, Activity::moving);
  emit(EventKind::motion_began);
  return Refusal::none;
}

Refusal Supervisor::home(int joint) noexcept {
  if (!is_joint(joint)) return Refusal::unknown_joint;
  // A joint that does not know where it is follows nobody: then the robot is still being brought up.
  if ((activity_ != Activity::holding && activity_ != Activity::bringing_up) || disable_wanted_) {
    return Refusal::not_ready;
  }
  if (nodes_[at(joint)].stage() != NodeStage::enabled) return Refusal::joint_unavailable;
  // During bring-up others may not be there yet: homing beside them would end as if they had failed.
  for (int i = 0; i < dof_; ++i) {
    if (out_of_action(nodes_[at(i)].stage())) return Refusal::not_ready;
  }
  begin_command(CommandKind::home, joint);
  nodes_[at(joint)].start_action(kModeHoming);
  acting_joint_ = joint;
  reference_ = at_rest(reference_.q);
  begin_motion(JointTrajectory(reference_), Activity::homing);
  emit(EventKind::homing_began, joint);
  return Refusal::none;
}

Refusal Supervisor::calibrate(int joint, const CalibrationSettings& settings) noexcept {
  if (!is_joint(joint)) return Refusal::unknown_joint;
  if (activity_ != Activity::holding || disable_wanted_) return Refusal::not_ready;
  begin_command(CommandKind::calibrate, joint);
  calibration_.start(joint, command_status_.number, settings, now_);
  shown_progress_ = 0;
  acting_joint_ = joint;
  reference_ = at_rest(reference_.q);
  begin_motion(JointTrajectory(reference_), Activity::calibrating);
  emit(EventKind::calibration_began, joint, static_cast<std::uint32_t>(settings.kind));
  return Refusal::none;
}

Refusal Supervisor::set_passive(int joint) noexcept {
  if (!is_joint(joint)) return Refusal::unknown_joint;
  const bool ready = activity_ == Activity::holding || activity_ == Activity::passive || coming_back();
  if (!ready || disable_wanted_) return Refusal::not_ready;
  if (nodes_[at(joint)].stage() != NodeStage::enabled) return Refusal::joint_unavailable;
  begin_command(CommandKind::passive, joint);
  let_go_ |= 1U << static_cast<unsigned>(joint);
  send_selection(let_go_, can::SelectionAction::now, now_);
  if (activity_ != Activity::passive) {
    reference_ = at_rest(reference_.q);
    begin_motion(JointTrajectory(reference_), Activity::passive);
  }
  return Refusal::none;
}

// All are enabled, and those that were let go take over their own position: a matter of some SYNCs.
bool Supervisor::coming_back() const noexcept {
  if (activity_ != Activity::bringing_up || !wanted_ || sync_ < 0) return false;
  for (int i = 0; i < dof_; ++i) {
    const NodeMeasurement& measured = nodes_[at(i)].measured();
    const bool homed = measured.error_or_limit != static_cast<std::uint16_t>(can::LimitCode::not_homed);
    if (nodes_[at(i)].stage() != NodeStage::enabled || !measured.valid || !homed) return false;
  }
  return true;
}

Refusal Supervisor::set_active(int joint) noexcept {
  if (!is_joint(joint)) return Refusal::unknown_joint;
  const std::uint32_t bit = 1U << static_cast<unsigned>(joint);
  if (activity_ != Activity::passive || (let_go_ & bit) == 0) return Refusal::not_passive;
  begin_command(CommandKind::active, joint);
  let_go_ &= ~bit;
  send_selection(let_go_, can::SelectionAction::now, now_);
  return Refusal::none;
}

// All joints that were let go by hand shall hold again.
void Supervisor::take_back() noexcept {
  if (let_go_ == 0) return;
  let_go_ = 0;
  send_selection(0, can::SelectionAction::now, now_);
}

// Joints come back by command, or by themselves; when all are back they are resynchronised like after any bring-up.
void Supervisor::advance_let_go() noexcept {
  for (int i = 0; i < dof_; ++i) {
    const std::uint32_t bit = 1U << static_cast<unsigned>(i);
    if ((let_go_ & bit) == 0) continue;
    const bool is_command = command_status_.kind == CommandKind::passive && command_status_.joint == i &&
                            command_status_.state == CommandState::running;
    if (nodes_[at(i)].measured().mode_display == kModePassive) {
      if (!is_command) continue;
      emit(EventKind::joint_passive, i);
      end_command(CommandFailure::none);
    } else if (!is_command) {
      let_go_ &= ~bit;  // it may have come back by itself; no later selection shall let it go again
      emit(EventKind::joint_active, i);
    } else if (now_ - command_status_.since >= kSelectTimeout) {
      let_go_ &= ~bit;
      send_selection(let_go_, can::SelectionAction::now, now_);
      const auto state = static_cast<unsigned>(nodes_[at(i)].measured().selection_acknowledged) >> 5U;
      end_command(state == static_cast<unsigned>(can::SelectionState::refused) ? CommandFailure::refused_by_joint
                                                                               : CommandFailure::timed_out);
    }
  }
  if (let_go_ == 0) activity_ = Activity::bringing_up;
}

void Supervisor::advance_homing() noexcept {
  NodeProxy& node = nodes_[at(acting_joint_)];
  const Duration limit = seconds(robot_.joints[at(acting_joint_)].homing.timeout_s) + kActionGrace;
  if (node.action() == ActionState::running) {
    if (now_ - activity_since_ > limit) node.stop_action();
    return;
  }
  // Set points lead again only once the module says that it is back in their mode.
  if (node.acts()) return;
  tell_action_ended();
  activity_ = Activity::bringing_up;
  switch (node.action()) {
    case ActionState::attained:
      end_command_of(CommandKind::home, CommandFailure::none);
      break;
    case ActionState::failed:
      end_command_of(CommandKind::home, CommandFailure::homing_failed);
      break;
    case ActionState::none:
    case ActionState::running:
    case ActionState::aborted:
      end_command_of(CommandKind::home,
                     now_ - activity_since_ > limit ? CommandFailure::timed_out : CommandFailure::stopped);
      break;
  }
}

void Supervisor::advance_calibration() noexcept {
  const CalibrationReport& report = calibration_.report();
  const bool short_one = report.settings.kind != CalibrationKind::friction;
  const bool late = now_ - activity_since_ > (short_one ? kCalibrationLimit : kIdentificationLimit);
  if (calibration_.running()) {
    if (report.progress_percent != shown_progress_) {
      shown_progress_ = report.progress_percent;
      emit(EventKind::calibration_progress, acting_joint_, shown_progress_);
    }
    if (late) stop_action();
    return;
  }
  if (nodes_[at(acting_joint_)].acts()) return;
  tell_action_ended();
  activity_ = Activity::bringing_up;
  end_command_of(CommandKind::calibrate, report.state == ActionState::attained ? CommandFailure::none
                                         : report.state == ActionState::failed ? CommandFailure::calibration_failed
                                         : late                                ? CommandFailure::timed_out
                                                                               : CommandFailure::stopped);
}

void Supervisor::begin_command(CommandKind kind, int joint) noexcept {
  const bool stops = kind == CommandKind::stop || kind == CommandKind::disable;
  end_command(stops ? CommandFailure::stopped : CommandFailure::superseded);
  command_status_ = {command_status_.number + 1, kind, joint, CommandState::running, CommandFailure::none, now_};
}

// A joint that is powered up hours after a failed bring-up shall not be enabled unasked.
void Supervisor::give_up_missing() noexcept {
  for (int i = 0; i < dof_; ++i) {
    if (nodes_[at(i)].stage() != NodeStage::enabled) given_up_ |= 1U << static_cast<unsigned>(i);
  }
}

void Supervisor::end_command(CommandFailure failure) noexcept {
  if (command_status_.state != CommandState::running) return;
  // A stop is what is wanted after a fault too.
  if (failure == CommandFailure::joint_fault &&
      (command_status_.kind == CommandKind::stop || command_status_.kind == CommandKind::disable)) {
    return;
  }
  command_status_.state = failure == CommandFailure::none ? CommandState::done : CommandState::failed;
  command_status_.failure = failure;
  const bool brings_up = command_status_.kind == CommandKind::enable || command_status_.kind == CommandKind::reset;
  if (brings_up && failure != CommandFailure::none && failure != CommandFailure::superseded) give_up_missing();
  emit(EventKind::command_ended, command_status_.joint, command_status_.number, static_cast<std::uint32_t>(failure));
}

// Another command may have come meanwhile: it does not end with what went on before.
void Supervisor::end_command_of(CommandKind kind, CommandFailure failure) noexcept {
  if (command_status_.kind == kind) end_command(failure);
}

// All others follow: nothing is to be waited for.
bool Supervisor::only_refused_are_missing() const noexcept {
  std::uint32_t refused = 0;
  for (int i = 0; i < dof_; ++i) {
    if (nodes_[at(i)].stage() == NodeStage::refused) refused |= 1U << static_cast<unsigned>(i);
  }
  return refused != 0 && all_follow(refused);
}

void Supervisor::advance_command() noexcept {
  if (command_status_.state != CommandState::running) return;
  const Duration since = now_ - command_status_.since;
  switch (command_status_.kind) {
    case CommandKind::none:
    case CommandKind::home:
    case CommandKind::move:
    case CommandKind::passive:
    case CommandKind::calibrate:
      return;  // ended where they happen
    case CommandKind::enable:
      if (activity_ == Activity::holding) {
        end_command(CommandFailure::none);
      } else if (only_refused_are_missing()) {
        end_command(CommandFailure::joint_refused);
      }
      break;
    case CommandKind::active:
      if (nodes_[at(command_status_.joint)].measured().follows_knots()) {
        emit(EventKind::joint_active, command_status_.joint);
        end_command(CommandFailure::none);
      }
      break;
    case CommandKind::disable: {
      if (activity_ != Activity::disabled) break;
      bool waiting = false;
      for (int i = 0; i < dof_; ++i) {
        // One that is lost cannot be asked: it brakes by its own watchdog.
        if (nodes_[at(i)].stage() == NodeStage::lost || nodes_[at(i)].stage() == NodeStage::absent) continue;
        const NodeMeasurement& measured = nodes_[at(i)].measured();
        if (measured.valid && is_powered(measured.statusword)) waiting = true;
      }
      if (!waiting) end_command(CommandFailure::none);
      break;
    }
    case CommandKind::stop:
      if (!stop_wanted_ && at_rest_now()) end_command(CommandFailure::none);
      break;
    case CommandKind::reset: {
      if (recover_wanted_) break;
      bool bad = false;
      for (int i = 0; i < dof_; ++i) {
        const NodeStage stage = nodes_[at(i)].stage();
        bad = bad || stage == NodeStage::faulted || stage == NodeStage::refused || stage == NodeStage::identifying;
      }
      if (activity_ == Activity::holding || (activity_ == Activity::disabled && !bad)) {
        end_command(CommandFailure::none);
      }
      break;
    }
  }
  if (since > kCommandTimeout) end_command(CommandFailure::timed_out);
}

Refusal Supervisor::execute(const StrikePlan& plan) noexcept {
  if (activity_ != Activity::holding || disable_wanted_) return Refusal::not_ready;
  if (plan.approach.dof() != dof_ || plan.strike.dof() != dof_ || !(plan.strike.duration() > Duration{})) {
    return Refusal::not_usable;
  }
  // The switch must come within the swing, and only to joints there are.
  if ((plan.passive >> static_cast<unsigned>(dof_)) != 0 ||
      (plan.passive != 0 && !(plan.switch_time > Duration{} && plan.switch_time < plan.strike.duration()))) {
    return Refusal::not_usable;
  }
  if (!((plan.approach.start().q - reference_.q).cwiseAbs().maxCoeff() <= kStartTolerance_rad)) {
    return Refusal::wrong_start;
  }
  program_ = program_of(plan);
  condition_.emplace(chain_, plan, switch_config(robot_));
  observer_.reset(plan.normal, plan.head_position_m, kContactGate_m);
  outcome_ = SwingOutcome{};
  swing_open_ = true;
  for (auto& seen : outcome_.passive_seen) seen = Time{-1};
  selection_ = Selection::none;
  contact_phase_ = ContactPhase::none;
  begin_motion(program_.approach, Activity::approaching);
  emit(EventKind::approach_began);
  return Refusal::none;
}

void Supervisor::begin_motion(const JointTrajectory& trajectory, Activity activity) noexcept {
  motion_ = trajectory;
  motion_start_ = last_knot_;
  detached_ = 0;
  activity_ = activity;
  activity_since_ = now_;
}

JointTrajectory Supervisor::stopping_motion() const noexcept {
  // The velocity falls to zero on a cubic whose steepest slope is 1.5 v/T; starting acceleration is carried along.
  double duration_s = sync_period_.seconds();
  for (int i = 0; i < dof_; ++i) {
    const double limit = robot_.joints[at(i)].stop_deceleration_rad_s2();
    duration_s = std::max(duration_s, 1.5 * std::abs(reference_.qd[i]) / limit);
  }
  const auto knots = static_cast<std::int64_t>(std::ceil(duration_s / sync_period_.seconds()));
  const Duration duration = sync_period_ * std::max<std::int64_t>(knots, 4);
  JointMotion end = at_rest(reference_.q + 0.5 * duration.seconds() * reference_.qd);
  for (int i = 0; i < dof_; ++i) end.q[i] = std::clamp(end.q[i], limits_.lower_rad[i], limits_.upper_rad[i]);
  JointTrajectory trajectory(reference_);
  if (!trajectory.append(end, duration)) return JointTrajectory(at_rest(reference_.q));
  return trajectory;
}

bool Supervisor::sync_due() const noexcept {
  if (sync_ < 0) return step_count_ % steps_per_sync_ == 0 && may_sync();
  if (now_ < knot_time(sync_ + 1)) return false;
  // One that would come too late is left out: modules must not take it for the next one.
  return (now_ - first_sync_) % sync_period_ <= Duration{sync_period_.ns / kLatestSyncShare};
}

void Supervisor::on_sync(can::TransmitQueue& tx) noexcept {
  if (sync_ < 0) {
    sync_ = 0;
    first_sync_ = now_;
  } else {
    // A shell that was late skips SYNCs, as if they were lost on the wire: counter, knots and time stay together.
    sync_ = std::max(sync_ + 1, (now_ - first_sync_) / sync_period_);
  }
  synced_ = now_;
  for (int i = 0; i < dof_; ++i) nodes_[at(i)].begin_cycle();
  cycle_seen_ = false;
  (void)tx.push_back(can::sync_frame(sync_counter(sync_)));
  advance_activity();
  advance_selection(tx);
  stream_knots(tx);
}

void Supervisor::on_cycle() noexcept {
  for (int i = 0; i < dof_; ++i) {
    if (!nodes_[at(i)].cycle_complete()) return;
  }
  cycle_seen_ = true;
  for (int i = 0; i < dof_; ++i) {
    const NodeMeasurement& measured = nodes_[at(i)].measured();
    sample_.q[i] = measured.position_rad;
    sample_.qd[i] = measured.velocity_rad_s;
    sample_.torque_nm[i] = measured.torque_nm;
  }
  const bool late_switch = selection_ == Selection::armed || selection_ == Selection::in_force;
  if (activity_ != Activity::swinging && activity_ != Activity::resuming && activity_ != Activity::returning &&
      !late_switch) {
    return;
  }

  // A blow may last until the hammer is lifted.
  const ContactReport& contact = observer_.step(synced_, sample_);
  for (int i = 0; i < dof_; ++i) {
    const NodeMeasurement& measured = nodes_[at(i)].measured();
    if (measured.mode_display == kModePassive && outcome_.passive_seen[at(i)].ns < 0) {
      outcome_.passive_seen[at(i)] = synced_;
      emit(EventKind::joint_passive, i);
    }
    const bool by_model = measured.error_or_limit == static_cast<std::uint16_t>(can::LimitCode::model_torque);
    outcome_.torque_sensed = outcome_.torque_sensed && !by_model;
    if (contact.phase == ContactPhase::touching) {
      outcome_.peak_torque_nm[at(i)] = std::max(outcome_.peak_torque_nm[at(i)], std::abs(measured.torque_nm));
      outcome_.axis_impulse_nm_s[at(i)] += measured.torque_nm * sync_period_.seconds();
    }
  }
  if (contact.phase != contact_phase_) {
    if (contact_phase_ == ContactPhase::none) emit(EventKind::contact_began);
    if (contact.phase == ContactPhase::over) emit(EventKind::contact_ended);
    contact_phase_ = contact.phase;
  }
  if (activity_ == Activity::swinging && contact_phase_ == ContactPhase::none) condition_->step(sample_.q, sample_.qd);
}

void Supervisor::stop_now() noexcept {
  switch (activity_) {
    case Activity::approaching:
    case Activity::dwelling:
    case Activity::swinging:
    case Activity::returning:
      abort_swing(AbortReason::stop_requested);
      break;
    case Activity::resuming:  // the joints are on their way to rest: what is left is not to go back
      if (outcome_.aborted == AbortReason::none) {
        outcome_.aborted = AbortReason::stop_requested;
        emit(EventKind::swing_aborted, -1, static_cast<std::uint32_t>(AbortReason::stop_requested));
      }
      break;
    case Activity::moving:
      begin_motion(stopping_motion(), Activity::stopping);
      break;
    case Activity::homing:
    case Activity::calibrating:
      stop_action();
      break;
    case Activity::passive:
      take_back();
      break;
    case Activity::faulted:
      if (acting_joint_ >= 0) stop_action();
      break;
    case Activity::bringing_up:
    case Activity::holding:
    case Activity::stopping:
    case Activity::disabled:
      break;
  }
}

void Supervisor::advance_activity() noexcept {
  if (stop_wanted_) {
    stop_wanted_ = false;
    stop_now();
  }
  if (activity_ == Activity::approaching || activity_ == Activity::dwelling || activity_ == Activity::swinging ||
      activity_ == Activity::returning || activity_ == Activity::moving) {
    const bool may_be_passive = activity_ == Activity::swinging && selection_ != Selection::none;
    const std::uint32_t except = may_be_passive ? program_.passive : 0U;
    astray_cycles_ = all_follow(except) && (detached_ & ~except) == 0 ? 0 : astray_cycles_ + 1;
    if (astray_cycles_ >= kAstrayCycles && activity_ == Activity::moving) {
      end_command_of(CommandKind::move, CommandFailure::not_following);
      begin_motion(stopping_motion(), Activity::stopping);
    } else if (astray_cycles_ >= kAstrayCycles) {
      abort_swing(AbortReason::not_following);
    }
  }
  switch (activity_) {
    case Activity::bringing_up:
    case Activity::holding:
    case Activity::faulted:
    case Activity::disabled:
      break;
    case Activity::moving:
      if (motion_ended()) {
        activity_ = Activity::holding;
        emit(EventKind::motion_ended);
        end_command_of(CommandKind::move, CommandFailure::none);
      }
      break;
    case Activity::homing:
      advance_homing();
      break;
    case Activity::calibrating:
      advance_calibration();
      break;
    case Activity::passive:
      advance_let_go();
      break;
    case Activity::approaching:
      if (motion_ended()) {
        activity_ = Activity::dwelling;
        activity_since_ = now_;
      }
      break;
    case Activity::dwelling:
      if (now_ - activity_since_ >= config_.dwell) {
        begin_motion(program_.strike, Activity::swinging);
        outcome_.began = knot_time(motion_start_);
        outcome_.planned_contact = outcome_.began + program_.contact_time;
        outcome_.switch_effective = outcome_.began + program_.switch_time;
        selection_ = program_.passive != 0 ? Selection::waiting : Selection::none;
        emit(EventKind::swing_began);
      }
      break;
    case Activity::swinging:
      if (selection_ == Selection::in_force) {
        if (blow_over()) begin_resume();
      } else if (motion_ended()) {
        // The report is closed by the time the arm is back; a blow still open then has ended by leaving.
        finish_swing();
      }
      break;
    case Activity::resuming:
      if (all_follow() && motion_ended()) {
        emit(EventKind::joints_active);
        selection_ = Selection::none;
        if (outcome_.aborted == AbortReason::stop_requested) {
          finish_swing();
        } else {
          begin_return();
        }
      }
      break;
    case Activity::returning:
      if (motion_ended()) finish_swing();
      break;
    case Activity::stopping:
      if (motion_ended() && selection_ == Selection::none) {
        activity_ = Activity::holding;
        if (swing_open_) {
          close_swing();
        } else {
          emit(EventKind::motion_ended);
        }
      }
      break;
  }
}

void Supervisor::close_swing() noexcept {
  outcome_.contact = observer_.report();
  outcome_.done = true;
  swing_open_ = false;
}

// A switch in force has served: the blow ended, is late, or the arm must be caught.
bool Supervisor::blow_over() const noexcept {
  if (contact_phase_ == ContactPhase::over) return true;
  if (now_ >= outcome_.switch_effective + program_.passive_time) return true;
  return activity_ != Activity::faulted && sinking();  // with a joint lost, what is known of the arm is old
}

void Supervisor::send_selection(std::uint32_t passive, can::SelectionAction action, Time effective) noexcept {
  const Duration since_first = effective - first_sync_;
  const std::int64_t knot = since_first / sync_period_;
  selection_sequence_ = static_cast<std::uint8_t>(selection_sequence_ % can::kSelectionSequenceMask + 1);  // 1 .. 31
  command_.mask = wire_mask(passive);
  command_.sync_counter = sync_counter(knot);
  command_.offset_us = static_cast<std::uint16_t>((since_first % sync_period_).ns / 1000);
  command_.sequence = selection_sequence_;
  command_.action = action;
  command_pending_ = true;
  acknowledged_ = false;
}

bool Supervisor::acknowledged(const NodeProxy& node) const noexcept {
  const std::uint8_t acknowledged = node.measured().selection_acknowledged;
  if (can::acknowledged_sequence(acknowledged) != selection_sequence_) return false;
  const unsigned state = acknowledged >> 5U;
  // A module that had this sequence from an earlier supervisor takes the order for a repetition and arms nothing.
  if (command_.action == can::SelectionAction::arm) return state == static_cast<unsigned>(can::SelectionState::armed);
  return state != static_cast<unsigned>(can::SelectionState::refused);
}

void Supervisor::advance_selection(can::TransmitQueue& tx) noexcept {
  if (command_pending_) {
    acknowledged_ = true;
    command_pending_ = false;  // nobody who could still hear it: it must not wait for a joint that comes back
    for (int i = 0; i < dof_; ++i) {
      if (acknowledged(nodes_[at(i)])) continue;
      acknowledged_ = false;
      command_pending_ = command_pending_ || nodes_[at(i)].stage() == NodeStage::enabled;
    }
    if (acknowledged_ && selection_ == Selection::armed) emit(EventKind::selection_acknowledged);
  }
  if (activity_ == Activity::swinging) {
    if (selection_ == Selection::waiting && outcome_.switch_effective - now_ <= config_.arm_ahead) {
      send_selection(program_.passive, can::SelectionAction::arm, outcome_.switch_effective);
      selection_ = Selection::armed;
      emit(EventKind::selection_armed, -1, selection_sequence_);
    }
    if (selection_ == Selection::armed) {
      const SwitchState& condition = condition_->state();
      outcome_.switch_state = condition;
      if (!acknowledged_ && outcome_.switch_effective - now_ <= config_.acknowledge_before) {
        withdraw_selection();
        abort_swing(AbortReason::not_acknowledged);
      } else if (condition.verdict == SwitchVerdict::cancel) {
        withdraw_selection();
        abort_swing(AbortReason::condition);
      } else if (now_ >= outcome_.switch_effective) {
        selection_ = Selection::in_force;
      }
    }
  }
  if (activity_ == Activity::stopping || activity_ == Activity::faulted) {
    // What was too late to be withdrawn.
    if (selection_ == Selection::armed && now_ >= outcome_.switch_effective) selection_ = Selection::in_force;
    if (selection_ == Selection::in_force && blow_over()) {
      send_selection(0, can::SelectionAction::now, now_);
      selection_ = Selection::none;
    }
  }
  if (command_pending_) (void)tx.push_back(can::selection_frame(command_));
}

// Contact comes earlier than armed for: the robot is told in the cycle that sees it, not with the next SYNC.
bool Supervisor::pull_due() const noexcept {
  if (activity_ != Activity::swinging || selection_ != Selection::armed) return false;
  const Duration ahead = outcome_.switch_effective - now_;
  return condition_->state().verdict == SwitchVerdict::switch_now && ahead > kPullMargin &&
         (acknowledged_ || ahead > config_.acknowledge_before);
}

void Supervisor::pull_selection(can::TransmitQueue& tx) noexcept {
  outcome_.switch_state = condition_->state();
  send_selection(program_.passive, can::SelectionAction::now, now_);
  (void)tx.push_back(can::selection_frame(command_));
  outcome_.switch_effective = now_;
  outcome_.pulled = true;
  selection_ = Selection::in_force;
  emit(EventKind::selection_pulled, -1, selection_sequence_);
}

void Supervisor::begin_resume() noexcept {
  send_selection(0, can::SelectionAction::now, now_);
  selection_ = Selection::releasing;
  begin_motion(stopping_motion(), Activity::resuming);
}

void Supervisor::begin_return() noexcept {
  // Joints that were passive rest where they came to; the others where their reference stopped.
  JointMotion start = at_rest(reference_.q);
  double duration_s = 0.2;
  for (int i = 0; i < dof_; ++i) {
    // Rest to rest on a quintic: peak velocity 1.875 d/T, peak acceleration 5.774 d/T^2.
    const double travel = std::abs(program_.q_back_swing[i] - start.q[i]);
    duration_s = std::max({duration_s, 1.875 * travel / (kReturnShare * limits_.velocity_rad_s[i]),
                           std::sqrt(5.774 * travel / (kReturnShare * limits_.acceleration_rad_s2[i]))});
  }
  const auto knots = static_cast<std::int64_t>(std::ceil(duration_s / sync_period_.seconds()));
  JointTrajectory trajectory(start);
  (void)trajectory.append(at_rest(program_.q_back_swing), sync_period_ * knots);
  begin_motion(trajectory, Activity::returning);
}

void Supervisor::withdraw_selection() noexcept {
  send_selection(0, can::SelectionAction::cancel, now_);
  selection_ = Selection::none;
  emit(EventKind::selection_cancelled);
}

void Supervisor::abort_swing(AbortReason reason) noexcept {
  outcome_.aborted = reason;
  emit(EventKind::swing_aborted, -1, static_cast<std::uint32_t>(reason));
  if (selection_ == Selection::in_force || selection_ == Selection::releasing) {
    begin_resume();
  } else {
    if (selection_ == Selection::armed && !too_late_to_cancel()) withdraw_selection();
    if (selection_ != Selection::armed) selection_ = Selection::none;
    begin_motion(stopping_motion(), Activity::stopping);
  }
}

void Supervisor::finish_swing() noexcept {
  close_swing();
  selection_ = Selection::none;
  activity_ = Activity::holding;
  emit(EventKind::swing_ended);
}

void Supervisor::stream_knots(can::TransmitQueue& tx) noexcept {
  last_knot_ = sync_ + kKnotsAhead;
  const JointVector before = reference_.q;
  if (activity_ != Activity::bringing_up) motion_.sample(sync_period_ * (last_knot_ - motion_start_), reference_);
  for (int i = 0; i < dof_; ++i) {
    const NodeMeasurement& measured = nodes_[at(i)].measured();
    const std::uint32_t bit = 1U << static_cast<unsigned>(i);
    if (activity_ == Activity::bringing_up || !measured.follows_knots()) detached_ |= bit;
    if ((detached_ & bit) == 0) continue;
    if (measured.follows_knots()) {
      // What took over from its own position stays there until the next motion.
      reference_.q[i] = before[i];
    } else {
      // Led by nobody (not enabled, passive, homing, or just back): its own position is echoed, so that it takes over
      // from where it is. In steps: a joint that takes over while it still moves must not be sent after its own noise.
      const bool near = std::abs(measured.position_rad - before[i]) <= kEchoStep_rad;
      reference_.q[i] = near ? before[i] : measured.position_rad;
    }
    reference_.qd[i] = 0.0;
    reference_.qdd[i] = 0.0;
  }
  ++knot_sequence_;
  // What the links will ask of the transmissions: the feedforward of modules without a torque sensor.
  const JointVector model_torque = chain_.inverse_dynamics(reference_.q, reference_.qd, reference_.qdd);
  for (int i = 0; i < dof_; ++i) {
    const NodeProxy& node = nodes_[at(i)];
    if (node.stage() != NodeStage::enabled || !node.measured().valid) continue;
    const std::uint8_t id = node.settings().node_id;
    const auto position = can::urad_from_rad(reference_.q[i]);
    const auto velocity = can::urad_s_from_rad_s(reference_.qd[i]);
    const auto acceleration = can::mrad_s2_from_rad_s2(reference_.qdd[i]);
    const auto rated_mnm = static_cast<std::uint32_t>(std::lround(node.settings().rated_torque_nm * 1e3));
    const auto torque = can::permille_from_nm(model_torque[i], rated_mnm);
    // A knot that is not a number is not sent: the module's watchdog then stops the joint.
    if (!position || !velocity || !acceleration || !torque) continue;
    (void)tx.push_back(can::pack_rpdo2(id, {*position, *velocity}));
    (void)tx.push_back(can::pack_rpdo3(id, {*acceleration, *torque, knot_sequence_}));
  }
}

}  // namespace mrr::sup
