// Room: module_fw. Everything a module knows about its joint before it starts: checked at the edge, immutable
// afterwards. May touch common/core only. Freestanding; float SI, joint side unless a name says motor.
#pragma once

#include <array>
#include <cstdint>
#include <limits>

#include "common/core/time.h"

namespace mrr::fw {

/// Sensors: scales of RawSensors, filters, and how long a reading may be missing.
struct SensingConfig {
  std::int32_t encoder_counts_per_turn = 16384;  ///< per motor turn
  bool encoder_absolute = true;                  ///< false: motion in mode 8, 10, -1 only after homing
  std::int32_t encoder_zero_count = 0;           ///< count at joint position 0 (absolute encoder)
  /// Double pole of the velocity observer. Below 1500 the compensator of a base joint rattles.
  float velocity_bandwidth_rad_s = 2500.0F;
  bool torque_sensor = true;
  float torque_offset_nm = 0.0F;               ///< what the sensor reads too high
  float torque_full_scale_nm = 100.0F;         ///< at ADC 32767; sign: torque the transmission gives the link
  float torque_bandwidth_rad_s = 0.0F;         ///< of a sensor of first order; 0: as good as at once
  float current_full_scale_a = 40.0F;          ///< at ADC 32767 and at duty 32767
  Duration encoder_timeout = milliseconds(3);  ///< a missing fresh bit makes the value invalid after this
  Duration torque_timeout = milliseconds(5);
  Duration current_timeout = milliseconds(10);
  Duration slow_timeout = milliseconds(500);   ///< temperatures, bus voltage
  float max_plausible_velocity_rad_s = 20.0F;  ///< a faster encoder step is a fault, not motion
};

/// Friction of the drive, joint side (theory: equation 5).
struct FrictionConfig {
  float coulomb_nm = 0.0F;
  float static_nm = 0.0F;
  float stribeck_decay_s2_rad2 = 0.0F;  ///< f_tau
  float viscous_nm_s_rad = 0.0F;
};

/// Order of the four: viscous b, Coulomb f_c, static f_s, Stribeck f_tau.
struct CompensatorConfig {
  bool enabled = true;
  std::array<float, 4> integral_gain{};   ///< K_i
  std::array<float, 4> integral_limit{};  ///< u_max
  std::array<float, 4> robust_gain{};     ///< rho
  std::array<float, 4> robust_width{};    ///< eps, > 0 where rho > 0
  float position_gain_nm = 0.0F;          ///< rho_q
  float position_width_rad_s = 1.0F;      ///< eps_q
};

/// Active law (theory section 2).
struct ControlConfig {
  float inertia_kg_m2 = 0.0F;  ///< J = gamma^2 I_r
  float lambda_1_s = 50.0F;
  float position_gain_nm_rad = 0.0F;    ///< K_P
  float velocity_gain_nm_s_rad = 0.0F;  ///< K_D
  float friction_feedforward = 1.0F;    ///< share of the identified friction
  /// How far the sensed load may depart from the supervisor's model torque (60B2h) and still be carried; what is beyond
  /// is contact, and the joint yields to it with K_P, K_D. Infinite, or no fresh model torque: all of it is carried.
  float carried_departure_nm = std::numeric_limits<float>::infinity();
  /// Slower than this the direction of friction is the reference's; more than two encoder counts per tick.
  float still_velocity_rad_s = 0.01F;
  float moving_velocity_rad_s = 0.02F;  ///< from it on it is that of the motion itself
  float reference_still_rad_s = 2e-3F;  ///< a reference slower than this fades out of the direction
  CompensatorConfig compensator;
};

/// Passive law and the change between the laws.
struct PassiveConfig {
  float compensation_nm = 0.0F;         ///< f_m in motion, below the Coulomb friction
  float static_compensation_nm = 0.0F;  ///< f_m at rest, below the static friction; not below compensation_nm
  float still_velocity_rad_s = 0.02F;   ///< slower than this may be elastic micro-motion: it says nothing
  float moving_velocity_rad_s = 0.05F;  ///< at and above it the trend is the motion alone
  float torque_dead_band_nm = 1.0F;     ///< at rest: sensed torque below it says nothing
  float torque_trend_nm = 1.5F;  ///< at rest: sensed torque that makes a trend, which lasts down to the dead band
  /// Fastest change of the trend (-1 .. 1) in motion, and at rest. Compensation bends the drive's friction and with it
  /// the spring that the torque sensor looks at: faster than the link swings on that spring, the two chase each other.
  float trend_rate_1_s = 60.0F;
  float rest_trend_rate_1_s = 10.0F;
  float torque_filter_rad_s = 30.0F;        ///< of the sensed torque that makes a trend; below the link on its spring
  Duration blend = milliseconds(3);         ///< active torque fades into passive torque
  float resume_torque_slew_nm_s = 2000.0F;  ///< coming back
  float guard_energy_j = 0.015F;            ///< observed gain of energy at which the compensation is taken back
  Duration max_time = milliseconds(500);    ///< then active again by itself
  float max_travel_rad = 0.35F;             ///< the same
};

/// The share of the static friction that `compensation_nm` is of the Coulomb friction.
constexpr float static_compensation_nm(float compensation_nm, const FrictionConfig& f) noexcept {
  return f.coulomb_nm > 0.0F ? compensation_nm * (f.static_nm / f.coulomb_nm) : 0.0F;
}

/// How the reference is led when no knots lead it.
struct ReferenceConfig {
  float stop_deceleration_rad_s2 = 20.0F;        ///< slow-down ramp (6084h): controlled stop, return from passive
  float quick_stop_deceleration_rad_s2 = 40.0F;  ///< quick-stop ramp (6085h)
  float settle_rate_1_s = 100.0F;                ///< the last bit of a stop is exponential with this rate
  float resync_window_rad = 0.01F;               ///< a knot this near to the held reference takes over
  float resync_velocity_rad_s = 0.1F;            ///< ... and this near in velocity
  float offset_decay_1_s = 20.0F;                ///< how fast the remaining difference is removed
};

struct DriveConfig {
  float gear_ratio = 1.0F;
  float torque_constant_positive_nm_a = 0.1F;  ///< motor side, efficiency included
  float torque_constant_negative_nm_a = 0.1F;
  float peak_current_a = 0.0F;
  float continuous_current_a = 0.0F;
  float thermal_time_constant_s = 60.0F;
  float max_winding_temperature_c = 130.0F;
  float max_drive_temperature_c = 90.0F;
  float temperature_derating_c = 15.0F;  ///< current comes down over this much below the limit
  float min_bus_voltage_v = 0.0F;
  float max_bus_voltage_v = 80.0F;
  float rated_torque_nm = 1.0F;  ///< 0x6076: torque on the wire is in thousandths of it
};

struct LimitsConfig {
  float lower_rad = -3.0F;
  float upper_rad = 3.0F;
  float velocity_rad_s = 2.0F;
  float acceleration_rad_s2 = 25.0F;
  float torque_nm = 0.0F;  ///< largest commanded joint-side torque
  float following_error_rad = 0.1F;
  Duration following_error_time = milliseconds(50);
};

/// What homing looks for.
enum class HomingMark : std::uint8_t { home_switch, limit_switch, index };

struct HomingConfig {
  std::int8_t method = -1;           ///< 6098h: -1 on the switch, 37 here
  float switch_position_rad = 0.0F;  ///< what the joint reads at the switch's edge
  int direction = -1;
  float fast_rad_s = 0.2F;
  float slow_rad_s = 0.02F;
  Duration timeout = milliseconds(30'000);
  float max_travel_rad = 0.0F;  ///< 0: not capped
  float max_torque_nm = 0.0F;   ///< beyond what the joint carries; 0: not capped
  bool index = false;  ///< after the edge goes on to the encoder's next index pulse, which is the reference then
  float index_position_rad = 0.0F;  ///< what the joint reads there
  HomingMark mark = HomingMark::home_switch;
  bool leaving = false;  ///< the reference is the edge as the joint leaves the switch, not as it meets it
};

struct BrakeConfig {
  Duration release = milliseconds(60);
  Duration engage = milliseconds(60);
  Duration torque_confirm_timeout = milliseconds(500);
};

/// What the node watches. Zero switches a watchdog off (0x1016 can set the heartbeat one over the bus).
struct WatchdogConfig {
  std::uint8_t missing_knots = 2;                     ///< this many knot periods without a knot: controlled stop
  Duration supervisor_heartbeat = milliseconds(500);  ///< consumer heartbeat time (0x1016) at start
  Duration sync = milliseconds(50);                   ///< in mode 8: without SYNC for longer is a fault
  Duration torque_target = milliseconds(100);         ///< in mode 10: without a target for longer it holds
  /// As 2131h: 0 report, 2 hold, 3 stop, 4 damp. Of knots, torque targets, heartbeat, SYNC, bus-off.
  std::array<std::uint8_t, 5> reactions{2, 2, 3, 3, 3};
  std::array<std::uint8_t, 2> torque_reactions{3, 3};         ///< 2132h: mode 10; of heartbeat, bus-off
  std::array<std::uint8_t, 4> passive_reactions{0, 0, 0, 0};  ///< 2133h: of knots, heartbeat, SYNC, bus-off
  Duration passive;                                           ///< passive: without knots for longer; 0: not watched
  Duration loop = milliseconds(10);                           ///< longer between two ticks, while led, is a fault
};

/// All of it. Copied from the robot description on a PC, or linked in as a table on a microcontroller.
struct ModuleConfig {
  std::uint8_t node_id = 2;
  std::uint8_t supervisor_node_id = 1;
  std::uint8_t selection_bit = 0;
  std::uint32_t configuration_hash = 0;    ///< shown at 0x2001; the supervisor compares it
  std::uint32_t serial_number = 0;         ///< 0x1018 sub 4
  Duration tick = milliseconds(1);         ///< control period
  Duration knot_period = milliseconds(4);  ///< nominal SYNC period
  std::uint32_t bit_rate = 1'000'000;
  bool test_faults = false;  ///< object 2F00h exists: writing an emergency code provokes that fault
  SensingConfig sensing;
  FrictionConfig friction;
  ControlConfig control;
  PassiveConfig passive;
  ReferenceConfig reference;
  DriveConfig drive;
  LimitsConfig limits;
  HomingConfig homing;
  BrakeConfig brake;
  WatchdogConfig watchdog;
};

}  // namespace mrr::fw
