#include "supervisor/strike/trajectory.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>

#include "supervisor/impact/external.h"

namespace mrr::sup {
namespace {

/// Below this speed a joint may stick: friction then acts against the drive, whichever way it pushes.
constexpr double kStickingRadS = 2e-3;
constexpr double kRounding = 1e-9;
/// Instants at which torques are looked at. A quintic has one shape however long it takes: between as many, what swings
/// once along it changes by a fifth of a percent.
constexpr std::int64_t kInstants = 48;
constexpr std::int64_t kGlances = 8;

QuinticState state_of(const JointMotion& motion, int joint) noexcept {
  return {motion.q[joint], motion.qd[joint], motion.qdd[joint]};
}

/// Keeps the check that exceeds its limit by the largest share.
class Worst {
 public:
  void enter(LimitKind kind, int joint, double value, double limit) noexcept {
    const double share = limit > 0.0 ? std::abs(value) / limit : std::numeric_limits<double>::infinity();
    if (share <= 1.0 + kRounding) return;
    keep(kind, joint, value, limit, share);
  }
  void enter_position(int joint, const Range& range, double lower, double upper) noexcept {
    if (!(range.low >= lower - kRounding)) keep(LimitKind::position, joint, range.low, lower, 2.0 + lower - range.low);
    if (!(range.high <= upper + kRounding))
      keep(LimitKind::position, joint, range.high, upper, 2.0 + range.high - upper);
  }
  [[nodiscard]] const LimitCheck& check() const noexcept { return check_; }

 private:
  void keep(LimitKind kind, int joint, double value, double limit, double share) noexcept {
    if (check_.worst != LimitKind::none && !(share > share_)) return;
    check_ = {kind, joint, value, limit};
    share_ = share;
  }
  LimitCheck check_;
  double share_ = 0.0;
};

void check_kinematics(const MotionLimits& limits, const JointTrajectory& trajectory, std::size_t segment,
                      Worst& worst) noexcept {
  for (int i = 0; i < trajectory.dof(); ++i) {
    const QuinticExtremes extremes = trajectory.piece(segment, i).extremes();
    worst.enter_position(i, extremes.position, limits.lower_rad[i], limits.upper_rad[i]);
    worst.enter(LimitKind::velocity, i, extremes.velocity.magnitude(), limits.velocity_rad_s[i]);
    worst.enter(LimitKind::acceleration, i, extremes.acceleration.magnitude(), limits.acceleration_rad_s2[i]);
    worst.enter(LimitKind::jerk, i, extremes.jerk.magnitude(), limits.jerk_rad_s3[i]);
  }
}

void check_torques_at(const RobotDescription& robot, const Chain& chain, const MotionLimits& limits,
                      const JointMotion& motion, Worst& worst) noexcept {
  const MotionTorques torques = motion_torques(robot, chain, motion);
  for (int i = 0; i < chain.dof(); ++i) {
    worst.enter(LimitKind::torque, i, torques.drive_nm[i], limits.torque_nm[i]);
    worst.enter(LimitKind::transmission, i, torques.transmission_nm[i], limits.transmission_nm[i]);
  }
}

enum class Look : std::uint8_t {
  glance,   ///< at a few instants: what fails so, fails
  careful,  ///< at all that count
};

void check_torques(const RobotDescription& robot, const Chain& chain, const MotionLimits& limits,
                   const JointTrajectory& trajectory, std::size_t segment, Look look, Worst& worst) noexcept {
  const Duration start = trajectory.segment_start(segment);
  const Duration length = trajectory.segment_start(segment + 1) - start;
  JointMotion motion;
  const auto check_from = [&](std::int64_t first, std::int64_t stride) {
    for (std::int64_t k = first; k <= kInstants; k += stride) {
      trajectory.sample(start + length * k / kInstants, motion);
      check_torques_at(robot, chain, limits, motion, worst);
    }
  };
  // A few samples show most of what is too much: a search need not look further.
  check_from(0, kInstants / kGlances);
  if (look == Look::careful && worst.check().ok()) check_from(0, 1);
}

LimitCheck look_at(const RobotDescription& robot, const Chain& chain, const MotionLimits& limits,
                   const JointTrajectory& trajectory, std::size_t segment, Look look) noexcept {
  Worst worst;
  check_kinematics(limits, trajectory, segment, worst);
  if (worst.check().ok()) check_torques(robot, chain, limits, trajectory, segment, look, worst);
  return worst.check();
}

}  // namespace

JointMotion at_rest(const JointVector& q) { return {q, JointVector::Zero(q.size()), JointVector::Zero(q.size())}; }

JointTrajectory::JointTrajectory(const JointMotion& start) noexcept : start_(start), end_(start) {}

bool JointTrajectory::append(const JointMotion& end, Duration duration) noexcept {
  const Eigen::Index n = start_.q.size();
  if (n == 0 || end.q.size() != n || end.qd.size() != n || end.qdd.size() != n) return false;
  if (!(duration > Duration{}) || !(end.q.allFinite() && end.qd.allFinite() && end.qdd.allFinite())) return false;
  if (segments_.full()) return false;
  Segment segment{duration_, duration, {}};
  for (int i = 0; i < n; ++i) {
    segment.joint[static_cast<std::size_t>(i)] =
        Quintic::between(state_of(end_, i), state_of(end, i), duration.seconds());
  }
  if (!segments_.push_back(segment)) return false;
  duration_ += duration;
  end_ = end;
  return true;
}

void JointTrajectory::sample(Duration t, JointVector& q, JointVector& qd, JointVector& qdd) const noexcept {
  const Eigen::Index n = start_.q.size();
  if (segments_.empty() || t < Duration{} || t > duration_) {
    q = t > duration_ ? end_.q : start_.q;
    qd.setZero(n);
    qdd.setZero(n);
    return;
  }
  std::size_t k = segments_.size() - 1;
  while (k > 0 && t < segments_[k].start) --k;
  const double s = (t - segments_[k].start).seconds();
  q.resize(n);
  qd.resize(n);
  qdd.resize(n);
  for (int i = 0; i < n; ++i) {
    const QuinticState state = segments_[k].joint[static_cast<std::size_t>(i)].sample(s);
    q[i] = state.position;
    qd[i] = state.velocity;
    qdd[i] = state.acceleration;
  }
}

MotionLimits motion_limits(const RobotDescription& robot) {
  const int n = robot.dof();
  MotionLimits limits{JointVector(n), JointVector(n), JointVector(n), JointVector(n),
                      JointVector(n), JointVector(n), JointVector(n)};
  for (int i = 0; i < n; ++i) {
    const JointDescription& joint = robot.joints[static_cast<std::size_t>(i)];
    const double motor = joint.motor.max_velocity_rad_s / joint.transmission.gear_ratio;
    limits.lower_rad[i] = joint.limits.lower_rad;
    limits.upper_rad[i] = joint.limits.upper_rad;
    limits.velocity_rad_s[i] = kVelocityShare * std::min(joint.limits.velocity_rad_s, motor);
    limits.acceleration_rad_s2[i] = kAccelerationShare * joint.limits.acceleration_rad_s2;
    limits.jerk_rad_s3[i] = kAccelerationShare * joint.limits.jerk_rad_s3;
    limits.torque_nm[i] = kTorqueShare * joint.limits.torque_nm;
    limits.transmission_nm[i] = kTransmissionShare * joint.transmission.repeated_peak_nm;
  }
  return limits;
}

std::string describe(const LimitCheck& check, const RobotDescription& robot) {
  const std::string name = robot.joints[static_cast<std::size_t>(check.joint)].name;
  switch (check.worst) {
    case LimitKind::none:
      return "all limits respected";
    case LimitKind::position:
      return fmt::format("{} would go to {:.3f} rad, limit {:.3f} rad", name, check.value, check.limit);
    case LimitKind::velocity:
      return fmt::format("{} would need {:.3f} rad/s, limit {:.3f} rad/s", name, check.value, check.limit);
    case LimitKind::acceleration:
      return fmt::format("{} would need {:.2f} rad/s^2, limit {:.2f} rad/s^2", name, check.value, check.limit);
    case LimitKind::jerk:
      return fmt::format("{} would need {:.0f} rad/s^3, limit {:.0f} rad/s^3", name, check.value, check.limit);
    case LimitKind::torque:
      return fmt::format("the drive of {} would need {:.2f} Nm, limit {:.2f} Nm", name, std::abs(check.value),
                         check.limit);
    case LimitKind::transmission:
      return fmt::format("the gear of {} would carry {:.2f} Nm, limit {:.2f} Nm", name, std::abs(check.value),
                         check.limit);
  }
  return {};
}

MotionTorques motion_torques(const RobotDescription& robot, const Chain& chain, const JointMotion& motion) noexcept {
  const ChainPose pose = chain.pose(motion.q);
  MotionTorques torques;
  torques.transmission_nm = chain.inverse_dynamics(pose, motion.qd, motion.qdd);
  torques.drive_nm = torques.transmission_nm;
  torques.drive_nm.noalias() += chain.reflected_inertia(pose).lazyProduct(motion.qdd);
  for (int i = 0; i < chain.dof(); ++i) {
    const FrictionDescription& friction = robot.joints[static_cast<std::size_t>(i)].friction;
    const double qd = motion.qd[i];
    double& drive = torques.drive_nm[i];
    drive += std::abs(qd) > kStickingRadS ? friction_torque_nm(friction, qd) : std::copysign(friction.static_nm, drive);
  }
  return torques;
}

LimitCheck check_torques_at(const RobotDescription& robot, const Chain& chain, const MotionLimits& limits,
                            const JointMotion& motion) noexcept {
  Worst worst;
  check_torques_at(robot, chain, limits, motion, worst);
  return worst.check();
}

LimitCheck check_segment(const RobotDescription& robot, const Chain& chain, const MotionLimits& limits,
                         const JointTrajectory& trajectory, std::size_t segment) noexcept {
  return look_at(robot, chain, limits, trajectory, segment, Look::careful);
}

LimitCheck check_trajectory(const RobotDescription& robot, const Chain& chain, const MotionLimits& limits,
                            const JointTrajectory& trajectory) noexcept {
  for (std::size_t k = 0; k < trajectory.segments(); ++k) {
    const LimitCheck check = check_segment(robot, chain, limits, trajectory, k);
    if (!check.ok()) return check;
  }
  return {};
}

std::optional<Duration> shortest_duration(const RobotDescription& robot, const Chain& chain, const MotionLimits& limits,
                                          const JointMotion& start, const JointMotion& end, Duration grid,
                                          Duration longest, LimitCheck& why) {
  const auto feasible = [&](std::int64_t steps, Look look = Look::careful) {
    JointTrajectory trajectory(start);
    if (!trajectory.append(end, grid * steps)) return false;
    const LimitCheck check = look_at(robot, chain, limits, trajectory, 0, look);
    if (!check.ok()) why = check;
    return check.ok();
  };
  // No joint can be faster on average than its limit; from rest to rest it is 15/8 times as fast as on average at its
  // fastest, accelerates by 10/sqrt(3) d/T^2 and begins with a jerk of 60 d/T^3.
  const auto at_rest_there = [](const JointMotion& m) { return m.qd.isZero() && m.qdd.isZero(); };
  const bool rests = at_rest_there(start) && at_rest_there(end);
  double least_s = 0.0;
  for (int i = 0; i < chain.dof(); ++i) {
    const double travel = std::abs(end.q[i] - start.q[i]);
    if (!(travel <= limits.velocity_rad_s[i] * longest.seconds())) {
      why = {LimitKind::velocity, i, travel / longest.seconds(), limits.velocity_rad_s[i]};
      return std::nullopt;
    }
    least_s = std::max(least_s, travel / limits.velocity_rad_s[i]);
    if (!rests) continue;
    least_s = std::max({least_s, 1.875 * travel / limits.velocity_rad_s[i],
                        std::sqrt(10.0 / std::numbers::sqrt3 * travel / limits.acceleration_rad_s2[i]),
                        std::cbrt(60.0 * travel / limits.jerk_rad_s3[i])});
  }
  // What the ends themselves ask for does not depend on the duration.
  for (const JointMotion* motion : {&start, &end}) {
    const LimitCheck check = check_torques_at(robot, chain, limits, *motion);
    if (check.ok()) continue;
    why = check;
    return std::nullopt;
  }
  // From rest to rest slower is always easier: what cannot be done slowest cannot be done. A glance spares the search
  // most of what is hopeless, and costs what can be done little.
  if (rests && !feasible(longest / grid, Look::glance)) return std::nullopt;
  // Coarse upwards, because with speed at an end longer is not always easier; then back to the first that holds.
  const std::int64_t last = longest / grid;
  std::int64_t failed = std::max<std::int64_t>(seconds(least_s) / grid, 1) - 1;
  for (std::int64_t steps = failed + 1; steps <= last; steps += 1 + steps / 32) {
    if (!feasible(steps)) {
      failed = steps;
      continue;
    }
    LimitCheck keep = why;
    for (std::int64_t shorter = failed + 1; shorter < steps; ++shorter) {
      if (feasible(shorter)) {
        why = keep;
        return grid * shorter;
      }
    }
    why = keep;
    return grid * steps;
  }
  return std::nullopt;
}

}  // namespace mrr::sup
