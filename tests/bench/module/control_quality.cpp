#include "tests/bench/module/control_quality.h"

#include <fmt/format.h>

#include <algorithm>
#include <limits>

#include "supervisor/model/chain.h"

namespace mrr::fw::test {

namespace {

/// A(1 - cos wt), or rest-to-rest quintics to and fro, from where the joint stands.
MotionState point(const QualityCase& c, double from, double t) {
  const Path path = c.path;
  const auto state = [](double q, double v, double a) {
    return MotionState{static_cast<float>(q), static_cast<float>(v), static_cast<float>(a)};
  };
  if (t <= 0.0) return state(from, 0, 0);
  if (path == Path::swing) {  // the reference's: 0.594 rad in 0.57 s (the base joint is slower), and back
    constexpr double kTravel = 0.594;
    const double time_s = c.joint == 0 ? 0.8 : 0.57;
    constexpr double kPause = 0.2;
    const double phase = std::fmod(t, 2.0 * (time_s + kPause));
    const bool back = phase >= time_s + kPause;
    const double s = std::clamp((back ? phase - time_s - kPause : phase) / time_s, 0.0, 1.0);
    const double d = back ? -kTravel : kTravel;
    return state((back ? from + kTravel : from) + d * s * s * s * (10 - 15 * s + 6 * s * s),
                 d * 30 * s * s * (1 - 2 * s + s * s) / time_s,
                 d * 60 * s * (1 - 3 * s + 2 * s * s) / (time_s * time_s));
  }
  const double amplitude = path == Path::sine ? 0.3 : 0.05;
  const double w = 2.0 * M_PI * (path == Path::sine ? 0.5 : 0.1);
  return state(from + amplitude * (1.0 - std::cos(w * t)), amplitude * w * std::sin(w * t),
               amplitude * w * w * std::cos(w * t));
}

JointSetup setup_of(const QualityCase& c) {
  JointSetup s;
  s.joint = c.joint;
  s.seed = c.seed;
  s.module_robot = [c](RobotDescription& robot) {
    robot.bus.loop_rate_hz = c.loop_hz;
    ControlDescription& k = robot.joints[static_cast<std::size_t>(c.joint)].control;
    k.friction_feedforward = c.feedforward;
    robot.joints[static_cast<std::size_t>(c.joint)].sensors.torque_bandwidth_hz =
        c.believed_bandwidth_hz > 0.0 ? c.believed_bandwidth_hz : c.torque_bandwidth_hz;
    k.compensator.enabled = c.compensator;
  };
  s.plant = [c](RobotDescription& robot, sim::PlantDescription& plant) {
    for (JointDescription& j : robot.joints) {
      j.link.mass_kg *= c.link_inertia;
      j.link.inertia_kg_m2 *= c.link_inertia;
      j.motor.rotor_inertia_kg_m2 *= c.rotor_inertia;
    }
    sim::JointTruth& truth = plant.joints[static_cast<std::size_t>(c.joint)];
    for (double& x : truth.friction.coulomb_nm) x *= c.friction;
    for (double& x : truth.friction.static_nm) x *= c.friction;
    truth.friction.viscous_nm_s_rad *= c.friction;
    truth.sensor.torque_bandwidth_hz = c.torque_bandwidth_hz;
  };
  return s;
}

/// Enabled and following where it stands, the model torque streamed as a supervisor does.
bool prepare(PlantBench& b, const QualityCase& c) {
  auto chain = std::make_shared<sup::Chain>(hammer_robot());
  const std::vector<double> pose = setup_of(c).pose_rad;
  b.model_torque_nm = [chain, pose, c](const MotionState& m) {
    sup::JointVector q = Eigen::Map<const Eigen::VectorXd>(pose.data(), static_cast<Eigen::Index>(pose.size()));
    sup::JointVector qd = sup::JointVector::Zero(q.size());
    sup::JointVector qdd = qd;
    q[c.joint] = double{m.position_rad};
    qd[c.joint] = double{m.velocity_rad_s};
    qdd[c.joint] = double{m.acceleration_rad_s2};
    return (1.0 + c.model_error) * chain->inverse_dynamics(q, qd, qdd)[c.joint];
  };
  return b.enable() && b.follow_here();
}

}  // namespace

Tracking track(const QualityCase& c, double seconds) {
  PlantBench b(setup_of(c));
  Tracking result;
  if (!prepare(b, c)) {
    result.note = fmt::format("not enabled: state {}, fault {:04X}h", static_cast<int>(b.status().state),
                              static_cast<int>(b.status().fault));
    return result;
  }
  const double from = double{b.trajectory(0.0).position_rad};
  const double start = b.seconds_now() + 0.1;
  b.trajectory = [=](double t) { return point(c, from, t - start); };
  b.spoil = [&](RawSensors& raw) {
    if (c.sensor_lost_at_s >= 0.0 && b.seconds_now() - start >= c.sensor_lost_at_s) {
      raw.fresh = static_cast<std::uint8_t>(raw.fresh & ~unsigned{kFreshTorque});
    }
  };
  double sum = 0.0;
  double steps = 0.0;
  float last = 0.0F;
  int n = 0;
  const double warm_up = c.sensor_lost_at_s >= 0.0 ? c.sensor_lost_at_s : 1.0;
  b.each_tick = [&](const ModuleStatus& s) {
    const double t = s.now.seconds() - start;
    if (t > warm_up) {
      const double error = b.joint.motor_q() - double{point(c, from, t).position_rad};
      sum += error * error;
      result.max_mrad = std::max(result.max_mrad, 1e3 * std::abs(error));
      const double step = double{s.torque_command_nm - last};
      steps += step * step;
      ++n;
    }
    last = s.torque_command_nm;
  };
  b.run(0.1 + seconds);
  result.completed = b.status().following_knots && b.status().fault == can::Emergency::none;
  if (!result.completed) {
    result.note =
        fmt::format("fault {:04X}h, limit {}", static_cast<int>(b.status().fault), static_cast<int>(b.status().limit));
  }
  result.limit = b.status().limit;
  result.rms_mrad = 1e3 * std::sqrt(sum / n);
  result.torque_rms_step_nm = std::sqrt(steps / n);
  return result;
}

Standing stand(const QualityCase& c, double hold_s) {
  PlantBench b(setup_of(c));
  Standing result;
  if (!prepare(b, c)) return result;
  const double from = double{b.trajectory(0.0).position_rad};
  const double start = b.seconds_now() + 0.1;
  b.trajectory = [=](double t) { return point(c, from, std::min(t - start, 1.0)); };
  // Half a period of the sine ends at rest.
  b.run(1.1);
  b.trajectory = [=](double) { return MotionState{static_cast<float>(from + 0.6), 0.0F, 0.0F}; };
  b.run(1.0);
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  double low = kInfinity, high = -kInfinity;
  double last_low = kInfinity, last_high = -kInfinity, torque_low = kInfinity, torque_high = -kInfinity;
  int ticks = 0;
  int swinging = 0;
  const double end = b.seconds_now() + hold_s;
  b.each_tick = [&](const ModuleStatus& s) {
    low = std::min(low, b.joint.motor_q());
    high = std::max(high, b.joint.motor_q());
    ++ticks;
    swinging += s.limit == can::LimitCode::torque_swings ? 1 : 0;
    if (s.now.seconds() < end - 10.0) return;
    last_low = std::min(last_low, b.joint.motor_q());
    last_high = std::max(last_high, b.joint.motor_q());
    torque_low = std::min(torque_low, double{s.torque_command_nm});
    torque_high = std::max(torque_high, double{s.torque_command_nm});
  };
  b.run(hold_s);
  result.completed = b.status().following_knots && b.status().fault == can::Emergency::none;
  result.peak_to_peak_mrad = 1e3 * (high - low);
  result.last_peak_to_peak_mrad = 1e3 * (last_high - last_low);
  result.last_torque_peak_to_peak_nm = torque_high - torque_low;
  result.said_to_swing = static_cast<double>(swinging) / ticks;
  return result;
}

namespace {

void select(PlantBench& b, bool active) {
  static std::uint8_t sequence = 0;
  sequence = static_cast<std::uint8_t>(sequence % 31U + 1U);
  b.select(can::SelectionAction::now, active, sequence);
  b.tick();
}

}  // namespace

double torque_to_turn(int joint, double direction, bool compensated, std::uint64_t seed) {
  JointSetup setup;
  setup.joint = joint;
  setup.seed = seed;
  setup.config = [&](ModuleConfig& m) {
    m.passive.max_time = milliseconds(100'000);
    if (!compensated) m.passive.compensation_nm = m.passive.static_compensation_nm = 0.0F;
  };
  PlantBench b(setup);
  constexpr double kNever = std::numeric_limits<double>::quiet_NaN();
  if (!b.enable() || !b.follow_here()) return kNever;
  b.run(0.1);
  select(b, false);
  const double from = b.joint.motor_q();
  constexpr double kRate_nm_s = 2.0;
  constexpr double kTurned_rad = 3e-3;
  for (double hand = 0.0; hand < 80.0; hand += kRate_nm_s * b.config.tick.seconds()) {
    b.joint.external_nm = direction * hand;
    b.tick();
    if (b.status().law != Law::passive) return kNever;
    if (direction * (b.joint.motor_q() - from) > kTurned_rad) return hand;
  }
  return kNever;
}

constexpr double kFarOut_rad = 1.5;  // of 2.4 and more

PassiveResult push_about(const PassiveCase& c, double seconds) {
  QualityCase q;
  q.joint = c.joint;
  q.friction = c.friction;
  q.feedforward = 1.0;
  JointSetup setup = setup_of(q);
  setup.config = [&](ModuleConfig& m) {
    m.passive.max_time = milliseconds(400);
    if (!c.compensated) m.passive.compensation_nm = m.passive.static_compensation_nm = 0.0F;
  };
  PassiveResult result;
  Random random(c.seed, 99);
  // Without gravity the hand is all that pushes. The torque sensor is as wrong as it may be.
  setup.plant = [&, inner = setup.plant](RobotDescription& r, sim::PlantDescription& p) {
    inner(r, p);
    r.gravity_m_s2.setZero();
    sim::JointTruth& truth = p.joints[static_cast<std::size_t>(c.joint)];
    // Against the identified one, not against what the example's plant has.
    const FrictionDescription& identified = r.joints[static_cast<std::size_t>(c.joint)].friction;
    for (double& x : truth.friction.coulomb_nm) x = c.friction * identified.coulomb_nm;
    for (double& x : truth.friction.static_nm) x = c.friction * identified.static_nm;
    truth.friction.viscous_nm_s_rad = c.friction * identified.viscous_nm_s_rad;
    truth.sensor.torque_offset_nm = random.uniform(-0.3, 0.3);
    truth.sensor.torque_gain_error = random.uniform(-0.02, 0.02);
    const double static_nm = std::max(truth.friction.static_nm[0], truth.friction.static_nm[1]);
    result.bristle_j = 0.5 * static_nm * static_nm / truth.friction.bristle_stiffness_nm_rad;
  };
  PlantBench b(setup);
  if (!b.enable()) {
    result.note = "not enabled";
    return result;
  }
  const double static_nm = double{b.config.friction.static_nm};
  const auto work = [&] { return b.joint.truth.energy.motor_work_j - b.joint.truth.energy.friction_work_j; };
  double passive_s = 0.0;
  while (passive_s < seconds) {
    b.joint.external_nm = 0.0;
    // Back to the middle now and then, by hand as it were: the joint holds where it is, the travel is bounded.
    if (!b.run_until([&] { return std::abs(b.joint.motor_v()) < 1e-3; }, 2.0) || !b.follow_here()) {
      result.note = fmt::format("not led again: fault {:04X}h, limit {}", static_cast<int>(b.status().fault),
                                static_cast<int>(b.status().limit));
      return result;
    }
    select(b, false);
    b.run(b.config.passive.blend.seconds());
    ++result.phases;
    const double start = work();
    const double from = b.joint.motor_q();
    double lowest = start;
    double next_change = 0.0;
    for (double t = 0.0; b.status().law == Law::passive && t < 0.5; t += b.config.tick.seconds()) {
      if (t >= next_change) {
        next_change = t + random.uniform(0.2, 1.8) * c.push_s;
        double share = random.uniform() < 0.25 ? 0.0 : random.uniform(-c.hand_share, c.hand_share);
        // Far out the hand pushes back only: a joint that leans on its limit switch is not led again.
        if (std::abs(b.joint.motor_q()) > kFarOut_rad) share = -std::copysign(share, b.joint.motor_q());
        b.joint.external_nm = share * static_nm;
      }
      b.tick();
      passive_s += b.config.tick.seconds();
      const double now = work();
      lowest = std::min(lowest, now);
      result.gained_j = std::max(result.gained_j, now - lowest);
      result.moved_rad = std::max(result.moved_rad, std::abs(b.joint.motor_q() - from));
    }
    result.net_j += work() - start;
    const auto& od = b.module.objects();
    result.observed_j = std::max(result.observed_j, double{od.passive_gained_j});
    if (b.status().limit == can::LimitCode::passivity_guard) ++result.guarded;
  }
  result.completed = b.status().fault == can::Emergency::none;
  return result;
}

}  // namespace mrr::fw::test
