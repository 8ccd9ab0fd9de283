// Room: common/robot. load_robot(): the two files of a robot read, checked one by one and against each other.
#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <limits>
#include <numbers>

#include "common/robot/robot.h"
#include "common/robot/urdf_chain.h"
#include "common/robot/yaml_reader.h"

namespace mrr {
namespace {

constexpr double kPi = std::numbers::pi;

std::string format(const char* pattern, double a) {
  char buffer[200];
  std::snprintf(buffer, sizeof buffer, pattern, a);
  return buffer;
}
std::string format(const char* pattern, double a, double b) {
  char buffer[200];
  std::snprintf(buffer, sizeof buffer, pattern, a, b);
  return buffer;
}

Eigen::Vector3d to_vector(const std::array<double, 3>& v) { return {v[0], v[1], v[2]}; }

bool is_whole(double x) { return std::abs(x - std::round(x)) <= 1e-9 * std::max(1.0, std::abs(x)); }

BusDescription read_bus(const YamlReader& yaml) {
  BusDescription bus;
  bus.interface = yaml.text("interface");
  if (bus.interface.size() > 15) yaml.fail("interface", "a Linux interface name has at most 15 characters; shorten it");
  bus.fd = yaml.boolean("fd", bus.fd);
  if (bus.fd) yaml.fail("fd", "the modules speak classic CAN; CAN FD is not there yet; set it to false");
  bus.bit_rate = yaml.number("bit_rate", Unit::bit_rate, {1e4, 1e6}, bus.bit_rate);
  bus.data_bit_rate = yaml.number("data_bit_rate", Unit::bit_rate, {1e5, 8e6}, bus.data_bit_rate);
  if (!(bus.data_bit_rate >= bus.bit_rate)) yaml.fail("data_bit_rate", "must not be below bit_rate");
  bus.knot_rate_hz = yaml.number("knot_rate", Unit::frequency, {10.0, 1000.0}, bus.knot_rate_hz);
  bus.loop_rate_hz = yaml.number("loop_rate", Unit::frequency, {100.0, 20000.0}, bus.loop_rate_hz);
  bus.max_load = yaml.number("max_load", Unit::none, {0.1, 0.95}, bus.max_load);
  if (!is_whole(1e6 / bus.loop_rate_hz)) {
    yaml.fail("loop_rate", "must give a period of whole microseconds; use for example 1 kHz, 2 kHz or 4 kHz");
  }
  if (!is_whole(bus.loop_rate_hz / bus.knot_rate_hz)) {
    yaml.fail("knot_rate", format("must divide the loop rate of %g Hz without remainder", bus.loop_rate_hz));
  }
  return bus;
}

TransmissionDescription read_transmission(const YamlReader& yaml) {
  const Range torque = Range::positive(5000.0);
  TransmissionDescription t;
  t.type = yaml.text("type");
  t.gear_ratio = yaml.number("gear_ratio", Unit::none, {1.0, 1000.0, true, false});
  t.rated_nm = yaml.number("rated", Unit::torque, torque);
  t.repeated_peak_nm = yaml.number("repeated_peak", Unit::torque, torque);
  t.momentary_peak_nm = yaml.number("momentary_peak", Unit::torque, torque);
  if (!(t.rated_nm < t.repeated_peak_nm)) yaml.fail("repeated_peak", "must be above the rated torque");
  if (!(t.repeated_peak_nm < t.momentary_peak_nm))
    yaml.fail("momentary_peak", "must be above the repeated peak torque");
  t.stiffness_nm_rad = yaml.numbers<3>("stiffness", Unit::torsional_stiffness, Range::positive(1e7));
  t.stiffness_break_nm = yaml.numbers<2>("stiffness_breaks", Unit::torque, torque);
  if (!(t.stiffness_nm_rad[0] <= t.stiffness_nm_rad[1] && t.stiffness_nm_rad[1] <= t.stiffness_nm_rad[2])) {
    yaml.fail("stiffness", "must not fall from K1 to K3; a harmonic drive gets stiffer with load");
  }
  if (!(t.stiffness_break_nm[0] < t.stiffness_break_nm[1])) {
    yaml.fail("stiffness_breaks", "the first break must be below the second");
  }
  return t;
}

MotorDescription read_motor(const YamlReader& yaml) {
  MotorDescription m;
  m.rotor_inertia_kg_m2 = yaml.number("rotor_inertia", Unit::inertia, Range::positive(0.1));
  m.torque_constant_positive_nm_a =
      yaml.number("torque_constant_positive", Unit::torque_constant, Range::positive(10.0));
  m.torque_constant_negative_nm_a =
      yaml.number("torque_constant_negative", Unit::torque_constant, Range::positive(10.0));
  m.peak_current_a = yaml.number("peak_current", Unit::current, Range::positive(200.0));
  m.continuous_current_a = yaml.number("continuous_current", Unit::current, Range::positive(200.0));
  if (!(m.continuous_current_a <= m.peak_current_a)) {
    yaml.fail("continuous_current", format("must not be above the peak current of %g A", m.peak_current_a));
  }
  m.thermal_time_constant_s = yaml.number("thermal_time_constant", Unit::time, Range::positive(1e4));
  m.max_winding_temperature_c = yaml.number("max_winding_temperature", Unit::temperature, {40.0, 250.0});
  m.max_velocity_rad_s = yaml.number("max_velocity", Unit::angular_velocity, Range::positive(3000.0));
  return m;
}

FrictionDescription read_friction(const YamlReader& yaml) {
  FrictionDescription f;
  f.coulomb_nm = yaml.number("coulomb", Unit::torque, {0.0, 1000.0});
  f.static_nm = yaml.number("static", Unit::torque, {0.0, 1000.0});
  if (!(f.static_nm >= f.coulomb_nm)) {
    yaml.fail("static", format("must not be below the Coulomb friction of %g Nm", f.coulomb_nm));
  }
  f.stribeck_decay_s2_rad2 = yaml.number("stribeck_decay", Unit::stribeck_decay, Range::positive(1e6));
  f.viscous_nm_s_rad = yaml.number("viscous", Unit::torsional_damping, {0.0, 1000.0});
  return f;
}

CompensatorDescription read_compensator(const YamlReader& yaml) {
  CompensatorDescription c;
  c.enabled = yaml.boolean("enabled", c.enabled);
  constexpr std::array<const char*, 4> kParameters = {"viscous", "coulomb", "static", "stribeck"};
  for (std::size_t i = 0; i < kParameters.size(); ++i) {
    const YamlReader p = yaml.section(kParameters[i]);
    c.integral_gain[i] = p.number("integral_gain", Unit::none, {0.0, 1e6});
    c.integral_limit[i] = p.number("limit", Unit::none, {0.0, 1e6});
    c.robust_gain[i] = p.number("gain", Unit::none, {0.0, 1e6});
    c.robust_width[i] = p.number("width", Unit::none, Range::positive(1e6));
  }
  const YamlReader position = yaml.section("position");
  c.position_gain_nm = position.number("gain", Unit::torque, {0.0, 1000.0});
  c.position_width_rad_s = position.number("width", Unit::angular_velocity, Range::positive(100.0));
  return c;
}

/// `joint` has its transmission, motor and friction already.
ControlDescription read_control(const YamlReader& yaml, const JointDescription& joint, const BusDescription& bus) {
  const double J = joint.reflected_inertia_kg_m2();
  ControlDescription c;
  c.lambda_1_s = yaml.number("lambda", Unit::rate, {0.0, 0.1 * bus.loop_rate_hz, true, false});
  c.position_gain_nm_rad =
      yaml.number("position_gain", Unit::torsional_stiffness, Range::positive(1e6), c.lambda_1_s * c.lambda_1_s * J);
  c.velocity_gain_nm_s_rad =
      yaml.number("velocity_gain", Unit::torsional_damping, Range::positive(1e5), 2.0 * c.lambda_1_s * J);
  c.friction_feedforward = yaml.number("friction_feedforward", Unit::none, {0.0, 1.2}, c.friction_feedforward);
  if (const auto compensator = yaml.optional_section("compensator")) {
    c.compensator = read_compensator(*compensator);
  } else {
    c.compensator.enabled = false;
  }
  if (c.compensator.enabled) {
    // In a boundary layer the compensator acts as more damping; too much of it is unstable in a sampled loop. The
    // Coulomb and static parts share the weight (1-E)^2 + E^2 <= 1, so the larger one counts (theory, section 2).
    const auto slope = [&](std::size_t i) { return c.compensator.robust_gain[i] / c.compensator.robust_width[i]; };
    const double q_slope = c.compensator.position_gain_nm / c.compensator.position_width_rad_s;
    const double bandwidth_1_s = (c.velocity_gain_nm_s_rad + std::max(slope(1), slope(2)) + q_slope) / J;
    const double allowed_1_s = 0.25 * bus.loop_rate_hz;
    if (!(bandwidth_1_s <= allowed_1_s)) {
      yaml.fail("compensator",
                format("its damping with that of the loop is %.0f 1/s where the loop rate allows %.0f 1/s; "
                       "lower a gain, widen a width or raise loop_rate",
                       bandwidth_1_s, allowed_1_s));
    }
  }
  c.passive_compensation =
      yaml.number("passive_compensation", Unit::none, {0.0, 0.9, false, true}, c.passive_compensation);
  const double f_m = c.passive_compensation * joint.friction.static_nm;
  if (c.passive_compensation > 0.0 && !(f_m < joint.friction.coulomb_nm)) {
    yaml.fail("passive_compensation",
              format("that is %.3g Nm, which must stay below the Coulomb friction of %.3g Nm lest it drives the joint",
                     f_m, joint.friction.coulomb_nm));
  }
  c.passive_blend_s = yaml.number("passive_blend", Unit::time, {0.0, 0.05}, c.passive_blend_s);
  c.friction_by_reference = yaml.boolean("friction_by_reference", false);
  c.carried_departure_nm =
      yaml.number("carried_departure", Unit::torque, Range::at_least(0.0), 0.25 * joint.transmission.rated_nm);
  c.resume_torque_slew_nm_s =
      yaml.number("resume_torque_slew", Unit::torque_rate, Range::positive(1e6), c.resume_torque_slew_nm_s);
  c.max_passive_s = yaml.number("max_passive", Unit::time, Range::positive(10.0), c.max_passive_s);
  c.max_passive_travel_rad =
      yaml.number("max_passive_travel", Unit::angle, Range::positive(kPi), c.max_passive_travel_rad);
  return c;
}

SensorsDescription read_sensors(const YamlReader& yaml, const JointDescription& joint) {
  SensorsDescription s;
  s.encoder_counts_per_turn = static_cast<std::int32_t>(yaml.integer("encoder_counts", 4, 1 << 26));
  const double reach_rad = std::max(std::abs(joint.limits.lower_rad), std::abs(joint.limits.upper_rad));
  const double counts = s.encoder_counts_per_turn * joint.transmission.gear_ratio * reach_rad / (2.0 * kPi);
  // A factor of two is left for the zero offset.
  if (!(2.0 * counts < std::numeric_limits<std::int32_t>::max())) {
    yaml.fail("encoder_counts", "the joint's travel must fit a 32-bit count twice; lower it");
  }
  s.encoder_absolute = yaml.boolean("encoder_absolute", s.encoder_absolute);
  if (const auto torque = yaml.optional_section("torque_sensor")) {
    s.torque_sensor = true;
    s.torque_full_scale_nm = torque->number("full_scale", Unit::torque, Range::positive(10000.0));
    s.torque_bandwidth_hz = torque->number("bandwidth", Unit::frequency, Range::positive(1e5));
    s.torque_noise_nm = torque->number("noise", Unit::torque, {0.0, 100.0});
    if (!(s.torque_full_scale_nm >= joint.transmission.repeated_peak_nm)) {
      torque->fail("full_scale", format("must reach the transmission's repeated peak torque of %g Nm",
                                        joint.transmission.repeated_peak_nm));
    }
  }
  s.current_full_scale_a = yaml.number("current_full_scale", Unit::current, Range::positive(1000.0));
  if (!(s.current_full_scale_a >= joint.motor.peak_current_a)) {
    yaml.fail("current_full_scale", format("must reach the motor's peak current of %g A", joint.motor.peak_current_a));
  }
  return s;
}

HomingDescription read_homing(const YamlReader& yaml, const JointLimits& limits, bool absolute) {
  HomingDescription h;
  h.method = yaml.choice<HomingMethod>("method", {{"switch", HomingMethod::on_switch}, {"here", HomingMethod::here}},
                                       h.method);
  h.switch_position_rad = yaml.number("switch_position", Unit::angle, {limits.lower_rad, limits.upper_rad});
  h.direction = yaml.choice<int>("direction", {{"negative", -1}, {"positive", 1}});
  h.fast_rad_s = yaml.number("fast", Unit::angular_velocity, Range::positive(limits.velocity_rad_s));
  h.slow_rad_s = yaml.number("slow", Unit::angular_velocity, Range::positive(h.fast_rad_s));
  h.timeout_s = yaml.number("timeout", Unit::time, Range::positive(600.0));
  const double sweep_s = (limits.upper_rad - limits.lower_rad) / h.fast_rad_s;
  if (!(h.timeout_s >= sweep_s)) {
    yaml.fail("timeout",
              format("a search through the whole travel takes %.3g s; raise it, or the fast velocity", sweep_s));
  }
  h.max_travel_rad = yaml.number("max_travel", Unit::angle, {0.0, 4.0 * kPi}, h.max_travel_rad);
  h.max_torque_nm = yaml.number("max_torque", Unit::torque, {0.0, limits.torque_nm}, h.max_torque_nm);
  if (yaml.has("index_position")) {
    h.index_position_rad = yaml.number("index_position", Unit::angle, {limits.lower_rad, limits.upper_rad});
    if (h.method == HomingMethod::here) {
      yaml.fail("index_position",
                "homing where the joint stands looks for no index; leave it out, or set method to switch");
    }
    // The joint goes on in the direction of the search.
    if (!(h.direction * (*h.index_position_rad - h.switch_position_rad) >= 0.0)) {
      yaml.fail("index_position", "it must lie beyond switch_position in the direction of the search");
    }
  } else {
    (void)yaml.number("index_position", Unit::angle, Range::any(), 0.0);
  }
  if (h.method == HomingMethod::here && absolute) {
    yaml.fail("method",
              "a joint with an absolute encoder knows where it is; set it to switch, or encoder_absolute to false");
  }
  return h;
}

using Reactions = std::vector<std::pair<std::string, SilenceReaction>>;

WatchdogDescription read_watchdog(const YamlReader& yaml, const BusDescription& bus) {
  const Reactions harmless = {
      {"hold", SilenceReaction::hold}, {"stop", SilenceReaction::stop}, {"damp", SilenceReaction::damp}};
  Reactions any = harmless;
  any.insert(any.begin(), {"report", SilenceReaction::report});
  WatchdogDescription w;
  if (const auto knots = yaml.optional_section("knots")) {
    w.missing_knots = static_cast<int>(knots->integer("missing", 1, 50, w.missing_knots));
    w.knots = knots->choice("reaction", harmless, w.knots);
  }
  if (const auto torque = yaml.optional_section("torque_target")) {
    w.torque_target_s = torque->number("timeout", Unit::time, {0.0, 10.0}, w.torque_target_s);
    w.torque_target = torque->choice("reaction", harmless, w.torque_target);
  }
  if (const auto heartbeat = yaml.optional_section("heartbeat")) {
    // The supervisor says it every 50 ms.
    w.heartbeat_s = heartbeat->number("timeout", Unit::time, {0.15, 10.0}, w.heartbeat_s);
    w.heartbeat = heartbeat->choice("reaction", any, w.heartbeat);
  }
  if (const auto sync = yaml.optional_section("sync")) {
    w.sync_s = sync->number("timeout", Unit::time, {0.0, 10.0}, w.sync_s);
    w.sync = sync->choice("reaction", any, w.sync);
    if (w.sync_s > 0.0 && !(w.sync_s * bus.knot_rate_hz >= 2.0)) {
      sync->fail("timeout", format("that is less than two SYNC periods of %g ms; raise it, or set 0 s to watch nothing",
                                   1e3 / bus.knot_rate_hz));
    }
  }
  if (const auto bus_off = yaml.optional_section("bus_off")) w.bus_off = bus_off->choice("reaction", any, w.bus_off);
  if (const auto torque = yaml.optional_section("in_torque_mode")) {
    w.torque_heartbeat = torque->choice("heartbeat", any, w.torque_heartbeat);
    w.torque_bus_off = torque->choice("bus_off", any, w.torque_bus_off);
  }
  if (const auto passive = yaml.optional_section("while_passive")) {
    w.passive_knots_s = passive->number("knots_timeout", Unit::time, {0.0, 10.0}, w.passive_knots_s);
    w.passive_knots = passive->choice("knots", any, w.passive_knots);
    w.passive_heartbeat = passive->choice("heartbeat", any, w.passive_heartbeat);
    w.passive_sync = passive->choice("sync", any, w.passive_sync);
    w.passive_bus_off = passive->choice("bus_off", any, w.passive_bus_off);
  }
  return w;
}

/// A jerk limit that is not given lets a motion reach its acceleration limit in this time.
constexpr double kRampS = 5e-3;

void read_joint(const YamlReader& yaml, JointDescription& joint, const BusDescription& bus) {
  joint.node_id = static_cast<std::uint8_t>(yaml.integer("node_id", 2, 127));
  joint.selection_bit = static_cast<std::uint8_t>(yaml.integer("selection_bit", 0, 31));

  const YamlReader limits = yaml.section("limits");
  joint.limits.acceleration_rad_s2 = limits.number("acceleration", Unit::angular_acceleration, Range::positive(1000.0));
  joint.limits.jerk_rad_s3 =
      limits.number("jerk", Unit::angular_jerk, Range::positive(1e6), joint.limits.acceleration_rad_s2 / kRampS);
  joint.limits.following_error_rad = limits.number("following_error", Unit::angle, Range::positive(kPi));
  joint.limits.following_error_time_s = limits.number("following_error_time", Unit::time, {0.0, 10.0});
  const JointLimits hard = joint.limits;
  joint.limits.lower_rad = limits.number("lower", Unit::angle, {hard.lower_rad, hard.upper_rad}, hard.lower_rad);
  joint.limits.upper_rad = limits.number("upper", Unit::angle, {hard.lower_rad, hard.upper_rad}, hard.upper_rad);
  if (!(joint.limits.lower_rad < joint.limits.upper_rad)) {
    limits.fail("upper", format("it must be above the lower limit of %g rad", joint.limits.lower_rad));
  }
  joint.park_rad = yaml.number("park", Unit::angle, {joint.limits.lower_rad, joint.limits.upper_rad}, 0.0);
  if (!(joint.park_rad >= joint.limits.lower_rad && joint.park_rad <= joint.limits.upper_rad)) {
    yaml.fail(format("without 'park' the joint rests at 0 rad, outside its limits of %g to %g rad; give it",
                     joint.limits.lower_rad, joint.limits.upper_rad));
  }

  const YamlReader motor = yaml.section("motor");
  joint.transmission = read_transmission(yaml.section("transmission"));
  joint.motor = read_motor(motor);
  joint.friction = read_friction(yaml.section("friction"));

  // The URDF's limits must be ones which this drive can keep.
  const double gamma = joint.transmission.gear_ratio;
  if (!(joint.limits.velocity_rad_s * gamma <= joint.motor.max_velocity_rad_s * (1.0 + 1e-9))) {
    motor.fail("max_velocity",
               format("the URDF's velocity limit of %g rad/s needs %g rad/s of the motor; lower the limit",
                      joint.limits.velocity_rad_s, joint.limits.velocity_rad_s * gamma));
  }
  const double weaker_nm_a =
      gamma * std::min(joint.motor.torque_constant_positive_nm_a, joint.motor.torque_constant_negative_nm_a);
  if (!(joint.limits.torque_nm <= weaker_nm_a * joint.motor.peak_current_a * (1.0 + 1e-9))) {
    motor.fail("peak_current",
               format("that gives %.4g Nm at the joint where the URDF's effort limit is %.4g Nm; lower the limit",
                      weaker_nm_a * joint.motor.peak_current_a, joint.limits.torque_nm));
  }
  if (!(joint.limits.torque_nm <= joint.transmission.momentary_peak_nm)) {
    yaml.section("transmission")
        .fail("momentary_peak",
              format("the URDF's effort limit of %g Nm must not be above it; lower the limit", joint.limits.torque_nm));
  }
  if (!(joint.limits.torque_nm > joint.friction.static_nm)) {
    yaml.section("friction")
        .fail("static", format("the URDF's effort limit of %g Nm must be above it, or the joint never moves",
                               joint.limits.torque_nm));
  }

  joint.control = read_control(yaml.section("control"), joint, bus);
  joint.sensors = read_sensors(yaml.section("sensors"), joint);
  joint.homing = read_homing(yaml.section("homing"), hard, joint.sensors.encoder_absolute);
  if (const auto watchdog = yaml.optional_section("watchdog")) joint.watchdog = read_watchdog(*watchdog, bus);
  if (const auto calibration = yaml.optional_section("calibration")) {
    joint.torque_offset_nm = calibration->number("torque_offset", Unit::torque, {-1000.0, 1000.0}, 0.0);
    if (!joint.sensors.torque_sensor && joint.torque_offset_nm != 0.0) {
      calibration->fail("torque_offset", "the joint has no torque sensor; leave it out, or add sensors.torque_sensor");
    }
  }
  const YamlReader brake = yaml.section("brake");
  joint.brake.release_s = brake.number("release", Unit::time, {0.0, 2.0});
  joint.brake.engage_s = brake.number("engage", Unit::time, {0.0, 2.0});
}

HammerDescription read_hammer(const YamlReader& yaml, const UrdfChain& chain) {
  const std::string link = yaml.text("link");
  const auto it = chain.links.find(link);
  if (it == chain.links.end()) yaml.fail("link", "the URDF has no link of that name; name the link of the hammer face");
  if (it->second.carrier != static_cast<int>(chain.joints.size()) - 1) {
    yaml.fail("link", "it must be fixed to the last moving link, '" + chain.joints.back().link.name + "'");
  }
  HammerDescription hammer;
  hammer.face = it->second.pose;
  hammer.face_radius_m = yaml.number("face_radius", Unit::length, Range::positive(0.2));
  hammer.max_tilt_rad = yaml.number("max_tilt", Unit::angle, Range::positive(kPi / 4.0));
  return hammer;
}

TaskDescription read_task(const YamlReader& yaml) {
  TaskDescription t;
  t.nail_position_m = to_vector(yaml.numbers<3>("nail_position", Unit::length, {-10.0, 10.0}));
  const Eigen::Vector3d normal = to_vector(yaml.numbers<3>("normal", Unit::none, {-1e3, 1e3}, {0.0, 0.0, 1.0}));
  if (!(normal.norm() > 1e-6)) yaml.fail("normal", "must have a direction; for example 0 0 1");
  t.normal = normal.normalized();
  t.nail_height_m = yaml.number("nail_height", Unit::length, {0.0, 0.5}, t.nail_height_m);
  t.flush_tolerance_m = yaml.number("flush_tolerance", Unit::length, Range::positive(0.05), t.flush_tolerance_m);
  t.max_swings = static_cast<int>(yaml.integer("max_swings", 1, 10000, t.max_swings));
  t.still_swings = static_cast<int>(yaml.integer("still_swings", 1, 10000, t.still_swings));
  t.still_tolerance_m = yaml.number("still_tolerance", Unit::length, Range::positive(0.05), t.still_tolerance_m);
  t.impacts_over_momentary_peak =
      yaml.number("impacts_over_momentary_peak", Unit::none, {1.0, 1e9}, t.impacts_over_momentary_peak);
  t.assumed_contact_s = yaml.number("assumed_contact", Unit::time, {1e-4, 1.0}, t.assumed_contact_s);
  t.back_swing_rad = yaml.number("back_swing", Unit::angle, Range::positive(kPi), t.back_swing_rad);
  t.max_speed_share = yaml.number("max_speed_share", Unit::none, Range::positive(1.0), t.max_speed_share);
  t.switch_lead_s = yaml.number("switch_lead", Unit::time, {0.0, 0.2}, t.switch_lead_s);
  return t;
}

/// What holds between joints, and between a joint and the task.
void check_across(const RobotDescription& robot, const YamlReader& joints, const YamlReader& task) {
  // A blow must be seen by its knots: two and a half per contact are the least with which it was felt.
  if (!(robot.task.assumed_contact_s * robot.bus.knot_rate_hz >= 2.5)) {
    task.fail("assumed_contact",
              format("with knots at %g Hz such a contact is not seen; raise bus.knot_rate to %g Hz or more",
                     robot.bus.knot_rate_hz, 2.5 / robot.task.assumed_contact_s));
  }
  for (std::size_t i = 0; i < robot.joints.size(); ++i) {
    const JointDescription& a = robot.joints[i];
    for (std::size_t k = 0; k < i; ++k) {
      const JointDescription& b = robot.joints[k];
      if (a.node_id == b.node_id) {
        joints.section(a.name).fail("node_id", "'" + b.name + "' has the same; each joint needs its own from 2 to 127");
      }
      if (a.selection_bit == b.selection_bit) {
        joints.section(a.name).fail("selection_bit",
                                    "'" + b.name + "' has the same; each joint needs its own from 0 to 31");
      }
    }
    // A hammer that lands while torque still fades strikes a joint which is not passive yet.
    if (!(a.control.passive_blend_s < robot.task.switch_lead_s)) {
      task.fail("switch_lead", "it must be longer than joint '" + a.name + "' needs to go passive" +
                                   format(" (passive_blend, %g s)", a.control.passive_blend_s));
    }
  }
}

std::uint64_t hash_of_files(const std::filesystem::path& directory) {
  std::uint64_t hash = 14695981039346656037ULL;  // FNV-1a
  const auto add = [&hash](char c) { hash = (hash ^ static_cast<unsigned char>(c)) * 1099511628211ULL; };
  for (const char* name : {"robot.urdf", "robot.yaml"}) {
    std::ifstream file(directory / name, std::ios::binary);
    for (char c = 0; file.get(c);) add(c);
    add('\0');
  }
  return hash;
}

RobotDescription read_robot(const std::filesystem::path& directory, const std::string* text) {
  std::error_code ec;
  if (!std::filesystem::is_directory(directory, ec)) {
    throw description_error(directory.string(),
                            "there is no such directory; give one that holds robot.urdf and robot.yaml");
  }
  RobotDescription robot;
  robot.source = directory;
  robot.source_hash = hash_of_files(directory);
  UrdfChain chain = read_urdf_chain(directory / "robot.urdf");
  const std::filesystem::path file = directory / "robot.yaml";
  const YamlReader yaml = text == nullptr ? YamlReader::from_file(file) : YamlReader::from_text(*text, file.string());

  robot.name = chain.name;
  robot.gravity_m_s2 = to_vector(yaml.numbers<3>("gravity", Unit::acceleration, {-100.0, 100.0}, {0.0, 0.0, -9.81}));
  robot.bus = read_bus(yaml.section("bus"));
  robot.hammer = read_hammer(yaml.section("hammer"), chain);
  robot.task = read_task(yaml.section("task"));
  robot.joints = std::move(chain.joints);

  const YamlReader joints = yaml.section("joints");
  for (const std::string& name : joints.keys()) {
    const bool known = std::any_of(robot.joints.begin(), robot.joints.end(),
                                   [&](const JointDescription& joint) { return joint.name == name; });
    if (known) continue;
    std::string names;
    for (const auto& joint : robot.joints) names += (names.empty() ? "" : ", ") + joint.name;
    joints.section(name).fail("the URDF has no revolute joint of that name; it has " + names);
  }
  for (JointDescription& joint : robot.joints) read_joint(joints.section(joint.name), joint, robot.bus);
  check_across(robot, joints, yaml.section("task"));
  yaml.finish();
  return robot;
}

}  // namespace

RobotDescription load_robot(const std::filesystem::path& directory) { return read_robot(directory, nullptr); }

RobotDescription load_robot(const std::filesystem::path& directory, const std::string& yaml) {
  return read_robot(directory, &yaml);
}

bool source_changed(const RobotDescription& robot) {
  return !robot.source.empty() && hash_of_files(robot.source) != robot.source_hash;
}

std::string joint_words(const RobotDescription& robot, int joint) {
  std::string text = "joint ";
  text += std::to_string(joint + 1);
  text += " (";
  text += robot.joints[static_cast<std::size_t>(joint)].name;
  text += ')';
  return text;
}

}  // namespace mrr
