// Room: module_fw. One joint's firmware as an object that is stepped: communication -> decision -> action -> execution.
// May touch common/core and can_protocol. Freestanding: no heap, no exceptions, no clock, fixed memory.
#pragma once

#include <cstdint>
#include <limits>
#include <optional>
#include <span>

#include "can_protocol/frame.h"
#include "can_protocol/node.h"
#include "can_protocol/storage.h"
#include "common/core/time.h"
#include "module_fw/actions/arbiter.h"
#include "module_fw/actions/brake_sequence.h"
#include "module_fw/actions/calibration.h"
#include "module_fw/actions/drive_state_machine.h"
#include "module_fw/actions/homing.h"
#include "module_fw/comms/selection_switch.h"
#include "module_fw/config.h"
#include "module_fw/control/active_law.h"
#include "module_fw/control/friction_identification.h"
#include "module_fw/control/passive_law.h"
#include "module_fw/control/reference.h"
#include "module_fw/control/sync_pll.h"
#include "module_fw/control/torque_selector.h"
#include "module_fw/drive/drive.h"
#include "module_fw/faults/fault_monitor.h"
#include "module_fw/faults/sensor_watch.h"
#include "module_fw/faults/swing_watch.h"
#include "module_fw/joint_io.h"
#include "module_fw/sensing/sensing.h"
#include "module_fw/status.h"

namespace mrr::fw {

class Module final : private can::NodeApplication {
 public:
  explicit Module(const ModuleConfig& config) noexcept;
  Module(const Module&) = delete;
  Module& operator=(const Module&) = delete;

  /// One control tick. Call it every `config.tick` of the module's own clock.
  /// @param now       own clock, increasing
  /// @param sensors   raw readings; only those whose fresh bit is set are used
  /// @param received  frames since the last tick, in order, with arrival times on the same clock as `now`
  /// @param actuator  out: what the power stage shall do until the next tick
  /// @param tx        out: frames to send are appended, oldest first
  void step(Time now, const RawSensors& sensors, std::span<const can::ReceivedFrame> received,
            ActuatorCommand& actuator, can::TransmitQueue& tx) noexcept;

  /// Takes over what 1010h stored there, and stores there from now on. Before the first step; may wait for the memory.
  /// `port` must outlive the module.
  void load_parameters(can::StoragePort& port) noexcept;

  /// The shell's CAN controller went bus-off, or is back.
  void bus_off(Time now) noexcept;
  void bus_recovered(Time now) noexcept;
  /// It is error-passive, or no longer: EMCY 8120h and its error reset; nothing else changes.
  void bus_passive(bool is, Time now) noexcept;

  /// For tests and telemetry only: nothing on the robot's bus depends on it.
  [[nodiscard]] const ModuleStatus& status() const noexcept {
    publish();
    return status_;
  }
  /// As the arbiter's table names it.
  [[nodiscard]] Situation situation() const noexcept;
  /// The objects as the bus sees them. For tests.
  [[nodiscard]] const can::ObjectDictionary& objects() const noexcept {
    publish();
    return od_;
  }

 private:
  // What the node tells.
  can::Abort may_write(can::ObjectId id, const can::Value& value) noexcept override;
  void written(can::ObjectId id, can::WriteSource source, Time at) noexcept override;
  [[nodiscard]] bool follows(can::ObjectId id) const noexcept override {
    return id == can::ObjectId::controlword || id == can::ObjectId::target_torque_permille ||
           id == can::ObjectId::max_torque_permille;
  }
  void pdo_delivered(std::uint8_t number, Time received) noexcept override;
  void sync(Time at, std::optional<std::uint8_t> counter) noexcept override;
  void selection(const can::SelectionCommand& command, Time at) noexcept override;
  void nmt_changed(can::NmtState state, Time at) noexcept override;
  void reset(can::ResetKind kind, Time at) noexcept override;
  void heartbeat_lost(std::uint8_t node_id, Time at) noexcept override;
  void heartbeat_seen(std::uint8_t node_id, can::NmtState state, Time at) noexcept override;
  can::Abort store(Time at) noexcept override;
  can::Abort restore_defaults(Time at) noexcept override;
  can::LssStored store_node_id(std::uint8_t node_id) noexcept override;

  /// Configuration -> objects, once at start.
  void fill_objects() noexcept;
  /// Objects -> laws and limits: what was written over the bus comes into force when the joint is enabled.
  void apply_parameters() noexcept;
  void apply_live_parameters() noexcept;
  void choose_reactions() noexcept;
  [[nodiscard]] can::Abort begin_write(const can::ObjectDictionary* od) noexcept;
  void publish_storage() noexcept;

  // The stages of a tick, in their order.
  void watch_loop(Time now) noexcept;
  inline void watch(Time now, const RawSensors& sensors) noexcept;
  inline void find_faults(Time now, const RawSensors& sensors) noexcept;
  void settle_faults(Time now) noexcept;
  inline void decide_state(Time now) noexcept;
  void obey(std::uint16_t controlword, Time now) noexcept;
  void forget_faults() noexcept;
  inline void lead(Time now) noexcept;
  inline void follow_mode(Time now) noexcept;
  inline void carry_out_selection(Time now) noexcept;
  void run_homing(Time now) noexcept;
  [[nodiscard]] Homing::Inputs homing_inputs() const noexcept;
  void run_calibration(Time now) noexcept;
  void end_calibration() noexcept;
  void run_identification() noexcept;
  void stop_identification() noexcept;
  inline void watch_motion(Time now) noexcept;
  inline void estimate_load(Time now) noexcept;
  inline void guard_passivity() noexcept;
  [[nodiscard]] inline float control_torque(Time now) noexcept;
  inline void sequence_brake(Time now) noexcept;
  void publish() const noexcept;
  void publish_identification() const noexcept;
  void refresh() noexcept override { publish(); }

  void offer_knot(const Knot& knot, Duration period) noexcept;
  void fail(can::Fault fault, Time now) noexcept;
  /// Causes that last until they are taken back, as opposed to those that each tick looks for.
  void stand(can::Fault fault) noexcept { standing_ |= FaultMonitor::bit(fault); }
  void pass(can::Fault fault) noexcept { standing_ &= ~FaultMonitor::bit(fault); }
  void stand_if(can::Fault fault, bool stands) noexcept { stands ? stand(fault) : pass(fault); }
  [[nodiscard]] bool stands(can::Fault fault) const noexcept { return (standing_ & FaultMonitor::bit(fault)) != 0; }
  [[nodiscard]] bool configuration_valid() const noexcept { return !stands(can::Fault::configuration); }
  [[nodiscard]] bool cut() const noexcept { return reaction_ == can::Reaction::torque_off; }
  void enable() noexcept;
  void stop_and_hold(float deceleration_rad_s2) noexcept;
  /// Of the ramp that an option code names: 1, 5 the slow-down ramp, 2, 6 the quick-stop ramp.
  [[nodiscard]] float ramp_rad_s2(std::int16_t option) const noexcept;
  void leave_operation(DriveState from, DriveState to) noexcept;
  void stop_at_limit(can::LimitCode why) noexcept;
  void go_passive(Time now) noexcept;
  void go_active() noexcept;
  [[nodiscard]] PassiveLaw::Evidence evidence() const noexcept;
  [[nodiscard]] Authority arbitrate() const noexcept;
  [[nodiscard]] bool calibration_mode() const noexcept { return mode_ <= Mode::identification; }
  /// A calibration or identification moves or pushes the joint.
  [[nodiscard]] bool calibrating() const noexcept { return calibration_.running() || identification_.running(); }
  [[nodiscard]] Calibration::Settings calibration_settings() const noexcept;
  [[nodiscard]] Calibration::Inputs calibration_inputs(Time now) const noexcept;
  [[nodiscard]] bool closing() const noexcept;
  [[nodiscard]] bool without_torque_sensor(Time now) const noexcept;
  [[nodiscard]] bool model_torque_fresh(Time now) const noexcept { return now <= model_torque_until_; }
  [[nodiscard]] bool may_change_law() const noexcept;
  [[nodiscard]] bool passive() const noexcept { return selector_.law() == Law::passive; }
  [[nodiscard]] bool torque_mode() const noexcept {
    return mode_ == Mode::cyclic_torque && authority_ == Authority::motion;
  }
  [[nodiscard]] inline std::uint16_t statusword() const noexcept;
  [[nodiscard]] inline can::LimitCode active_limit() const noexcept;

  ModuleConfig config_;  ///< what is in force: as configured, then as written over the bus
  float dt_s_;
  std::uint32_t tick_us_;
  float permille_per_nm_;  ///< of 6076h
  float permille_per_a_;   ///< of 6075h
  mutable ModuleStatus status_;
  mutable can::ObjectDictionary od_;
  mutable bool shown_ = false;  ///< both show the last tick
  can::Node node_;
  can::ParameterStore store_;
  SyncPll pll_;
  SelectionSwitch selection_;

  Sensing sensing_;
  Reference reference_;
  ActiveLaw active_;
  PassiveLaw passive_;
  PassivityGuard guard_;
  TorqueSelector selector_;
  Drive drive_;
  DriveStateMachine machine_;
  BrakeSequence brake_;
  Homing homing_;
  Calibration calibration_;
  bool calibration_active_ = false;
  FrictionIdentification identification_;

  Authority authority_ = Authority::none;
  static constexpr Time kBeforeStart{std::numeric_limits<std::int64_t>::min()};
  static constexpr Time kNever{std::numeric_limits<std::int64_t>::max()};
  Time started_at_;
  Duration overrun_after_;  ///< the last tick: the next one is late
  Time overrun_at_ = kBeforeStart;
  bool parameters_changed_ = false;
  bool usable_at_start_ = true;

  // Communication
  bool knot_position_came_ = false;      ///< RPDO2 since the last SYNC
  bool knot_acceleration_came_ = false;  ///< RPDO3 since the last SYNC
  bool knots_have_sequence_ = false;     ///< RPDO3 came since the joint was enabled
  std::uint16_t own_sequence_ = 0;       ///< for set points without one
  float last_target_rad_ = 0.0F;
  bool has_last_target_ = false;
  std::optional<std::uint8_t> sync_counter_;
  Time sync_due_ = kNever;  ///< the watchdog's, from the first SYNC since the joint was enabled
  Time knot_due_ = kNever;  ///< while the reference follows knots
  bool heartbeat_lost_ = false;

  // Decision
  bool limit_stop_ = false;
  float user_stop_rad_s2_ = 0.0F;
  can::LimitCode hold_reason_ = can::LimitCode::none;
  can::LimitCode passive_ended_by_ = can::LimitCode::none;
  bool passivity_lost_ = false;  ///< the guard took the compensation back in the last passive phase
  Mode mode_ = Mode::none;       ///< without the law: passive is a law within mode 8
  std::int8_t last_requested_mode_ = 0;
  bool homing_start_bit_ = false;                ///< controlword bit 4, for homing and calibrations
  bool start_edge_ = false;                      ///< it rose in this tick
  StaticVector<std::uint16_t, 8> controlwords_;  ///< that came since the last tick

  // Control
  float load_torque_nm_ = 0.0F;
  bool load_by_model_ = false;    ///< the torque sensor is lost
  bool load_catches_up_ = false;  ///< on the way from one source to the other
  Time knot_came_at_;
  Time set_point_at_;                       ///< RPDO2 or RPDO3
  Time model_torque_until_ = kBeforeStart;  ///< 60B2h came with a knot and is fresh
  bool saturated_ = false;
  float max_torque_nm_ = 0.0F;
  Time passive_since_;
  float passive_from_rad_ = 0.0F;
  bool was_blending_ = false;
  DriveLimit drive_limit_ = DriveLimit::none;

  // Faults
  FaultMonitor faults_;
  SensorWatch sensor_watch_;
  SwingWatch swing_watch_;
  std::uint64_t standing_ = 0;                      ///< causes that were found once and last, a bit each
  std::uint64_t raised_ = 0;                        ///< causes the bus was told of, a bit each
  std::uint64_t tell_again_ = 0;                    ///< of these, whose reaction has become harder since
  can::Reaction reaction_ = can::Reaction::report;  ///< what is being done about them
  Time reaction_since_;
  float damping_nm_s_rad_ = 0.0F;
  bool torque_target_came_ = false;  ///< by RPDO, since the joint was enabled
  Time torque_target_at_;
  bool bus_off_ = false;
  std::int64_t following_error_ticks_ = 0;
  std::int64_t following_error_limit_ticks_ = 0;
  float following_error_rad_ = 0.0F;
  std::uint64_t provoked_ = 0;  ///< by 2F00h, a bit
};

}  // namespace mrr::fw
