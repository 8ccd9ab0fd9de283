#include "supervisor/impact/resolved.h"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "common/core/random.h"
#include "supervisor/impact/internal.h"
#include "supervisor/impact/swing_policy.h"

namespace mrr::sup {
namespace {

constexpr double kRunIn_s = 0.012;  // before the switch, so that loops and springs are as they are in motion
constexpr double kEarliest_s = 0.1;
constexpr double kLongestStep_s = 2.5e-4;
constexpr double kStepPerPeriod = 0.35;  // step times the fastest frequency
constexpr std::uint64_t kRobotsSeed = 77;
constexpr double kMostStepsPerTick = 50.0;
constexpr double kLongest_s = 0.6;  // after the planned contact
// The firmware's own constants.
constexpr double kObserver_1_s = 2500.0;  // double pole of the velocity observer
constexpr double kReferenceStill_rad_s = 2e-3;
constexpr double kVelocityMargin_rad_s = 0.15;
constexpr double kLeash_rad = 0.008;
constexpr double kTrendRate_1_s = 60.0;
constexpr double kTrendRateAtRest_1_s = 10.0;
constexpr double kPullFilter_rad_s = 30.0;
constexpr double kTrendStill_rad_s = 0.02;
constexpr double kTrendMoving_rad_s = 0.05;
// And the supervisor's.
constexpr double kGapMargin_m = 5e-4;  // the switch is pulled when the gap is down to speed times lead and this
constexpr double kTold_s = 2e-3;       // from the SYNC whose answers show that to the switch in force
constexpr double kFelt_n = 6.0;        // force from which it takes the blow for begun
constexpr double kGone_n = 2.4;        // ... and below which, twice in a row, for over
constexpr double kShortest_s = 0.015;  // what ends sooner was no blow
constexpr double kSettle_1_s = 100.0;  // a module's reference comes to rest at this rate
constexpr double kRest_rad_s = 1e-4;
constexpr double kDetachedSeen_knots = 2.5;  // a status asked for, told, and made a set point of

double sat(double x) noexcept { return std::clamp(x, -1.0, 1.0); }
double sign(double x) noexcept { return x > 0.0 ? 1.0 : (x < 0.0 ? -1.0 : 0.0); }
std::size_t at(int i) noexcept { return static_cast<std::size_t>(i); }

/// Torque of the transmission's spring, odd, piecewise linear.
double spring_torque(const JointDrive& d, double twist) noexcept {
  const double x = std::abs(twist);
  const double x1 = d.stiffness_break_nm[0] / d.stiffness_nm_rad[0];
  if (x <= x1) return d.stiffness_nm_rad[0] * twist;
  const double x2 = x1 + (d.stiffness_break_nm[1] - d.stiffness_break_nm[0]) / d.stiffness_nm_rad[1];
  const double torque = x <= x2 ? d.stiffness_break_nm[0] + d.stiffness_nm_rad[1] * (x - x1)
                                : d.stiffness_break_nm[1] + d.stiffness_nm_rad[2] * (x - x2);
  return std::copysign(torque, twist);
}
double spring_twist(const JointDrive& d, double torque) noexcept {
  const double t = std::abs(torque);
  double x = std::min(t, d.stiffness_break_nm[0]) / d.stiffness_nm_rad[0];
  x += std::clamp(t - d.stiffness_break_nm[0], 0.0, d.stiffness_break_nm[1] - d.stiffness_break_nm[0]) /
       d.stiffness_nm_rad[1];
  x += std::max(t - d.stiffness_break_nm[1], 0.0) / d.stiffness_nm_rad[2];
  return std::copysign(x, torque);
}

/// One joint: rotor, sensors, law.
struct Joint {
  double motor_q = 0.0, motor_v = 0.0;                 // joint side
  double bristle = 0.0;                                // rad
  double command = 0.0, torque = 0.0;                  // asked for, and what the current gives
  double carried = 0.0;                                // by the transmission, on the link in + direction
  double sensed = 0.0;                                 // the same after the sensor's filter
  double seen_q = 0.0, seen_rest = 0.0, seen_v = 0.0;  // velocity observer, rad and rad per tick
  std::array<double, 4> integral{};
  bool saturated = false;
  bool passive = false;
  double trend = 0.0, blend_left_s = 0.0, blend_from = 0.0, blend_to = 0.0;
  double pull = 0.0, pulled = 0.0;  // sensed torque as the motor feels it, filtered; the way it pulls: -1, 0, 1
  bool own_reference = false;       // it has been called back
  bool catching_up = false;
  double reference_q = 0.0, reference_v = 0.0;
  double at_start = 0.0, sum = 0.0, peak = 0.0;  // of the contact
};

/// What one robot has otherwise than its description, and one nail than was learnt of it.
struct Variation {
  std::array<double, kMaxJoints> friction{}, motor{}, spring{};  // shares more than described
  double mass = 0.0, resistance = 0.0;
  double head_m = 0.0;  // higher than believed
};

/// Robot `number` of those of this description; 0 is as described.
Variation robot_of(int number, int joints) noexcept {
  Variation v;
  if (number == 0) return v;
  Random random(kRobotsSeed, static_cast<std::uint64_t>(number));
  const auto within = [&](double most) { return random.uniform(-most, most); };
  v.mass = within(kRobotsDiffer.link_mass);
  v.resistance = within(kRobotsDiffer.nail_resistance);
  v.head_m = within(kRobotsDiffer.nail_height_m);
  for (int i = 0; i < joints; ++i) {
    v.friction[at(i)] = within(kRobotsDiffer.friction);
    v.motor[at(i)] = within(kRobotsDiffer.motor_torque);
    v.spring[at(i)] = within(kRobotsDiffer.spring);
  }
  return v;
}

/// A blow from just before the switch until the face has left.
class Blow {
 public:
  Blow(const StrikeArm& arm, const PredictInput& input, const Variation& robot) noexcept
      : arm_(arm),
        in_(input),
        robot_(robot),
        early_m_(input.early_m - robot.head_m),
        n_(arm.chain.dof()),
        q_(input.q),
        v_(input.qd),
        lever_(input.q) {}
  Prediction run() noexcept;

 private:
  void start(double t) noexcept;
  void new_pose() noexcept;
  void expect(double t) noexcept;
  void control(double t) noexcept;
  double active_torque(int i, const ReferenceProfile::Point& s, double t) noexcept;
  double passive_torque(int i, bool begins) noexcept;
  void supervise(double t) noexcept;
  void resume(double t) noexcept;
  [[nodiscard]] bool sinking() const noexcept;
  void decide_switch(double t) noexcept;
  void touch() noexcept;
  void step() noexcept;
  void record(double t) noexcept;
  void conclude(double t) noexcept;
  [[nodiscard]] Prediction result() noexcept;
  [[nodiscard]] ReferenceProfile::Point reference(double t) const noexcept;
  struct Target {
    double q, v, a;
  };
  [[nodiscard]] Target target(int i, const ReferenceProfile::Point& s, double t) const noexcept;
  [[nodiscard]] bool is_passive(int i) const noexcept { return in_.joints[at(i)] == JointHold::free; }

  const StrikeArm& arm_;
  const PredictInput& in_;
  const Variation& robot_;
  double early_m_;  // where the face is when the reference is at q, above the head
  int n_;
  JointVector q_, v_, accel_;  // links
  std::array<Joint, kMaxJoints> joint_{};
  double h_ = kLongestStep_s;
  double observer_pole_ = 0.0, pull_gain_ = 0.0;
  std::array<double, kMaxJoints> current_keep_{}, sensor_keep_{};
  // Of the pose last looked at.
  JointVector pose_q_, lever_, bias_;
  JointMatrix inverse_;  // M^-1
  double pose_gap_ = 0.0;
  bool over_head_ = true;
  JointVector expected_;  // what the supervisor says the links ask for, Nm
  // Contact. Heights are along the normal, over the head's before the blow.
  Eigen::Vector3d head_m_ = Eigen::Vector3d::Zero();
  double head_height_ = 0.0;
  double nail_v_ = 0.0;
  double force_ = 0.0;
  bool touched_ = false;
  double began_s_ = 0.0;
  double low_since_s_ = std::numeric_limits<double>::infinity();
  bool over_ = false;
  JointVector begin_v_;
  double begin_height_ = 0.0;
  // Coming back.
  bool resumed_ = false;
  double resumed_s_ = 0.0, stopping_s_ = 1.0;
  ReferenceProfile::Point resumed_at_;
  bool returning_ = false;
  double return_from_s_ = 0.0, return_s_ = 1.0;
  JointVector return_q_, return_way_;
  double switch_s_ = 0.0;  // when passive joints are let go
  // As the supervisor feels the blow.
  double felt_n_s_ = 0.0;
  double felt_since_s_ = 0.0;
  int low_ = 0;
  enum class Felt : std::uint8_t { nothing, touching, over } phase_ = Felt::nothing;
  double resume_due_s_ = std::numeric_limits<double>::infinity();
  double effective_mass_kg_ = 0.0;
  Prediction none_, out_, kept_;
};

ReferenceProfile::Point Blow::reference(double t) const noexcept {
  if (!resumed_ || t < resumed_s_) return in_.reference.at(t);
  const double x = std::min((t - resumed_s_) / stopping_s_, 1.0);  // the supervisor's stopping motion
  return {resumed_at_.s + resumed_at_.v * stopping_s_ * x * (1.0 - x * x * (1.0 - 0.5 * x)),
          resumed_at_.v * (1.0 - x * x * (3.0 - 2.0 * x)), -6.0 * resumed_at_.v * x * (1.0 - x) / stopping_s_};
}

/// What joint i is led along.
Blow::Target Blow::target(int i, const ReferenceProfile::Point& s, double t) const noexcept {
  if (!returning_) return {in_.q[i] + in_.qd[i] * s.s, in_.qd[i] * s.v, in_.qd[i] * s.a};
  const double x = std::clamp((t - return_from_s_) / return_s_, 0.0, 1.0);
  const double u = 1.0 - x;
  return {return_q_[i] + return_way_[i] * x * x * x * (10.0 - x * (15.0 - 6.0 * x)),
          return_way_[i] * 30.0 * x * x * u * u / return_s_,
          return_way_[i] * 60.0 * x * u * (1.0 - 2.0 * x) / (return_s_ * return_s_)};
}

void Blow::new_pose() noexcept {
  pose_q_ = q_;
  const ChainPose pose = arm_.chain.pose(q_);
  const Eigen::Vector3d head = head_m_ + head_height_ * in_.normal;
  const Eigen::Vector3d to_face = pose.face.position_m - head;
  const Eigen::Vector3d out = pose.face.rotation.col(2);
  const double cosine = -in_.normal.dot(out);
  // The face's plane over the head's centre; a head beside the face is not struck.
  pose_gap_ = (cosine > 0.1 ? -to_face.dot(out) / cosine : in_.normal.dot(to_face)) + head_height_;
  const double lateral2 = (to_face - in_.normal * in_.normal.dot(to_face)).squaredNorm();
  over_head_ = lateral2 <= arm_.face_radius_m * arm_.face_radius_m;
  const Eigen::Vector3d point = head + (pose_gap_ - head_height_) * in_.normal;
  for (int i = 0; i < n_; ++i) {
    lever_[i] = in_.normal.dot(pose.axis[at(i)].cross(point - pose.link[at(i)].position_m));
  }
  inverse_ = arm_.chain.mass_matrix(pose).llt().solve(JointMatrix::Identity(n_, n_)) / (1.0 + robot_.mass);
  bias_ = (1.0 + robot_.mass) * arm_.chain.inverse_dynamics(pose, v_, JointVector::Zero(n_));
}

/// The model's torque that comes with the knots.
void Blow::expect(double t) noexcept {
  const ReferenceProfile::Point s = reference(t);
  JointVector q(n_), v(n_), a(n_);
  for (int i = 0; i < n_; ++i) {
    const Joint& j = joint_[at(i)];
    // Whoever does not follow its set points is taken for at rest where it is: what slows it down is not the reference.
    const bool detached = j.own_reference || (j.passive && t - switch_s_ > kDetachedSeen_knots * arm_.knot_s);
    const Target g = detached ? Target{j.motor_q, 0.0, 0.0} : target(i, s, t);
    q[i] = g.q;
    v[i] = g.v;
    a[i] = g.a;
  }
  expected_ = arm_.chain.inverse_dynamics(arm_.chain.pose(q), v, a);
}

/// In steady motion along the reference.
void Blow::start(double t) noexcept {
  head_m_ = arm_.chain.face_pose(in_.q).position_m - early_m_ * in_.normal;
  const ReferenceProfile::Point s = in_.reference.at(t);
  q_ = in_.q + in_.qd * s.s;
  v_ = in_.qd * s.v;
  accel_ = in_.qd * s.a;
  expect(t);
  for (int i = 0; i < n_; ++i) {
    const JointDrive& d = arm_.drive[at(i)];
    Joint& j = joint_[at(i)];
    j.motor_q = q_[i];
    j.motor_v = v_[i];
    j.seen_v = v_[i] * arm_.tick_s;
    j.seen_q = j.motor_q - j.seen_v;
    j.carried = j.sensed = expected_[i];
    q_[i] -= spring_twist(d, expected_[i]);
    if (d.friction.static_nm > 0.0) {
      j.bristle = d.presliding_rad * sign(v_[i]) * d.friction.coulomb_nm / d.friction.static_nm;
    }
    j.torque = j.command = d.rotor_inertia_kg_m2 * accel_[i] + expected_[i] + friction_torque_nm(d.friction, v_[i]);
  }
  new_pose();
  effective_mass_kg_ = 1.0 / std::max(lever_.dot(inverse_ * lever_), 1e-12);
  double fastest2 = in_.contact.face_stiffness_n_m * lever_.dot(inverse_ * lever_);
  for (int i = 0; i < n_; ++i) {
    const JointDrive& d = arm_.drive[at(i)];
    const double k = *std::max_element(d.stiffness_nm_rad.begin(), d.stiffness_nm_rad.end());
    fastest2 =
        std::max(fastest2, k * inverse_(i, i) + (k + d.friction.static_nm / d.presliding_rad) / d.rotor_inertia_kg_m2);
  }
  const double steps = std::ceil(arm_.tick_s / std::min(kLongestStep_s, kStepPerPeriod / std::sqrt(fastest2)));
  h_ = arm_.tick_s / std::clamp(steps, 1.0, kMostStepsPerTick);
  for (int i = 0; i < n_; ++i) {
    constexpr double kTwoPi = 2.0 * std::numbers::pi;
    current_keep_[at(i)] = std::exp(-kTwoPi * arm_.drive[at(i)].current_bandwidth_hz * h_);
    sensor_keep_[at(i)] = std::exp(-kTwoPi * arm_.drive[at(i)].sensor_bandwidth_hz * h_);
  }
}

/// Passive joints are called back: the supervisor stops its reference, they take over from where they are.
void Blow::resume(double t) noexcept {
  resumed_at_ = in_.reference.at(t);
  resumed_s_ = t;
  stopping_s_ = 4.0 * arm_.knot_s;
  for (int i = 0; i < n_; ++i) {
    const JointDrive& d = arm_.drive[at(i)];
    stopping_s_ = std::max(stopping_s_, 1.5 * std::abs(in_.qd[i] * resumed_at_.v) / d.stop_deceleration_rad_s2);
    Joint& j = joint_[at(i)];
    if (!j.passive) continue;
    j.passive = false;
    j.own_reference = j.catching_up = true;
    j.integral = {};
    j.reference_q = j.motor_q;
    j.reference_v = j.seen_v / arm_.tick_s;
  }
  resumed_ = true;
}

/// The switch is armed for the planned instant; the face seen nearer pulls it.
void Blow::decide_switch(double t) noexcept {
  double gap = pose_gap_ - early_m_;  // by the motors, to where the head is believed to be
  double speed = 0.0;
  for (int i = 0; i < n_; ++i) {
    gap += lever_[i] * (joint_[at(i)].motor_q - pose_q_[i]);
    speed -= lever_[i] * joint_[at(i)].motor_v;
  }
  const bool seen = gap >= 0.0 && gap <= speed * arm_.lead_s + kGapMargin_m;
  if (seen && switch_s_ - t > kTold_s + kPullMargin.seconds()) switch_s_ = t + kTold_s;
}

/// Once per knot: what the supervisor makes of the blow.
void Blow::supervise(double t) noexcept {
  const double felt_n = felt_n_s_ / arm_.knot_s;
  felt_n_s_ = 0.0;
  if (!resumed_) {
    if (t <= switch_s_) {
      decide_switch(t);
      return;
    }
    if (phase_ == Felt::nothing && felt_n > kFelt_n) {
      phase_ = Felt::touching;
      felt_since_s_ = t - arm_.knot_s;
    } else if (phase_ == Felt::touching) {
      low_ = felt_n < kGone_n ? low_ + 1 : 0;
      if (low_ >= 2) phase_ = t - 2.0 * arm_.knot_s - felt_since_s_ < kShortest_s ? Felt::nothing : Felt::over;
    }
    // What it sees is a knot old.
    if (phase_ == Felt::over) resume_due_s_ = std::min(resume_due_s_, t + 2.0 * arm_.knot_s);
    if (sinking()) resume_due_s_ = std::min(resume_due_s_, t + arm_.knot_s);
    if (t >= switch_s_ + in_.passive_s) resume_due_s_ = t;
    if (t >= resume_due_s_ - 0.5 * arm_.tick_s) resume(t);
  } else if (!returning_ && t >= resumed_s_ + stopping_s_) {
    for (int i = 0; i < n_; ++i) {
      const Joint& j = joint_[at(i)];
      if (j.own_reference && !(std::abs(j.reference_v) < kRest_rad_s)) return;
    }
    returning_ = true;
    return_from_s_ = t + 2.0 * arm_.knot_s;  // they report it, and a knot goes out
    return_q_ = return_way_ = JointVector::Zero(n_);
    return_s_ = 0.2;
    const ReferenceProfile::Point s = reference(t);
    for (int i = 0; i < n_; ++i) {
      Joint& j = joint_[at(i)];
      const JointDrive& d = arm_.drive[at(i)];
      return_q_[i] = j.own_reference ? j.reference_q : in_.q[i] + in_.qd[i] * s.s;
      j.own_reference = false;
      return_way_[i] = in_.q[i] - in_.qd[i] * in_.reference.travel_s - return_q_[i];
      // Peak velocity and acceleration of a quintic from rest to rest.
      return_s_ = std::max({return_s_, 1.875 * std::abs(return_way_[i]) / d.return_speed_rad_s,
                            std::sqrt(5.774 * std::abs(return_way_[i]) / d.return_acceleration_rad_s2)});
    }
  }
}

/// The supervisor's rule: passive and hardly slowed down, the arm needs the rest of the way to the board to stop.
bool Blow::sinking() const noexcept {
  const double height = pose_gap_ + lever_.dot(q_ - pose_q_);
  if (!(-height >= kRubberGives_m)) return false;
  const double speed = -lever_.dot(v_);
  if (!(speed > arm_.sinking_share * -lever_.dot(in_.qd))) return false;
  double deceleration = std::numeric_limits<double>::infinity();
  for (int i = 0; i < n_; ++i) {
    if (!is_passive(i) || std::abs(lever_[i]) < kLeastLever_m) continue;
    deceleration = std::min(deceleration, std::abs(lever_[i]) * arm_.drive[at(i)].stop_deceleration_rad_s2);
  }
  return -height + speed * (1.5 * arm_.knot_s + 0.5 * speed / deceleration) >= in_.contact.nail_room_m;
}

/// The active law (14)-(18) with its compensator.
double Blow::active_torque(int i, const ReferenceProfile::Point& s, double t) noexcept {
  const JointDrive& d = arm_.drive[at(i)];
  Joint& j = joint_[at(i)];
  auto [q_d, v_d, a_d] = target(i, s, t);
  const double seen_v = j.seen_v / arm_.tick_s;
  if (j.own_reference) {
    // It comes to rest by itself, never faster than the joint.
    const double way = sign(j.reference_v);
    j.reference_v = way * std::clamp(way * seen_v + kVelocityMargin_rad_s, 0.0, std::abs(j.reference_v));
    a_d = std::clamp(-kSettle_1_s * j.reference_v, -d.stop_deceleration_rad_s2, d.stop_deceleration_rad_s2);
    j.reference_q += arm_.tick_s * (j.reference_v + 0.5 * arm_.tick_s * a_d);
    j.reference_v += arm_.tick_s * a_d;
    q_d = j.reference_q = std::clamp(j.reference_q, j.motor_q - kLeash_rad, j.motor_q + kLeash_rad);
    v_d = j.reference_v;
  }
  const double e = j.motor_q - q_d;
  const double e_v = seen_v - v_d;
  double load = d.torque_sensor ? j.sensed : expected_[i];
  load = std::clamp(load, expected_[i] - d.carried_departure_nm, expected_[i] + d.carried_departure_nm);

  const double beyond = (std::abs(seen_v) - d.still_velocity_rad_s) / d.still_velocity_rad_s;
  const double seen = std::clamp(beyond, 0.0, 1.0);
  const double r_d = sat(v_d / kReferenceStill_rad_s);
  const double way = std::abs(r_d) * seen * sign(seen_v) + (1.0 - seen) * r_d;
  const double x = d.friction.stribeck_decay_s2_rad2 * seen_v * seen_v;
  const double Es = x < 30.0 ? std::exp(-x) * way : 0.0;
  double torque = d.rotor_inertia_kg_m2 * a_d - d.velocity_gain_nm_s_rad * e_v - d.position_gain_nm_rad * e + load +
                  d.friction_feedforward * (d.friction.viscous_nm_s_rad * seen_v + d.friction.coulomb_nm * (way - Es) +
                                            d.friction.static_nm * Es);
  const CompensatorDescription& c = d.compensator;
  if (c.enabled) {
    const double r = e_v + d.lambda_1_s * e;
    const std::array<double, 4> y{seen_v, way - Es, Es,
                                  -(d.friction.static_nm - d.friction.coulomb_nm) * seen_v * seen_v * Es};
    if (c.position_width_rad_s > 0.0) torque -= c.position_gain_nm * sat(r / c.position_width_rad_s);
    for (std::size_t k = 0; k < 4; ++k) {
      const double zeta = y[k] * r;
      if (!j.saturated && !j.catching_up) {
        j.integral[k] = std::clamp(j.integral[k] - c.integral_gain[k] * arm_.tick_s * zeta, -c.integral_limit[k],
                                   c.integral_limit[k]);
      }
      const double robust = c.robust_width[k] > 0.0 ? c.robust_gain[k] * sat(zeta / c.robust_width[k]) : 0.0;
      torque += y[k] * (j.integral[k] - robust);
    }
  }
  return torque;
}

/// The passive law (20): a share of friction along the trend, which follows motion, and at rest the sensed torque.
double Blow::passive_torque(int i, bool begins) noexcept {
  const JointDrive& d = arm_.drive[at(i)];
  Joint& j = joint_[at(i)];
  const double pull = d.torque_sensor ? -j.sensed : 0.0;
  const bool strong = std::abs(pull) > d.sensed_trend_nm + d.static_compensation_nm;
  j.pull = begins || strong ? pull : j.pull + pull_gain_ * (pull - j.pull);
  const double seen_v = j.seen_v / arm_.tick_s;
  const double moves =
      std::clamp((std::abs(seen_v) - kTrendStill_rad_s) / (kTrendMoving_rad_s - kTrendStill_rad_s), 0.0, 1.0);
  if (begins) j.pulled = 0.0;
  if (std::abs(j.pull) >= d.sensed_trend_nm) {
    j.pulled = sign(j.pull);
  } else if (!(j.pull * j.pulled > d.sensed_dead_band_nm)) {
    j.pulled = 0.0;
  }
  const double wanted = moves * sign(seen_v) + (1.0 - moves) * j.pulled;
  if (begins) {
    j.trend = wanted;
  } else {
    const double missing = wanted - j.trend;
    const bool turned = moves > 0.0 && missing * j.trend < 0.0;
    const double slow = kTrendRateAtRest_1_s + moves * (kTrendRate_1_s - kTrendRateAtRest_1_s);
    const double most = (strong || turned ? kTrendRate_1_s : slow) * arm_.tick_s;
    j.trend += std::clamp(missing, -most, most);
  }
  return (d.static_compensation_nm + moves * (d.compensation_nm - d.static_compensation_nm)) * j.trend;
}

/// One tick of every joint's loop.
void Blow::control(double t) noexcept {
  const ReferenceProfile::Point s = reference(t);
  const bool let_go = !resumed_ && t >= switch_s_ - 0.1 * arm_.tick_s;
  for (int i = 0; i < n_; ++i) {
    const JointDrive& d = arm_.drive[at(i)];
    Joint& j = joint_[at(i)];
    const double pole = observer_pole_;
    const double ahead = j.seen_rest + j.seen_v - (j.motor_q - j.seen_q);
    j.seen_q = j.motor_q;
    j.seen_rest = pole * pole * ahead;
    j.seen_v -= (1.0 - pole) * (1.0 - pole) * ahead;

    if (let_go && is_passive(i) && !j.passive) {
      j.passive = true;
      j.blend_from = j.command;
      j.blend_to = passive_torque(i, true);
      j.blend_left_s = d.blend_s;
    }
    double wanted = 0.0;
    if (j.passive) {
      if (j.blend_left_s > 0.5 * arm_.tick_s) {
        j.blend_left_s -= arm_.tick_s;
        wanted = j.blend_to + (j.blend_from - j.blend_to) * std::max(j.blend_left_s, 0.0) / d.blend_s;
      } else {
        wanted = passive_torque(i, false);
      }
    } else {
      wanted = active_torque(i, s, t);
      if (j.catching_up) {
        const double most = d.resume_slew_nm_s * arm_.tick_s;
        j.catching_up = !(std::abs(wanted - j.command) <= most);
        wanted = j.command + std::clamp(wanted - j.command, -most, most);
      }
    }
    const double limited = std::clamp(wanted, -d.torque_limit_nm[1], d.torque_limit_nm[0]);
    j.saturated = limited != wanted;
    j.command = limited;
  }
}

void Blow::touch() noexcept {
  const ContactLaw& law = in_.contact;
  const double depth = head_height_ - (pose_gap_ + lever_.dot(q_ - pose_q_));
  force_ = nail_v_ = 0.0;
  if (!(depth > 0.0 && over_head_)) return;
  const double speed = -lever_.dot(v_);
  const double elastic = law.face_stiffness_n_m * depth;
  force_ = std::max(0.0, elastic * (1.0 + law.face_damping_s_m * speed));
  const double resistance =
      (1.0 + robot_.resistance) * (law.nail_resistance_n - law.nail_resistance_slope_n_m * head_height_);
  if (force_ > resistance && -head_height_ < law.nail_room_m) {
    // The nail yields: F = k d (1 + c (v - u)) with u = (F - R)/c_v.
    const double share = elastic * law.face_damping_s_m / law.nail_damping_n_s_m;
    force_ = (elastic * (1.0 + law.face_damping_s_m * speed) + share * resistance) / (1.0 + share);
    nail_v_ = std::max(0.0, (force_ - resistance) / law.nail_damping_n_s_m);
  }
}

/// Semi-implicit Euler: forces at the new positions of the last step, then speeds, then positions.
void Blow::step() noexcept {
  touch();
  JointVector push(n_);
  for (int i = 0; i < n_; ++i) {
    const JointDrive& d = arm_.drive[at(i)];
    Joint& j = joint_[at(i)];
    j.carried =
        (1.0 + robot_.spring[at(i)]) * spring_torque(d, j.motor_q - q_[i]) + d.damping_nm_s_rad * (j.motor_v - v_[i]);
    push[i] = j.carried - bias_[i] + lever_[i] * force_;
    j.torque = j.command + (j.torque - j.command) * current_keep_[at(i)];
    j.sensed = j.carried + (j.sensed - j.carried) * sensor_keep_[at(i)];

    // Friction: bristles that bend up to the level of (5), then slide.
    const FrictionDescription& f = d.friction;
    double friction = f.viscous_nm_s_rad * j.motor_v;
    if (f.static_nm > 0.0) {
      const double x = f.stribeck_decay_s2_rad2 * j.motor_v * j.motor_v;
      const double decay = x < 30.0 ? std::exp(-x) : 0.0;
      const double level = f.coulomb_nm + (f.static_nm - f.coulomb_nm) * decay;
      const double stiffness = f.static_nm / d.presliding_rad;
      const double before = j.bristle;
      j.bristle = (before + h_ * j.motor_v) / (1.0 + h_ * stiffness * std::abs(j.motor_v) / level);
      const double damping = 1.4 * std::sqrt(stiffness * d.rotor_inertia_kg_m2) * decay;
      friction += stiffness * j.bristle + damping * (j.bristle - before) / h_;
    }
    if (in_.joints[at(i)] == JointHold::held) continue;
    j.motor_v += h_ * ((1.0 + robot_.motor[at(i)]) * j.torque - (1.0 + robot_.friction[at(i)]) * friction - j.carried) /
                 d.rotor_inertia_kg_m2;
    j.motor_q += h_ * j.motor_v;
  }
  accel_.noalias() = inverse_.lazyProduct(push);
  v_ += h_ * accel_;
  q_ += h_ * v_;
  head_height_ = std::max(head_height_ - h_ * nail_v_, -in_.contact.nail_room_m);
}

void Blow::record(double t) noexcept {
  if (force_ > 0.0) felt_n_s_ += h_ * force_;
  if (!touched_) {
    if (!(force_ > 0.0)) return;
    touched_ = true;
    began_s_ = t;
    begin_v_ = v_ - h_ * accel_;
    begin_height_ = head_height_;
    for (int i = 0; i < n_; ++i) joint_[at(i)].at_start = joint_[at(i)].carried;
    out_.speed_before_m_s = -lever_.dot(begin_v_);
  }
  out_.impulse_n_s += h_ * force_;
  out_.peak_force_n = std::max(out_.peak_force_n, force_);
  for (int i = 0; i < n_; ++i) {
    Joint& j = joint_[at(i)];
    j.sum += h_ * j.carried;
    j.peak = std::max(j.peak, std::abs(j.carried));
  }
  if (!(force_ < kBlowOverShare * out_.peak_force_n)) {
    low_since_s_ = std::numeric_limits<double>::infinity();
    return;
  }
  if (low_since_s_ > t) {
    low_since_s_ = t;
    conclude(t + h_);
  }
  over_ = t - low_since_s_ > kBlowOver_s;
}

/// The blow as it is if it ends now.
void Blow::conclude(double t) noexcept {
  kept_ = out_;
  kept_.approaching = true;
  kept_.contact_s = t - began_s_;
  kept_.start_s = began_s_;
  kept_.penetration_m = begin_height_ - head_height_;
  kept_.speed_after_m_s = -lever_.dot(v_);
  kept_.delta_qd = v_ - begin_v_;
  for (int i = 0; i < n_; ++i) {
    kept_.axis_impulse_nm_s[i] = -joint_[at(i)].sum;
    kept_.carried_before_nm[i] = -joint_[at(i)].at_start;
    kept_.peak_torque_nm[i] = joint_[at(i)].peak;
  }
}

Prediction Blow::result() noexcept {
  Prediction out = kept_;
  out.feasible = std::isfinite(out_.impulse_n_s) && v_.allFinite();
  if (!out.feasible) return none_;
  out.effective_mass_kg = effective_mass_kg_;
  if (!out.approaching) return out;
  const ChainPose pose = arm_.chain.pose(in_.q);
  out.blow_impulse_nm_s = out.axis_impulse_nm_s + out.contact_s * arm_.chain.gravity(pose);
  // The whole wrench from the jump of speeds and the blow. Its axis component differs a little from what was
  // integrated, by what the pose changes meanwhile: that is put right.
  Vector6 external = Vector6::Zero();
  external.head<3>() = out.impulse_n_s * in_.normal;
  internal_impulses(arm_.chain, pose, out.delta_qd, external, Formulation::corrected, out.wrench);
  for (int i = 0; i < n_; ++i) {
    Eigen::Vector3d& torque = out.wrench[at(i)].torque_nm_s;
    torque += (out.blow_impulse_nm_s[i] - pose.axis[at(i)].dot(torque)) * pose.axis[at(i)];
  }
  return out;
}

Prediction Blow::run() noexcept {
  none_.delta_qd = none_.axis_impulse_nm_s = none_.blow_impulse_nm_s = none_.carried_before_nm = none_.peak_torque_nm =
      JointVector::Zero(n_);
  out_ = kept_ = none_;
  const JointVector J_n = arm_.chain.jacobian(in_.q).topRows<3>().transpose() * in_.normal;
  if (!(J_n.dot(in_.qd) < 0.0)) {  // going away: nothing is struck
    none_.feasible = true;
    return none_;
  }
  bool any_passive = false;
  for (int i = 0; i < n_; ++i) any_passive = any_passive || is_passive(i);
  // On the grid of the knots, one of which is the planned contact.
  double before = kRunIn_s;
  if (any_passive) {
    before += in_.switch_lead_s + kGapMargin_m / std::max(-J_n.dot(in_.qd), 1e-6) + arm_.knot_s;
  }
  const double from = -std::ceil(std::min(before, kEarliest_s) / arm_.knot_s) * arm_.knot_s;
  switch_s_ = -in_.switch_lead_s;
  observer_pole_ = std::exp(-kObserver_1_s * arm_.tick_s);
  pull_gain_ = 1.0 - std::exp(-kPullFilter_rad_s * arm_.tick_s);
  start(from);
  const int per_tick = static_cast<int>(std::lround(arm_.tick_s / h_));
  const int per_pose = std::max(1, static_cast<int>(std::lround(arm_.knot_s / arm_.tick_s)));
  const int ticks = static_cast<int>((kLongest_s - from) / arm_.tick_s);
  for (int tick = 0; tick < ticks; ++tick) {
    const double t = from + tick * arm_.tick_s;
    if (tick % per_pose == 0) {
      new_pose();
      expect(t + arm_.knot_s);
      if (any_passive) supervise(t);
    }
    control(t);
    for (int k = 0; k < per_tick && !over_; ++k) {
      step();
      record(t + k * h_);
    }
    if (over_) return result();
  }
  if (touched_) conclude(from + ticks * arm_.tick_s);  // it never ended
  return result();
}

}  // namespace

Prediction resolve_blow(const StrikeArm& arm, const PredictInput& input) noexcept {
  constexpr int kMost = kMostRobots;
  const int n = arm.chain.dof();
  Prediction out = Blow(arm, input, {}).run();
  out.as_one_robot();
  const int robots = std::min(input.robots, kMost);
  if (robots <= 1 || !out.feasible) return out;

  // What tells blows apart: the nail's impulse, the joints' impulses and peaks.
  constexpr std::size_t kFigures = 1 + 2 * kMaxJoints;
  std::array<std::array<double, kFigures>, kMost> blows{};
  const auto figures = static_cast<std::size_t>(1 + 2 * n);
  const auto note = [&](int robot, const Prediction& p) {
    auto& blow = blows[at(robot)];
    blow[0] = p.impulse_n_s;
    for (int i = 0; i < n; ++i) {
      blow[at(1 + 2 * i)] = p.axis_impulse_nm_s[i];
      blow[at(2 + 2 * i)] = p.peak_torque_nm[i];
    }
  };
  note(0, out);
  for (int robot = 1; robot < robots; ++robot) {
    const Prediction p = Blow(arm, input, robot_of(robot, n)).run();
    if (!p.feasible) {
      Prediction none = p;
      none.as_one_robot();
      return none;
    }
    note(robot, p);
    out.impulse_low_n_s = std::min(out.impulse_low_n_s, p.impulse_n_s);
    out.impulse_high_n_s = std::max(out.impulse_high_n_s, p.impulse_n_s);
    out.axis_impulse_low_nm_s = out.axis_impulse_low_nm_s.cwiseMin(p.axis_impulse_nm_s);
    out.axis_impulse_high_nm_s = out.axis_impulse_high_nm_s.cwiseMax(p.axis_impulse_nm_s);
    out.peak_torque_low_nm = out.peak_torque_low_nm.cwiseMin(p.peak_torque_nm);
    out.peak_torque_high_nm = out.peak_torque_high_nm.cwiseMax(p.peak_torque_nm);
  }
  // The blow with the least sum of distances from the medians, each measured by how far the blows are from it.
  std::array<double, kMost> away{};
  for (std::size_t f = 0; f < figures; ++f) {
    std::array<double, kMost> sorted{};
    for (int r = 0; r < robots; ++r) sorted[at(r)] = blows[at(r)][f];
    std::sort(sorted.begin(), sorted.begin() + robots);
    const double median = 0.5 * (sorted[at((robots - 1) / 2)] + sorted[at(robots / 2)]);
    double spread = 0.05 * std::abs(median) * robots;  // who agrees this well need not be told apart
    for (int r = 0; r < robots; ++r) spread += std::abs(blows[at(r)][f] - median);
    for (int r = 0; r < robots && spread > 0.0; ++r) away[at(r)] += std::abs(blows[at(r)][f] - median) / spread;
  }
  const auto nearest = static_cast<int>(std::min_element(away.begin(), away.begin() + robots) - away.begin());
  if (nearest == 0) return out;
  Prediction middle = Blow(arm, input, robot_of(nearest, n)).run();
  middle.impulse_low_n_s = out.impulse_low_n_s;
  middle.impulse_high_n_s = out.impulse_high_n_s;
  middle.axis_impulse_low_nm_s = out.axis_impulse_low_nm_s;
  middle.axis_impulse_high_nm_s = out.axis_impulse_high_nm_s;
  middle.peak_torque_low_nm = out.peak_torque_low_nm;
  middle.peak_torque_high_nm = out.peak_torque_high_nm;
  return middle;
}

}  // namespace mrr::sup
