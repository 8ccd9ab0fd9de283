#include "module_fw/targets/host/module_config.h"

#include <bit>
#include <concepts>

namespace mrr::fw {

namespace {

float f(double value) { return static_cast<float>(value); }

std::array<float, 4> f(const std::array<double, 4>& values) {
  return {f(values[0]), f(values[1]), f(values[2]), f(values[3])};
}

/// FNV-1a, fed value by value: padding has no say in it.
class Hash {
 public:
  Hash& add(std::uint64_t bits) {
    for (int i = 0; i < 8; ++i) {
      state_ = (state_ ^ static_cast<std::uint32_t>(bits >> (8 * i) & 0xFFU)) * 16777619U;
    }
    return *this;
  }
  Hash& add(float value) { return add(std::uint64_t{std::bit_cast<std::uint32_t>(value)}); }
  Hash& add(Duration value) { return add(static_cast<std::uint64_t>(value.ns)); }
  Hash& add(std::integral auto value) { return add(static_cast<std::uint64_t>(value)); }
  template <typename T, std::size_t N>
  Hash& add(const std::array<T, N>& values) {
    for (const T& value : values) add(value);
    return *this;
  }
  template <typename First, typename Second, typename... Rest>
  Hash& add(const First& first, const Second& second, const Rest&... rest) {
    add(first);
    return add(second, rest...);
  }
  [[nodiscard]] std::uint32_t value() const { return state_; }

 private:
  std::uint32_t state_ = 2166136261U;
};

std::uint32_t hash_of(const ModuleConfig& c) {
  Hash hash;
  hash.add(c.node_id, c.supervisor_node_id, c.selection_bit, c.tick, c.knot_period, c.bit_rate);
  const SensingConfig& s = c.sensing;
  hash.add(s.encoder_counts_per_turn, s.encoder_absolute, s.encoder_zero_count, s.velocity_bandwidth_rad_s,
           s.torque_sensor, s.torque_full_scale_nm, s.current_full_scale_a, s.max_plausible_velocity_rad_s);
  hash.add(c.friction.coulomb_nm, c.friction.static_nm, c.friction.stribeck_decay_s2_rad2, c.friction.viscous_nm_s_rad);
  const ControlConfig& k = c.control;
  hash.add(k.inertia_kg_m2, k.lambda_1_s, k.position_gain_nm_rad, k.velocity_gain_nm_s_rad, k.friction_feedforward,
           k.still_velocity_rad_s, k.compensator.enabled, k.compensator.integral_gain, k.compensator.integral_limit,
           k.compensator.robust_gain, k.compensator.robust_width, k.compensator.position_gain_nm,
           k.compensator.position_width_rad_s);
  const PassiveConfig& p = c.passive;
  hash.add(p.compensation_nm, p.moving_velocity_rad_s, p.torque_dead_band_nm, p.torque_full_trend_nm, p.trend_rate_1_s,
           p.blend, p.resume_torque_slew_nm_s, p.max_time, p.max_travel_rad);
  const DriveConfig& d = c.drive;
  hash.add(d.gear_ratio, d.torque_constant_positive_nm_a, d.torque_constant_negative_nm_a, d.peak_current_a,
           d.continuous_current_a, d.thermal_time_constant_s, d.max_winding_temperature_c, d.rated_torque_nm);
  const LimitsConfig& l = c.limits;
  hash.add(l.lower_rad, l.upper_rad, l.velocity_rad_s, l.acceleration_rad_s2, l.torque_nm, l.following_error_rad,
           l.following_error_time);
  hash.add(c.homing.switch_position_rad, c.homing.direction, c.homing.fast_rad_s, c.homing.slow_rad_s, c.homing.timeout,
           c.brake.release, c.brake.engage);
  return hash.value();
}

}  // namespace

ModuleConfig module_config(const RobotDescription& robot, int joint) {
  const JointDescription& j = robot.joints[static_cast<std::size_t>(joint)];
  ModuleConfig c;
  c.node_id = j.node_id;
  c.selection_bit = j.selection_bit;
  c.serial_number = j.node_id;
  c.tick = seconds(1.0 / robot.bus.loop_rate_hz);
  c.knot_period = seconds(1.0 / robot.bus.knot_rate_hz);
  c.bit_rate = static_cast<std::uint32_t>(robot.bus.bit_rate);

  c.sensing.encoder_counts_per_turn = j.sensors.encoder_counts_per_turn;
  c.sensing.encoder_absolute = j.sensors.encoder_absolute;
  c.sensing.torque_sensor = j.sensors.torque_sensor;
  if (j.sensors.torque_sensor) c.sensing.torque_full_scale_nm = f(j.sensors.torque_full_scale_nm);
  c.sensing.current_full_scale_a = f(j.sensors.current_full_scale_a);

  c.friction = {f(j.friction.coulomb_nm), f(j.friction.static_nm), f(j.friction.stribeck_decay_s2_rad2),
                f(j.friction.viscous_nm_s_rad)};

  c.control.inertia_kg_m2 = f(j.reflected_inertia_kg_m2());
  c.control.lambda_1_s = f(j.control.lambda_1_s);
  c.control.position_gain_nm_rad = f(j.control.position_gain_nm_rad);
  c.control.velocity_gain_nm_s_rad = f(j.control.velocity_gain_nm_s_rad);
  c.control.friction_feedforward = f(j.control.friction_feedforward);
  const CompensatorDescription& compensator = j.control.compensator;
  c.control.compensator = {compensator.enabled,
                           f(compensator.integral_gain),
                           f(compensator.integral_limit),
                           f(compensator.robust_gain),
                           f(compensator.robust_width),
                           f(compensator.position_gain_nm),
                           f(compensator.position_width_rad_s)};

  c.passive.compensation_nm = f(j.control.passive_compensation * j.friction.static_nm);
  c.passive.blend = seconds(j.control.passive_blend_s);
  c.passive.resume_torque_slew_nm_s = f(j.control.resume_torque_slew_nm_s);
  c.passive.max_time = seconds(j.control.max_passive_s);
  c.passive.max_travel_rad = f(j.control.max_passive_travel_rad);

  c.drive.gear_ratio = f(j.transmission.gear_ratio);
  c.drive.torque_constant_positive_nm_a = f(j.motor.torque_constant_positive_nm_a);
  c.drive.torque_constant_negative_nm_a = f(j.motor.torque_constant_negative_nm_a);
  c.drive.peak_current_a = f(j.motor.peak_current_a);
  c.drive.continuous_current_a = f(j.motor.continuous_current_a);
  c.drive.thermal_time_constant_s = f(j.motor.thermal_time_constant_s);
  c.drive.max_winding_temperature_c = f(j.motor.max_winding_temperature_c);
  c.drive.rated_torque_nm = f(j.transmission.rated_nm);

  c.limits.lower_rad = f(j.limits.lower_rad);
  c.limits.upper_rad = f(j.limits.upper_rad);
  c.limits.velocity_rad_s = f(j.limits.velocity_rad_s);
  c.limits.acceleration_rad_s2 = f(j.limits.acceleration_rad_s2);
  c.limits.torque_nm = f(j.limits.torque_nm);
  c.limits.following_error_rad = f(j.limits.following_error_rad);
  c.limits.following_error_time = seconds(j.limits.following_error_time_s);

  c.homing = {f(j.homing.switch_position_rad), j.homing.direction, f(j.homing.fast_rad_s), f(j.homing.slow_rad_s),
              seconds(j.homing.timeout_s)};
  c.brake.release = seconds(j.brake.release_s);
  c.brake.engage = seconds(j.brake.engage_s);
  c.configuration_hash = hash_of(c);
  return c;
}

}  // namespace mrr::fw
