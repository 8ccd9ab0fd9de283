// Room: supervisor/strike. Joint trajectories of a few quintic segments, and the builders that find their durations.
// May touch common/, supervisor/model and friction. Sampling allocates nothing and throws nothing; building may do
// neither in the cycle.
#pragma once

#include <cstdint>
#include <limits>
#include <optional>
#include <string>

#include "common/core/containers.h"
#include "common/core/time.h"
#include "common/robot/robot.h"
#include "supervisor/model/chain.h"
#include "supervisor/strike/quintic.h"

namespace mrr::sup {

/// State of all joints: rad, rad/s, rad/s^2. Vectors have dof() entries.
struct JointMotion {
  JointVector q;
  JointVector qd;
  JointVector qdd;
};

/// At rest at q.
[[nodiscard]] JointMotion at_rest(const JointVector& q);

/// Piecewise quintic motion of all joints, position, velocity and acceleration continuous from piece to piece.
class JointTrajectory {
 public:
  static constexpr std::size_t kMaxSegments = 8;

  /// An empty trajectory that stays at `start`; append() makes it move.
  JointTrajectory() = default;
  explicit JointTrajectory(const JointMotion& start) noexcept;

  /// Goes on from where the trajectory ends to `end` in `duration`. False (and nothing appended) if full, if the
  /// duration is not positive, if sizes differ or anything is not finite.
  [[nodiscard]] bool append(const JointMotion& end, Duration duration) noexcept;

  /// State at t since the start. Before the start and after the end it stays put: q of that end, q' = q'' = 0.
  void sample(Duration t, JointVector& q, JointVector& qd, JointVector& qdd) const noexcept;
  void sample(Duration t, JointMotion& motion) const noexcept { sample(t, motion.q, motion.qd, motion.qdd); }

  [[nodiscard]] Duration duration() const noexcept { return duration_; }
  [[nodiscard]] int dof() const noexcept { return static_cast<int>(start_.q.size()); }
  [[nodiscard]] std::size_t segments() const noexcept { return segments_.size(); }
  /// When segment k begins; k <= segments(), the last is duration().
  [[nodiscard]] Duration segment_start(std::size_t k) const noexcept {
    return k < segments_.size() ? segments_[k].start : duration_;
  }
  [[nodiscard]] const Quintic& piece(std::size_t segment, int joint) const noexcept {
    return segments_[segment].joint[static_cast<std::size_t>(joint)];
  }
  [[nodiscard]] const JointMotion& start() const noexcept { return start_; }
  [[nodiscard]] const JointMotion& end() const noexcept { return end_; }

 private:
  struct Segment {
    Duration start;
    Duration duration;
    std::array<Quintic, kMaxJoints> joint;
  };
  StaticVector<Segment, kMaxSegments> segments_;
  JointMotion start_;
  JointMotion end_;
  Duration duration_;
};

/// What a planned motion may ask of the joints. Shares below 1 leave the controllers room to correct.
struct MotionLimits {
  JointVector lower_rad;
  JointVector upper_rad;
  JointVector velocity_rad_s;  ///< URDF and motor
  JointVector acceleration_rad_s2;
  JointVector jerk_rad_s3;
  JointVector torque_nm;        ///< commanded, joint side: URDF effort
  JointVector transmission_nm;  ///< what the gear carries: repeated peak
};
inline constexpr double kVelocityShare = 0.95;
inline constexpr double kAccelerationShare = 0.9;  ///< and of the jerk limit
inline constexpr double kTorqueShare = 0.9;
/// Of the repeated peak: the springs of the gears overshoot what inverse dynamics of rigid joints asks of them.
inline constexpr double kTransmissionShare = 0.75;
[[nodiscard]] MotionLimits motion_limits(const RobotDescription& robot);

/// Which limit a motion breaks, by how much, where.
enum class LimitKind : std::uint8_t { none, position, velocity, acceleration, jerk, torque, transmission };
struct LimitCheck {
  LimitKind worst = LimitKind::none;  ///< none: all respected
  int joint = 0;
  double value = 0.0;  ///< of the worst one, in the unit of its limit
  double limit = 0.0;
  [[nodiscard]] bool ok() const noexcept { return worst == LimitKind::none; }
};
/// "the drive of joint_2 would need 48.10 Nm, limit 40.50 Nm"
[[nodiscard]] std::string describe(const LimitCheck& check, const RobotDescription& robot);

/// Torques of a motion by inverse dynamics: `transmission` = M q'' + h (9), `drive` = that + B q'' + tau_f (10).
/// Friction by (5) with the sign of q'; below 2e-3 rad/s static friction against the drive, the worse case.
struct MotionTorques {
  JointVector transmission_nm;
  JointVector drive_nm;
};
[[nodiscard]] MotionTorques motion_torques(const RobotDescription& robot, const Chain& chain,
                                           const JointMotion& motion) noexcept;

/// Torques of one state.
[[nodiscard]] LimitCheck check_torques_at(const RobotDescription& robot, const Chain& chain, const MotionLimits& limits,
                                          const JointMotion& motion) noexcept;

/// Checks segment k: position, velocity, acceleration, jerk exactly (extremes of the quintics), torques at 49
/// instants, evenly.
[[nodiscard]] LimitCheck check_segment(const RobotDescription& robot, const Chain& chain, const MotionLimits& limits,
                                       const JointTrajectory& trajectory, std::size_t segment) noexcept;
/// All segments.
[[nodiscard]] LimitCheck check_trajectory(const RobotDescription& robot, const Chain& chain, const MotionLimits& limits,
                                          const JointTrajectory& trajectory) noexcept;

/// Shortest duration, in whole steps of `grid` (the knot period, so that a segment's end is a knot and the modules'
/// interpolation stays exact), in which start -> end respects all limits. nullopt if there is none up to `longest`;
/// `why` then has the limit that stood in the way last.
[[nodiscard]] std::optional<Duration> shortest_duration(const RobotDescription& robot, const Chain& chain,
                                                        const MotionLimits& limits, const JointMotion& start,
                                                        const JointMotion& end, Duration grid, Duration longest,
                                                        LimitCheck& why);

}  // namespace mrr::sup
