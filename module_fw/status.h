// Room: module_fw. What a module shows of itself to tests and telemetry, and the names of its states, modes and faults.
// May touch common/core and the codes of can_protocol. Freestanding.
#pragma once

#include <cstdint>

#include "can_protocol/faults.h"
#include "can_protocol/object_dictionary.h"
#include "common/core/time.h"

namespace mrr::fw {

/// CiA 402 power drive states.
enum class DriveState : std::uint8_t {
  not_ready_to_switch_on,
  switch_on_disabled,
  ready_to_switch_on,
  switched_on,
  operation_enabled,
  quick_stop_active,
  fault_reaction_active,
  fault,
};

/// 0x6060 / 0x6061.
enum class Mode : std::int8_t {
  limit_recovery = -5,
  brake_test = -4,
  torque_zero = -3,
  identification = -2,
  passive = -1,
  none = 0,
  homing = 6,
  cyclic_position = 8,
  cyclic_torque = 10,
};

/// What leads the joint in this tick; the arbiter picks the first that claims, in this order.
enum class Authority : std::uint8_t { fault_reaction, limit, user_stop, calibration, homing, motion, none };

/// Law in force.
enum class Law : std::uint8_t { off, active, passive };

/// A picture of the last tick.
struct ModuleStatus {
  Time now;
  DriveState state = DriveState::not_ready_to_switch_on;
  Mode mode = Mode::none;  ///< in force, as 0x6061
  Authority authority = Authority::none;
  Law law = Law::off;
  can::LimitCode limit = can::LimitCode::none;  ///< what holds the joint back, if anything
  bool operational = false;                     ///< NMT OPERATIONAL
  bool homed = false;
  bool following_knots = false;  ///< statusword bit 12 in mode 8
  bool brake_released = false;   ///< commanded, dwell included: motion is allowed

  float position_rad = 0.0F;
  float velocity_rad_s = 0.0F;
  float joint_torque_nm = 0.0F;  ///< sensor
  float current_a = 0.0F;
  bool position_valid = false;
  bool torque_valid = false;

  float reference_position_rad = 0.0F;
  float reference_velocity_rad_s = 0.0F;
  float reference_acceleration_rad_s2 = 0.0F;
  float active_torque_nm = 0.0F;   ///< demanded by the active law, before limits
  float passive_torque_nm = 0.0F;  ///< demanded by the passive law
  float torque_command_nm = 0.0F;  ///< after blend, slew and limits: what the drive is asked for
  float compensator_nm = 0.0F;     ///< share of the robust compensator in active_torque_nm
  float thermal_load = 0.0F;       ///< of the I^2 t model, 1 = continuous current for ever

  bool sync_locked = false;
  std::int64_t sync_error_ns = 0;  ///< last arrival against the phase-locked prediction
  float clock_drift_ppm = 0.0F;    ///< SYNC period on own clock against nominal
  std::uint8_t sync_counter = 0;

  std::uint8_t selection_acknowledged = 0;
  bool selection_armed = false;
  Time selection_executed_at;  ///< tick in which the last selection came into force
  Time blend_ended_at;         ///< tick in which the commanded torque first was the passive torque

  can::Emergency fault = can::Emergency::none;  ///< first cause, by its code
  can::Fault cause = can::Fault::none;          ///< ... by its row in the table
  Time fault_at;
  std::uint32_t knots_accepted = 0;
  std::uint32_t knots_missing = 0;
  std::uint32_t knots_rejected = 0;
};

}  // namespace mrr::fw
