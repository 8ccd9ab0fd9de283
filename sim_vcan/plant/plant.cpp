#include "sim_vcan/plant/plant.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "common/core/random.h"
#include "common/robot/errors.h"
#include "sim_vcan/plant/multibody.h"

namespace mrr::sim {

using Eigen::Vector3d;

namespace {

constexpr double kTwoPi = 2.0 * std::numbers::pi;
constexpr double kFullScale = 32767.0;
/// A gripping brake as a spring and damper on the motor side: stiffer than any transmission, still well sampled.
constexpr double kBrakeStiffness = 1.0e5;
constexpr double kBrakeDamping = 100.0;

constexpr std::size_t at(int i) noexcept { return static_cast<std::size_t>(i); }

double tilt_of(double cosine) noexcept { return std::acos(std::clamp(cosine, -1.0, 1.0)); }

/// Rounds and saturates to what an N-bit converter can say.
template <typename Int>
Int quantise(double counts) noexcept {
  constexpr double lo = static_cast<double>(std::numeric_limits<Int>::min());
  constexpr double hi = static_cast<double>(std::numeric_limits<Int>::max());
  return static_cast<Int>(std::clamp(std::nearbyint(counts), lo, hi));
}

/// Piecewise-linear torsion spring: torque, energy and deflection, odd about zero.
struct Spring {
  explicit Spring(const SpringDescription& d) : k(d.stiffness_nm_rad), damping(d.damping_nm_s_rad) {
    torque_at = d.break_nm;
    bend = {torque_at[0] / k[0], torque_at[0] / k[0] + (torque_at[1] - torque_at[0]) / k[1]};
  }
  [[nodiscard]] double torque(double deflection) const noexcept {
    const double x = std::abs(deflection);
    const double t = x <= bend[0]   ? k[0] * x
                     : x <= bend[1] ? torque_at[0] + k[1] * (x - bend[0])
                                    : torque_at[1] + k[2] * (x - bend[1]);
    return std::copysign(t, deflection);
  }
  [[nodiscard]] double energy(double deflection) const noexcept {
    const double x = std::abs(deflection);
    const double x1 = std::min(x, bend[0]);
    const double x2 = std::clamp(x - bend[0], 0.0, bend[1] - bend[0]);
    const double x3 = std::max(x - bend[1], 0.0);
    return 0.5 * k[0] * x1 * x1 + x2 * (torque_at[0] + 0.5 * k[1] * x2) + x3 * (torque_at[1] + 0.5 * k[2] * x3);
  }
  [[nodiscard]] double deflection(double torque) const noexcept {
    const double t = std::abs(torque);
    const double x = t <= torque_at[0]   ? t / k[0]
                     : t <= torque_at[1] ? bend[0] + (t - torque_at[0]) / k[1]
                                         : bend[1] + (t - torque_at[1]) / k[2];
    return std::copysign(x, torque);
  }
  std::array<double, 3> k;
  std::array<double, 2> torque_at{};
  std::array<double, 2> bend{};
  double damping;
};

/// What never changes after construction, gathered for the inner loop.
struct JointConstants {
  explicit JointConstants(const JointDescription& joint, const JointTruth& truth, const PlantDescription& plant)
      : friction(truth.friction), spring(truth.spring), inertia(joint.reflected_inertia_kg_m2()) {
    const double gear = joint.transmission.gear_ratio;
    torque_per_ampere = {gear * truth.drive.torque_constant_nm_a[0], gear * truth.drive.torque_constant_nm_a[1]};
    ripple_per_rad = 2.0 * gear;
    current_rate = kTwoPi * truth.drive.current_bandwidth_hz;
    sensor_rate = kTwoPi * truth.sensor.torque_bandwidth_hz;
    peak_current = joint.motor.peak_current_a;
    ampere_per_count = joint.sensors.current_full_scale_a / kFullScale;
    ambient = truth.drive.ambient_c;
    thermal_rate = joint.motor.thermal_time_constant_s > 0.0 ? 1.0 / joint.motor.thermal_time_constant_s : 0.0;
    // The continuous current is the one that ends at the highest winding temperature.
    const double continuous = joint.motor.continuous_current_a;
    rise_per_a2 =
        continuous > 0.0 ? (joint.motor.max_winding_temperature_c - ambient) / (continuous * continuous) : 0.0;
    stop_low = joint.limits.lower_rad - plant.stop_margin_rad;
    stop_high = joint.limits.upper_rad + plant.stop_margin_rad;
    brake_torque = truth.drive.brake_torque_nm;
    brake_release = seconds(truth.drive.brake_release_s);
    brake_engage = seconds(truth.drive.brake_engage_s);
    // Power lost = power made: the motor as a generator, joint side.
    const double shorted = truth.drive.short_resistance_ohm;
    const double weaker = std::min(torque_per_ampere[0], torque_per_ampere[1]);
    short_damping = shorted > 0.0 ? weaker * weaker / shorted : 0.0;
  }
  LugreFriction friction;
  Spring spring;
  double inertia;
  std::array<double, 2> torque_per_ampere{};
  double ripple_per_rad;
  double current_rate;
  double sensor_rate;
  double peak_current;
  double ampere_per_count;
  double ambient;
  double thermal_rate;
  double rise_per_a2;
  double stop_low;
  double stop_high;
  double brake_torque;
  Duration brake_release;
  Duration brake_engage;
  double short_damping = 0.0;  ///< Nm s/rad
};

struct JointState {
  fw::ActuatorCommand command;
  double bristle = 0.0;          // rad
  double ripple_phase = 0.0;     // rad
  double current = 0.0;          // A
  double winding = 0.0;          // degC
  double filtered_torque = 0.0;  // Nm, after the torque sensor's bandwidth
  double drift = 0.0;            // Nm
  Time drift_at;
  double brake_anchor = 0.0;  // motor position at which the brake's spring is slack
  bool brake_free = false;
  bool brake_wanted_free = false;
  Time brake_command_at;
  double external = 0.0;
  std::int64_t index_turn = 0;  // motor turns at the last sample
  // As of the last substep, for truth() and the contact's record.
  double transmission = 0.0;
  double friction = 0.0;
  double motor = 0.0;
  double brake = 0.0;
};

/// Factors exp(-rate h) of the current loops and torque filters; substeps are nearly always of one length.
struct Decay {
  double h = -1.0;
  PerJoint current{};
  PerJoint sensor{};
};

}  // namespace

struct Plant::World {
  RobotDescription robot;
  PlantDescription plant;
  Multibody body;
  std::vector<JointConstants> constants;
  std::uint64_t seed;
  double nail_height_error = 0.0;
  Vector3d nail_base;  // where it enters the board
  Vector3d normal;
  double face_radius = 0.0;
  std::size_t n;

  Time now;
  PerJoint q{};  // links
  PerJoint v{};
  PerJoint a{};   // of the last substep
  PerJoint qm{};  // motors, joint side
  PerJoint vm{};
  PerJoint am{};
  std::array<JointState, kMaxJoints> joints;
  std::vector<Random> noise;
  double nail_height = 0.0;
  double nail_velocity = 0.0;
  bool over_head = false;  // the face was last seen above the head and covers it: only then can it strike it
  double force_nail = 0.0;
  double force_board = 0.0;
  bool board_struck = false;  // in this substep
  EnergyTerms work;
  ContactRecords contacts;
  std::uint64_t contact_count = 0;
  double contact_start_height = 0.0;
  Decay decay;

  World(RobotDescription r, PlantDescription p, std::uint64_t s)
      : robot(std::move(r)), plant(std::move(p)), body(robot, plant.rotor_coupling), seed(s), n(robot.joints.size()) {
    for (std::size_t i = 0; i < n; ++i) constants.emplace_back(robot.joints[i], plant.joints[i], plant);
    normal = robot.task.normal.normalized();
    nail_base = robot.task.nail_position_m;
    face_radius = robot.hammer.face_radius_m;
  }

  void substep(double h, Duration dt) noexcept;
  void update_brakes() noexcept;
  [[nodiscard]] double face_force(double depth, double speed, double stiffness, double damping) const noexcept {
    return std::max(0.0, stiffness * depth * (1.0 + damping * speed));
  }
  /// Sets the forces; returns where they act.
  Vector3d touch(const ArmPose& pose, const PerJoint& speed) noexcept;
  void record(const ArmPose& pose, const PerJoint& mean_speed, double h, Duration dt) noexcept;
  void head_geometry(const ArmPose& pose, double& gap, double& lateral, double& cosine) const noexcept;
};

void Plant::World::head_geometry(const ArmPose& pose, double& gap, double& lateral, double& cosine) const noexcept {
  const Vector3d to_face = pose.face - (nail_base + nail_height * normal);
  lateral = (to_face - normal * normal.dot(to_face)).norm();
  cosine = -normal.dot(pose.face_axis);
  // The face's plane, above the head's centre.
  gap = cosine > 0.1 ? -to_face.dot(pose.face_axis) / cosine : to_face.dot(normal);
}

Vector3d Plant::World::touch(const ArmPose& pose, const PerJoint& speed) noexcept {
  Vector3d point = pose.face;
  force_nail = force_board = 0.0;
  board_struck = false;
  nail_velocity = 0.0;

  double gap = 0.0;
  double lateral = 0.0;
  double cosine = 0.0;  // of the tilt
  head_geometry(pose, gap, lateral, cosine);
  const bool facing = cosine > 0.5;
  if (!facing || !(lateral <= face_radius)) {
    over_head = false;  // beside the nail: coming in from the side below its head is no blow
  } else if (gap >= 0.0) {
    over_head = true;
  } else if (over_head) {
    point = nail_base + (nail_height + gap) * normal;
    const double in_speed = -normal.dot(body.point_velocity(pose, speed, point));
    const BoardDescription& board = plant.board;
    const double k = plant.face.stiffness_n_m;
    const double c = plant.face.damping_s_m;
    const double depth = -gap;
    const double driven = board.nail_length_m - nail_height;
    const double resistance = board.nail_resistance_n + board.nail_resistance_slope_n_m * driven;
    force_nail = face_force(depth, in_speed, k, c);
    if (force_nail > resistance && nail_height > 0.0) {
      // F = k d (1 + c (in_speed - d_nail')) and d_nail' = (F - R) / c_v, solved for F; it stays above R.
      const double share = k * depth * c / board.nail_damping_n_s_m;
      force_nail = (k * depth * (1.0 + c * in_speed) + share * resistance) / (1.0 + share);
      nail_velocity = (force_nail - resistance) / board.nail_damping_n_s_m;
    }
  }

  // The rubber is one spring, and the nail stands higher than the board: while it is under the face, the board is not
  // touched. Its head flush, the nail cannot give way any more and it is the board that is struck through it.
  if (force_nail > 0.0) {
    board_struck = !(nail_height > 0.0);
    return point;
  }
  // The face's lowest rim point against the bare board; the point wanders to the centre as the tilt goes to zero.
  Vector3d downhill = -normal + normal.dot(pose.face_axis) * pose.face_axis;
  const double sine = downhill.norm();
  if (sine > 0.0) downhill *= face_radius * std::min(1.0, sine / 0.05) / sine;
  const Vector3d lowest = pose.face + downhill;
  const Vector3d from_nail = lowest - nail_base;
  const double board_depth = -normal.dot(from_nail);
  const bool on_head = over_head && gap < 0.0;
  if (!on_head && board_depth > 0.0 && facing &&
      (from_nail + board_depth * normal).norm() <= plant.board.half_width_m) {
    point = lowest;
    const double in_speed = -normal.dot(body.point_velocity(pose, speed, lowest));
    force_board = face_force(board_depth, in_speed, plant.board.surface_stiffness_n_m, plant.board.surface_damping_s_m);
    board_struck = force_board > 0.0;
  }
  return point;
}

void Plant::World::update_brakes() noexcept {
  for (std::size_t i = 0; i < n; ++i) {
    JointState& joint = joints[i];
    if (joint.brake_free == joint.brake_wanted_free) continue;
    const JointConstants& constant = constants[i];
    const Duration wait = joint.brake_wanted_free ? constant.brake_release : constant.brake_engage;
    if (now - joint.brake_command_at < wait) continue;
    joint.brake_free = joint.brake_wanted_free;
    joint.brake_anchor = qm[i];
  }
}

// One step of length h: half a drift of the positions, all forces there, a kick of the velocities, half a drift.
// Second order. Springs, contact and gravity are explicit (symplectic); damping, viscous friction and bristles, which
// would ask for smaller steps, are linear in the mean velocity of the step and solved for together with it.
void Plant::World::substep(double h, Duration dt) noexcept {
  update_brakes();
  if (h != decay.h) {
    decay.h = h;
    for (std::size_t i = 0; i < n; ++i) {
      decay.current[i] = std::exp(-h * constants[i].current_rate);
      decay.sensor[i] = std::exp(-h * constants[i].sensor_rate);
    }
  }
  const double half = 0.5 * h;

  PerJoint v_mid;  // predicted for the middle of the step, for what is not linear in it
  PerJoint vm_mid;
  for (std::size_t i = 0; i < n; ++i) {
    q[i] += half * v[i];
    qm[i] += half * vm[i];
    v_mid[i] = v[i] + half * a[i];
    vm_mid[i] = vm[i] + half * am[i];
  }
  nail_height = std::max(0.0, nail_height - half * nail_velocity);

  ArmPose pose;
  body.place(q, pose);
  SquareMatrix m;
  SquareMatrix s;
  BiasTorque bias;
  body.mass_matrix(pose, m);
  body.coupling(pose, s);
  body.bias(pose, v_mid, vm_mid, bias);

  PerJoint contact{};
  const Vector3d point = touch(pose, v_mid);
  const double force = force_nail + force_board;
  if (force > 0.0) body.add_force(pose, point, force * normal, contact);

  PerJoint link_push;  // h times torque
  PerJoint motor_push;
  PerJoint motor_mass;  // B + what is linear in the mean velocity
  PerJoint spring_torque;
  PerJoint stop;
  PerJoint friction_fixed;  // tau_f = fixed + slope * mean velocity
  PerJoint friction_slope;
  PerJoint brake_fixed;
  PerJoint brake_slope;
  for (std::size_t i = 0; i < n; ++i) {
    const JointConstants& constant = constants[i];
    JointState& joint = joints[i];

    // Current loop, first order; torque from the mean current of the step.
    const double wanted = joint.command.power_stage_enabled
                              ? std::clamp(constant.ampere_per_count * static_cast<double>(joint.command.current_duty),
                                           -constant.peak_current, constant.peak_current)
                              : 0.0;
    const double current_before = joint.current;
    joint.current = wanted + (current_before - wanted) * decay.current[i];
    const double current = 0.5 * (current_before + joint.current);
    joint.motor = current * constant.torque_per_ampere[current >= 0.0 ? 0 : 1];
    joint.winding +=
        h * constant.thermal_rate * (constant.rise_per_a2 * current * current - (joint.winding - constant.ambient));

    // LuGre: the bristle's decay is implicit, so that a fast motor needs no smaller step.
    const LugreFriction& f = constant.friction;
    friction_fixed[i] = 0.0;
    friction_slope[i] = f.viscous_nm_s_rad;
    if (f.bristle_stiffness_nm_rad > 0.0) {
      const double speed = vm_mid[i];
      const std::size_t way = speed >= 0.0 ? 0 : 1;
      const double stribeck = std::exp(-f.stribeck_decay_s2_rad2 * speed * speed);
      double level = f.coulomb_nm[way] + (f.static_nm[way] - f.coulomb_nm[way]) * stribeck;
      if (f.ripple > 0.0) level *= 1.0 + f.ripple * std::sin(constant.ripple_per_rad * qm[i] + joint.ripple_phase);
      const double rate = f.bristle_stiffness_nm_rad * std::abs(speed) / level;
      const double keep = 1.0 / (1.0 + h * rate);
      const double damping = f.bristle_damping_nm_s_rad * stribeck;
      friction_fixed[i] = joint.bristle * (0.5 * f.bristle_stiffness_nm_rad * (1.0 + keep) - damping * rate * keep);
      friction_slope[i] += keep * (half * f.bristle_stiffness_nm_rad + damping);
      joint.bristle *= keep;  // the part from the velocity is added below
      vm_mid[i] = keep;       // reused for it
    }

    brake_fixed[i] = brake_slope[i] = 0.0;
    if (!joint.brake_free) {
      // Beyond its torque it slips: the spring's slack end follows, and there is nothing but that torque.
      const double give = constant.brake_torque / kBrakeStiffness;
      const double twist = qm[i] - joint.brake_anchor;
      const bool slips = !(std::abs(twist) < give);
      if (slips) joint.brake_anchor = qm[i] - std::copysign(give, twist);
      brake_fixed[i] = kBrakeStiffness * (qm[i] - joint.brake_anchor);
      brake_slope[i] = slips ? 0.0 : kBrakeDamping;
    } else if (!joint.command.power_stage_enabled && !joint.brake_wanted_free) {
      // The brake's line also opens the relay that shorts the windings: they slow the joint until the brake grips.
      brake_slope[i] = constant.short_damping;
    }

    stop[i] = 0.0;
    if (q[i] > constant.stop_high) {
      stop[i] = std::min(
          0.0, -plant.stop_stiffness_nm_rad * (q[i] - constant.stop_high) - plant.stop_damping_nm_s_rad * v_mid[i]);
    } else if (q[i] < constant.stop_low) {
      stop[i] = std::max(
          0.0, plant.stop_stiffness_nm_rad * (constant.stop_low - q[i]) - plant.stop_damping_nm_s_rad * v_mid[i]);
    }

    const double d = constant.spring.damping;
    spring_torque[i] = constant.spring.torque(qm[i] - q[i]);
    const double transmission = spring_torque[i] + d * (vm[i] - v[i]);
    link_push[i] = h * (transmission - bias.link[i] + contact[i] + stop[i] + joint.external);
    motor_push[i] = h * (joint.motor - transmission - bias.motor[i] - friction_fixed[i] - brake_fixed[i] -
                         (friction_slope[i] + brake_slope[i]) * vm[i]);
    motor_mass[i] = constant.inertia + half * (d + friction_slope[i] + brake_slope[i]);
    m[i][i] += half * d;
    s[i][i] -= half * d;
  }

  // [M S; S^T B] (dv, dvm) = (link_push, motor_push): B is diagonal, so the rotors are eliminated first.
  PerJoint dv{};
  std::copy_n(link_push.begin(), n, dv.begin());
  for (std::size_t i = 0; i < n; ++i) {  // column i of S: links 0 .. i
    const double weight = 1.0 / motor_mass[i];
    for (std::size_t j = 0; j <= i; ++j) {
      const double scaled = s[j][i] * weight;
      dv[j] -= scaled * motor_push[i];
      for (std::size_t k = 0; k <= j; ++k) m[j][k] -= scaled * s[k][i];
    }
  }
  solve_spd(static_cast<int>(n), m, dv);

  PerJoint mean{};
  const double per_h = h > 0.0 ? 1.0 / h : 0.0;
  for (std::size_t i = 0; i < n; ++i) {
    double push = motor_push[i];
    for (std::size_t j = 0; j <= i; ++j) push -= s[j][i] * dv[j];
    const double dvm = push / motor_mass[i];
    mean[i] = v[i] + 0.5 * dv[i];
    const double motor_mean = vm[i] + 0.5 * dvm;
    v[i] += dv[i];
    vm[i] += dvm;
    if (h > 0.0) {
      a[i] = per_h * dv[i];
      am[i] = per_h * dvm;
    }
    q[i] += half * v[i];
    qm[i] += half * vm[i];

    JointState& joint = joints[i];
    const JointConstants& constant = constants[i];
    const double twist_speed = motor_mean - mean[i];
    joint.transmission = spring_torque[i] + constant.spring.damping * twist_speed;
    joint.friction = friction_fixed[i] + friction_slope[i] * motor_mean;
    joint.brake = brake_fixed[i] + brake_slope[i] * motor_mean;
    if (constant.friction.bristle_stiffness_nm_rad > 0.0) joint.bristle += vm_mid[i] * h * motor_mean;
    joint.filtered_torque = joint.transmission + (joint.filtered_torque - joint.transmission) * decay.sensor[i];

    work.motor_work_j += h * joint.motor * motor_mean;
    work.friction_work_j += h * joint.friction * motor_mean;
    work.damping_work_j += h * constant.spring.damping * twist_speed * twist_speed;
    work.brake_work_j += h * joint.brake * motor_mean;
    work.stop_work_j -= h * stop[i] * mean[i];
    work.contact_work_j += h * contact[i] * mean[i];
    work.external_work_j += h * joint.external * mean[i];
  }
  work.nail_work_j += h * force_nail * nail_velocity;
  nail_height = std::max(0.0, nail_height - half * nail_velocity);
  now += dt;
  record(pose, mean, h, dt);
}

void Plant::World::record(const ArmPose& pose, const PerJoint& mean_speed, double h, Duration dt) noexcept {
  const double force = force_nail + force_board;
  const bool open = !contacts.empty() && contacts.back().open;
  if (!(force > 0.0)) {
    if (open && now - contacts.back().end > kContactMergeGap) contacts.back().open = false;
    return;
  }
  if (!open) {
    if (!contacts.push_back({})) contacts.back() = {};
    ++contact_count;
    ContactRecord& fresh = contacts.back();
    fresh.open = true;
    fresh.start = now - dt;
    fresh.speed_at_start_m_s = -normal.dot(body.point_velocity(pose, mean_speed, pose.face));
    double gap = 0.0;
    double cosine = 0.0;
    head_geometry(pose, gap, fresh.lateral_m, cosine);
    fresh.tilt_rad = tilt_of(cosine);
    contact_start_height = nail_height + h * nail_velocity;
    for (std::size_t i = 0; i < n; ++i) {
      fresh.transmission_before_nm[i] = joints[i].transmission;
      fresh.link_velocity_before_rad_s[i] = v[i];
      fresh.motor_velocity_before_rad_s[i] = vm[i];
    }
  }
  ContactRecord& blow = contacts.back();
  blow.end = now;
  blow.board_struck = blow.board_struck || board_struck;
  blow.impulse_n_s += h * force;
  blow.peak_force_n = std::max(blow.peak_force_n, force);
  blow.penetration_m = contact_start_height - nail_height;
  blow.speed_at_end_m_s = -normal.dot(body.point_velocity(pose, mean_speed, pose.face));
  for (std::size_t i = 0; i < n; ++i) {
    const double torque = joints[i].transmission;
    blow.peak_transmission_torque_nm[i] = std::max(blow.peak_transmission_torque_nm[i], std::abs(torque));
    blow.transmission_impulse_nm_s[i] += h * (torque - blow.transmission_before_nm[i]);
    blow.link_velocity_after_rad_s[i] = v[i];
    blow.motor_velocity_after_rad_s[i] = vm[i];
  }
}

namespace {

void check(const RobotDescription& robot, const PlantDescription& plant) {
  if (robot.joints.empty() || robot.dof() > kMaxJoints) {
    throw DescriptionError("The emulator needs 1 to " + std::to_string(kMaxJoints) + " joints, the robot has " +
                           std::to_string(robot.dof()) + ".");
  }
  if (plant.joints.size() != robot.joints.size()) {
    throw DescriptionError("The plant describes " + std::to_string(plant.joints.size()) + " joints, the robot " +
                           robot.name + " has " + std::to_string(robot.dof()) + ".");
  }
  for (std::size_t i = 0; i < robot.joints.size(); ++i) {
    const JointDescription& joint = robot.joints[i];
    const JointTruth& truth = plant.joints[i];
    if (!(joint.reflected_inertia_kg_m2() > 0.0)) {
      throw DescriptionError("Joint " + joint.name + ": the emulator needs a rotor inertia above 0.");
    }
    const auto& k = truth.spring.stiffness_nm_rad;
    if (!(k[0] > 0.0 && k[1] > 0.0 && k[2] > 0.0 && truth.spring.break_nm[0] > 0.0 &&
          truth.spring.break_nm[1] >= truth.spring.break_nm[0])) {
      throw DescriptionError("Joint " + joint.name +
                             ": the transmission needs stiffnesses above 0 and ordered break torques.");
    }
    const LugreFriction& f = truth.friction;
    for (std::size_t way = 0; way < 2; ++way) {
      if (f.bristle_stiffness_nm_rad > 0.0 && !(f.coulomb_nm[way] > 0.0 && f.static_nm[way] >= f.coulomb_nm[way])) {
        throw DescriptionError("Joint " + joint.name + ": bristle friction needs 0 < Coulomb <= static friction.");
      }
    }
  }
}

/// Draws what the descriptions only know roughly. The order of the draws is part of what a seed means.
void perturb(RobotDescription& robot, PlantDescription& plant, Random& random, double& nail_height_error) {
  const PerturbationDescription& range = plant.perturbation;
  const auto factor = [&](double share) { return 1.0 + random.uniform(-share, share); };
  for (std::size_t i = 0; i < robot.joints.size(); ++i) {
    JointTruth& joint = plant.joints[i];
    const double dry = factor(range.friction_share);
    for (std::size_t way = 0; way < 2; ++way) {
      joint.friction.coulomb_nm[way] *= dry;
      joint.friction.static_nm[way] *= dry;
      joint.drive.torque_constant_nm_a[way] *= factor(range.torque_constant_share);
    }
    joint.friction.viscous_nm_s_rad *= factor(range.friction_share);
    const double spring = factor(range.spring_share);
    for (double& k : joint.spring.stiffness_nm_rad) k *= spring;
    joint.sensor.torque_offset_nm += random.uniform(-range.torque_offset_nm, range.torque_offset_nm);
    joint.sensor.torque_gain_error += random.uniform(-range.torque_gain_share, range.torque_gain_share);
    joint.sensor.current_offset_a += random.uniform(-range.current_offset_a, range.current_offset_a);
    joint.sensor.encoder_offset_rad += random.uniform(-range.encoder_offset_rad, range.encoder_offset_rad);
    joint.sensor.home_switch_offset_rad += random.uniform(-range.home_switch_offset_rad, range.home_switch_offset_rad);
    const double mass = factor(range.link_mass_share);
    robot.joints[i].link.mass_kg *= mass;
    robot.joints[i].link.inertia_kg_m2 *= mass;
  }
  const double resistance = factor(range.resistance_share);
  plant.board.nail_resistance_n *= resistance;
  plant.board.nail_resistance_slope_n_m *= resistance;
  plant.board.nail_damping_n_s_m *= resistance;
  nail_height_error = random.uniform(-range.nail_height_m, range.nail_height_m);
  const Vector3d normal = robot.task.normal.normalized();
  const Vector3d across = normal.unitOrthogonal();
  robot.task.nail_position_m += random.uniform(-range.nail_lateral_m, range.nail_lateral_m) * across +
                                random.uniform(-range.nail_lateral_m, range.nail_lateral_m) * normal.cross(across);
}

}  // namespace

Plant::Plant(const RobotDescription& robot, const PlantDescription& description, std::uint64_t seed) {
  check(robot, description);
  RobotDescription actual_robot = robot;
  PlantDescription actual = description;
  Random random(seed, 1);
  double nail_height_error = 0.0;
  if (seed != 0) perturb(actual_robot, actual, random, nail_height_error);
  world_ = std::make_unique<World>(std::move(actual_robot), std::move(actual), seed);
  world_->nail_height_error = nail_height_error;
  for (std::size_t i = 0; i < world_->n; ++i) {
    world_->joints[i].ripple_phase = seed == 0 ? 0.0 : random.uniform(0.0, kTwoPi);
  }
  const PerJoint zero{};
  reset(std::span(zero).first(world_->n), robot.task.nail_height_m);
}

Plant::~Plant() = default;
Plant::Plant(Plant&&) noexcept = default;
Plant& Plant::operator=(Plant&&) noexcept = default;

void Plant::reset(std::span<const double> link_position_rad, double nail_height_m) {
  World& w = *world_;
  if (link_position_rad.size() != w.n) {
    throw DescriptionError("The emulator was given " + std::to_string(link_position_rad.size()) +
                           " joint positions for " + std::to_string(w.n) + " joints.");
  }
  w.now = {};
  w.work = {};
  w.contacts.clear();
  w.contact_count = 0;
  w.nail_velocity = w.force_nail = w.force_board = 0.0;
  w.over_head = false;
  w.nail_height = std::clamp(nail_height_m + w.nail_height_error, 0.0, w.plant.board.nail_length_m);
  w.q = w.v = w.a = w.qm = w.vm = w.am = {};
  std::copy(link_position_rad.begin(), link_position_rad.end(), w.q.begin());

  // At rest: springs carry gravity, brakes carry the springs.
  ArmPose pose;
  w.body.place(w.q, pose);
  BiasTorque gravity;
  w.body.bias(pose, w.v, w.vm, gravity);
  w.noise.clear();
  for (std::size_t i = 0; i < w.n; ++i) {
    const JointConstants& constant = w.constants[i];
    JointState fresh;
    fresh.ripple_phase = w.joints[i].ripple_phase;
    fresh.winding = constant.ambient;
    fresh.transmission = fresh.filtered_torque = gravity.link[i];
    w.qm[i] = w.q[i] + constant.spring.deflection(gravity.link[i]);
    const double held = std::clamp(-gravity.link[i], -constant.brake_torque, constant.brake_torque);
    fresh.brake = held;
    fresh.brake_anchor = w.qm[i] - held / kBrakeStiffness;
    fresh.index_turn = static_cast<std::int64_t>(std::floor(w.qm[i] * 0.5 * constant.ripple_per_rad / kTwoPi));
    w.noise.emplace_back(w.seed, 16 + i);
    fresh.drift = w.plant.joints[i].sensor.torque_drift_nm * (w.seed == 0 ? 0.0 : w.noise[i].normal());
    w.joints[i] = fresh;
  }
}

void Plant::step(Duration dt) noexcept {
  if (!(dt.ns > 0)) return;
  const std::int64_t count = (dt.ns + kPlantSubstep.ns - 1) / kPlantSubstep.ns;
  const Duration each = dt / count;
  const double h = dt.seconds() / static_cast<double>(count);
  for (std::int64_t k = 0; k + 1 < count; ++k) world_->substep(h, each);
  world_->substep(h, dt - each * (count - 1));  // integer nanoseconds add up exactly
}

void Plant::set_actuator(int joint, const fw::ActuatorCommand& command) noexcept {
  JointState& state = world_->joints[at(joint)];
  state.command = command;
  if (command.brake_release != state.brake_wanted_free) {
    state.brake_wanted_free = command.brake_release;
    state.brake_command_at = world_->now;
  }
}

void Plant::set_external_torque(int joint, double torque_nm) noexcept {
  world_->joints[at(joint)].external = torque_nm;
}

fw::RawSensors Plant::sample(int joint) noexcept {
  World& w = *world_;
  const std::size_t i = at(joint);
  const JointDescription& description = w.robot.joints[i];
  const SensorsDescription& scale = description.sensors;
  const SensorTruth& sensor = w.plant.joints[i].sensor;
  const DriveTruth& drive = w.plant.joints[i].drive;
  JointState& state = w.joints[i];
  Random& noise = w.noise[i];

  fw::RawSensors raw;
  raw.fresh = fw::kFreshEncoder | fw::kFreshCurrent | fw::kFreshTemperature | fw::kFreshBusVoltage;
  const double turns = (w.qm[i] + sensor.encoder_offset_rad) * description.transmission.gear_ratio / kTwoPi;
  raw.encoder_count = static_cast<std::int32_t>(
      std::clamp(std::floor(turns * static_cast<double>(scale.encoder_counts_per_turn)), -2147483648.0, 2147483647.0));

  if (scale.torque_sensor) {
    const double elapsed = (w.now - state.drift_at).seconds();
    if (elapsed > 0.0 && sensor.torque_drift_time_s > 0.0) {
      // Ornstein-Uhlenbeck: a wander with a standard deviation and a correlation time.
      const double keep = std::exp(-elapsed / sensor.torque_drift_time_s);
      state.drift = state.drift * keep + sensor.torque_drift_nm * std::sqrt(1.0 - keep * keep) * noise.normal();
      state.drift_at = w.now;
    }
    const double torque = (1.0 + sensor.torque_gain_error) * state.filtered_torque + sensor.torque_offset_nm +
                          state.drift + sensor.torque_noise_nm * noise.normal();
    raw.torque_adc = quantise<std::int16_t>(torque / scale.torque_full_scale_nm * kFullScale);
    raw.fresh |= fw::kFreshTorque;
  }
  const double current = state.current + sensor.current_offset_a + sensor.current_noise_a * noise.normal();
  raw.current_adc = quantise<std::int16_t>(current / scale.current_full_scale_a * kFullScale);
  raw.winding_temperature_adc = quantise<std::int16_t>(10.0 * state.winding);
  // The stage heats with its current too, far less than the winding.
  raw.drive_temperature_adc =
      quantise<std::int16_t>(10.0 * (drive.ambient_c + 0.2 * (state.winding - drive.ambient_c)));
  raw.bus_voltage_adc =
      quantise<std::uint16_t>(100.0 * (drive.bus_voltage_v - drive.supply_resistance_ohm * std::abs(state.current)));

  const JointLimits& limits = description.limits;
  if (w.q[i] < limits.lower_rad - sensor.limit_switch_margin_rad) raw.inputs |= fw::kInputNegativeLimit;
  if (w.q[i] > limits.upper_rad + sensor.limit_switch_margin_rad) raw.inputs |= fw::kInputPositiveLimit;
  const double edge = description.homing.switch_position_rad + sensor.home_switch_offset_rad;
  const bool homed = description.homing.direction < 0 ? w.q[i] <= edge : w.q[i] >= edge;
  if (homed) raw.inputs |= fw::kInputHomeSwitch;
  const auto turn = static_cast<std::int64_t>(std::floor(turns));
  if (turn != state.index_turn) raw.inputs |= fw::kInputIndexPulse;
  state.index_turn = turn;
  if (state.brake_free) raw.inputs |= fw::kInputBrakeReleased;
  return raw;
}

PlantTruth Plant::truth() const noexcept {
  const World& w = *world_;
  PlantTruth result;
  result.now = w.now;
  result.dof = static_cast<int>(w.n);
  result.link_position_rad = w.q;
  result.link_velocity_rad_s = w.v;
  result.motor_position_rad = w.qm;
  result.motor_velocity_rad_s = w.vm;
  ArmPose pose;
  w.body.place(w.q, pose);
  result.energy = w.work;
  for (std::size_t i = 0; i < w.n; ++i) {
    const JointState& joint = w.joints[i];
    result.transmission_torque_nm[i] = joint.transmission;
    result.friction_torque_nm[i] = joint.friction;
    result.motor_torque_nm[i] = joint.motor;
    result.current_a[i] = joint.current;
    result.winding_temperature_c[i] = joint.winding;
    result.brake_torque_nm[i] = joint.brake_free ? 0.0 : joint.brake;
    result.brake_released[i] = joint.brake_free;
    result.energy.spring_j += w.constants[i].spring.energy(w.qm[i] - w.q[i]);
  }
  result.energy.kinetic_j = w.body.kinetic_energy(pose, w.v, w.vm);
  result.energy.gravity_j = w.body.gravity_energy(pose);
  result.face_position_m = pose.face;
  result.face_velocity_m_s = w.body.point_velocity(pose, w.v, pose.face);
  double cosine = 0.0;
  w.head_geometry(pose, result.face_gap_m, result.face_lateral_m, cosine);
  result.face_tilt_rad = tilt_of(cosine);
  result.nail_force_n = w.force_nail;
  result.contact_force_n = w.force_nail + w.force_board;
  result.contact = result.contact_force_n > 0.0;
  result.nail_height_m = w.nail_height;
  result.nail_velocity_m_s = w.nail_velocity;
  return result;
}

Time Plant::now() const noexcept { return world_->now; }
int Plant::dof() const noexcept { return static_cast<int>(world_->n); }
const ContactRecords& Plant::contacts() const noexcept { return world_->contacts; }
std::uint64_t Plant::contact_count() const noexcept { return world_->contact_count; }
const RobotDescription& Plant::actual_robot() const noexcept { return world_->robot; }
const PlantDescription& Plant::actual_description() const noexcept { return world_->plant; }

}  // namespace mrr::sim
