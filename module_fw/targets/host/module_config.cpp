#include "module_fw/targets/host/module_config.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <numbers>
#include <stdexcept>

namespace mrr::fw {

namespace {

class Fnv1a {
 public:
  void add(std::uint64_t value, int bytes) {
    for (int i = 0; i < bytes; ++i) {
      hash_ ^= static_cast<std::uint32_t>((value >> (8 * i)) & 0xFFU);
      hash_ *= 16777619U;
    }
  }
  void add(float x) { add(std::bit_cast<std::uint32_t>(x), 4); }
  void add(Duration d) { add(static_cast<std::uint64_t>(d.ns), 8); }
  void add(bool b) { add(b ? 1U : 0U, 1); }
  void add(std::int32_t v) { add(static_cast<std::uint32_t>(v), 4); }
  void add(std::uint32_t v) { add(v, 4); }
  void add(std::uint8_t v) { add(v, 1); }
  template <typename... T>
  void all(const T&... values) {
    (add(values), ...);
  }
  [[nodiscard]] std::uint32_t value() const { return hash_; }

 private:
  std::uint32_t hash_ = 2166136261U;
};

float narrow(double x) { return static_cast<float>(x); }

std::array<float, 4> narrow(const std::array<double, 4>& v) {
  return {narrow(v[0]), narrow(v[1]), narrow(v[2]), narrow(v[3])};
}

}  // namespace

std::uint32_t configuration_hash(const ModuleConfig& c) {
  Fnv1a h;
  h.all(c.node_id, c.supervisor_node_id, c.selection_bit, c.tick, c.knot_period, c.bit_rate);
  const SensingConfig& s = c.sensing;
  h.all(s.encoder_counts_per_turn, s.encoder_absolute, s.encoder_zero_count, s.velocity_bandwidth_rad_s,
        s.torque_sensor, s.torque_full_scale_nm, s.torque_bandwidth_rad_s, s.current_full_scale_a, s.encoder_timeout,
        s.torque_timeout, s.current_timeout, s.slow_timeout, s.max_plausible_velocity_rad_s);
  const FrictionConfig& f = c.friction;
  h.all(f.coulomb_nm, f.static_nm, f.stribeck_decay_s2_rad2, f.viscous_nm_s_rad);
  const ControlConfig& k = c.control;
  h.all(k.inertia_kg_m2, k.lambda_1_s, k.position_gain_nm_rad, k.velocity_gain_nm_s_rad, k.friction_feedforward,
        k.carried_departure_nm, k.still_velocity_rad_s, k.moving_velocity_rad_s, k.reference_still_rad_s,
        k.compensator.enabled, k.compensator.position_gain_nm, k.compensator.position_width_rad_s);
  for (std::size_t i = 0; i < 4; ++i) {
    h.all(k.compensator.integral_gain[i], k.compensator.integral_limit[i], k.compensator.robust_gain[i],
          k.compensator.robust_width[i]);
  }
  const PassiveConfig& p = c.passive;
  h.all(p.compensation_nm, p.static_compensation_nm, p.guard_energy_j, p.still_velocity_rad_s, p.moving_velocity_rad_s,
        p.torque_dead_band_nm, p.torque_trend_nm, p.trend_rate_1_s, p.rest_trend_rate_1_s, p.torque_filter_rad_s,
        p.blend, p.resume_torque_slew_nm_s, p.max_time, p.max_travel_rad);
  const ReferenceConfig& r = c.reference;
  h.all(r.stop_deceleration_rad_s2, r.quick_stop_deceleration_rad_s2, r.settle_rate_1_s, r.resync_window_rad,
        r.resync_velocity_rad_s, r.offset_decay_1_s);
  const DriveConfig& d = c.drive;
  h.all(d.gear_ratio, d.torque_constant_positive_nm_a, d.torque_constant_negative_nm_a, d.peak_current_a,
        d.continuous_current_a, d.thermal_time_constant_s, d.max_winding_temperature_c, d.max_drive_temperature_c,
        d.temperature_derating_c, d.min_bus_voltage_v, d.max_bus_voltage_v, d.rated_torque_nm);
  const LimitsConfig& l = c.limits;
  h.all(l.lower_rad, l.upper_rad, l.velocity_rad_s, l.acceleration_rad_s2, l.torque_nm, l.following_error_rad,
        l.following_error_time);
  h.all(c.homing.switch_position_rad, c.homing.direction, c.homing.fast_rad_s, c.homing.slow_rad_s, c.homing.timeout,
        c.homing.max_travel_rad, c.homing.max_torque_nm, c.homing.index, c.homing.index_position_rad,
        static_cast<std::int32_t>(c.homing.method));
  h.all(c.brake.release, c.brake.engage, c.brake.torque_confirm_timeout);
  h.all(c.watchdog.missing_knots, c.watchdog.supervisor_heartbeat, c.watchdog.sync, c.watchdog.loop,
        c.watchdog.torque_target, s.torque_offset_nm);
  for (const std::uint8_t reaction : c.watchdog.reactions) h.add(reaction);
  for (const std::uint8_t reaction : c.watchdog.torque_reactions) h.add(reaction);
  for (const std::uint8_t reaction : c.watchdog.passive_reactions) h.add(reaction);
  h.add(c.watchdog.passive);
  return h.value();
}

ModuleConfig module_config(const RobotDescription& robot, int joint) {
  const JointDescription& j = robot.joints.at(static_cast<std::size_t>(joint));
  ModuleConfig c;
  c.node_id = j.node_id;
  c.selection_bit = j.selection_bit;
  c.serial_number = j.node_id;
  c.tick = seconds(1.0 / robot.bus.loop_rate_hz);
  c.knot_period = seconds(1.0 / robot.bus.knot_rate_hz);
  c.bit_rate = static_cast<std::uint32_t>(std::lround(robot.bus.bit_rate));

  c.sensing.encoder_counts_per_turn = j.sensors.encoder_counts_per_turn;
  c.sensing.encoder_absolute = j.sensors.encoder_absolute;
  c.sensing.torque_sensor = j.sensors.torque_sensor;
  c.sensing.torque_offset_nm = narrow(j.torque_offset_nm);
  if (j.sensors.torque_sensor) {
    c.sensing.torque_full_scale_nm = narrow(j.sensors.torque_full_scale_nm);
    c.sensing.torque_bandwidth_rad_s = narrow(2.0 * std::numbers::pi * j.sensors.torque_bandwidth_hz);
  }
  c.sensing.current_full_scale_a = narrow(j.sensors.current_full_scale_a);

  c.friction = {narrow(j.friction.coulomb_nm), narrow(j.friction.static_nm), narrow(j.friction.stribeck_decay_s2_rad2),
                narrow(j.friction.viscous_nm_s_rad)};

  c.control.inertia_kg_m2 = narrow(j.reflected_inertia_kg_m2());
  c.control.lambda_1_s = narrow(j.control.lambda_1_s);
  c.control.position_gain_nm_rad = narrow(j.control.position_gain_nm_rad);
  c.control.velocity_gain_nm_s_rad = narrow(j.control.velocity_gain_nm_s_rad);
  c.control.friction_feedforward = narrow(j.control.friction_feedforward);
  c.control.carried_departure_nm = narrow(j.control.carried_departure_nm);
  // The encoder tells motion from rest above two and a half counts per tick.
  const double count_rad = 2.0 * std::numbers::pi / (j.sensors.encoder_counts_per_turn * j.transmission.gear_ratio);
  c.control.still_velocity_rad_s = std::max(narrow(2.5 * count_rad * robot.bus.loop_rate_hz), 5e-3F);
  if (j.control.friction_by_reference) c.control.still_velocity_rad_s = c.sensing.max_plausible_velocity_rad_s;
  c.control.moving_velocity_rad_s = 2.0F * c.control.still_velocity_rad_s;
  const CompensatorDescription& comp = j.control.compensator;
  c.control.compensator.enabled = comp.enabled;
  c.control.compensator.integral_gain = narrow(comp.integral_gain);
  c.control.compensator.integral_limit = narrow(comp.integral_limit);
  c.control.compensator.robust_gain = narrow(comp.robust_gain);
  c.control.compensator.robust_width = narrow(comp.robust_width);
  c.control.compensator.position_gain_nm = narrow(comp.position_gain_nm);
  c.control.compensator.position_width_rad_s = narrow(comp.position_width_rad_s);

  // f_m is a share of the static friction, and must stay below the Coulomb friction.
  c.passive.compensation_nm =
      narrow(std::min(j.control.passive_compensation * j.friction.static_nm, 0.89 * j.friction.coulomb_nm));
  c.passive.static_compensation_nm = static_compensation_nm(c.passive.compensation_nm, c.friction);
  c.passive.blend = seconds(j.control.passive_blend_s);
  c.passive.resume_torque_slew_nm_s = narrow(j.control.resume_torque_slew_nm_s);
  c.passive.max_time = seconds(j.control.max_passive_s);
  c.passive.max_travel_rad = narrow(j.control.max_passive_travel_rad);
  // At rest the sensed torque tells the trend only beyond its own noise and drift.
  c.passive.torque_dead_band_nm = narrow(std::max(1.0, 6.0 * j.sensors.torque_noise_nm + 0.5));
  // Friction stores a little elastically and gives it back at every reversal: that much is no gain.
  c.passive.guard_energy_j = 0.005F + 0.00016F * c.friction.static_nm;
  c.passive.torque_trend_nm = 1.5F * c.passive.torque_dead_band_nm;

  c.reference.stop_deceleration_rad_s2 = narrow(j.stop_deceleration_rad_s2());
  c.reference.quick_stop_deceleration_rad_s2 = narrow(j.limits.acceleration_rad_s2);

  c.drive.gear_ratio = narrow(j.transmission.gear_ratio);
  c.drive.torque_constant_positive_nm_a = narrow(j.motor.torque_constant_positive_nm_a);
  c.drive.torque_constant_negative_nm_a = narrow(j.motor.torque_constant_negative_nm_a);
  c.drive.peak_current_a = narrow(j.motor.peak_current_a);
  c.drive.continuous_current_a = narrow(j.motor.continuous_current_a);
  c.drive.thermal_time_constant_s = narrow(j.motor.thermal_time_constant_s);
  c.drive.max_winding_temperature_c = narrow(j.motor.max_winding_temperature_c);
  c.drive.rated_torque_nm = narrow(j.transmission.rated_nm);

  c.limits.lower_rad = narrow(j.limits.lower_rad);
  c.limits.upper_rad = narrow(j.limits.upper_rad);
  c.limits.velocity_rad_s = narrow(j.limits.velocity_rad_s);
  c.limits.acceleration_rad_s2 = narrow(j.limits.acceleration_rad_s2);
  c.limits.torque_nm = narrow(j.limits.torque_nm);
  c.limits.following_error_rad = narrow(j.limits.following_error_rad);
  c.limits.following_error_time = seconds(j.limits.following_error_time_s);

  c.homing.switch_position_rad = narrow(j.homing.switch_position_rad);
  c.homing.direction = j.homing.direction;
  c.homing.fast_rad_s = narrow(j.homing.fast_rad_s);
  c.homing.slow_rad_s = narrow(j.homing.slow_rad_s);
  c.homing.timeout = seconds(j.homing.timeout_s);
  c.homing.method = j.homing.method == HomingMethod::here ? 37 : -1;
  c.homing.max_travel_rad = narrow(j.homing.max_travel_rad);
  c.homing.max_torque_nm = narrow(j.homing.max_torque_nm);
  c.homing.index = j.homing.index_position_rad.has_value();
  c.homing.index_position_rad = narrow(j.homing.index_position_rad.value_or(0.0));

  const WatchdogDescription& w = j.watchdog;
  c.watchdog.missing_knots = static_cast<std::uint8_t>(w.missing_knots);
  c.watchdog.torque_target = seconds(w.torque_target_s);
  c.watchdog.supervisor_heartbeat = seconds(w.heartbeat_s);
  c.watchdog.sync = seconds(w.sync_s);
  const auto number = [](SilenceReaction reaction) { return static_cast<std::uint8_t>(reaction); };
  c.watchdog.reactions = {number(w.knots), number(w.torque_target), number(w.heartbeat), number(w.sync),
                          number(w.bus_off)};
  c.watchdog.torque_reactions = {number(w.torque_heartbeat), number(w.torque_bus_off)};
  c.watchdog.passive_reactions = {number(w.passive_knots), number(w.passive_heartbeat), number(w.passive_sync),
                                  number(w.passive_bus_off)};
  c.watchdog.passive = seconds(w.passive_knots_s);

  c.brake.release = seconds(j.brake.release_s);
  c.brake.engage = seconds(j.brake.engage_s);

  c.configuration_hash = configuration_hash(c);
  return c;
}

}  // namespace mrr::fw
