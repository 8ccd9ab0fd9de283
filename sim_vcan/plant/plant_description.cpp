#include "sim_vcan/plant/plant_description.h"

#include <cmath>

#include "common/robot/yaml_reader.h"

namespace mrr::sim {

namespace {

/// Presliding displacement of the friction bristles where a description says nothing, joint side: some 30 motor mrad.
constexpr double kDefaultPresliding_rad = 3e-4;

/// Read into `joint`: what the file does not say stays.
void read_joint(const YamlReader& section, JointTruth& joint) {
  if (const auto friction = section.optional_section("friction")) {
    LugreFriction& f = joint.friction;
    constexpr Range torque{0.0, 1000.0};
    f.coulomb_nm = friction->numbers<2>("coulomb", Unit::torque, torque, f.coulomb_nm);
    f.static_nm = friction->numbers<2>("static", Unit::torque, torque, f.static_nm);
    for (std::size_t way = 0; way < 2; ++way) {
      if (!(f.static_nm[way] >= f.coulomb_nm[way])) {
        friction->fail("static", "static friction cannot be below Coulomb friction; swap or correct them");
      }
    }
    f.stribeck_decay_s2_rad2 =
        friction->number("stribeck_decay", Unit::stribeck_decay, {0.0, 1e8}, f.stribeck_decay_s2_rad2);
    f.viscous_nm_s_rad = friction->number("viscous", Unit::torsional_damping, {0.0, 1e4}, f.viscous_nm_s_rad);
    f.bristle_stiffness_nm_rad =
        friction->number("bristle_stiffness", Unit::torsional_stiffness, {0.0, 5e5}, f.bristle_stiffness_nm_rad);
    f.bristle_damping_nm_s_rad =
        friction->number("bristle_damping", Unit::torsional_damping, {0.0, 1e4}, f.bristle_damping_nm_s_rad);
    f.ripple = friction->number("ripple", Unit::none, {0.0, 0.5}, f.ripple);
  }
  if (const auto spring = section.optional_section("spring")) {
    SpringDescription& s = joint.spring;
    s.stiffness_nm_rad =
        spring->numbers<3>("stiffness", Unit::torsional_stiffness, Range::positive(5e5), s.stiffness_nm_rad);
    s.break_nm = spring->numbers<2>("break", Unit::torque, Range::positive(1e4), s.break_nm);
    if (!(s.break_nm[1] >= s.break_nm[0])) spring->fail("break", "the torque where K1 ends must come first");
    s.damping_nm_s_rad = spring->number("damping", Unit::torsional_damping, {0.0, 1e4}, s.damping_nm_s_rad);
  }
  if (const auto drive = section.optional_section("drive")) {
    DriveTruth& d = joint.drive;
    d.torque_constant_nm_a =
        drive->numbers<2>("torque_constant", Unit::torque_constant, Range::positive(100.0), d.torque_constant_nm_a);
    d.current_bandwidth_hz =
        drive->number("current_bandwidth", Unit::frequency, {10.0, 5000.0}, d.current_bandwidth_hz);
    d.brake_torque_nm = drive->number("brake_torque", Unit::torque, {0.0, 1e4}, d.brake_torque_nm);
    d.brake_release_s = drive->number("brake_release", Unit::time, {0.0, 5.0}, d.brake_release_s);
    d.brake_engage_s = drive->number("brake_engage", Unit::time, {0.0, 5.0}, d.brake_engage_s);
    d.ambient_c = drive->number("ambient", Unit::temperature, {-40.0, 80.0}, d.ambient_c);
    d.short_resistance_ohm = drive->number("short_resistance", Unit::resistance, {0.0, 1000.0}, d.short_resistance_ohm);
    d.bus_voltage_v = drive->number("bus_voltage", Unit::voltage, {0.0, 600.0}, d.bus_voltage_v);
    d.supply_resistance_ohm =
        drive->number("supply_resistance", Unit::resistance, {0.0, 100.0}, d.supply_resistance_ohm);
  }
  if (const auto sensor = section.optional_section("sensor")) {
    SensorTruth& s = joint.sensor;
    s.torque_noise_nm = sensor->number("torque_noise", Unit::torque, {0.0, 100.0}, s.torque_noise_nm);
    s.torque_bandwidth_hz = sensor->number("torque_bandwidth", Unit::frequency, {1.0, 1e5}, s.torque_bandwidth_hz);
    s.torque_drift_nm = sensor->number("torque_drift", Unit::torque, {0.0, 100.0}, s.torque_drift_nm);
    s.torque_drift_time_s =
        sensor->number("torque_drift_time", Unit::time, Range::positive(1e6), s.torque_drift_time_s);
    s.current_noise_a = sensor->number("current_noise", Unit::current, {0.0, 100.0}, s.current_noise_a);
    s.limit_switch_margin_rad =
        sensor->number("limit_switch_margin", Unit::angle, {0.0, 1.0}, s.limit_switch_margin_rad);
  }
}

void read_plant(const std::filesystem::path& file, const RobotDescription& robot, PlantDescription& plant) {
  const YamlReader reader = YamlReader::from_file(file);
  if (const auto joints = reader.optional_section("joints")) {
    for (std::size_t i = 0; i < robot.joints.size(); ++i) {
      if (const auto joint = joints->optional_section(robot.joints[i].name)) read_joint(*joint, plant.joints[i]);
    }
  }
  if (const auto face = reader.optional_section("face")) {
    plant.face.stiffness_n_m =
        face->number("stiffness", Unit::stiffness, Range::positive(1e6), plant.face.stiffness_n_m);
    plant.face.damping_s_m = face->number("damping", Unit::contact_damping, {0.0, 100.0}, plant.face.damping_s_m);
  }
  if (const auto stops = reader.optional_section("end_stops")) {
    plant.stop_margin_rad = stops->number("margin", Unit::angle, {0.0, 1.0}, plant.stop_margin_rad);
    plant.stop_stiffness_nm_rad =
        stops->number("stiffness", Unit::torsional_stiffness, Range::positive(1e5), plant.stop_stiffness_nm_rad);
    plant.stop_damping_nm_s_rad =
        stops->number("damping", Unit::torsional_damping, {0.0, 1000.0}, plant.stop_damping_nm_s_rad);
  }
  plant.rotor_coupling = reader.boolean("rotor_coupling", plant.rotor_coupling);
  if (const auto random = reader.optional_section("perturbation")) {
    PerturbationDescription& p = plant.perturbation;
    constexpr Range share{0.0, 0.5};
    p.friction_share = random->number("friction", Unit::none, share, p.friction_share);
    p.torque_constant_share = random->number("torque_constant", Unit::none, share, p.torque_constant_share);
    p.spring_share = random->number("spring", Unit::none, share, p.spring_share);
    p.link_mass_share = random->number("link_mass", Unit::none, share, p.link_mass_share);
    p.resistance_share = random->number("nail_resistance", Unit::none, share, p.resistance_share);
    p.torque_gain_share = random->number("torque_gain", Unit::none, share, p.torque_gain_share);
    p.torque_offset_nm = random->number("torque_offset", Unit::torque, {0.0, 100.0}, p.torque_offset_nm);
    p.current_offset_a = random->number("current_offset", Unit::current, {0.0, 10.0}, p.current_offset_a);
    p.encoder_offset_rad = random->number("encoder_offset", Unit::angle, {0.0, 0.1}, p.encoder_offset_rad);
    p.home_switch_offset_rad = random->number("home_switch_offset", Unit::angle, {0.0, 0.1}, p.home_switch_offset_rad);
    p.nail_height_m = random->number("nail_height", Unit::length, {0.0, 0.05}, p.nail_height_m);
    p.nail_lateral_m = random->number("nail_lateral", Unit::length, {0.0, 0.05}, p.nail_lateral_m);
  }
  reader.finish();
}

void read_board(const std::filesystem::path& file, BoardDescription& board) {
  const YamlReader reader = YamlReader::from_file(file);
  board.name = reader.text("name");
  const YamlReader nail = reader.section("nail");
  board.nail_length_m = nail.number("length", Unit::length, Range::positive(0.5));
  board.nail_resistance_n = nail.number("resistance", Unit::force, {0.0, 1e6});
  board.nail_resistance_slope_n_m = nail.number("resistance_slope", Unit::stiffness, {0.0, 1e7});
  board.nail_damping_n_s_m = nail.number("damping", Unit::damping, Range::positive(1e6));
  const YamlReader surface = reader.section("surface");
  board.surface_stiffness_n_m = surface.number("stiffness", Unit::stiffness, Range::positive(1e6));
  board.surface_damping_s_m = surface.number("damping", Unit::contact_damping, {0.0, 100.0});
  board.half_width_m = surface.number("half_width", Unit::length, Range::positive(10.0));
  reader.finish();
}

}  // namespace

PlantDescription default_plant(const RobotDescription& robot) {
  PlantDescription plant;
  for (const JointDescription& joint : robot.joints) {
    JointTruth truth;
    const FrictionDescription& identified = joint.friction;
    truth.friction.coulomb_nm = {identified.coulomb_nm, identified.coulomb_nm};
    truth.friction.static_nm = {identified.static_nm, identified.static_nm};
    truth.friction.stribeck_decay_s2_rad2 = identified.stribeck_decay_s2_rad2;
    truth.friction.viscous_nm_s_rad = identified.viscous_nm_s_rad;
    if (identified.coulomb_nm > 0.0) {
      truth.friction.bristle_stiffness_nm_rad = identified.static_nm / kDefaultPresliding_rad;
      // 0.7 of critical damping of the rotor on its bristles.
      truth.friction.bristle_damping_nm_s_rad =
          1.4 * std::sqrt(truth.friction.bristle_stiffness_nm_rad * joint.reflected_inertia_kg_m2());
    }
    truth.spring.stiffness_nm_rad = joint.transmission.stiffness_nm_rad;
    truth.spring.break_nm = joint.transmission.stiffness_break_nm;
    truth.drive.torque_constant_nm_a = {joint.motor.torque_constant_positive_nm_a,
                                        joint.motor.torque_constant_negative_nm_a};
    // Holds what the transmission may carry repeatedly; a little faster than the times the module waits for.
    truth.drive.brake_torque_nm = joint.transmission.repeated_peak_nm;
    truth.drive.brake_release_s = 0.8 * joint.brake.release_s;
    truth.drive.brake_engage_s = 0.8 * joint.brake.engage_s;
    if (joint.sensors.torque_bandwidth_hz > 0.0) truth.sensor.torque_bandwidth_hz = joint.sensors.torque_bandwidth_hz;
    truth.sensor.torque_noise_nm = joint.sensors.torque_noise_nm;
    plant.joints.push_back(truth);
  }
  return plant;
}

PlantDescription load_plant(const RobotDescription& robot, const std::filesystem::path& board_yaml) {
  PlantDescription plant = default_plant(robot);
  const std::filesystem::path file = robot.source / "plant.yaml";
  if (std::filesystem::exists(file)) read_plant(file, robot, plant);
  read_board(board_yaml, plant.board);
  return plant;
}

}  // namespace mrr::sim
