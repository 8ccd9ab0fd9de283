// Room: supervisor/master. One module as the supervisor sees it: bring-up step by step, state, measurements, watchdog.
// May touch common/core and can_protocol. Stepped: allocates nothing, throws nothing.
#pragma once

#include <cstdint>

#include "can_protocol/client.h"
#include "can_protocol/frame.h"
#include "common/core/time.h"

namespace mrr::sup {

/// SYNC counters run from 1 to this (0x1019 of every module).
inline constexpr std::uint8_t kSyncCounterOverflow = 240;

/// What a node must be before it may be enabled, and how it is set up.
struct NodeSettings {
  std::uint8_t node_id = 0;
  std::uint32_t configuration_hash = 0;  ///< what the robot was planned with; another one is refused
  double rated_torque_nm = 1.0;          ///< unit of torques on the wire: 0x6076
  Duration sync_period = milliseconds(4);
  Duration heartbeat_period = milliseconds(100);   ///< of the module
  Duration heartbeat_timeout = milliseconds(500);  ///< silence after which a node is lost, either way
};

/// How far bring-up has come.
enum class NodeStage : std::uint8_t {
  absent,       ///< nothing heard yet
  identifying,  ///< protocol and configuration are compared
  configuring,  ///< heartbeats, SYNC
  starting,     ///< told to go OPERATIONAL
  idle,         ///< OPERATIONAL, not enabled
  enabling,     ///< walking to OPERATION ENABLED, brake included
  enabled,      ///< holds its position, follows knots once they are near
  refused,      ///< must not be used; see problem()
  faulted,      ///< reports a fault
  lost,         ///< was there, fell silent
};

enum class NodeProblem : std::uint8_t {
  none,
  silent,               ///< never answered
  wrong_protocol,       ///< another schema: update the module or the supervisor
  wrong_configuration,  ///< another configuration than the robot was planned with
  not_answering,        ///< a request timed out three times
  request_refused,      ///< SDO abort; see problem_detail()
  state_timeout,        ///< did not reach the state asked for
  fault,                ///< see problem_detail(): emergency code
  heartbeat_lost,
};
[[nodiscard]] const char* describe(NodeProblem problem) noexcept;
[[nodiscard]] const char* describe(NodeStage stage) noexcept;

/// What the last PDOs said, SI. `valid` only once all of them came.
struct NodeMeasurement {
  bool valid = false;
  double position_rad = 0.0;  ///< motor side, joint units
  double velocity_rad_s = 0.0;
  double torque_nm = 0.0;  ///< joint torque
  std::uint16_t statusword = 0;
  std::int8_t mode_display = 0;
  std::uint8_t selection_acknowledged = 0;
  std::uint16_t error_or_limit = 0;

  /// In cyclic position mode and led by knots: statusword bit 12.
  [[nodiscard]] bool follows_knots() const noexcept { return mode_display == 8 && (statusword & 0x1000U) != 0; }
};

/// What TPDO3 says ten times a second.
struct NodeCondition {
  bool valid = false;
  double winding_c = 0.0;
  double drive_c = 0.0;
  double bus_v = 0.0;
  double loop_load = 0.0;  ///< share of a control tick
};

/// How an action that was asked for stands: homing, or a calibration.
enum class ActionState : std::uint8_t {
  none,
  running,
  attained,
  failed,   ///< the module says so: statusword bit 13
  aborted,  ///< stop_action(), or the joint fell out of operation
};
/// Modes of operation in which the module acts by itself, from its start bit on until it says how it ended.
inline constexpr std::int8_t kModeHoming = 6;
inline constexpr std::int8_t kModeIdentification = -2;
inline constexpr std::int8_t kModeTorqueZero = -3;
inline constexpr std::int8_t kModeBrakeTest = -4;

/// What there is to know of a node, by value: for whoever must not hold the node itself.
struct NodeReport {
  NodeStage stage = NodeStage::absent;
  NodeProblem problem = NodeProblem::silent;
  std::uint32_t problem_detail = 0;
  NodeMeasurement measured;
  NodeCondition condition;
  std::uint16_t fault = 0;  ///< emergency code of the first fault since the last acknowledgement; 0: none
  Time fault_at;            ///< when it was seen here
};

/// CiA 402 state of a statusword, in words.
[[nodiscard]] const char* describe_state(std::uint16_t statusword) noexcept;
/// Power is on or on its way: no brake is to be trusted.
[[nodiscard]] bool is_powered(std::uint16_t statusword) noexcept;

class NodeProxy {
 public:
  NodeProxy() = default;
  explicit NodeProxy(const NodeSettings& settings) noexcept;

  /// A frame of this node, or any other: only its own count.
  void receive(const can::ReceivedFrame& received) noexcept;
  /// Bring-up, watchdogs, retries. Call every step.
  void step(Time now, can::TransmitQueue& tx) noexcept;

  /// Whether the node shall be enabled. Falling back takes power away in a controlled way.
  void want_enabled(bool wanted) noexcept { wanted_ = wanted; }
  /// Acknowledge: fault resets until it takes, a few at most, then bring-up goes on. A refused node is asked again.
  void reset_fault() noexcept;
  /// Homing or a calibration: its mode and the start bit, until the module says how it ended, then mode 8 again. Only
  /// when enabled.
  void start_action(std::int8_t mode) noexcept;
  /// The joint stops, and goes back to mode 8.
  void stop_action() noexcept;
  [[nodiscard]] ActionState action() const noexcept { return action_; }
  /// No set point leads it: it acts, or has not yet shown that it is back in their mode.
  [[nodiscard]] bool acts() const noexcept {
    return action_ == ActionState::running || (stage_ == NodeStage::enabled && in_action_mode());
  }
  /// For objects of a joint that is enabled; bring-up uses it before.
  [[nodiscard]] can::SdoClient& sdo() noexcept { return sdo_; }

  /// Forget which PDOs came: a new SYNC goes out.
  void begin_cycle() noexcept { received_in_cycle_ = 0; }
  [[nodiscard]] bool cycle_complete() const noexcept { return received_in_cycle_ == 3U; }

  [[nodiscard]] NodeStage stage() const noexcept { return stage_; }
  [[nodiscard]] NodeProblem problem() const noexcept { return problem_; }
  [[nodiscard]] std::uint32_t problem_detail() const noexcept { return problem_detail_; }
  [[nodiscard]] const NodeMeasurement& measured() const noexcept { return measured_; }
  [[nodiscard]] const NodeSettings& settings() const noexcept { return settings_; }
  [[nodiscard]] NodeReport report() const noexcept {
    return {stage_, problem_, problem_detail_, measured_, condition_, fault_, fault_at_};
  }

 private:
  static constexpr std::int8_t kModeCyclicPosition = 8;
  void enter(NodeStage stage, Time now) noexcept;
  void refuse(NodeProblem problem, std::uint32_t detail, Time now) noexcept;
  void step_requests(Time now, can::TransmitQueue& tx) noexcept;
  void step_power(Time now, can::TransmitQueue& tx) noexcept;
  void step_action(Time now, can::TransmitQueue& tx) noexcept;
  [[nodiscard]] bool in_action_mode() const noexcept {
    return action_ != ActionState::none && measured_.mode_display == action_mode_;
  }
  void send_controlword(std::uint16_t controlword, Time now, can::TransmitQueue& tx,
                        std::int8_t mode = kModeCyclicPosition) noexcept;

  NodeSettings settings_;
  NodeStage stage_ = NodeStage::absent;
  NodeProblem problem_ = NodeProblem::silent;
  std::uint32_t problem_detail_ = 0;
  NodeMeasurement measured_;
  NodeCondition condition_;
  std::uint16_t fault_ = 0;
  Time fault_at_;
  std::uint8_t received_in_cycle_ = 0;  // bit 0 TPDO1, bit 1 TPDO2
  std::uint8_t received_ever_ = 0;
  std::uint16_t last_emergency_ = 0;
  bool wanted_ = false;
  int resets_left_ = 0;
  bool ask_again_ = false;
  ActionState action_ = ActionState::none;
  std::int8_t action_mode_ = 0;
  bool action_started_ = false;  // the module has taken the start bit: what was attained before does not count
  Time action_asked_;            // since when the start bit is sent
  bool heard_ = false;
  bool booted_ = false;
  can::NmtState nmt_state_ = can::NmtState::initialising;
  Time last_heard_;
  Time stage_since_;
  Time last_command_;
  std::uint16_t controlword_ = 0;
  std::int8_t mode_ = kModeCyclicPosition;
  can::SdoClient sdo_{0};
  can::Frame answer_;
  bool has_answer_ = false;
  bool request_pending_ = false;
  int request_index_ = 0;
  int retries_ = 0;
};

}  // namespace mrr::sup
