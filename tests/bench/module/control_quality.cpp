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
  const double end = b.seconds_now() + hold_s;
  b.each_tick = [&](const ModuleStatus& s) {
    low = std::min(low, b.joint.motor_q());
    high = std::max(high, b.joint.motor_q());
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
  return result;
}

}  // namespace mrr::fw::test
