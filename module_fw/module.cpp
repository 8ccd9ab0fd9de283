#include "module_fw/module.h"

#include <bit>
#include <limits>

#include "can_protocol/units.h"

namespace mrr::fw {

namespace {

using can::Emergency;
using can::Fault;
using can::LimitCode;
using can::Reaction;

constexpr Duration kSensorStart = milliseconds(1000);  // by then every sensor must have spoken
constexpr float kPositionSlack = 0.01F;                // rad beyond a soft limit before the joint is stopped for it
constexpr float kCreep = 0.01F;                        // rad/s
constexpr float kOutward = 0.05F;        // rad/s: moves away from its limits, whatever the noise of the velocity
constexpr float kStill = 1e-3F;          // rad/s: slower is not moving towards a limit
constexpr float kConfirmShare = 0.05F;   // of full-scale current: agreement that confirms torque
constexpr float kHoldLeash = 0.8F;       // of the resynchronisation window: a held joint can always be taken over again
constexpr float kBrakeTestShare = 1.5F;  // of the rated torque
constexpr float kDamped = 0.05F;         // rad/s: slow enough for the brake when damping
// Of the friction: the passive law must not drive, not even with a tenth less friction than identified.
constexpr float kMaxCompensationShare = 0.895F;
constexpr float kTakeBackTicks = 3.0F;             // a compensation that drives is gone after so many
constexpr float kIdentificationSpeed = 0.8F;       // of the velocity limit
constexpr float kIdentificationLoad = 0.7F;        // of the sensed load
constexpr Duration kDampTime = milliseconds(150);  // ... which closes then at the latest
constexpr std::uint32_t kNotWatched = 0xFFFF'FFFFU;
constexpr unsigned kLimitSwitches = std::uint8_t{kInputNegativeLimit} | std::uint8_t{kInputPositiveLimit};
// What a reset does not take away.
constexpr std::uint64_t kStandsByItself = FaultMonitor::bit(Fault::configuration) | FaultMonitor::bit(Fault::storage) |
                                          FaultMonitor::bit(Fault::limit_switch);
constexpr std::uint32_t kShortestPeriodUs = 1000;  // as 2003h has it
constexpr std::uint32_t kLongestPeriodUs = 1'000'000;
constexpr float kInfinity = std::numeric_limits<float>::infinity();

#ifndef MRR_NO_TEST_OBJECTS
Fault fault_of(Emergency code) noexcept {
  for (std::size_t i = 0; i < can::kFaultCount; ++i) {
    if (can::kFaults[i].code == code) return static_cast<Fault>(i);
  }
  return Fault::none;
}
#endif

bool positive(float x) noexcept { return x > 0.0F && is_finite(x); }
bool not_negative(float x) noexcept { return x >= 0.0F && is_finite(x); }

// What the laws divide by or rely on. The host's loader checks far more; this is the last line.
bool usable(const ModuleConfig& c) noexcept {
  bool ok = c.node_id >= 1 && c.node_id <= 127 && c.selection_bit < 32 && c.tick.ns > 0 && c.knot_period >= c.tick;
  ok = ok && c.sensing.encoder_counts_per_turn > 0 && positive(c.drive.gear_ratio) &&
       positive(c.sensing.velocity_bandwidth_rad_s) && positive(c.sensing.current_full_scale_a) &&
       (!c.sensing.torque_sensor || positive(c.sensing.torque_full_scale_nm)) &&
       is_finite(c.sensing.torque_offset_nm) && not_negative(c.sensing.torque_bandwidth_rad_s) &&
       positive(c.sensing.max_plausible_velocity_rad_s);
  ok = ok && positive(c.drive.torque_constant_positive_nm_a) && positive(c.drive.torque_constant_negative_nm_a) &&
       positive(c.drive.continuous_current_a) && c.drive.peak_current_a >= c.drive.continuous_current_a &&
       is_finite(c.drive.peak_current_a) && positive(c.drive.thermal_time_constant_s) &&
       positive(c.drive.temperature_derating_c) && positive(c.drive.rated_torque_nm) &&
       is_finite(c.drive.max_winding_temperature_c) && is_finite(c.drive.max_drive_temperature_c);
  const FrictionConfig& f = c.friction;
  ok = ok && not_negative(f.coulomb_nm) && f.static_nm >= f.coulomb_nm && is_finite(f.static_nm) &&
       not_negative(f.stribeck_decay_s2_rad2) && not_negative(f.viscous_nm_s_rad);
  const ControlConfig& k = c.control;
  ok = ok && positive(k.inertia_kg_m2) && k.carried_departure_nm >= 0.0F && not_negative(k.lambda_1_s) &&
       not_negative(k.position_gain_nm_rad) && not_negative(k.velocity_gain_nm_s_rad) &&
       not_negative(k.friction_feedforward) && positive(k.reference_still_rad_s) &&
       not_negative(k.still_velocity_rad_s) && k.moving_velocity_rad_s > k.still_velocity_rad_s &&
       is_finite(k.moving_velocity_rad_s) && not_negative(k.compensator.position_gain_nm) &&
       is_finite(k.compensator.position_width_rad_s);
  for (std::size_t i = 0; i < 4; ++i) {
    ok = ok && not_negative(k.compensator.integral_gain[i]) && not_negative(k.compensator.integral_limit[i]) &&
         not_negative(k.compensator.robust_gain[i]) && not_negative(k.compensator.robust_width[i]);
  }
  const PassiveConfig& p = c.passive;
  ok = ok && not_negative(p.compensation_nm) && p.compensation_nm <= kMaxCompensationShare * f.coulomb_nm &&
       p.static_compensation_nm >= p.compensation_nm &&
       p.static_compensation_nm <= kMaxCompensationShare * f.static_nm && positive(p.guard_energy_j) &&
       not_negative(p.still_velocity_rad_s) && p.moving_velocity_rad_s > p.still_velocity_rad_s &&
       is_finite(p.moving_velocity_rad_s) && not_negative(p.torque_dead_band_nm) &&
       p.torque_trend_nm > p.torque_dead_band_nm && is_finite(p.torque_trend_nm) && positive(p.trend_rate_1_s) &&
       positive(p.rest_trend_rate_1_s) && positive(p.torque_filter_rad_s) && positive(p.resume_torque_slew_nm_s) &&
       positive(p.max_travel_rad) && p.blend.ns >= 0 && p.max_time.ns >= 0;
  const LimitsConfig& l = c.limits;
  ok = ok && l.lower_rad < l.upper_rad && positive(l.velocity_rad_s) && positive(l.acceleration_rad_s2) &&
       positive(l.torque_nm) && is_finite(l.lower_rad) && is_finite(l.upper_rad) && not_negative(l.following_error_rad);
  const HomingConfig& h = c.homing;
  ok = ok && positive(h.fast_rad_s) && positive(h.slow_rad_s) && is_finite(h.switch_position_rad) &&
       is_finite(h.index_position_rad) && not_negative(h.max_travel_rad) && not_negative(h.max_torque_nm);
  const ReferenceConfig& r = c.reference;
  return ok && positive(r.stop_deceleration_rad_s2) && positive(r.quick_stop_deceleration_rad_s2) &&
         positive(r.settle_rate_1_s) && not_negative(r.resync_window_rad) && not_negative(r.resync_velocity_rad_s) &&
         positive(r.offset_decay_1_s);
}

// A configuration that is not usable is never used for arithmetic: the module runs on harmless numbers, in FAULT.
ModuleConfig usable_or_harmless(const ModuleConfig& c) noexcept {
  if (usable(c)) return c;
  ModuleConfig harmless;
  harmless.node_id = c.node_id >= 1 && c.node_id <= 127 ? c.node_id : std::uint8_t{127};
  harmless.bit_rate = c.bit_rate;
  harmless.control.inertia_kg_m2 = 1.0F;
  harmless.drive.peak_current_a = harmless.drive.continuous_current_a = 1.0F;
  harmless.limits.torque_nm = 1.0F;
  return harmless;
}

TorqueSelector make_selector(const PassiveConfig& p, Duration tick) noexcept {
  return TorqueSelector(static_cast<std::int32_t>(p.blend / tick), p.resume_torque_slew_nm_s * tick.seconds_f());
}

std::uint32_t micro(float x) noexcept { return static_cast<std::uint32_t>(x * 1e6F + 0.5F); }
std::int32_t micro_rad(float x) noexcept { return can::urad_from_rad(x).value_or(0); }

/// 60C2h: value * 10^exponent seconds, in us.
std::uint32_t interpolation_time_us(const can::ObjectDictionary& od) noexcept {
  std::uint32_t us = od.interpolation_time_value;
  for (int e = od.interpolation_time_exponent; e > -6; --e) us *= 10U;
  return us;
}

/// 60C2h says what 2003h does, in milliseconds where it can.
void show_interpolation_time(can::ObjectDictionary& od) noexcept {
  std::uint32_t value = od.knot_period_us;
  std::int8_t exponent = -6;
  while (value % 10U == 0 && (exponent < -3 || value > 255U)) {
    value /= 10U;
    ++exponent;
  }
  if (value > 255U) return;  // it has no such form
  od.interpolation_time_value = static_cast<std::uint8_t>(value);
  od.interpolation_time_exponent = exponent;
}

std::uint32_t to_ms(Duration d) noexcept { return static_cast<std::uint32_t>(d / milliseconds(1)); }

}  // namespace

Module::Module(const ModuleConfig& config) noexcept
    : config_(usable_or_harmless(config)),
      dt_s_(config_.tick.seconds_f()),
      tick_us_(static_cast<std::uint32_t>(config_.tick / microseconds(1))),
      permille_per_nm_(1e3F / config_.drive.rated_torque_nm),
      permille_per_a_(1e3F / config_.drive.continuous_current_a),
      node_(
          (fill_objects(), od_),
          can::NodeConfig{.node_id = config_.node_id, .bit_rate = config_.bit_rate, .test_objects = config.test_faults},
          *this),
      pll_(config_.knot_period),
      selection_(config_.selection_bit),
      sensing_(config_.sensing, config_.drive, dt_s_),
      reference_(config_.reference, config_.limits, dt_s_),
      active_(config_.control, config_.friction, dt_s_),
      passive_(config_.passive, dt_s_),
      guard_(config_.control.inertia_kg_m2, dt_s_),
      selector_(make_selector(config_.passive, config_.tick)),
      drive_(config_.drive, config_.sensing, config_.limits, dt_s_),
      brake_(config_.brake),
      usable_at_start_(usable(config)),
      faults_(config_.tick),
      sensor_watch_(config_),
      swing_watch_(config_.friction, config_.tick) {
  stand_if(Fault::configuration, !usable_at_start_);
  status_.homed = config_.sensing.encoder_absolute;
  overrun_after_ = config_.tick + config_.tick / 2;
  homing_.configure(config_.homing);
  apply_live_parameters();
}

// ---------------------------------------------------------------------------------------------- configuration

void Module::fill_objects() noexcept {
  const ModuleConfig& c = config_;
  od_.protocol_hash = can::kProtocolHash;
  od_.configuration_hash = c.configuration_hash;
  od_.identity_serial_number = c.serial_number;
  od_.store_all = od_.restore_all = 0;  // no memory yet
  od_.loop_rate_hz = static_cast<std::uint16_t>(milliseconds(1000) / c.tick);
  od_.knot_period_us = static_cast<std::uint32_t>(c.knot_period / microseconds(1));
  show_interpolation_time(od_);
  od_.selection_bit = c.selection_bit;
  od_.consumer_heartbeat[0] =
      static_cast<std::uint32_t>(c.supervisor_node_id) << 16U | (to_ms(c.watchdog.supervisor_heartbeat) & 0xFFFFU);

  od_.control_lambda_1_s = c.control.lambda_1_s;
  od_.control_position_gain_nm_rad = c.control.position_gain_nm_rad;
  od_.control_velocity_gain_nm_s_rad = c.control.velocity_gain_nm_s_rad;
  od_.control_friction_feedforward = c.control.friction_feedforward;
  od_.control_compensator_enabled = c.control.compensator.enabled ? 1 : 0;
  od_.control_resume_torque_slew_nm_s = c.passive.resume_torque_slew_nm_s;
  od_.friction_coulomb_nm = c.friction.coulomb_nm;
  od_.friction_static_nm = c.friction.static_nm;
  od_.friction_stribeck_decay_s2_rad2 = c.friction.stribeck_decay_s2_rad2;
  od_.friction_viscous_nm_s_rad = c.friction.viscous_nm_s_rad;
  od_.compensator_integral_gain = c.control.compensator.integral_gain;
  od_.compensator_integral_limit = c.control.compensator.integral_limit;
  od_.compensator_robust_gain = c.control.compensator.robust_gain;
  od_.compensator_robust_width = c.control.compensator.robust_width;
  od_.compensator_position_gain_nm = c.control.compensator.position_gain_nm;
  od_.compensator_position_width_rad_s = c.control.compensator.position_width_rad_s;
  od_.passive_compensation = c.friction.static_nm > 0.0F ? c.passive.compensation_nm / c.friction.static_nm : 0.0F;
  od_.passive_guard_j = c.passive.guard_energy_j;
  od_.passive_blend_s = c.passive.blend.seconds_f();
  od_.passive_max_s = c.passive.max_time.seconds_f();
  od_.passive_max_travel_rad = c.passive.max_travel_rad;
  od_.limit_velocity_rad_s = c.limits.velocity_rad_s;
  od_.limit_torque_nm = c.limits.torque_nm;
  od_.limit_current_a = c.drive.peak_current_a;
  od_.limit_winding_temperature_degc = c.drive.max_winding_temperature_c;
  od_.watchdog_knot_periods = c.watchdog.missing_knots;
  od_.watchdog_sync_ms = static_cast<std::uint16_t>(to_ms(c.watchdog.sync));
  od_.watchdog_torque_ms = static_cast<std::uint16_t>(to_ms(c.watchdog.torque_target));
  od_.reaction_knots_lost = c.watchdog.reactions[0];
  od_.reaction_torque_target_lost = c.watchdog.reactions[1];
  od_.reaction_heartbeat_lost = c.watchdog.reactions[2];
  od_.reaction_sync_lost = c.watchdog.reactions[3];
  od_.reaction_bus_off = c.watchdog.reactions[4];
  od_.watchdog_passive_ms = static_cast<std::uint16_t>(to_ms(c.watchdog.passive));
  od_.reaction_torque_heartbeat_lost = c.watchdog.torque_reactions[0];
  od_.reaction_torque_bus_off = c.watchdog.torque_reactions[1];
  od_.reaction_passive_knots_lost = c.watchdog.passive_reactions[0];
  od_.reaction_passive_heartbeat_lost = c.watchdog.passive_reactions[1];
  od_.reaction_passive_sync_lost = c.watchdog.passive_reactions[2];
  od_.reaction_passive_bus_off = c.watchdog.passive_reactions[3];
  od_.torque_sensor_offset_nm = c.sensing.torque_offset_nm;
  od_.homing_method = c.homing.method;
  od_.homing_switch_position_urad = micro_rad(c.homing.switch_position_rad);
  od_.homing_timeout_ms = to_ms(c.homing.timeout);
  od_.homing_max_travel_urad = micro(c.homing.max_travel_rad);
  od_.homing_max_torque_nm = c.homing.max_torque_nm;
  od_.homing_index = c.homing.index ? 1 : 0;
  od_.homing_index_position_urad = micro_rad(c.homing.index_position_rad);
  od_.homing_speed_switch_urad_s = micro(c.homing.fast_rad_s);
  od_.homing_speed_zero_urad_s = micro(c.homing.slow_rad_s);
  od_.brake_release_ms = static_cast<std::uint16_t>(to_ms(c.brake.release));
  od_.brake_engage_ms = static_cast<std::uint16_t>(to_ms(c.brake.engage));
  od_.drive_gear_ratio = c.drive.gear_ratio;
  od_.drive_reflected_inertia_kg_m2 = c.control.inertia_kg_m2;
  od_.following_error_window_urad =
      c.limits.following_error_rad > 0.0F ? micro(c.limits.following_error_rad) : kNotWatched;
  od_.following_error_timeout_ms = static_cast<std::uint16_t>(to_ms(c.limits.following_error_time));
  od_.position_limit_min_urad = micro_rad(c.limits.lower_rad);
  od_.position_limit_max_urad = micro_rad(c.limits.upper_rad);
  od_.profile_deceleration_mrad_s2 = static_cast<std::uint32_t>(c.reference.stop_deceleration_rad_s2 * 1e3F);
  od_.quick_stop_deceleration_mrad_s2 = static_cast<std::uint32_t>(c.reference.quick_stop_deceleration_rad_s2 * 1e3F);
  od_.motor_rated_current_ma = static_cast<std::uint32_t>(c.drive.continuous_current_a * 1e3F + 0.5F);
  od_.motor_rated_torque_mnm = static_cast<std::uint32_t>(c.drive.rated_torque_nm * 1e3F + 0.5F);
}

void Module::apply_parameters() noexcept {
  parameters_changed_ = false;
  ModuleConfig c = config_;
  c.control.lambda_1_s = od_.control_lambda_1_s;
  c.control.position_gain_nm_rad = od_.control_position_gain_nm_rad;
  c.control.velocity_gain_nm_s_rad = od_.control_velocity_gain_nm_s_rad;
  c.control.friction_feedforward = od_.control_friction_feedforward;
  c.control.compensator.enabled = od_.control_compensator_enabled != 0;
  c.passive.resume_torque_slew_nm_s = od_.control_resume_torque_slew_nm_s;
  c.friction = {od_.friction_coulomb_nm, od_.friction_static_nm, od_.friction_stribeck_decay_s2_rad2,
                od_.friction_viscous_nm_s_rad};
  c.control.compensator.integral_gain = od_.compensator_integral_gain;
  c.control.compensator.integral_limit = od_.compensator_integral_limit;
  c.control.compensator.robust_gain = od_.compensator_robust_gain;
  c.control.compensator.robust_width = od_.compensator_robust_width;
  c.control.compensator.position_gain_nm = od_.compensator_position_gain_nm;
  c.control.compensator.position_width_rad_s = od_.compensator_position_width_rad_s;
  const float wanted_nm = od_.passive_compensation * c.friction.static_nm;
  c.passive.compensation_nm = limit(wanted_nm, 0.0F, kMaxCompensationShare * c.friction.coulomb_nm);
  c.passive.static_compensation_nm = static_compensation_nm(c.passive.compensation_nm, c.friction);
  c.passive.guard_energy_j = od_.passive_guard_j;
  c.passive.blend = {static_cast<std::int64_t>(micro(od_.passive_blend_s)) * 1000};
  c.passive.max_time = {static_cast<std::int64_t>(micro(od_.passive_max_s)) * 1000};
  c.passive.max_travel_rad = od_.passive_max_travel_rad;
  c.limits.velocity_rad_s = od_.limit_velocity_rad_s;
  if (od_.max_motor_speed_urad_s != kNotWatched) {
    const float speed = static_cast<float>(od_.max_motor_speed_urad_s) * 1e-6F;
    if (speed < c.limits.velocity_rad_s) c.limits.velocity_rad_s = speed;
  }
  c.limits.torque_nm = od_.limit_torque_nm;
  c.limits.lower_rad = static_cast<float>(od_.position_limit_min_urad) * 1e-6F;
  c.limits.upper_rad = static_cast<float>(od_.position_limit_max_urad) * 1e-6F;
  c.drive.peak_current_a = od_.limit_current_a;
  c.drive.max_winding_temperature_c = od_.limit_winding_temperature_degc;
  c.watchdog.missing_knots = od_.watchdog_knot_periods;
  c.reference.stop_deceleration_rad_s2 = static_cast<float>(od_.profile_deceleration_mrad_s2) * 1e-3F;
  c.reference.quick_stop_deceleration_rad_s2 = static_cast<float>(od_.quick_stop_deceleration_mrad_s2) * 1e-3F;
  c.homing.switch_position_rad = static_cast<float>(od_.homing_switch_position_urad) * 1e-6F;
  c.homing.fast_rad_s = static_cast<float>(od_.homing_speed_switch_urad_s) * 1e-6F;
  c.homing.slow_rad_s = static_cast<float>(od_.homing_speed_zero_urad_s) * 1e-6F;
  c.homing.timeout = milliseconds(od_.homing_timeout_ms);
  c.homing.max_travel_rad = static_cast<float>(od_.homing_max_travel_urad) * 1e-6F;
  c.homing.max_torque_nm = od_.homing_max_torque_nm;
  c.homing.index = od_.homing_index != 0;
  c.homing.index_position_rad = static_cast<float>(od_.homing_index_position_urad) * 1e-6F;
  c.selection_bit = od_.selection_bit;
  const Duration knot_period = microseconds(od_.knot_period_us);
  const bool new_period = knot_period != c.knot_period;
  const bool new_bit = c.selection_bit != config_.selection_bit;
  c.knot_period = knot_period;
  stand_if(Fault::configuration, !(usable_at_start_ && usable(c)));
  if (!configuration_valid()) return;
  config_ = c;
  reference_ = Reference(c.reference, c.limits, dt_s_);
  active_ = ActiveLaw(c.control, c.friction, dt_s_);
  passive_ = PassiveLaw(c.passive, dt_s_);
  guard_ = PassivityGuard(c.control.inertia_kg_m2, dt_s_);
  selector_ = make_selector(c.passive, c.tick);
  drive_.configure(c.drive, c.limits);
  sensor_watch_.configure(c);
  swing_watch_ = SwingWatch(c.friction, c.tick);
  if (new_bit) selection_ = SelectionSwitch(c.selection_bit);  // otherwise what it acknowledged still stands
  homing_.configure(c.homing);
  if (new_period) pll_ = SyncPll(knot_period);
}

void Module::load_parameters(can::StoragePort& port) noexcept {
  store_.load(port, od_, node_.config().node_id);
  od_.store_all = od_.restore_all = 1;  // on command
  stand_if(Fault::stored_parameters, store_.state() == can::StorageState::refused);
  const std::uint8_t id = od_.stored_node_id;
  if ((id >= 1 && id <= can::kMaxNodeId) || id == can::kUnconfiguredNodeId) node_.begin_with(id);
  od_.configuration_hash = can::hash_with_changes(config_.configuration_hash, node_.factory(), od_);
  parameters_changed_ = true;
  apply_live_parameters();
  publish_storage();
}

// Not while the joint is led: a memory may hold up the controller.
can::Abort Module::begin_write(const can::ObjectDictionary* od) noexcept {
  if (!store_.has_memory()) return can::Abort::cannot_store;
  if (brake_.phase() != BrakeSequence::Phase::off) return can::Abort::state;
  return store_.begin_write(od, node_.config().node_id) ? can::Abort::none : can::Abort::local_control;
}

can::Abort Module::store(Time) noexcept {
  const can::Abort refused = begin_write(&od_);
  if (refused == can::Abort::none) {
    od_.configuration_hash = can::hash_with_changes(config_.configuration_hash, node_.factory(), od_);
    pass(Fault::stored_parameters);
  }
  return refused;
}

can::Abort Module::restore_defaults(Time) noexcept { return begin_write(nullptr); }

// CiA 305: the node id alone. What else was written and not stored stays so.
can::LssStored Module::store_node_id(std::uint8_t node_id) noexcept {
  const std::uint8_t before = od_.stored_node_id;
  od_.stored_node_id = node_.power_on().stored_node_id = node_id;
  const can::Abort refused = begin_write(&node_.power_on());
  if (refused == can::Abort::none) return can::LssStored::done;
  od_.stored_node_id = node_.power_on().stored_node_id = before;
  return refused == can::Abort::cannot_store ? can::LssStored::not_supported : can::LssStored::memory_failed;
}

void Module::publish_storage() noexcept {
  stand_if(Fault::storage, store_.lost_something());
  od_.storage_state = static_cast<std::uint8_t>(store_.state());
  od_.storage_version = store_.version();
  od_.storage_slot = store_.slot();
  od_.storage_migrated = store_.migrated();
  od_.storage_refused = store_.refused_object();
}

// ---------------------------------------------------------------------------------------------- communication

can::Abort Module::may_write(can::ObjectId id, [[maybe_unused]] const can::Value& value) noexcept {
#ifndef MRR_NO_TEST_OBJECTS
  // One provoked fault at a time: the reset clears the first cause.
  if (id == can::ObjectId::test_fault) {
    if (status_.fault != Emergency::none) return can::Abort::state;
    if (fault_of(static_cast<Emergency>(value.as_unsigned())) == Fault::none) return can::Abort::value;
  }
#endif
  // The loop is locked to this period while the joint is led.
  const bool period = id == can::ObjectId::knot_period_us || id == can::ObjectId::interpolation_time_value ||
                      id == can::ObjectId::interpolation_time_exponent;
  if (period && machine_.state() == DriveState::operation_enabled) return can::Abort::state;
  return can::Abort::none;
}

void Module::written(can::ObjectId id, can::WriteSource source, Time at) noexcept {
#ifndef MRR_NO_TEST_OBJECTS
  if (id == can::ObjectId::test_fault) {
    provoked_ = FaultMonitor::bit(fault_of(static_cast<Emergency>(od_.test_fault)));
    return;
  }
#endif
  if (id == can::ObjectId::controlword && !controlwords_.push_back(od_.controlword)) {
    controlwords_.back() = od_.controlword;
  }
  if (id == can::ObjectId::knot_period_us) show_interpolation_time(od_);
  if (id == can::ObjectId::interpolation_time_value || id == can::ObjectId::interpolation_time_exponent) {
    // On the way from one period to another the two may make one that cannot be: the old one stands until they do not.
    const std::uint32_t us = interpolation_time_us(od_);
    if (us >= kShortestPeriodUs && us <= kLongestPeriodUs) od_.knot_period_us = us;
  }
  const bool by_sdo = source == can::WriteSource::sdo;
  if (!by_sdo && id == can::ObjectId::target_torque_permille) {
    torque_target_came_ = true;
    torque_target_at_ = at;
  }
  if (by_sdo) parameters_changed_ = true;
  if (by_sdo || id == can::ObjectId::max_torque_permille) apply_live_parameters();
}

// Objects that are in force at once.
void Module::apply_live_parameters() noexcept {
  max_torque_nm_ = static_cast<float>(od_.max_torque_permille) * 1e-3F * config_.drive.rated_torque_nm;
  choose_reactions();
  sensing_.set_torque_offset(od_.torque_sensor_offset_nm);
  const ControlConfig& k = config_.control;
  const float own_damping = 2.0F * k.lambda_1_s * k.inertia_kg_m2;
  damping_nm_s_rad_ = k.velocity_gain_nm_s_rad > own_damping ? k.velocity_gain_nm_s_rad : own_damping;
  const bool watched = od_.following_error_window_urad != kNotWatched;
  following_error_rad_ = watched ? static_cast<float>(od_.following_error_window_urad) * 1e-6F : kInfinity;
  following_error_limit_ticks_ = milliseconds(od_.following_error_timeout_ms) / config_.tick;
}

// What a silent source leads to in the mode in force. A joint in FAULT keeps what brought it there.
void Module::choose_reactions() noexcept {
  if (machine_.state() == DriveState::fault || machine_.state() == DriveState::fault_reaction_active) return;
  const auto choose = [this](Fault fault, std::uint8_t number) {
    const auto reaction = static_cast<Reaction>(number);
    // A harder one is as good as a new fault: told again.
    if (reaction > faults_.reaction_of(fault)) tell_again_ |= FaultMonitor::bit(fault);
    faults_.set_reaction(fault, reaction);
  };
  const can::ObjectDictionary& od = od_;
  const bool torque = mode_ == Mode::cyclic_torque;
  choose(Fault::knots_lost, passive() ? od.reaction_passive_knots_lost : od.reaction_knots_lost);
  choose(Fault::torque_target_lost, od.reaction_torque_target_lost);
  choose(Fault::heartbeat_lost, passive() ? od.reaction_passive_heartbeat_lost
                                : torque  ? od.reaction_torque_heartbeat_lost
                                          : od.reaction_heartbeat_lost);
  choose(Fault::sync_lost, passive() ? od.reaction_passive_sync_lost : od.reaction_sync_lost);
  choose(Fault::bus_off, passive() ? od.reaction_passive_bus_off
                         : torque  ? od.reaction_torque_bus_off
                                   : od.reaction_bus_off);
}

void Module::pdo_delivered(std::uint8_t number, Time received) noexcept {
  if (number == 2 || number == 3) set_point_at_ = received;
  if (number == 2) knot_position_came_ = true;
  if (number == 3) {
    knot_acceleration_came_ = knots_have_sequence_ = true;
    knot_came_at_ = received;
    model_torque_until_ = received + pll_.period() * 3;
  }
}

void Module::sync(Time at, std::optional<std::uint8_t> counter) noexcept {
  const SyncPll::Arrival arrival = pll_.on_sync(at);
  const Duration quiet = milliseconds(od_.watchdog_sync_ms);
  const Duration periods = pll_.period() * 4;
  sync_due_ = od_.watchdog_sync_ms == 0 ? kNever : at + (quiet > periods ? quiet : periods);
  // Delivered twice: it says nothing new, and the knot that came meanwhile is for the next one.
  if (arrival.periods == 0) return;
  sync_counter_ = counter;
  if (counter) {
    status_.sync_counter = *counter;
    selection_.on_sync(*counter, od_.sync_counter_overflow, pll_);
  }
  // A knot is both halves, or, from a client that knows no acceleration, the position alone.
  const bool complete = knot_position_came_ && (knot_acceleration_came_ || !knots_have_sequence_);
  knot_position_came_ = knot_acceleration_came_ = false;
  const Duration period = pll_.period();
  if (!complete) {
    if (reference_.following()) {
      ++od_.count_missed_knots;
      ++status_.knots_missing;
    }
    has_last_target_ = false;
    return;
  }
  Knot knot;
  knot.state.position_rad = static_cast<float>(od_.target_position_urad) * 1e-6F;
  if (knots_have_sequence_) {
    knot.state.velocity_rad_s = static_cast<float>(od_.velocity_offset_urad_s) * 1e-6F;
    knot.state.acceleration_rad_s2 = static_cast<float>(od_.target_acceleration_mrad_s2) * 1e-3F;
    knot.sequence = od_.knot_sequence;
    // It came for an earlier SYNC, which was lost: on the way meanwhile, as it says itself.
    const std::int64_t late = (at - knot_came_at_ + Duration{period.ns / 2}) / period - 1;
    if (late > 0) knot.state = carried_on(knot.state, short_seconds(period.ns) * static_cast<float>(late));
  } else {
    // Positions alone: the velocity is their difference.
    if (has_last_target_) {
      knot.state.velocity_rad_s = (knot.state.position_rad - last_target_rad_) / short_seconds(period.ns);
    }
    last_target_rad_ = knot.state.position_rad;
    has_last_target_ = true;
    knot.sequence = ++own_sequence_;
  }
  offer_knot(knot, period);
}

void Module::offer_knot(const Knot& knot, Duration period) noexcept {
  if (!(permits(situation(), Request::set_points) && authority_ == Authority::motion &&
        mode_ == Mode::cyclic_position && status_.homed && pll_.locked())) {
    return;
  }
  switch (reference_.offer(knot, pll_.sync_time(), period, sensing_.position_rad())) {
    case KnotVerdict::resynchronised:
      passive_ended_by_ = LimitCode::none;
      passivity_lost_ = false;
      pass(Fault::knots_lost);
      [[fallthrough]];
    case KnotVerdict::accepted:
      knot_due_ = pll_.sync_time() + pll_.period() * config_.watchdog.missing_knots + pll_.period() / 4;
      hold_reason_ = LimitCode::none;
      limit_stop_ = false;
      ++status_.knots_accepted;
      break;
    case KnotVerdict::stale:
      ++od_.count_stale_knots;
      break;
    case KnotVerdict::out_of_limits:
      ++status_.knots_rejected;
      if (reference_.following()) stop_at_limit(LimitCode::knot_rejected);
      break;
    case KnotVerdict::jump:
      ++status_.knots_rejected;
      hold_reason_ = LimitCode::knot_rejected;
      break;
    case KnotVerdict::ignored_far:
    case KnotVerdict::ignored_moving:
      break;
  }
}

void Module::selection(const can::SelectionCommand& command, Time at) noexcept {
  SelectionSwitch::Context context;
  context.now = at;
  context.allowed = may_change_law();
  context.counter_overflow = od_.sync_counter_overflow;
  context.counter = sync_counter_;
  selection_.command(command, context, pll_);
  od_.selection_acknowledged = selection_.acknowledgement();
}

void Module::nmt_changed(can::NmtState state, Time) noexcept {
  status_.operational = state == can::NmtState::operational;
  // What was commanded before does not enable the joint when the node is started.
  od_.controlword = static_cast<std::uint16_t>(od_.controlword & ~unsigned{kControlEnable});
}

void Module::reset(can::ResetKind kind, Time) noexcept {
  const bool whole_node = kind == can::ResetKind::node;
  if (whole_node && machine_.state() == DriveState::fault) forget_faults();
  machine_.restart(whole_node);
  controlwords_.clear();
  selection_.reset();
  parameters_changed_ = true;
  apply_live_parameters();
  if (whole_node) {
    heartbeat_lost_ = false;
    raised_ = 0;  // the node has forgotten its errors: what is still in force is told again
    od_.configuration_hash = can::hash_with_changes(config_.configuration_hash, node_.factory(), od_);
  }
}

void Module::heartbeat_lost(std::uint8_t node_id, Time) noexcept {
  if (node_id == config_.supervisor_node_id) heartbeat_lost_ = true;
}

void Module::bus_off(Time now) noexcept {
  if (!bus_off_) node_.bus_off(now);
  bus_off_ = true;
}

void Module::bus_recovered(Time now) noexcept {
  if (bus_off_) node_.bus_recovered(now);
  bus_off_ = false;
}

void Module::bus_passive(bool is, Time now) noexcept {
  if (is) {
    node_.raise(Emergency::can_passive, {}, now);
  } else {
    node_.clear(Emergency::can_passive, now);
  }
}

void Module::heartbeat_seen(std::uint8_t node_id, can::NmtState, Time) noexcept {
  if (node_id == config_.supervisor_node_id) heartbeat_lost_ = false;
}

// ---------------------------------------------------------------------------------------------- decision

Situation Module::situation() const noexcept {
  const DriveState s = machine_.state();
  if (s == DriveState::fault) return Situation::fault;
  if (s == DriveState::fault_reaction_active) return Situation::fault_reaction;
  if (s != DriveState::operation_enabled && s != DriveState::quick_stop_active) return Situation::disabled;
  if (calibrating()) return Situation::calibration;
  if (!brake_.motion_allowed()) return Situation::starting;
  if (authority_ == Authority::limit) return Situation::limit;
  if (authority_ == Authority::user_stop) return Situation::user_stop;
  if (homing_.running()) return Situation::homing;
  return passive() ? Situation::passive : Situation::motion;
}

bool Module::may_change_law() const noexcept {
  return permits(situation(), Request::selection) && mode_ == Mode::cyclic_position &&
         authority_ == Authority::motion && status_.homed;
}

// A cause that is new: the bus is told; of those that end in FAULT the first is kept with a picture of the joint.
void Module::fail(Fault fault, Time now) noexcept {
  const Emergency code = can::row_of(fault).code;
  shown_ = false;
  publish();
  shown_ = false;
  if (faults_.reaction_of(fault) >= Reaction::stop) {
    if (status_.fault == Emergency::none) {
      status_.fault = code;
      status_.cause = fault;
      status_.fault_at = now;
      od_.first_fault_cause = static_cast<std::uint16_t>(code);
      od_.first_fault_time_ms = static_cast<std::uint32_t>(now.ns / 1'000'000);
      od_.first_fault_position_urad = od_.position_actual_urad;
      od_.first_fault_velocity_urad_s = od_.velocity_actual_urad_s;
      od_.first_fault_torque_permille = od_.torque_actual_permille;
      od_.first_fault_current_permille = od_.current_actual_permille;
      od_.first_fault_mode = od_.modes_of_operation_display;
      od_.first_fault_statusword = od_.statusword;
      od_.first_fault_detail = od_.active_limit;
    } else if (od_.later_faults < 0xFFFFU) {
      ++od_.later_faults;
    }
  }
  od_.error_code = static_cast<std::uint16_t>(code);
  node_.raise(
      code,
      {static_cast<std::uint8_t>(status_.state), static_cast<std::uint8_t>(od_.modes_of_operation_display),
       static_cast<std::uint8_t>(od_.active_limit), static_cast<std::uint8_t>(status_.law), od_.selection_acknowledged},
      now);
}

// Everything that the table of faults says, looked for. What is in force in this tick stands in faults_ afterwards.
void Module::watch(Time now, const RawSensors& sensors) noexcept {
  faults_.begin_tick(standing_ | provoked_);
  find_faults(now, sensors);
  faults_.conclude();
  const std::uint64_t present = faults_.present();
  if ((present | raised_) != 0) settle_faults(now);
  if (machine_.state() != DriveState::fault_reaction_active) reaction_ = Reaction::report;
#ifndef MRR_NO_TEST_OBJECTS
  // A provoked fault that ends in no FAULT is over at once: there would be nothing to reset.
  if (!faults_.disables()) provoked_ = 0;
#endif
  if (!faults_.disables()) return;
  const Reaction wanted = od_.fault_reaction_option_code == 0 ? Reaction::torque_off : faults_.worst();
  if (reaction_ == Reaction::report) reaction_since_ = now;
  if (wanted > reaction_) reaction_ = wanted;
}

// New causes, the hardest first; those that are over and were no reason for FAULT are taken back.
void Module::settle_faults(Time now) noexcept {
  const std::uint64_t present = faults_.present();
  const std::uint64_t fresh_now = present & (~raised_ | tell_again_);
  tell_again_ = 0;
  const auto tell = [&](Fault fault) {
    raised_ |= FaultMonitor::bit(fault);
    fail(fault, now);
    const bool silence = fault == Fault::heartbeat_lost || fault == Fault::sync_lost || fault == Fault::bus_off ||
                         (fault == Fault::knots_lost && passive());
    if (silence && faults_.reaction_of(fault) == Reaction::hold && brake_.motion_allowed())
      stop_at_limit(LimitCode::watchdog);
  };
  const std::uint64_t hardest = fresh_now & FaultMonitor::bit(faults_.cause());
  if (hardest != 0) tell(faults_.cause());
  for (std::uint64_t fresh = fresh_now & ~hardest; fresh != 0; fresh &= fresh - 1U) {
    tell(static_cast<Fault>(std::countr_zero(fresh)));
  }
  for (std::uint64_t over = raised_ & ~present; over != 0; over &= over - 1U) {
    const auto fault = static_cast<Fault>(std::countr_zero(over));
    if (faults_.reaction_of(fault) >= Reaction::stop) continue;  // until the reset
    raised_ &= ~FaultMonitor::bit(fault);
    node_.clear(can::row_of(fault).code, now);
  }
}

void Module::find_faults(Time now, const RawSensors& sensors) noexcept {
  const ModuleConfig& c = config_;
  const bool enabled = machine_.state() == DriveState::operation_enabled;
  const MotionState& r = reference_.state();
  const float sum = sensing_.position_rad() + sensing_.velocity_rad_s() + r.position_rad + r.velocity_rad_s +
                    r.acceleration_rad_s2 + load_torque_nm_ + drive_.thermal_load();
  faults_.check(Fault::not_a_number, !is_finite(sum));
  faults_.check(Fault::homing_failed, homing_.phase() == Homing::Phase::failed && mode_ == Mode::homing);
  faults_.check(Fault::power_stage, sensing_.input(kInputPowerStageFault));
  if (!sensing_.complete() && now - started_at_ <= kSensorStart) return;  // still starting

  sensor_watch_.update(sensors, sensing_,
                       {.free = brake_.brake_open() && sensing_.input(kInputBrakeReleased),
                        .commanded_a = drive_.commanded_current_a(),
                        .model_nm = load_torque_nm_,
                        .model_known = model_torque_fresh(now)},
                       faults_);
  const bool torque_lost = c.sensing.torque_sensor && !sensing_.joint_torque_nm().valid;
  if (!sensor_watch_.torque_trusted()) sensing_.distrust_torque();
  const Fault torque_trouble = torque_lost ? Fault::torque_sensor_lost : sensor_watch_.torque_trouble();
  if (torque_trouble != Fault::none && !without_torque_sensor(now)) faults_.find(torque_trouble);
  faults_.check(Fault::current_sensor, !sensing_.current_a().valid);
  const Reading& winding = sensing_.winding_c();
  const Reading& stage = sensing_.drive_c();
  const Reading& voltage = sensing_.bus_voltage_v();
  if (winding.valid && stage.valid) {
    faults_.check(Fault::winding_over_temperature, !(winding.value < c.drive.max_winding_temperature_c));
    faults_.check(Fault::drive_over_temperature, !(stage.value < c.drive.max_drive_temperature_c));
  } else {
    faults_.find(Fault::temperature_sensor);
  }
  faults_.check(Fault::thermal_overload, !(drive_.thermal_load() <= can::row_of(Fault::thermal_overload).threshold));
  faults_.check(Fault::under_voltage, !voltage.valid || !(voltage.value >= c.drive.min_bus_voltage_v));
  faults_.check(Fault::over_voltage, voltage.valid && !(voltage.value <= c.drive.max_bus_voltage_v));
  const unsigned switches = sensing_.inputs() & kLimitSwitches;
  faults_.check(Fault::limit_switches, switches == kLimitSwitches);
  if (switches == 0) pass(Fault::limit_switch);
  // A switch that is armed is carried through even without a supervisor; what a passive phase does is configured.
  if (enabled && !selection_.armed()) {
    faults_.check(Fault::heartbeat_lost, heartbeat_lost_);
    faults_.check(Fault::sync_lost, now > sync_due_ && mode_ == Mode::cyclic_position);
    faults_.check(Fault::bus_off, bus_off_);
  }
  if (brake_.phase() == BrakeSequence::Phase::off) {
    following_error_ticks_ = 0;
    return;
  }
  const float v = sensing_.velocity_rad_s();
  faults_.check(Fault::over_speed,
                !(absolute(v) <= can::row_of(Fault::over_speed).threshold * c.limits.velocity_rad_s));
  const float q = sensing_.position_rad();
  constexpr float kBeyond = can::row_of(Fault::position_limit).threshold;
  const bool outward =
      (q > c.limits.upper_rad + kBeyond && v > kOutward) || (q < c.limits.lower_rad - kBeyond && v < -kOutward);
  // A search for a limit switch goes beyond the limits; any other knows where it is, if the joint does.
  const bool seeks_limit = homing_.running() && homing_.config().mark == HomingMark::limit_switch;
  if (outward) faults_.check(Fault::position_limit, status_.homed && !seeks_limit);
  if (!sensing_.input(kInputBrakeReleased)) faults_.check(Fault::brake_closed, brake_.brake_open());
  if (enabled && selector_.law() == Law::active && brake_.motion_allowed() && !torque_mode() &&
      !selector_.catching_up()) {
    const float error = q - r.position_rad;
    following_error_ticks_ = absolute(error) <= following_error_rad_ ? 0 : following_error_ticks_ + 1;
    if (following_error_ticks_ > following_error_limit_ticks_) faults_.find(Fault::following_error);
  } else {
    following_error_ticks_ = 0;
  }
}

// A joint that is led goes on without its torque sensor: active by the supervisor's model torque, passive without
// compensation. It is not enabled anew without it.
bool Module::without_torque_sensor(Time now) const noexcept {
  return machine_.state() == DriveState::operation_enabled && brake_.motion_allowed() &&
         (passive() || model_torque_fresh(now));
}

bool Module::closing() const noexcept {
  const DriveState s = machine_.state();
  return brake_.phase() != BrakeSequence::Phase::off && s != DriveState::operation_enabled &&
         s != DriveState::quick_stop_active;
}

void Module::forget_faults() noexcept {
  sensor_watch_.reset();
  status_.cause = Fault::none;
  status_.fault = Emergency::none;
  od_.later_faults = 0;
  od_.first_fault_cause = 0;
  od_.error_code = 0;
}

// Each control word has its turn, however close they came; the last one stands.
void Module::decide_state(Time now) noexcept {
  if (controlwords_.empty()) [[likely]] {
    if (!(status_.operational && machine_.settled(od_.controlword, faults_.disables()))) obey(od_.controlword, now);
    return;
  }
  for (const std::uint16_t word : controlwords_) obey(word, now);
  controlwords_.clear();
}

void Module::obey(std::uint16_t controlword, Time now) noexcept {
  DriveStateMachine::Inputs in;
  in.controlword = controlword;
  // Motion needs NMT OPERATIONAL; without it an enabled joint is disabled in order.
  if (!status_.operational) in.controlword = static_cast<std::uint16_t>(in.controlword & ~unsigned{kControlEnable});
  in.fault = faults_.disables();
  in.ready = sensing_.complete();
  const DriveState before = machine_.state();
  in.stopped =
      before == DriveState::fault_reaction_active ? brake_.phase() == BrakeSequence::Phase::off : reference_.at_rest();
  in.quick_stop_option = od_.quick_stop_option_code;
  const DriveState after = machine_.update(in);
  if (before != after) {
    if (after == DriveState::operation_enabled && before == DriveState::switched_on) enable();
    leave_operation(before, after);
    if (before == DriveState::fault && after == DriveState::switch_on_disabled) {
      for (std::uint64_t left = raised_ & ~faults_.present(); left != 0; left &= left - 1U) {
        node_.clear(can::row_of(static_cast<Fault>(std::countr_zero(left))).code, now);
      }
      raised_ &= faults_.present();
      forget_faults();
    }
  }
  // A fault that can pass by itself is forgotten once the joint is safe; the latch stays in the state machine.
  if (after == DriveState::fault && machine_.fault_reset_requested() == false) {
    standing_ &= kStandsByItself;
    sensor_watch_.reset();
    provoked_ = 0;
    if (parameters_changed_) apply_parameters();
  }
}

void Module::leave_operation(DriveState from, DriveState to) noexcept {
  if (from == DriveState::operation_enabled) selection_.disarm();
  if (from != DriveState::operation_enabled && from != DriveState::quick_stop_active) return;
  bool at_once = false;
  switch (to) {
    case DriveState::switched_on:
      at_once = od_.disable_operation_option_code == 0;
      break;
    case DriveState::ready_to_switch_on:
      at_once = od_.shutdown_option_code == 0;
      break;
    case DriveState::switch_on_disabled:  // disable voltage, or a quick stop, which has ended or has no ramp
      at_once = true;
      break;
    default:
      break;
  }
  if (!at_once || reference_.at_rest()) return;
  // No ramp: the joint shall rest where it is led now, and the brake does not wait.
  if (passive() || mode_ == Mode::cyclic_torque) go_active();
  reference_.start_at(reference_.state().position_rad, 0.0F, config_.reference.stop_deceleration_rad_s2);
}

float Module::ramp_rad_s2(std::int16_t option) const noexcept {
  const bool quick = option == 2 || option == 6;
  return quick ? config_.reference.quick_stop_deceleration_rad_s2 : config_.reference.stop_deceleration_rad_s2;
}

void Module::enable() noexcept {
  if (parameters_changed_) apply_parameters();
  if (!configuration_valid()) return;
  choose_reactions();
  active_.reset();
  reference_.start_at(sensing_.position_rad(), sensing_.velocity_rad_s(), config_.reference.stop_deceleration_rad_s2);
  if (selector_.law() == Law::off) selector_.go_active();
  selection_.reset();
  hold_reason_ = LimitCode::none;
  passive_ended_by_ = LimitCode::none;
  passivity_lost_ = false;
  limit_stop_ = false;
  knots_have_sequence_ = false;
  has_last_target_ = false;
  sync_due_ = kNever;
  saturated_ = false;
  load_by_model_ = load_catches_up_ = false;
  load_torque_nm_ = sensing_.joint_torque_nm().value;
  pass(Fault::knots_lost);
  pass(Fault::torque_target_lost);
  pass(Fault::limit_switch);
  torque_target_came_ = false;
  following_error_ticks_ = 0;
  last_requested_mode_ = od_.modes_of_operation;
  homing_start_bit_ = true;  // a start bit that was set before does not start
  homing_.abort();
}

Authority Module::arbitrate() const noexcept {
  if (machine_.state() == DriveState::fault_reaction_active || closing()) return Authority::fault_reaction;
  if (brake_.phase() == BrakeSequence::Phase::off) return Authority::none;
  // In torque mode the hold lasts until the mode or the state is set anew: there are no knots to take over.
  if (limit_stop_ && (mode_ == Mode::cyclic_torque || !reference_.at_rest())) return Authority::limit;
  if (machine_.state() == DriveState::quick_stop_active || (od_.controlword & kControlHalt) != 0)
    return Authority::user_stop;
  if (calibration_mode()) return Authority::calibration;
  if (mode_ == Mode::homing) return Authority::homing;
  return Authority::motion;
}

void Module::stop_and_hold(float deceleration_rad_s2) noexcept {
  if (passive() || mode_ == Mode::cyclic_torque) go_active();
  reference_.stop(deceleration_rad_s2);
}

void Module::stop_at_limit(LimitCode why) noexcept {
  limit_stop_ = true;
  hold_reason_ = why;
  // A halt on the way slows down harder already.
  stop_and_hold(authority_ == Authority::user_stop ? user_stop_rad_s2_ : config_.reference.stop_deceleration_rad_s2);
}

void Module::go_passive(Time now) noexcept {
  passive_.begin(evidence());
  guard_.begin(sensing_.velocity_rad_s(), sensing_.joint_torque_nm().value);
  selector_.go_passive(passive_.torque_nm());
  passive_since_ = now;
  passive_from_rad_ = sensing_.position_rad();
  passive_ended_by_ = LimitCode::none;
  passivity_lost_ = false;
  hold_reason_ = LimitCode::none;
  pass(Fault::knots_lost);  // a passive joint follows none; it is watched anew, as 2130h:04 says
  was_blending_ = true;
  status_.selection_executed_at = now;
  ++od_.count_selections;
  choose_reactions();
}

// Where the joint is and as fast as it is, nothing remembered; from there it comes to rest and holds.
void Module::go_active() noexcept {
  active_.reset();
  reference_.start_at(sensing_.position_rad(), sensing_.velocity_rad_s(), config_.reference.stop_deceleration_rad_s2);
  selector_.go_active();
  saturated_ = false;
  choose_reactions();
}

PassiveLaw::Evidence Module::evidence() const noexcept {
  return {sensing_.velocity_rad_s(), sensing_.joint_torque_nm().valid, sensing_.joint_torque_nm().value, 0.0F};
}

// Modes. -1 is a change of law within mode 8; it needs an edge, so that enabling never drops the arm.
void Module::follow_mode(Time now) noexcept {
  const std::int8_t requested = od_.modes_of_operation;
  if (requested == last_requested_mode_ && mode_ != Mode::none) return;
  // What has the joint goes on; the mode asked for waits until it has ended.
  const Situation s = situation();
  const auto wanted = static_cast<Mode>(requested);
  const Request request = wanted == Mode::homing           ? Request::homing
                          : wanted <= Mode::identification ? Request::calibration
                                                           : Request::set_points;
  const bool busy =
      s == Situation::homing || s == Situation::calibration || (s == Situation::limit && !reference_.at_rest());
  if (busy && wanted != mode_ && !permits(s, request)) return;
  const std::int8_t previous = last_requested_mode_;
  last_requested_mode_ = requested;
  constexpr auto kPassiveMode = static_cast<std::int8_t>(Mode::passive);
  if (requested == kPassiveMode) {
    if (previous != kPassiveMode && may_change_law() && !passive()) go_passive(now);
    if (mode_ == Mode::none || mode_ == Mode::homing) mode_ = Mode::cyclic_position;
    return;
  }
  if (previous == kPassiveMode && passive()) go_active();
  const auto mode = static_cast<Mode>(requested);
  if (mode == mode_) return;
  if (selector_.law() != Law::off) go_active();
  homing_.abort();
  limit_stop_ = false;
  mode_ = mode;
  choose_reactions();
}

// Who leads; what changes when that changes; the law that is due.
void Module::lead(Time now) noexcept {
  const bool start = (od_.controlword & kControlHomingStart) != 0;
  start_edge_ = start && !homing_start_bit_;
  homing_start_bit_ = start;
  follow_mode(now);
  const Authority before = authority_;
  if (limit_stop_ && mode_ != Mode::cyclic_torque && reference_.at_rest()) limit_stop_ = false;
  if (torque_target_came_ && stands(Fault::torque_target_lost)) {
    // A target came again: the torque returns, at the slew rate, unless another silence holds the joint.
    pass(Fault::torque_target_lost);
    const auto holds = [this](Fault fault) {
      return faults_.is_present(fault) && faults_.reaction_of(fault) == Reaction::hold;
    };
    if (!holds(Fault::heartbeat_lost) && !holds(Fault::bus_off)) {
      limit_stop_ = false;
      hold_reason_ = LimitCode::none;
    }
  }
  authority_ = arbitrate();
  switch (authority_) {
    case Authority::fault_reaction:
      if (authority_ != before) {
        const bool fault = machine_.state() == DriveState::fault_reaction_active;
        stop_and_hold(ramp_rad_s2(fault ? od_.fault_reaction_option_code : std::int16_t{1}));
      }
      break;
    case Authority::limit:
      // A switch that is armed comes into force though the set points have stopped: it is the safe side before a blow.
      if (hold_reason_ == LimitCode::knots_lost) carry_out_selection(now);
      break;
    case Authority::user_stop: {
      selection_.disarm();
      const bool quick_stop = machine_.state() == DriveState::quick_stop_active;
      const float ramp = ramp_rad_s2(quick_stop ? od_.quick_stop_option_code : od_.halt_option_code);
      // A quick stop may follow a halt that slows down more gently.
      if (authority_ != before || ramp > user_stop_rad_s2_) {
        hold_reason_ = LimitCode::halt;
        stop_and_hold(ramp);
      }
      user_stop_rad_s2_ = ramp;
      break;
    }
    case Authority::calibration:
      selection_.disarm();
      if (mode_ == Mode::identification) {
        run_identification();
      } else {
        run_calibration(now);
      }
      break;
    case Authority::homing:
      selection_.disarm();
      run_homing(now);
      break;
    case Authority::motion:
      if (authority_ != before) {
        if (hold_reason_ == LimitCode::halt) hold_reason_ = LimitCode::none;
        if (mode_ == Mode::cyclic_torque) selector_.go_active();
      }
      carry_out_selection(now);
      break;
    case Authority::none:
      selector_.off();
      selection_.disarm();
      break;
  }
  if (authority_ != Authority::homing && homing_.running()) {
    homing_.abort();
    reference_.stop(config_.reference.stop_deceleration_rad_s2);
  }
  if (authority_ != Authority::calibration) {
    stop_identification();
    if (calibration_.running()) {
      calibration_.interrupt();
      end_calibration();
    }
  }
  watch_motion(now);
}

Calibration::Settings Module::calibration_settings() const noexcept {
  const float most = max_torque_nm_ < config_.limits.torque_nm ? max_torque_nm_ : config_.limits.torque_nm;
  const auto or_else = [](float value, float otherwise) { return value > 0.0F ? value : otherwise; };
  return {.timeout = milliseconds(od_.action_timeout_ms),
          .torque_zero_max_nm = od_.torque_zero_max_nm,
          .torque_zero_load_nm = od_.torque_zero_load_nm,
          .brake_test_torque_nm =
              limit(or_else(od_.brake_test_torque_nm, kBrakeTestShare * config_.drive.rated_torque_nm), most),
          .brake_test_travel_rad = od_.brake_test_travel_rad,
          .recovery_speed_rad_s = od_.recovery_speed_rad_s,
          .recovery_margin_rad = od_.recovery_margin_rad,
          .recovery_travel_rad = od_.recovery_travel_rad,
          .recovery_torque_nm = or_else(od_.recovery_torque_nm, 0.5F * config_.limits.torque_nm),
          .lower_rad = config_.limits.lower_rad,
          .upper_rad = config_.limits.upper_rad};
}

Calibration::Inputs Module::calibration_inputs(Time now) const noexcept {
  return {.now = now,
          .position_rad = sensing_.position_rad(),
          .velocity_rad_s = sensing_.velocity_rad_s(),
          .position_known = status_.homed,
          .torque_nm = sensing_.joint_torque_nm(),
          .load_nm = load_torque_nm_,
          .commanded_nm = status_.torque_command_nm,
          .reference_at_rest = reference_.at_rest(),
          .lower_switch = sensing_.input(kInputNegativeLimit),
          .upper_switch = sensing_.input(kInputPositiveLimit),
          .brake_engaged = brake_.test_ready(now, sensing_.input(kInputBrakeReleased)),
          .brake_open = brake_.motion_allowed()};
}

void Module::run_calibration(Time now) noexcept {
  if (!homing_start_bit_) calibration_.interrupt();
  if (start_edge_ && !calibration_.running() && mode_ != Mode::identification && brake_.motion_allowed()) {
    reference_.stop(config_.reference.stop_deceleration_rad_s2);
    calibration_.start(mode_, calibration_settings(), calibration_inputs(now));
    od_.action_state = static_cast<std::uint8_t>(calibration_.state());
    calibration_active_ = true;
  }
  if (!calibration_active_) return;
  const Calibration::Wish before = calibration_.wish();
  calibration_.update(calibration_inputs(now));
  if (!calibration_.running()) return end_calibration();
  const float velocity = calibration_.wish().velocity_rad_s;
  if (velocity != before.velocity_rad_s) {
    reference_.move_at(velocity, static_cast<float>(od_.homing_acceleration_mrad_s2) * 1e-3F);
  }
}

// The joint is the control law's again, from where it is.
void Module::end_calibration() noexcept {
  calibration_active_ = false;
  od_.action_state = static_cast<std::uint8_t>(calibration_.state());
  if (calibration_.mode() == Mode::brake_test) {
    od_.brake_test_slip_rad = calibration_.slip_rad();
    if (selector_.law() == Law::active) go_active();
  }
  if (calibration_.mode() == Mode::torque_zero && calibration_.state() == ActionState::done) {
    od_.torque_sensor_offset_nm += calibration_.found_offset_nm();
    sensing_.set_torque_offset(od_.torque_sensor_offset_nm);
    load_catches_up_ = true;
  }
  reference_.stop(config_.reference.stop_deceleration_rad_s2);
}

void Module::carry_out_selection(Time now) noexcept {
  const std::optional<bool> to_active = selection_.due(now, pll_.period());
  if (!to_active) return;
  if (*to_active && passive()) {
    go_active();
    status_.selection_executed_at = now;
    ++od_.count_selections;
  } else if (!*to_active && !passive() && machine_.state() == DriveState::operation_enabled &&
             mode_ == Mode::cyclic_position && brake_.motion_allowed()) {
    go_passive(now);
    limit_stop_ = false;
  }
}

Homing::Inputs Module::homing_inputs() const noexcept {
  return {.home_switch = sensing_.input(kInputHomeSwitch),
          .negative_limit = sensing_.input(kInputNegativeLimit),
          .positive_limit = sensing_.input(kInputPositiveLimit),
          .index_pulse = sensing_.input(kInputIndexPulse),
          .position_rad = sensing_.position_rad(),
          .moving_rad_s = reference_.state().velocity_rad_s,
          .effort_nm = status_.torque_command_nm - load_torque_nm_};
}

void Module::run_homing(Time now) noexcept {
  if (!homing_start_bit_ && homing_.running()) {
    homing_.abort();
    reference_.stop(config_.reference.stop_deceleration_rad_s2);
  }
  if (start_edge_ && brake_.motion_allowed()) {
    if (od_.homing_method == 35 || od_.homing_method == 37) {
      reference_.shift(sensing_.set_position(static_cast<float>(od_.home_offset_urad) * 1e-6F));
      homing_.finish();
      status_.homed = true;
    } else {
      homing_.configure(homing_by_method(config_.homing, od_.homing_method));
      homing_.start(now, homing_inputs());
      const float acceleration = static_cast<float>(od_.homing_acceleration_mrad_s2) * 1e-3F;
      reference_.move_at(homing_.velocity_rad_s(), acceleration);
    }
    return;
  }
  if (!homing_.running()) return;
  const float before = homing_.velocity_rad_s();
  if (homing_.update(now, homing_inputs())) {
    const float offset = static_cast<float>(od_.home_offset_urad) * 1e-6F;
    reference_.shift(sensing_.set_position(homing_.reference_rad() + offset));
    status_.homed = true;
  }
  if (!homing_.running()) {
    reference_.stop(config_.reference.stop_deceleration_rad_s2);
  } else if (homing_.velocity_rad_s() != before) {
    reference_.move_at(homing_.velocity_rad_s(), static_cast<float>(od_.homing_acceleration_mrad_s2) * 1e-3F);
  }
}

void Module::stop_identification() noexcept {
  if (!identification_.running()) return;
  identification_.abort();
  reference_.stop(config_.reference.stop_deceleration_rad_s2);
}

void Module::run_identification() noexcept {
  if (!homing_start_bit_) stop_identification();
  const float acceleration = config_.reference.stop_deceleration_rad_s2;
  if (start_edge_ && brake_.motion_allowed()) {
    FrictionIdentification::Setup setup;
    setup.gear_ratio = config_.drive.gear_ratio;
    setup.inertia_kg_m2 = config_.control.inertia_kg_m2;
    setup.torque_constant = {config_.drive.torque_constant_positive_nm_a, config_.drive.torque_constant_negative_nm_a};
    setup.load_measured = config_.sensing.torque_sensor;
    setup.coulomb_nm = config_.friction.coulomb_nm > 0.0F ? config_.friction.coulomb_nm : 1.0F;
    setup.travel_rad = od_.identification_travel_rad;
    // A joint that does not know where it is has no room that is known.
    setup.lower_rad = status_.homed ? config_.limits.lower_rad : sensing_.position_rad();
    setup.upper_rad = status_.homed ? config_.limits.upper_rad : sensing_.position_rad();
    setup.speed_rad_s =
        limit(od_.identification_speed_rad_s, 0.0F, kIdentificationSpeed * config_.limits.velocity_rad_s);
    setup.acceleration_rad_s2 = acceleration;
    setup.max_residual = od_.identification_max_residual;
    setup.dt_s = dt_s_;
    identification_.start(setup, sensing_.position_rad());
    if (identification_.running()) reference_.move_at(identification_.velocity_rad_s(), acceleration);
    return;
  }
  if (!identification_.running()) return;
  if (sensing_.input(kInputNegativeLimit) || sensing_.input(kInputPositiveLimit)) return stop_identification();
  const float before = identification_.velocity_rad_s();
  const bool valid = sensing_.position_valid() && sensing_.current_a().valid &&
                     (!config_.sensing.torque_sensor || sensing_.joint_torque_nm().valid);
  const float load_nm = config_.sensing.torque_sensor ? sensing_.joint_torque_nm().value : load_torque_nm_;
  identification_.update(
      {sensing_.position_rad(), sensing_.velocity_rad_s(), sensing_.current_a().value, load_nm, valid});
  const float wanted = identification_.velocity_rad_s();
  if (wanted == 0.0F && before != 0.0F) {
    reference_.stop(acceleration);
  } else if (wanted != before) {
    reference_.move_at(wanted, acceleration);
  }
}

// Limits that stop the joint without being faults.
void Module::watch_motion(Time now) noexcept {
  if (!brake_.motion_allowed()) return;
  const float q = sensing_.position_rad();
  const LimitsConfig& l = config_.limits;
  const bool above = q > l.upper_rad + kPositionSlack && status_.homed;
  const bool below = q < l.lower_rad - kPositionSlack && status_.homed;
  if (passive()) {
    if (od_.watchdog_passive_ms != 0) {
      const Time last = set_point_at_ > passive_since_ ? set_point_at_ : passive_since_;
      stand_if(Fault::knots_lost, now - last > milliseconds(od_.watchdog_passive_ms));
    }
    LimitCode ended = LimitCode::none;
    if (now - passive_since_ >= config_.passive.max_time) ended = LimitCode::passive_time;
    if (!(absolute(q - passive_from_rad_) <= config_.passive.max_travel_rad)) ended = LimitCode::passive_travel;
    if (!(absolute(sensing_.velocity_rad_s()) <= l.velocity_rad_s)) ended = LimitCode::velocity;
    if (above) ended = LimitCode::position_upper;
    if (below) ended = LimitCode::position_lower;
    if ((sensing_.inputs() & kLimitSwitches) != 0) ended = LimitCode::limit_switch;
    if (ended != LimitCode::none) {
      go_active();
      passive_ended_by_ = ended;
    }
    return;
  }
  const bool led = authority_ == Authority::motion || authority_ == Authority::user_stop || calibrating();
  if (!led) return;
  const bool torque = torque_mode();
  if (above || below || (sensing_.inputs() & kLimitSwitches) != 0) {
    const float direction = torque ? sensing_.velocity_rad_s() : reference_.state().velocity_rad_s;
    // Limit recovery starts outside, from a reference that may still creep.
    const float still = calibrating() ? kCreep : kStill;
    const bool up = direction > still;
    const bool down = direction < -still;
    if (above && up) stop_at_limit(LimitCode::position_upper);
    if (below && down) stop_at_limit(LimitCode::position_lower);
    if ((sensing_.input(kInputPositiveLimit) && up) || (sensing_.input(kInputNegativeLimit) && down)) {
      stand(Fault::limit_switch);
      stop_at_limit(LimitCode::limit_switch);
    }
  }
  if (torque && torque_target_came_ && od_.watchdog_torque_ms != 0 &&
      now - torque_target_at_ > milliseconds(od_.watchdog_torque_ms)) {
    stand(Fault::torque_target_lost);
    torque_target_came_ = false;
    stop_at_limit(LimitCode::watchdog);
  }
  // The set-point watchdog: the last knot has been continued for as long as it may be.
  if (now > knot_due_ && reference_.following()) {
    stand(Fault::knots_lost);
    stop_at_limit(LimitCode::knots_lost);
  }
}

// ---------------------------------------------------------------------------------------------- control

// tau_s^: what the joint carries.
void Module::estimate_load(Time now) noexcept {
  const float model_nm = static_cast<float>(od_.torque_offset_permille) * 1e-3F * config_.drive.rated_torque_nm;
  if (!config_.sensing.torque_sensor) {
    load_torque_nm_ = model_nm;
    return;
  }
  const bool fresh = model_torque_fresh(now);
  const bool sensed = sensing_.joint_torque_nm().valid;
  float load_nm = load_torque_nm_;  // known to neither: the last word stands
  if (sensed) {
    load_nm = sensing_.carried_torque_nm();
    const float departure = config_.control.carried_departure_nm;
    if (fresh) load_nm = limit(load_nm, model_nm - departure, model_nm + departure);
  } else if (fresh) {
    load_nm = model_nm;
  }
  // From the one to the other without a step.
  if (sensed == load_by_model_) load_catches_up_ = true;
  load_by_model_ = !sensed;
  if (load_catches_up_) {
    const float missing = load_nm - load_torque_nm_;
    const float step = limit(missing, config_.passive.resume_torque_slew_nm_s * dt_s_);
    load_catches_up_ = step != missing;
    load_nm = load_torque_nm_ + step;
  }
  load_torque_nm_ = load_nm;
}

// Compensation that gives more than friction takes is taken back. Without the sensor nobody would notice.
void Module::guard_passivity() noexcept {
  if (!config_.sensing.torque_sensor || passive_.taken_back()) return;
  const Reading& torque = sensing_.joint_torque_nm();
  if (!torque.valid) {
    passive_.take_back(kTakeBackTicks);
  } else if (!(guard_.update(sensing_.velocity_rad_s(), torque.value) <= config_.passive.guard_energy_j)) {
    passive_.take_back(kTakeBackTicks);
    passivity_lost_ = true;
  }
}

[[gnu::flatten]] float Module::control_torque(Time now) noexcept {
  estimate_load(now);
  if (selector_.law() == Law::passive) {
    if (!selector_.blending()) {
      guard_passivity();
      passive_.update(evidence());
    }
    const float tau = selector_.step(0.0F, passive_.torque_nm());
    if (was_blending_ && !selector_.blending()) {
      was_blending_ = false;
      status_.blend_ended_at = now;
    }
    // q_d := q throughout, so that the way back starts where the joint is.
    reference_.start_at(sensing_.position_rad(), sensing_.velocity_rad_s(), config_.reference.stop_deceleration_rad_s2);
    status_.passive_torque_nm = passive_.torque_nm();
    return tau;
  }
  if (selector_.law() == Law::off) return selector_.step(0.0F, 0.0F);
  if (reaction_ >= Reaction::damp) [[unlikely]] {
    const float carried = sensing_.joint_torque_nm().valid || model_torque_fresh(now) ? load_torque_nm_ : 0.0F;
    // Without a position the best that can be done until the brake holds: carry what the joint carries, add nothing.
    const float damping = reaction_ >= Reaction::brake ? 0.0F : damping_nm_s_rad_;
    return selector_.step(carried - damping * sensing_.velocity_rad_s(), 0.0F);
  }
  if (calibration_.wish().push) return selector_.step(calibration_.wish().push_nm, 0.0F);
  if (torque_mode()) {
    const float target = static_cast<float>(od_.target_torque_permille + od_.torque_offset_permille) * 1e-3F;
    reference_.start_at(sensing_.position_rad(), sensing_.velocity_rad_s(), config_.reference.stop_deceleration_rad_s2);
    return selector_.step(target * config_.drive.rated_torque_nm, 0.0F);
  }
  reference_.keep_near(sensing_.position_rad(), kHoldLeash * config_.reference.resync_window_rad);
  reference_.not_faster_than(sensing_.velocity_rad_s());
  const MotionState& r = reference_.step(now);
  // With a torque constant that is too small, carrying all of the load would be carrying more than that: unstable.
  const float carried_nm = identification_.running() ? kIdentificationLoad * load_torque_nm_ : load_torque_nm_;
  const ActiveLawOutput law = active_.step(sensing_.position_rad() - r.position_rad, sensing_.velocity_rad_s(), r,
                                           carried_nm, !saturated_ && !selector_.catching_up());
  status_.active_torque_nm = law.torque_nm;
  status_.compensator_nm = law.compensator_nm;
  if (absolute(r.velocity_rad_s) <= kStill) swing_watch_.update(law.torque_nm, now);
  return selector_.step(law.torque_nm, 0.0F);
}

void Module::sequence_brake(Time now) noexcept {
  const DriveState s = machine_.state();
  BrakeSequence::Inputs in;
  in.wanted = (s == DriveState::operation_enabled || s == DriveState::quick_stop_active) && configuration_valid();
  in.test = calibration_.wish().brake;
  in.cut = cut();
  if (brake_.motion_allowed() && in.wanted && !in.cut && !in.test) return;  // open, as it shall be
  const Reading& current = sensing_.current_a();
  in.torque_confirmed =
      current.valid && !selector_.catching_up() &&
      absolute(current.value - drive_.commanded_current_a()) <= kConfirmShare * config_.sensing.current_full_scale_a;
  switch (reaction_) {
    case Reaction::brake:
      in.at_rest = true;
      break;
    case Reaction::damp:
      in.at_rest = absolute(sensing_.velocity_rad_s()) < kDamped || now - reaction_since_ > kDampTime;
      break;
    case Reaction::report:
    case Reaction::derate:
    case Reaction::hold:
    case Reaction::stop:
    case Reaction::torque_off:
      in.at_rest = reference_.at_rest();
      break;
  }
  in.feedback_released = sensing_.input(kInputBrakeReleased);
  switch (brake_.update(now, in)) {
    case BrakeSequence::Trouble::none:
      break;
    case BrakeSequence::Trouble::torque_not_confirmed:
      stand(Fault::torque_not_confirmed);
      break;
    case BrakeSequence::Trouble::not_released:
      stand(Fault::brake_not_released);
      break;
    case BrakeSequence::Trouble::not_engaged:
      stand(Fault::brake_not_engaged);
      break;
  }
}

// ---------------------------------------------------------------------------------------------- the tick

// The first tick, or one that comes late.
void Module::watch_loop(Time now) noexcept {
  if (overrun_at_ == kBeforeStart) {
    started_at_ = now;
    return;
  }
  ++od_.count_loop_overruns;
  if (now - status_.now > config_.watchdog.loop && brake_.phase() != BrakeSequence::Phase::off)
    stand(Fault::loop_overrun);
}

void Module::step(Time now, const RawSensors& sensors, std::span<const can::ReceivedFrame> received,
                  ActuatorCommand& actuator, can::TransmitQueue& tx) noexcept {
  if (!received.empty()) publish();  // what frames may ask for is the last tick
  shown_ = false;
  if (now > overrun_at_) watch_loop(now);
  overrun_at_ = now + overrun_after_;
  status_.now = now;
  sensing_.update(now, sensors);
  for (const can::ReceivedFrame& frame : received) node_.handle(frame, tx);

  watch(now, sensors);
  decide_state(now);
  sequence_brake(now);
  lead(now);

  actuator = {};
  if (brake_.power_stage_enabled() && !cut()) {
    const float demanded = control_torque(now);
    const Drive::Output out = drive_.command(demanded, sensing_.current_a(), sensing_.winding_c(), max_torque_nm_);
    if (out.finite) {
      saturated_ = out.limit != DriveLimit::none;
      drive_limit_ = out.limit;
      if (saturated_) selector_.set_commanded(out.torque_nm);
      status_.torque_command_nm = out.torque_nm;
      actuator.current_duty = out.duty;
      actuator.power_stage_enabled = true;
      actuator.brake_release = brake_.brake_release();
    } else {
      stand(Fault::not_a_number);  // FAULT in the next tick; this one already gives nothing and brakes
      selector_.off();
      status_.torque_command_nm = 0.0F;
    }
  } else {
    selector_.off();
    drive_.idle();
    drive_limit_ = DriveLimit::none;
    saturated_ = false;
    status_.torque_command_nm = 0.0F;
  }
  if (store_.state() == can::StorageState::writing) {
    store_.tick();
    publish_storage();
  }
  node_.tick(now, tx);
}

can::LimitCode Module::active_limit() const noexcept {
  if (machine_.state() != DriveState::operation_enabled) return LimitCode::none;
  if (calibrating()) return LimitCode::calibration;
  if (!brake_.motion_allowed()) return LimitCode::brake;
  if (homing_.running()) return LimitCode::homing;
  if (!status_.homed && mode_ != Mode::homing) return LimitCode::not_homed;
  if (hold_reason_ != LimitCode::none) return hold_reason_;
  if (passivity_lost_) return LimitCode::passivity_guard;
  if (passive_ended_by_ != LimitCode::none) return passive_ended_by_;
  if (load_by_model_ && config_.sensing.torque_sensor) return LimitCode::model_torque;
  switch (drive_limit_) {
    case DriveLimit::none:
      break;
    case DriveLimit::torque:
      return LimitCode::torque;
    case DriveLimit::current_peak:
      return LimitCode::current;
    case DriveLimit::current_thermal:
      return LimitCode::thermal;
  }
  if (swing_watch_.swings(status_.now)) return LimitCode::torque_swings;
  if (selector_.law() == Law::active && selector_.catching_up()) return LimitCode::torque_slew;
  if (reference_.continuing()) return LimitCode::knot_extrapolated;
  if (mode_ == Mode::cyclic_position && selector_.law() == Law::active && !reference_.following()) {
    return LimitCode::holding;
  }
  return LimitCode::none;
}

std::uint16_t Module::statusword() const noexcept {
  std::uint32_t word = machine_.state_bits() | static_cast<std::uint32_t>(kStatusRemote);
  if (sensing_.bus_voltage_v().valid) word |= kStatusVoltageEnabled;
  const bool in_fault = machine_.state() == DriveState::fault || machine_.state() == DriveState::fault_reaction_active;
  if (raised_ != 0 && !in_fault && !faults_.disables()) word |= kStatusWarning;
  if (status_.limit != LimitCode::none) word |= kStatusInternalLimit;
  switch (mode_) {
    case Mode::homing:
      if (reference_.at_rest()) word |= kStatusTargetReached;
      if (homing_.phase() == Homing::Phase::done) word |= kStatusFollowing;
      if (homing_.phase() == Homing::Phase::failed) word |= kStatusFollowingError;
      break;
    case Mode::identification:
      if (reference_.at_rest()) word |= kStatusTargetReached;
      if (identification_.state() == FrictionIdentification::State::done) word |= kStatusFollowing;
      if (identification_.state() > FrictionIdentification::State::done) word |= kStatusFollowingError;
      break;
    case Mode::cyclic_position:
      if (status_.following_knots) word |= kStatusFollowing;
      if (following_error_ticks_ > 0) word |= kStatusFollowingError;
      break;
    case Mode::cyclic_torque:
      if (torque_mode()) word |= kStatusFollowing;
      break;
    case Mode::torque_zero:
    case Mode::brake_test:
    case Mode::limit_recovery:
      if (reference_.at_rest()) word |= kStatusTargetReached;
      if (calibration_.mode() != mode_) break;
      if (calibration_.state() == ActionState::done) word |= kStatusFollowing;
      if (calibration_.state() > ActionState::done) word |= kStatusFollowingError;
      break;
    case Mode::passive:
    case Mode::none:
      break;
  }
  return static_cast<std::uint16_t>(word);
}

void Module::publish_identification() const noexcept {
  const FrictionIdentification::Result& r = identification_.result();
  od_.identification_progress_percent = identification_.progress_percent();
  od_.identified_positive = r.friction[0];
  od_.identified_negative = r.friction[1];
  od_.identified_torque_constant_positive_nm_a = r.torque_constant[0];
  od_.identified_torque_constant_negative_nm_a = r.torque_constant[1];
  od_.identified_residual_nm = r.residual_nm;
  od_.identified_samples = r.points;
}

// Drawn when somebody looks: at most once per tick, and in most ticks not at all.
void Module::publish() const noexcept {
  if (shown_) return;
  shown_ = true;
  const MotionState& r = reference_.state();
  status_.state = machine_.state();
  status_.authority = authority_;
  status_.law = selector_.law();
  status_.brake_released = brake_.motion_allowed();
  status_.position_rad = sensing_.position_rad();
  status_.velocity_rad_s = sensing_.velocity_rad_s();
  status_.joint_torque_nm = sensing_.joint_torque_nm().value;
  status_.current_a = sensing_.current_a().value;
  status_.position_valid = sensing_.position_valid();
  status_.torque_valid = sensing_.joint_torque_nm().valid;
  status_.reference_position_rad = r.position_rad;
  status_.reference_velocity_rad_s = r.velocity_rad_s;
  status_.reference_acceleration_rad_s2 = r.acceleration_rad_s2;
  status_.sync_locked = pll_.locked();
  status_.following_knots = status_.state == DriveState::operation_enabled && selector_.law() == Law::active &&
                            mode_ == Mode::cyclic_position && reference_.following();
  status_.selection_armed = selection_.armed();
  status_.limit = active_limit();

  // To the bus. A position that is not known is not shown anew: its validity bit says so.
  od_.statusword = statusword();
  status_.mode = passive() ? Mode::passive : mode_;
  od_.modes_of_operation_display = static_cast<std::int8_t>(status_.mode);
  if (status_.position_valid) {
    od_.position_actual_urad = to_count(status_.position_rad * 1e6F);
    od_.velocity_actual_urad_s = to_count(status_.velocity_rad_s * 1e6F);
  }
  od_.position_demand_urad = to_count(r.position_rad * 1e6F);
  od_.velocity_demand_urad_s = to_count(r.velocity_rad_s * 1e6F);
  od_.following_error_actual_urad = od_.position_demand_urad - od_.position_actual_urad;
  const float shown_nm = config_.sensing.torque_sensor ? status_.joint_torque_nm : status_.torque_command_nm;
  od_.torque_actual_permille = to_count16(shown_nm * permille_per_nm_);
  od_.torque_demand_permille = to_count16(status_.torque_command_nm * permille_per_nm_);
  od_.current_actual_permille = to_count16(status_.current_a * permille_per_a_);
  od_.active_limit = static_cast<std::uint16_t>(status_.limit);
  od_.error_or_limit = status_.fault != Emergency::none ? static_cast<std::uint16_t>(status_.fault) : od_.active_limit;
  od_.selection_acknowledged = selection_.acknowledgement();
  status_.selection_acknowledged = od_.selection_acknowledged;

  std::uint32_t validity = status_.position_valid ? 0x03U : 0U;
  if (status_.torque_valid) validity |= 0x04U;
  if (sensing_.current_a().valid) validity |= 0x08U;
  if (sensing_.winding_c().valid) validity |= 0x10U;
  if (sensing_.drive_c().valid) validity |= 0x20U;
  if (sensing_.bus_voltage_v().valid) validity |= 0x40U;
  if (status_.homed) validity |= 0x80U;
  od_.validity = static_cast<std::uint16_t>(validity);
  const std::uint32_t in = sensing_.inputs();
  // 60FDh: bits 0 negative limit, 1 positive limit, 2 home; 16 index, 17 brake released, 18 power stage fault.
  od_.digital_inputs = (in & 0x07U) | ((in >> 3U) & 0x07U) << 16U;
  od_.brake_released = sensing_.input(kInputBrakeReleased) ? 1 : 0;
  od_.uptime_us = static_cast<std::uint64_t>((status_.now - started_at_) / microseconds(1)) + tick_us_;
  status_.thermal_load = drive_.thermal_load();
  od_.passive_gained_j = guard_.largest_gain_j();
  od_.identification_state = static_cast<std::uint8_t>(identification_.state());
  if (identification_.state() != FrictionIdentification::State::none) publish_identification();
  status_.sync_error_ns = pll_.last_error().ns;
  status_.clock_drift_ppm = pll_.drift_ppm();
  od_.sync_locked = status_.sync_locked ? 1 : 0;
  od_.sync_phase_error_ns = static_cast<std::int32_t>(status_.sync_error_ns);
  od_.sync_drift_ppb = static_cast<std::int32_t>(status_.clock_drift_ppm * 1e3F);
  od_.winding_temperature_ddegc = to_count16(sensing_.winding_c().value * 10.0F);
  od_.drive_temperature_degc = static_cast<std::int8_t>(to_count(limit(sensing_.drive_c().value, 127.0F)));
  od_.bus_voltage_cv =
      static_cast<std::uint16_t>(to_count(limit(sensing_.bus_voltage_v().value * 100.0F, 0.0F, 65535.0F)));
  od_.thermal_use_permille = static_cast<std::uint16_t>(to_count(limit(status_.thermal_load * 1e3F, 0.0F, 65535.0F)));
}

}  // namespace mrr::fw
