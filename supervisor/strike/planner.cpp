#include "supervisor/strike/planner.h"

#include <fmt/format.h>

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <numbers>
#include <optional>
#include <span>
#include <utility>

#include "supervisor/impact/measures.h"
#include "supervisor/impact/selection.h"
#include "supervisor/strike/joint_norm.h"
#include "supervisor/strike/null_space.h"
#include "supervisor/strike/reconsider.h"

namespace mrr::sup {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kTie = 0.02;                  // measures nearer than this share are equal
constexpr double kSlowDown = 0.81;             // one step of slowing down
constexpr double kLeastSpeedShare = 0.3;       // a blow slower than this share of what was wanted is not worth it
constexpr double kRoomMatters = 2.0;           // of a whole back-swing, against the logarithm of the measure
constexpr double kLeastBackSwingShare = 0.25;  // of the back-swing that was wanted
constexpr double kMaxFollowThroughM = 0.06;
constexpr double kBoardRadiusM = 0.10;     // how far around the nail the board is taken to reach
constexpr double kLeaveBoardM = 0.01;      // a motion may begin this far inside the board, for a bad estimate
constexpr double kNailClearanceM = 0.003;  // beside the face
constexpr double kLongestMotionS = 30.0;
constexpr double kEvenSwing = 1.4;  // swing time over travel/speed; 2 is speed that only ever grows
constexpr double kUnhurried = 1.6;  // of the shortest time, where nothing is gained by haste
constexpr double kLongestSwingS = 10.0;
constexpr double kLeastArmingS = 0.25;  // for every module to acknowledge, and for a stop if one does not
constexpr double kRounding = 1e-12;     // a load worked out another way is still no more than its limit
constexpr double kIdle = 0.01;          // a joint that even held carries less than this share of rated is left active
constexpr double kDegrees = 180.0 / std::numbers::pi;

[[noreturn]] void refuse(const std::string& sentence) { throw PlanError(sentence); }

std::size_t at(int i) { return static_cast<std::size_t>(i); }

/// Names of the joints in a mask: "joint_2 and joint_3", "none".
std::string names(const RobotDescription& robot, std::uint32_t mask) {
  std::string text;
  for (int i = 0; i < robot.dof(); ++i) {
    if ((mask >> i & 1U) == 0) continue;
    mask &= ~(1U << i);
    text += (text.empty() ? "" : mask == 0 ? " and " : ", ") + robot.joints[at(i)].name;
  }
  return text.empty() ? "none" : text;
}

Duration knot_period(const RobotDescription& robot) { return seconds(1.0 / robot.bus.knot_rate_hz); }

/// Why trajectories could not be made.
struct Obstacle {
  std::string sentence;
  bool slower_helps = false;
};

/// Slower asks for less speed, acceleration and torque; it makes no room.
Obstacle obstacle(const std::string& what, const LimitCheck& check, const RobotDescription& robot) {
  return {what + describe(check, robot), check.worst != LimitKind::position};
}

/// One selection at one pose, for an approach at 1 m/s. Loads grow with the speed, shares of one load in another do
/// not.
struct Weighed {
  std::uint32_t passive = 0;
  double load_ratio_per_n_s = kInfinity;
  double impulse_n_s_per_m_s = 0.0;
  double effective_mass_kg = 0.0;
  double wanted_m_s = 0.0;   // the speed asked for
  double allowed_m_s = 0.0;  // up to which no joint exceeds its repeated peak; 0: a passive joint would fall too far
  double considerate_m_s = 0.0;  // up to which no active joint exceeds its rated limit
  double needless_m_s = 0.0;     // up to which some passive joint could as well be held
  int limiting_joint = 0;        // of allowed_m_s
};

/// A pose that may be struck from, with everything known about it before trajectories.
struct Blow {
  FaceSolution pose;
  JointVector unit;  // joint speeds for 1 m/s
  JointVector qd;
  double top_speed_m_s = 0.0;     // by the joints
  double wanted_speed_m_s = 0.0;  // before the gears had a say
  double speed_m_s = 0.0;
  double back_swing_rad = 0.0;
  Weighed chosen;
  std::uint32_t passive = 0;
  double measure = 0.0;
  std::string why;  // if not feasible
  bool feasible = false;
  // Filled in by detail().
  std::array<JointLoad, kMaxJoints> loads{};
  ImpactPrediction prediction;
};

class Planner {
 public:
  Planner(const RobotDescription& robot, const Chain& chain, const PlanInput& request);

  StrikePlan plan();

 private:
  [[nodiscard]] int dof() const { return chain_.dof(); }
  [[nodiscard]] std::uint32_t all() const { return (1U << dof()) - 1U; }
  void weigh(Blow& blow, double slower = 1.0, std::optional<std::uint32_t> around = {});
  void weigh_selections(const Blow& blow, const ChainPose& pose, const SelectionSweep& sweep,
                        std::optional<std::uint32_t> around);
  [[nodiscard]] const Weighed* choose(Blow& blow, double slower) const;
  [[nodiscard]] JointVector falls(const ChainPose& pose) const;
  void detail(Blow& blow);
  std::optional<Obstacle> settle_selection(Blow& blow, StrikePlan& plan);
  [[nodiscard]] const Weighed& weighed_of(std::uint32_t passive) const;
  [[nodiscard]] std::string why_not(const Weighed& w, const Blow& blow) const;
  void explain_selections(const Blow& blow, StrikePlan& plan);
  [[nodiscard]] double measure_of(const Blow& blow, const ChainPose& pose) const;
  [[nodiscard]] bool smaller_is_better() const { return request_.measure == StrikeMeasure::load_ratio; }
  [[nodiscard]] std::vector<std::size_t> ranked(const std::vector<Blow>& blows) const;
  void improve(const FaceTarget& target, std::vector<Blow>& blows);
  [[nodiscard]] double room_for_back_swing(const Blow& blow) const;

  std::optional<std::string> build(Blow& blow, StrikePlan& plan);
  std::optional<Obstacle> build_at_speed(const Blow& blow, StrikePlan& plan) const;
  std::optional<Obstacle> build_stop(const Blow& blow, StrikePlan& plan, Duration& stop) const;
  std::optional<Obstacle> build_swing(const Blow& blow, StrikePlan& plan, Duration stop, double travel) const;
  std::optional<Obstacle> build_approach(StrikePlan& plan) const;
  [[nodiscard]] bool below_board(const ChainPose& pose) const;
  [[nodiscard]] bool collides(const JointTrajectory& trajectory, Duration until) const;
  [[nodiscard]] double depth(const JointVector& q) const;
  [[nodiscard]] Duration whole_knots(double at_least_s) const {
    return grid_ * static_cast<std::int64_t>(std::ceil(at_least_s / grid_.seconds() - 1e-6));
  }
  [[nodiscard]] double weight_force(const Blow& blow) const;
  struct SwitchTimes {
    double lead_s = 0.0;
    double passive_s = 0.0;
  };
  [[nodiscard]] SwitchTimes switch_times(const Blow& blow, std::uint32_t passive, const JointVector& delta_qd,
                                         const JointVector& fall, Duration contact_time) const;
  void time_the_switch(const Blow& blow, StrikePlan& plan) const;

  const RobotDescription& robot_;
  const Chain& chain_;
  const PlanInput& request_;
  MotionLimits limits_;
  Duration grid_;
  std::array<JointLoad, kMaxJoints> joint_{};  // what does not depend on the pose
  JointVector speed_limit_;                    // of the joints at impact, rad/s
  std::array<double, kMaxJoints> controlled_inertia_{};
  std::optional<StrikeArm> arm_;         // none: the reference's equations know only the instant
  std::vector<Weighed> weighed_;         // of the pose weighed last
  std::uint32_t idle_ = 0;               // joints that carry next to nothing in it, held or not
  std::vector<RankedSelection> ranked_;  // of the pose settled last
};

Planner::Planner(const RobotDescription& robot, const Chain& chain, const PlanInput& request)
    : robot_(robot),
      chain_(chain),
      request_(request),
      limits_(motion_limits(robot)),
      grid_(knot_period(robot)),
      speed_limit_(chain.dof()) {
  const double share = robot_.task.max_speed_share * request_.speed_share;
  for (int i = 0; i < dof(); ++i) {
    const JointDescription& joint = robot_.joints[at(i)];
    // The design contact, not the learnt one: a soft nail's long contact is no reason to strike softer.
    const double by_gear =
        joint_speed_limit_rad_s(joint, robot_.task.assumed_contact_s, robot_.task.impacts_over_momentary_peak);
    speed_limit_[i] = share * std::min(request_.speed_factor * by_gear, limits_.velocity_rad_s[i]);
    controlled_inertia_[at(i)] = controlled_extra_inertia(
        joint.control.position_gain_nm_rad, joint.control.velocity_gain_nm_s_rad, request_.contact_duration_s);
    joint_[at(i)].limits = impulse_limits(joint.transmission, request_.contact_duration_s);
    joint_[at(i)].controlled_inertia_kg_m2 = controlled_inertia_[at(i)];
    joint_[at(i)].qd_limit_rad_s = speed_limit_[i];
  }
  if (request_.formulation == Formulation::corrected) arm_.emplace(robot_);
}

/// How fast each joint would begin to fall if it were passive, rad/s^2: by what gravity exceeds the friction that is
/// left, the nail not counted on.
JointVector Planner::falls(const ChainPose& pose) const {
  const JointVector g = chain_.gravity(pose);
  const JointMatrix M = chain_.mass_matrix(pose);
  JointVector fall(dof());
  for (int i = 0; i < dof(); ++i) {
    const JointDescription& joint = robot_.joints[at(i)];
    const double left_nm = joint.friction.static_nm * (1.0 - joint.control.passive_compensation);
    fall[i] = std::max(std::abs(g[i]) - left_nm, 0.0) / (M(i, i) + joint.reflected_inertia_kg_m2());
  }
  return fall;
}

/// Every selection that the request leaves open, into weighed_. `around`: only this one and those that differ from it
/// by one joint.
void Planner::weigh_selections(const Blow& blow, const ChainPose& pose, const SelectionSweep& sweep,
                               std::optional<std::uint32_t> around) {
  const double fall_s = robot_.task.switch_lead_s + request_.contact_duration_s;
  const JointVector drop = 0.5 * fall_s * fall_s * falls(pose);
  idle_ = 0;
  JointVector may_hold_m_s(dof());  // up to which each joint, held, carries no more than rated
  for (int i = 0; i < dof(); ++i) {
    const SelectionBlow held = sweep.held(i);
    const double impulse = held.impulse_n_s(1.0, request_.restitution, request_.nail_mass_kg);
    may_hold_m_s[i] = joint_[at(i)].limits.rated_nm_s / (std::abs(held.axis_nm_s_per_n_s[i]) * impulse);
    if (!(may_hold_m_s[i] >= 0.0)) may_hold_m_s[i] = 0.0;
    if (kIdle * may_hold_m_s[i] > blow.top_speed_m_s) idle_ |= 1U << i;
  }
  std::uint32_t candidates = 0;
  std::uint32_t fixed = 0;
  if (request_.passive) {
    fixed = *request_.passive & all();
  } else if (request_.mode == PassiveMode::always) {
    fixed = all();
  } else if (request_.mode != PassiveMode::never) {
    candidates = all();
  }
  weighed_.clear();
  const auto enter = [&](const SelectionBlow& s) {
    Weighed w;
    w.passive = s.passive;
    w.impulse_n_s_per_m_s = s.impulse_n_s(1.0, request_.restitution, request_.nail_mass_kg);
    w.effective_mass_kg = 1.0 / s.mobility_per_kg;
    w.allowed_m_s = w.considerate_m_s = kInfinity;
    w.load_ratio_per_n_s = 0.0;
    for (int i = 0; i < dof(); ++i) {
      const ImpulseLimits& limits = joint_[at(i)].limits;
      const double load = std::abs(s.axis_nm_s_per_n_s[i]);
      const bool passive = (s.passive >> i & 1U) != 0;
      w.load_ratio_per_n_s = std::max(w.load_ratio_per_n_s, load / limits.rated_nm_s);
      const double per_speed = load * w.impulse_n_s_per_m_s;
      if (passive) w.needless_m_s = std::max(w.needless_m_s, may_hold_m_s[i]);
      if (!passive) w.considerate_m_s = std::min(w.considerate_m_s, limits.rated_nm_s / per_speed);
      double allowed = limits.repeated_nm_s / per_speed;
      if ((candidates >> i & 1U) != 0 && passive && drop[i] > robot_.joints[at(i)].control.max_passive_travel_rad) {
        allowed = 0.0;
      }
      if (allowed < w.allowed_m_s) {
        w.allowed_m_s = allowed;
        w.limiting_joint = i;
      }
    }
    if (!std::isfinite(w.impulse_n_s_per_m_s)) w.allowed_m_s = 0.0;
    w.wanted_m_s = blow.top_speed_m_s;
    if (request_.wanted_penetration_m > 0.0 && std::isfinite(request_.nail_mass_kg)) {
      const double impulse = request_.wanted_penetration_m * request_.nail_mass_kg / request_.contact_duration_s;
      w.wanted_m_s =
          std::clamp(impulse / w.impulse_n_s_per_m_s, kLeastSpeedShare * blow.top_speed_m_s, blow.top_speed_m_s);
    }
    weighed_.push_back(w);
  };
  if (!around || candidates == 0) {
    sweep.for_each(candidates, fixed, enter);
    return;
  }
  enter(sweep.at(*around));
  for (int i = 0; i < dof(); ++i) enter(sweep.at(*around ^ (1U << i)));
}

/// The best of weighed_, and its speed. Null: none stays below the repeated peaks at a speed worth striking with.
const Weighed* Planner::choose(Blow& blow, double slower) const {
  double reach = 0.0;  // largest share of the wanted speed that any selection stands
  for (const Weighed& w : weighed_) {
    reach = std::max(reach, std::min((1.0 - kRounding) * w.allowed_m_s / w.wanted_m_s, slower));
  }
  if (!(reach >= kLeastSpeedShare)) {
    const Weighed& sturdiest =
        *std::max_element(weighed_.begin(), weighed_.end(),
                          [](const Weighed& a, const Weighed& b) { return a.allowed_m_s < b.allowed_m_s; });
    blow.speed_m_s = kLeastSpeedShare * sturdiest.wanted_m_s;
    if (sturdiest.allowed_m_s > 0.0) {
      const int i = sturdiest.limiting_joint;
      const double limit = joint_[at(i)].limits.repeated_nm_s;
      blow.why = fmt::format(
          "{} would carry {:.3f} N m s, repeated peak allows {:.3f} (passive: {}, at {:.3f} m/s, the slowest blow "
          "worth "
          "striking here)",
          robot_.joints[at(i)].name, limit * blow.speed_m_s / sturdiest.allowed_m_s, limit,
          names(robot_, sturdiest.passive), blow.speed_m_s);
    } else {
      blow.why = "the arm could not yield to the blow, or its passive joints would fall too far";
    }
    return nullptr;
  }
  const auto feasible = [&](const Weighed& w) { return w.allowed_m_s >= (1.0 - 1e-9) * reach * w.wanted_m_s; };
  const auto overloads = [&](const Weighed& w) { return reach * w.wanted_m_s > w.considerate_m_s; };
  const auto needless = [&](const Weighed& w) { return reach * w.wanted_m_s <= w.needless_m_s; };
  // Whoever would carry more than rated while active goes passive if anything helps, and nobody else; after that the
  // lightest load wins.
  const auto better = [&](const Weighed& a, const Weighed& b) {
    if (overloads(a) != overloads(b)) return overloads(b);
    if (needless(a) != needless(b)) return needless(b);
    return a.load_ratio_per_n_s < b.load_ratio_per_n_s;
  };
  const Weighed* best = nullptr;
  for (const Weighed& w : weighed_) {
    if (feasible(w) && (best == nullptr || better(w, *best))) best = &w;
  }
  if (best == nullptr) return nullptr;
  const double tie = (1.0 + kTie) * best->load_ratio_per_n_s;
  const bool overloaded = overloads(*best);
  const bool idle = needless(*best);
  for (const Weighed& w : weighed_) {
    if (!feasible(w) || overloads(w) != overloaded || needless(w) != idle || !(w.load_ratio_per_n_s <= tie)) continue;
    const int fewer = std::popcount(best->passive) - std::popcount(w.passive);
    if (fewer > 0 || (fewer == 0 && w.load_ratio_per_n_s < best->load_ratio_per_n_s)) best = &w;
  }
  blow.wanted_speed_m_s = best->wanted_m_s;
  blow.speed_m_s = reach * best->wanted_m_s;
  return best;
}

double Planner::measure_of(const Blow& blow, const ChainPose& pose) const {
  switch (request_.measure) {
    case StrikeMeasure::load_ratio:
      return blow.chosen.load_ratio_per_n_s;
    case StrikeMeasure::internal_impact:
      return internal_impact_measure(chain_, pose, chain_.reach_m(), request_.rotors, request_.formulation).w_ii;
    case StrikeMeasure::effective_mass:
      return blow.chosen.effective_mass_kg;
  }
  return kInfinity;
}

/// How far the joint that travels most can swing back within the limits, rad, at most what the task asks.
double Planner::room_for_back_swing(const Blow& blow) const {
  const double fastest = largest_magnitude(blow.unit);
  double room = robot_.task.back_swing_rad;
  for (int i = 0; i < dof(); ++i) {
    const double share = std::abs(blow.unit[i]) / fastest;
    if (!(share > 1e-9)) continue;
    const double left =
        blow.unit[i] > 0.0 ? blow.pose.q[i] - limits_.lower_rad[i] : limits_.upper_rad[i] - blow.pose.q[i];
    room = std::min(room, left / share);
  }
  return std::max(room, 0.0);
}

/// Velocity, selection and measure of a pose; as fast as the gears stand it, `slower` times what is wanted at the most.
void Planner::weigh(Blow& blow, double slower, std::optional<std::uint32_t> around) {
  blow.feasible = false;
  blow.why.clear();
  const ChainPose pose = chain_.pose(blow.pose.q);
  if (below_board(pose)) {
    blow.why = "a link would be inside the board in this pose";
    return;
  }
  blow.unit = unit_strike_velocity(chain_.jacobian(pose), request_.normal, speed_limit_);
  if (blow.unit.isZero()) {
    blow.why = "the face cannot move along the nail in this pose";
    return;
  }
  blow.top_speed_m_s = kInfinity;
  for (int i = 0; i < dof(); ++i) {
    if (blow.unit[i] != 0.0)
      blow.top_speed_m_s = std::min(blow.top_speed_m_s, speed_limit_[i] / std::abs(blow.unit[i]));
  }
  blow.back_swing_rad = room_for_back_swing(blow);
  const SelectionSweep sweep(chain_, pose, request_.normal, controlled_inertia_, request_.rotors, request_.formulation);
  if (!sweep.usable()) {
    blow.why = "the impulse of this pose cannot be computed";
    return;
  }
  weigh_selections(blow, pose, sweep, around);
  const Weighed* best = choose(blow, slower);
  if (best == nullptr) return;
  blow.chosen = *best;
  blow.passive = best->passive;
  blow.qd = blow.unit * blow.speed_m_s;
  blow.measure = measure_of(blow, pose);
  blow.feasible = std::isfinite(blow.measure);
  if (!blow.feasible) blow.why = "the predicted impulse is not usable";
}

/// Loads of every joint at the speed chosen: all free, held, and as planned.
void Planner::detail(Blow& blow) {
  ImpactInput input;
  input.q = blow.pose.q;
  input.qd = blow.qd;
  input.normal = request_.normal;
  input.restitution = request_.restitution;
  input.nail_mass_kg = request_.nail_mass_kg;
  input.rotor_model = request_.rotors;
  input.formulation = request_.formulation;
  for (int i = 0; i < dof(); ++i) {
    if ((blow.passive >> i & 1U) == 0) input.joints[at(i)] = {JointHold::controlled, controlled_inertia_[at(i)]};
  }
  blow.prediction = predict(chain_, input);
  blow.loads = joint_;
  const SelectionSweep sweep(chain_, chain_.pose(blow.pose.q), request_.normal, controlled_inertia_, request_.rotors,
                             request_.formulation);
  const auto load = [&](const SelectionBlow& s, int i) {
    const double impulse = s.impulse_n_s(blow.speed_m_s, request_.restitution, request_.nail_mass_kg);
    return std::isfinite(impulse) ? std::abs(s.axis_nm_s_per_n_s[i]) * impulse : kInfinity;
  };
  const SelectionBlow free = sweep.at(all());
  for (int i = 0; i < dof(); ++i) {
    JointLoad& joint = blow.loads[at(i)];
    joint.free_nm_s = load(free, i);
    joint.held_nm_s = load(sweep.held(i), i);
    joint.decision = decide_mode(joint.held_nm_s, joint.free_nm_s, joint.limits);
    joint.planned_nm_s = std::abs(blow.prediction.axis_impulse_nm_s[i]);
  }
}

const Weighed& Planner::weighed_of(std::uint32_t passive) const {
  return *std::lower_bound(weighed_.begin(), weighed_.end(), passive,
                           [](const Weighed& w, std::uint32_t p) { return w.passive < p; });
}

/// Why a selection may not be taken at the speed of `blow`; empty: it may.
std::string Planner::why_not(const Weighed& w, const Blow& blow) const {
  const double speed = blow.speed_m_s / blow.wanted_speed_m_s * w.wanted_m_s;
  const std::string& joint = robot_.joints[at(w.limiting_joint)].name;
  if (!std::isfinite(w.impulse_n_s_per_m_s)) return "the arm could not yield";
  if (!(w.allowed_m_s > 0.0)) return fmt::format("{} would fall too far", joint);
  if (!(w.allowed_m_s >= (1.0 - 1e-9) * speed)) {
    const double limit = joint_[at(w.limiting_joint)].limits.repeated_nm_s;
    return fmt::format("{} would carry {:.3f} N m s, repeated peak allows {:.3f}", joint, limit * speed / w.allowed_m_s,
                       limit);
  }
  return {};
}

/// An instant does not tell what a contact of a tenth of a second does to a gear: control, gravity, friction and what
/// it carried before count as much as the blow. So every selection that stands the speed is predicted over the contact,
/// with the motion as planned, and the one with the lowest peaks per newton second is taken. Weighs the pose weighed
/// last, which must be `blow`.
std::optional<Obstacle> Planner::settle_selection(Blow& blow, StrikePlan& plan) {
  ranked_.clear();
  if (!arm_) return std::nullopt;
  std::sort(weighed_.begin(), weighed_.end(), [](const Weighed& a, const Weighed& b) { return a.passive < b.passive; });
  const ChainPose pose = chain_.pose(blow.pose.q);
  const SelectionSweep sweep(chain_, pose, request_.normal, controlled_inertia_, request_.rotors, request_.formulation);
  const JointVector fall = falls(pose);
  plan.q_impact = blow.pose.q;
  plan.qd_impact = blow.qd;
  plan.normal = request_.normal;
  const PredictInput swing = predict_input(plan, request_.contact);

  // Where the request leaves nothing open there is one set; else every one without idle joints.
  const bool open = weighed_.size() > 1;
  const std::uint32_t fixed = open ? 0U : blow.passive;
  const auto input = [&](std::uint32_t chosen) -> std::optional<PredictInput> {
    const std::uint32_t passive = chosen | fixed;
    if (open && !why_not(weighed_of(passive), blow).empty()) return std::nullopt;
    if (open && passive != 0 && plan.contact_time < seconds(kLeastArmingS)) return std::nullopt;
    const SelectionBlow instant = sweep.at(passive);
    const double impulse = instant.impulse_n_s(blow.speed_m_s, request_.restitution, request_.nail_mass_kg);
    const SwitchTimes times = switch_times(blow, passive, impulse * instant.delta_qd_per_n_s, fall, plan.contact_time);
    PredictInput in = swing;
    for (int i = 0; i < dof(); ++i) {
      in.joints[at(i)] = (passive >> i & 1U) != 0 ? JointHold::free : JointHold::controlled;
    }
    in.switch_lead_s = times.lead_s;
    in.passive_s = passive != 0 ? times.passive_s : 1.0;
    return in;
  };
  std::array<double, kMaxJoints> rated{};
  std::array<double, kMaxJoints> repeated{};
  for (int i = 0; i < dof(); ++i) {
    rated[at(i)] = robot_.joints[at(i)].transmission.rated_nm;
    repeated[at(i)] = robot_.joints[at(i)].transmission.repeated_peak_nm;
  }
  const SelectionContest contest{.arm = *arm_,
                                 .blow = input,
                                 .rated_nm = {rated.data(), at(dof())},
                                 .repeated_nm = {repeated.data(), at(dof())},
                                 .candidates = open ? all() & ~idle_ : 0U,
                                 .tie = kTie};
  ranked_ = rank_selections(contest, std::array{blow.passive});
  const bool predicted = std::any_of(ranked_.begin(), ranked_.end(), [](const auto& r) { return r.peak_ratio > 0.0; });
  if (!predicted) {
    ranked_.clear();  // no model sees it hit: what the instant says stands
    return std::nullopt;
  }
  const RankedSelection& best = ranked_.front();
  if (!best.feasible) {
    return Obstacle{fmt::format("{} would carry {:.1f} Nm, repeated peak allows {:.1f} Nm (passive: {}, at {:.3f} m/s)",
                                robot_.joints[at(best.heaviest)].name, best.heaviest_nm, repeated[at(best.heaviest)],
                                names(robot_, best.passive), blow.speed_m_s),
                    true};
  }
  if (open) blow.chosen = weighed_of(best.passive);
  blow.passive = best.passive;
  return std::nullopt;
}

/// The selections of the pose settled last, which must be `blow`: the chosen one, then the lightest of the others, then
/// those that could not be taken.
void Planner::explain_selections(const Blow& blow, StrikePlan& plan) {
  constexpr std::size_t kListed = 16;
  plan.selections_weighed = static_cast<int>(weighed_.size());
  std::vector<SelectionCandidate>& list = plan.selections;
  if (!ranked_.empty()) {
    const RankedSelection& best = ranked_.front();
    for (const RankedSelection& r : ranked_) {
      if (list.size() == kListed) return;
      SelectionCandidate& c = list.emplace_back();
      c.passive = r.passive;
      c.model = r.model;
      c.feasible = r.feasible;
      c.load_ratio_per_n_s = r.peak_ratio_per_n_s;
      c.impulse_n_s = r.impulse_n_s;
      c.switch_lead_s = r.switch_lead_s;
      c.passive_s = r.passive_s;
      if (&r == &best) {
        c.note = "chosen";
      } else if (!r.feasible && !(r.peak_ratio > 0.0)) {
        c.note = "would not hit";
      } else if (!r.feasible) {
        const JointDescription& joint = robot_.joints[at(r.heaviest)];
        c.note = fmt::format("{} would carry {:.1f} Nm, repeated peak allows {:.1f} Nm", joint.name, r.heaviest_nm,
                             joint.transmission.repeated_peak_nm);
      } else if (r.peak_ratio_per_n_s <= (1.0 + kTie) * best.peak_ratio_per_n_s) {
        c.note = "no lighter, and not fewer joints passive";
      } else {
        c.note = fmt::format("loads {:.2f} times the best", r.peak_ratio_per_n_s / best.peak_ratio_per_n_s);
      }
    }
  }
  // By the instant: all there is to say with the equations as printed, and of selections that could not be taken.
  const auto known = [&](const Weighed& w) {
    return std::any_of(ranked_.begin(), ranked_.end(), [&](const auto& r) { return r.passive == w.passive; });
  };
  std::vector<const Weighed*> others;
  for (const Weighed& w : weighed_) {
    if (!known(w)) others.push_back(&w);
  }
  const double chosen_ratio = blow.chosen.load_ratio_per_n_s;
  const auto before = [&](const Weighed* a, const Weighed* b) {
    if ((a->passive == blow.passive) != (b->passive == blow.passive)) return a->passive == blow.passive;
    if (a->load_ratio_per_n_s != b->load_ratio_per_n_s) return a->load_ratio_per_n_s < b->load_ratio_per_n_s;
    return a->passive < b->passive;
  };
  const std::size_t room = std::min(kListed - list.size(), others.size());
  std::partial_sort(others.begin(), others.begin() + static_cast<std::ptrdiff_t>(room), others.end(), before);
  for (std::size_t k = 0; k < room; ++k) {
    const Weighed& w = *others[k];
    const double speed = blow.speed_m_s / blow.wanted_speed_m_s * w.wanted_m_s;
    SelectionCandidate& c = list.emplace_back();
    c.passive = w.passive;
    c.note = why_not(w, blow);
    c.feasible = c.note.empty();
    c.load_ratio_per_n_s = w.load_ratio_per_n_s;
    c.impulse_n_s = w.impulse_n_s_per_m_s * speed;
    if (!c.feasible) continue;
    if (w.passive == blow.passive) {
      c.note = "chosen";
    } else if (!ranked_.empty()) {
      c.note = "a joint would be passive without need";
    } else {
      c.note = fmt::format("loads {:.2f} times the chosen one, by the instant", w.load_ratio_per_n_s / chosen_ratio);
    }
  }
}

/// Best first; those as good as the best to within a tie by the least travel (the order of the inverse kinematics).
std::vector<std::size_t> Planner::ranked(const std::vector<Blow>& blows) const {
  std::vector<std::size_t> order;
  for (std::size_t k = 0; k < blows.size(); ++k) {
    if (blows[k].feasible) order.push_back(k);
  }
  if (order.empty()) return order;
  const auto better = [&](std::size_t a, std::size_t b) {
    return smaller_is_better() ? blows[a].measure < blows[b].measure : blows[a].measure > blows[b].measure;
  };
  std::stable_sort(order.begin(), order.end(), better);
  const double best = blows[order.front()].measure;
  const auto ties = std::find_if(order.begin(), order.end(), [&](std::size_t k) {
    return !(std::abs(blows[k].measure - best) <= kTie * std::abs(best));
  });
  std::sort(order.begin(), ties);
  return order;
}

/// Along the null space of the best poses to better ones, which join the others: a search without derivatives, because
/// the measure is a largest of loads under a best of selections.
void Planner::improve(const FaceTarget& target, std::vector<Blow>& blows) {
  constexpr std::size_t kStarts = 6;
  constexpr int kAllSelectionsInSearch = 10;
  const auto cost = [&](const Blow& blow) {
    if (!blow.feasible) return 1e3;
    const double value = std::log(blow.measure);
    return (smaller_is_better() ? value : -value) +
           kRoomMatters * (1.0 - blow.back_swing_rad / robot_.task.back_swing_rad);
  };
  std::vector<std::size_t> order = ranked(blows);
  std::stable_sort(order.begin(), order.end(),
                   [&](std::size_t a, std::size_t b) { return cost(blows[a]) < cost(blows[b]); });
  if (order.size() > kStarts) order.resize(kStarts);
  const NullSpaceSearch search(robot_, chain_, target);
  std::vector<Blow> found;
  for (const std::size_t k : order) {
    Blow trial;
    // With many joints all selections cost more than the search can bear; on the way the best of neighbours leads.
    std::optional<std::uint32_t> around;
    if (dof() > kAllSelectionsInSearch) around = blows[k].passive;
    const auto cost_at = [&](const FaceSolution& pose) {
      trial.pose = pose;
      weigh(trial, 1.0, around);
      return cost(trial);
    };
    const auto better = search.improve(blows[k].pose, cost_at);
    if (!better) continue;
    Blow& blow = found.emplace_back();
    blow.pose = *better;
    weigh(blow);
    if (!blow.feasible || !(cost(blow) < cost(blows[k]) - kTie)) found.pop_back();
  }
  for (Blow& blow : found) blows.push_back(std::move(blow));
}

/// How far the face centre is past the head, m, along -normal.
double Planner::depth(const JointVector& q) const {
  return request_.normal.dot(request_.head_position_m - chain_.face_pose(q).position_m);
}

/// Whether a link is below the board's surface where the board is: points on the lines from joint to joint to face.
bool Planner::below_board(const ChainPose& pose) const {
  constexpr int kPoints = 8;
  const auto below = [&](const Eigen::Vector3d& point) {
    const Eigen::Vector3d off = point - request_.head_position_m;
    const double height = request_.normal.dot(off);
    return height < -request_.board_distance_m - 1e-3 && (off - request_.normal * height).norm() < kBoardRadiusM;
  };
  for (int i = 0; i < dof(); ++i) {
    const Eigen::Vector3d& from = pose.link[at(i)].position_m;
    const Eigen::Vector3d& to = i + 1 < dof() ? pose.link[at(i + 1)].position_m : pose.face.position_m;
    for (int k = 0; k < kPoints; ++k) {  // the end is the next link's beginning; the face is looked at on its own
      if (below(from + (to - from) * (static_cast<double>(k) / kPoints))) return true;
    }
  }
  return false;
}

/// Whether the face meets nail or board, or a link the board, before `until`. A motion that begins so may leave it.
bool Planner::collides(const JointTrajectory& trajectory, Duration until) const {
  JointMotion motion;
  bool was_clear = false;
  for (Duration t; t < until; t += grid_) {
    trajectory.sample(t, motion);
    const ChainPose pose = chain_.pose(motion.q);
    const Eigen::Vector3d off = pose.face.position_m - request_.head_position_m;
    const double height = request_.normal.dot(off);
    const double beside = (off - request_.normal * height).norm();
    const bool nail = height < -1e-5 && beside < robot_.hammer.face_radius_m + kNailClearanceM;
    const bool board = height < -request_.board_distance_m - 1e-5 && beside < kBoardRadiusM;
    const bool clear = !nail && !board && !below_board(pose);
    if (was_clear && !clear) return true;
    if (board && height < -request_.board_distance_m - kLeaveBoardM) return true;
    was_clear = was_clear || clear;
  }
  return false;
}

/// From the impact state to rest past the head. Speed falls as 1 - 3s^2 + 2s^3, so the way is half of speed times time.
std::optional<Obstacle> Planner::build_stop(const Blow& blow, StrikePlan& plan, Duration& stop) const {
  const JointVector& qd = blow.qd;
  const double cap = std::max(kMaxFollowThroughM, request_.follow_through_m);
  double least_s = 0.0;
  for (int i = 0; i < dof(); ++i) least_s = std::max(least_s, 1.5 * std::abs(qd[i]) / limits_.acceleration_rad_s2[i]);
  std::string why_longer = "stopping within the acceleration limits takes that much";
  LimitCheck last;
  for (std::int64_t knots = std::max<std::int64_t>(1, seconds(least_s) / grid_);; ++knots) {
    stop = grid_ * knots;
    const JointVector q_stop = blow.pose.q + qd * (0.5 * stop.seconds());
    const double reached = depth(q_stop);
    const bool turned = blow.speed_m_s * 0.5 * stop.seconds() > 4.0 * std::max(cap, 0.01);
    if (turned || reached > cap) {
      if (!last.ok()) return obstacle("no room to follow through: ", last, robot_);
      return Obstacle{fmt::format("the reference cannot follow through by {:.1f} mm along the nail here",
                                  1e3 * request_.follow_through_m)};
    }
    if (reached < request_.follow_through_m) continue;
    JointTrajectory trajectory({blow.pose.q, qd, JointVector::Zero(dof())});
    if (!trajectory.append(at_rest(q_stop), stop)) return Obstacle{"a trajectory could not be made"};
    const LimitCheck check = check_segment(robot_, chain_, limits_, trajectory, 0);
    if (!check.ok()) {
      last = check;
      if (check.worst == LimitKind::position) return obstacle("no room to follow through: ", check, robot_);
      if (check.worst != LimitKind::acceleration) why_longer = describe(check, robot_) + " if it stopped sooner";
      continue;
    }
    plan.q_stop = q_stop;
    plan.follow_through_m = reached;
    // One knot more than asked for is only the grid.
    if (reached > request_.follow_through_m + blow.speed_m_s * grid_.seconds()) {
      plan.follow_through_note =
          fmt::format("{:.1f} mm instead of {:.1f} mm: {}", 1e3 * reached, 1e3 * request_.follow_through_m, why_longer);
    } else {
      plan.follow_through_note.clear();
    }
    return std::nullopt;
  }
}

/// Back-swing start -> impact -> stop -> back-swing start, along one line in joint space.
std::optional<Obstacle> Planner::build_swing(const Blow& blow, StrikePlan& plan, Duration stop, double travel) const {
  const JointVector back = blow.qd / largest_magnitude(blow.qd);
  const JointVector q_start = blow.pose.q - travel * back;
  for (int i = 0; i < dof(); ++i) {
    if (q_start[i] >= limits_.lower_rad[i] && q_start[i] <= limits_.upper_rad[i]) continue;
    return Obstacle{
        fmt::format("no room for the back-swing: {} would have to start at {:.3f} rad, limits {:.3f} to {:.3f}",
                    robot_.joints[at(i)].name, q_start[i], limits_.lower_rad[i], limits_.upper_rad[i])};
  }
  // Holding still does not get easier by striking slower.
  for (const JointVector* rest : {&q_start, &std::as_const(plan.q_stop)}) {
    const LimitCheck check = check_torques_at(robot_, chain_, limits_, at_rest(*rest));
    if (!check.ok()) return Obstacle{"the arm cannot be held at an end of the swing: " + describe(check, robot_)};
  }
  const JointMotion impact{blow.pose.q, blow.qd, JointVector::Zero(dof())};
  LimitCheck why;
  const auto down =
      shortest_duration(robot_, chain_, limits_, at_rest(q_start), impact, grid_, seconds(kLongestSwingS), why);
  if (!down) return obstacle("the swing is not feasible: ", why, robot_);
  const auto up = shortest_duration(robot_, chain_, limits_, at_rest(plan.q_stop), at_rest(q_start), grid_,
                                    seconds(kLongestMotionS), why);
  if (!up) return obstacle("the return is not feasible: ", why, robot_);
  // A hurried swing must brake again before impact and leaves the arm ringing on the springs of its gears.
  const Duration in = std::max(*down, whole_knots(kEvenSwing * travel / largest_magnitude(blow.qd)));
  const Duration out = whole_knots(kUnhurried * up->seconds());
  if (in > seconds(kLongestSwingS)) {
    return Obstacle{
        fmt::format("the swing would take {:.0f} s at {:.4f} m/s, at most {:.0f} s are swung; raise "
                    "task.max_speed_share or lower task.impacts_over_momentary_peak",
                    in.seconds(), blow.speed_m_s, kLongestSwingS)};
  }
  if (blow.passive != 0 && in < seconds(kLeastArmingS)) {
    return Obstacle{
        fmt::format("contact would come {:.0f} ms after the start, but arming the switch needs {:.0f} ms; "
                    "raise task.back_swing",
                    1e3 * in.seconds(), 1e3 * kLeastArmingS)};
  }

  JointTrajectory strike(at_rest(q_start));
  if (!strike.append(impact, in) || !strike.append(at_rest(plan.q_stop), stop) ||
      !strike.append(at_rest(q_start), out)) {
    return Obstacle{"a trajectory could not be made"};
  }
  if (collides(strike, in)) return Obstacle{"the hammer would touch nail or board on the way in"};
  plan.strike = strike;
  plan.contact_time = in;
  plan.stop_time = in + stop;
  plan.q_back_swing = q_start;
  plan.back_swing_rad = travel;
  return std::nullopt;
}

/// Rest to rest; over a raised pose if the straight way in joint space meets nail or board.
std::optional<Obstacle> Planner::build_approach(StrikePlan& plan) const {
  MotionLimits limits = limits_;  // the arm may stand a little outside its limits; it must then come back in
  limits.lower_rad = limits.lower_rad.cwiseMin(request_.start);
  limits.upper_rad = limits.upper_rad.cwiseMax(request_.start);
  Obstacle why;
  const auto go = [&](JointTrajectory& way, const JointVector& q) {
    if (largest_magnitude(way.end().q - q) < 1e-9) return true;
    LimitCheck check;
    const auto time =
        shortest_duration(robot_, chain_, limits, way.end(), at_rest(q), grid_, seconds(kLongestMotionS), check);
    if (time && way.append(at_rest(q), whole_knots(kUnhurried * time->seconds()))) return true;
    why = {"the way to the back-swing is not feasible: " + describe(check, robot_)};
    return false;
  };
  JointTrajectory direct(at_rest(request_.start));
  if (!go(direct, plan.q_back_swing)) return why;
  if (!collides(direct, direct.duration())) {
    plan.approach = direct;
    return std::nullopt;
  }
  const JointVector ones = JointVector::Ones(dof());
  const JointVector lift = -unit_strike_velocity(chain_.jacobian(request_.start), request_.normal, ones);
  for (const double height_m : {0.05, 0.1, 0.2, 0.3}) {
    const JointVector raised = (request_.start + height_m * lift).cwiseMax(limits.lower_rad).cwiseMin(limits.upper_rad);
    JointTrajectory over(at_rest(request_.start));
    if (!go(over, raised) || !go(over, plan.q_back_swing)) continue;
    if (collides(over, over.duration())) continue;
    plan.approach = over;
    return std::nullopt;
  }
  return Obstacle{"the hammer would touch nail or board on its way from the present pose to the back-swing"};
}

std::optional<Obstacle> Planner::build_at_speed(const Blow& blow, StrikePlan& plan) const {
  Duration stop;
  if (auto why = build_stop(blow, plan, stop)) return why;
  std::optional<Obstacle> why;
  for (double share = 1.0; share >= kLeastBackSwingShare; share -= 0.25) {
    auto swing = build_swing(blow, plan, stop, share * robot_.task.back_swing_rad);
    if (!swing) return build_approach(plan);
    if (!why) why = swing;  // the reason that counts is the one against the full back-swing
  }
  return why;
}

/// Trajectories of a blow and its selection; slower if they ask too much of the joints. Returns why not.
std::optional<std::string> Planner::build(Blow& blow, StrikePlan& plan) {
  std::optional<std::string> first;
  weigh(blow, blow.speed_m_s / blow.wanted_speed_m_s);  // another pose may have been weighed since
  while (blow.feasible) {
    auto why = build_at_speed(blow, plan);
    if (!why) why = settle_selection(blow, plan);
    if (!why) {
      // The selection may need another speed for the penetration that is wanted.
      const double speed = blow.speed_m_s / blow.wanted_speed_m_s * blow.chosen.wanted_m_s;
      if (std::abs(speed - blow.speed_m_s) <= 1e-9 * speed) return std::nullopt;
      blow.speed_m_s = speed;
      blow.wanted_speed_m_s = blow.chosen.wanted_m_s;
      blow.qd = blow.unit * speed;
      why = build_at_speed(blow, plan);
      if (!why) return std::nullopt;
    }
    if (!first) first = why->sentence;
    if (!why->slower_helps) break;
    weigh(blow, kSlowDown * blow.speed_m_s / blow.wanted_speed_m_s);
  }
  return first;
}

/// A contact lasts long enough for gravity to count: active joints carry their share of the arm, passive ones lay it on
/// the nail, less the friction that is left. F n.J H^-1 J^T n = n.J H^-1 (g - tau_f) over the passive joints.
double Planner::weight_force(const Blow& blow) const {
  const ChainPose pose = chain_.pose(blow.pose.q);
  const JointVector g = chain_.gravity(pose);
  JointMatrix H = chain_.mass_matrix(pose) + chain_.reflected_inertia(pose, request_.rotors);
  JointVector limp = JointVector::Zero(dof());
  for (int i = 0; i < dof(); ++i) {
    const JointDescription& joint = robot_.joints[at(i)];
    if ((blow.passive >> i & 1U) == 0) {
      H(i, i) += blow.loads[at(i)].controlled_inertia_kg_m2;
      continue;
    }
    const double left_nm = joint.friction.coulomb_nm - joint.control.passive_compensation * joint.friction.static_nm;
    const double magnitude = std::max(std::abs(g[i]) - std::max(left_nm, 0.0), 0.0);
    limp[i] = g[i] > 0.0 ? -magnitude : magnitude;
  }
  const JointVector J_n = chain_.jacobian(pose).topRows<3>().transpose() * request_.normal;
  const Eigen::PartialPivLU<JointMatrix> solver(H);
  const JointVector per_force = solver.solve(J_n);
  const double mobility = J_n.dot(per_force);
  return mobility > 0.0 ? std::max(-per_force.dot(limp) / mobility, 0.0) : 0.0;
}

/// When `passive` is let go of before contact, and for how long. `fall` as falls() says.
Planner::SwitchTimes Planner::switch_times(const Blow& blow, std::uint32_t passive, const JointVector& delta_qd,
                                           const JointVector& fall, Duration contact_time) const {
  double blend_s = 0.0;
  double longest_s = kInfinity;
  for (int i = 0; i < dof(); ++i) {
    if ((passive >> i & 1U) == 0) continue;
    const ControlDescription& control = robot_.joints[at(i)].control;
    blend_s = std::max(blend_s, control.passive_blend_s);
    longest_s = std::min(longest_s, control.max_passive_s);
  }
  SwitchTimes times;
  // The blend must be over, and a knot has gone by, before contact.
  times.lead_s = std::min(std::max(robot_.task.switch_lead_s, blend_s + grid_.seconds()), contact_time.seconds());

  // Long enough for a contact longer than expected, short enough that no passive joint leaves its travel: it keeps the
  // speed of the swing up to contact, the predicted speed after it, and falls by what gravity exceeds friction.
  times.passive_s = std::min(times.lead_s + 1.6 * request_.contact_duration_s + 0.02, longest_s);
  for (int i = 0; i < dof(); ++i) {
    if ((passive >> i & 1U) == 0) continue;
    const double before = std::abs(blow.qd[i]) * times.lead_s;
    const double after = std::abs(blow.qd[i] + delta_qd[i]);
    const double most = 0.8 * robot_.joints[at(i)].control.max_passive_travel_rad;
    const auto travel = [&](double t) {
      return before + after * std::max(t - times.lead_s, 0.0) + 0.5 * fall[i] * t * t;
    };
    while (times.passive_s > times.lead_s && travel(times.passive_s) > most) times.passive_s -= 1e-3;
  }
  return times;
}

void Planner::time_the_switch(const Blow& blow, StrikePlan& plan) const {
  const SwitchTimes times =
      switch_times(blow, blow.passive, blow.prediction.delta_qd, falls(chain_.pose(blow.pose.q)), plan.contact_time);
  plan.switch_time = plan.contact_time - seconds(times.lead_s);
  plan.passive_time = blow.passive == 0 ? Duration{} : seconds(times.passive_s);
}

StrikePlan Planner::plan() {
  FaceTarget target;
  target.position_m = request_.head_position_m;
  target.normal = request_.normal;
  target.max_tilt_rad = robot_.hammer.max_tilt_rad;
  target.max_lateral_m = 0.25 * robot_.hammer.face_radius_m;
  IkOptions options;
  options.seed = request_.seed;
  const IkResult reach = solve_face_on_point(robot_, chain_, target, request_.start, options);
  if (reach.solutions.empty()) refuse("no strike: " + reach.why);

  std::vector<Blow> blows;
  for (const FaceSolution& solution : reach.solutions) {
    Blow& blow = blows.emplace_back();
    blow.pose = solution;
    weigh(blow);
  }
  if (dof() > 3) improve(target, blows);

  StrikePlan plan;
  const std::vector<std::size_t> order = ranked(blows);
  std::size_t chosen = blows.size();
  std::string first_reason;
  for (const std::size_t k : order) {
    const double measure_before = blows[k].measure;
    const auto why = build(blows[k], plan);
    if (!why) {
      chosen = k;
      break;
    }
    blows[k].measure = measure_before;
    blows[k].feasible = false;
    blows[k].why = *why;
    if (first_reason.empty()) first_reason = *why;
  }
  if (chosen == blows.size()) {
    if (first_reason.empty()) first_reason = blows.front().why;
    refuse(fmt::format("no strike on the head at ({:.4f}, {:.4f}, {:.4f}) m: of {} pose{} none is feasible; {}",
                       request_.head_position_m.x(), request_.head_position_m.y(), request_.head_position_m.z(),
                       blows.size(), blows.size() == 1 ? "" : "s", first_reason));
  }

  Blow& blow = blows[chosen];
  plan.q_impact = blow.pose.q;
  plan.qd_impact = blow.qd;
  detail(blow);
  explain_selections(blow, plan);
  plan.head_position_m = request_.head_position_m;
  plan.board_distance_m = request_.board_distance_m;
  plan.normal = request_.normal;
  const Eigen::Vector3d v = chain_.jacobian(blow.pose.q).topRows<3>() * blow.qd;
  plan.speed_m_s = -request_.normal.dot(v);
  plan.lateral_speed_m_s = (v + request_.normal * plan.speed_m_s).norm();
  plan.tilt_rad = blow.pose.tilt_rad;
  plan.lateral_m = blow.pose.lateral_error_m;
  plan.speed_reduction = blow.speed_m_s / blow.wanted_speed_m_s;
  plan.passive = blow.passive;
  plan.loads = blow.loads;
  plan.prediction = blow.prediction;
  plan.weight_force_n = weight_force(blow);
  // The reference's equations know only the instant.
  const double pressed_s = request_.formulation == Formulation::corrected ? request_.contact_duration_s : 0.0;
  plan.impulse_n_s = blow.prediction.impulse_n_s + plan.weight_force_n * pressed_s;
  plan.effective_mass_kg = blow.prediction.effective_mass_kg;
  plan.measure = request_.measure;
  plan.measure_value = blow.measure;
  time_the_switch(blow, plan);
  if (arm_) {
    plan.blow = predict(*arm_, predict_input(plan, request_.contact), PredictionModel::resolved);
    if (plan.blow.feasible && plan.blow.approaching) plan.impulse_n_s = plan.blow.impulse_n_s;
  }

  std::vector<std::size_t> listed = order;
  for (std::size_t k = 0; k < blows.size(); ++k) {
    if (std::find(order.begin(), order.end(), k) == order.end()) listed.push_back(k);
  }
  std::stable_partition(listed.begin(), listed.end(), [&](std::size_t k) { return blows[k].feasible; });
  for (const std::size_t k : listed) {
    Blow& other = blows[k];
    PoseCandidate& c = plan.poses.emplace_back();
    c.q = other.pose.q;
    c.tilt_rad = other.pose.tilt_rad;
    c.lateral_m = other.pose.lateral_error_m;
    c.speed_m_s = other.speed_m_s;
    c.passive = other.passive;
    c.measure = other.measure;
    c.back_swing_rad = other.back_swing_rad;
    c.feasible = other.feasible;
    c.load_share = JointVector::Zero(dof());
    if (other.qd.size() == dof()) {
      detail(other);
      for (int i = 0; i < dof(); ++i) {
        c.load_share[i] = other.loads[at(i)].planned_nm_s / other.loads[at(i)].limits.rated_nm_s;
      }
      c.impulse_n_s = other.prediction.impulse_n_s;
      c.swing_s = kEvenSwing * other.back_swing_rad / largest_magnitude(other.qd);
    }
    if (k == chosen) {
      c.back_swing_rad = plan.back_swing_rad;
      c.swing_s = plan.contact_time.seconds();
      c.note = "chosen";
    } else if (!other.feasible) {
      c.note = other.why;
    } else if (std::abs(c.measure - plan.measure_value) <= kTie * std::abs(plan.measure_value)) {
      c.note = "as good, but further from the present pose";
    } else {
      c.note = fmt::format("measure {:.4g} against {:.4g}", c.measure, plan.measure_value);
    }
  }

  // Over the contact if that was predicted, else of the instant.
  const bool over_contact = plan.blow.feasible && plan.blow.approaching;
  const auto share = [&](int i) {
    const JointLoad& load = plan.loads[at(i)];
    return over_contact ? plan.blow.peak_torque_nm[i] / robot_.joints[at(i)].transmission.rated_nm
                        : load.planned_nm_s / load.limits.rated_nm_s;
  };
  int heaviest = 0;
  for (int i = 1; i < dof(); ++i) {
    if (share(i) > share(heaviest)) heaviest = i;
  }
  plan.why = fmt::format(
      "Of {} pose{} this one serves best; at {:.3f} m/s{} the blow gives {:.2f} N s, passive: {}, and loads {} most, "
      "with {}{:.0f} % of {}.",
      blows.size(), blows.size() == 1 ? "" : "s", plan.speed_m_s,
      plan.speed_reduction < 0.999 ? fmt::format(" ({:.0f} % of the speed wanted)", 100.0 * plan.speed_reduction) : "",
      plan.impulse_n_s, names(robot_, plan.passive), robot_.joints[at(heaviest)].name,
      over_contact ? fmt::format("{:.1f} Nm at its peak, ", plan.blow.peak_torque_nm[heaviest]) : "",
      100.0 * share(heaviest), over_contact ? "its rated torque" : "what its rated torque allows");
  return plan;
}

}  // namespace

std::string validate_input(const RobotDescription& robot, const PlanInput& r) {
  if (!r.head_position_m.allFinite()) return "plan: head_position_m is not finite; give three numbers in m";
  if (!(std::abs(r.normal.norm() - 1.0) <= 1e-6)) {
    return fmt::format("plan: normal has length {:.6g}, must be 1", r.normal.norm());
  }
  const struct {
    const char* name;
    double value, low, high;
    const char* unit;
  } ranges[] = {{"board_distance_m", r.board_distance_m, 0.0, 1.0, "m"},
                {"restitution", r.restitution, 0.0, 1.0, "(no unit)"},
                {"nail_mass_kg", r.nail_mass_kg, 1e-6, kInfinity, "kg"},
                {"contact_duration_s", r.contact_duration_s, 1e-4, 1.0, "s"},
                {"follow_through_m", r.follow_through_m, 0.0, 0.2, "m"},
                {"speed_share", r.speed_share, 1e-3, 1.0, "(no unit)"},
                {"speed_factor", r.speed_factor, 1.0, 10.0, "(no unit)"},
                {"wanted_penetration_m", r.wanted_penetration_m, 0.0, 0.2, "m"}};
  for (const auto& [name, value, low, high, unit] : ranges) {
    if (value >= low && value <= high) continue;
    return fmt::format("plan: {} is {:.6g} {}, allowed {:.6g} to {:.6g} {}", name, value, unit, low, high, unit);
  }
  if (r.start.size() != robot.dof()) {
    return fmt::format("plan: start has {} joints, the robot has {}", r.start.size(), robot.dof());
  }
  if (!r.start.allFinite()) return "plan: start is not finite; give one angle in rad per joint";
  if (r.passive && (*r.passive >> robot.dof()) != 0) {
    return fmt::format("plan: passive is {:#x}, a joint the robot with its {} joints does not have", *r.passive,
                       robot.dof());
  }
  return {};
}

JointVector unit_strike_velocity(const Jacobian& J_h, const Eigen::Vector3d& normal,
                                 const JointVector& qd_limits) noexcept {
  // min sum |x_i| + (v_lateral / v_normal)^2 / (2 kappa^2), x_i = qd_i relative to its limit, by iteratively reweighted
  // least squares. The first term leaves joints with a short lever at rest; the second is soft, so that a stretched
  // arm, which could only cancel a little sideways motion by a lot of joint motion, does not try.
  constexpr double kLateral = 0.05;
  constexpr double kSmooth = 1e-4;
  const Eigen::Index n = J_h.cols();
  const Eigen::Matrix3d across = Eigen::Matrix3d::Identity() - normal * normal.transpose();
  const JointVector J_n = -(J_h.topRows<3>().transpose() * normal);
  const double lever = largest_magnitude(J_n.cwiseProduct(qd_limits));
  if (!(lever > 1e-6)) return JointVector::Zero(n);
  const JointVector scale = qd_limits / lever;  // qd_i = scale_i x_i, x of the size of 1 for 1 m/s
  const JointVector b = J_n.cwiseProduct(scale);
  JointMatrix lateral(n, n);
  {
    Eigen::Matrix<double, 3, Eigen::Dynamic, 0, 3, kMaxJoints> J_l = across * J_h.topRows<3>();
    for (Eigen::Index i = 0; i < n; ++i) J_l.col(i) *= scale[i];
    lateral.noalias() = J_l.transpose().lazyProduct(J_l);
    lateral /= kLateral * kLateral;
  }
  JointVector weight = JointVector::Ones(n);
  JointVector x(n);
  for (int k = 0; k < 60; ++k) {
    JointMatrix A = lateral;
    A.diagonal() += weight;
    x = A.ldlt().solve(b);
    x /= b.dot(x);
    for (Eigen::Index i = 0; i < n; ++i) weight[i] = 1.0 / (std::abs(x[i]) + kSmooth);
  }
  const double largest = largest_magnitude(x);
  for (Eigen::Index i = 0; i < n; ++i) {
    if (std::abs(x[i]) < 2e-3 * largest) x[i] = 0.0;  // what the smoothing leaves of a joint at rest
  }
  x /= b.dot(x);
  if (!x.allFinite()) return JointVector::Zero(n);
  return x.cwiseProduct(scale);
}

StrikePlan plan(const RobotDescription& robot, const Chain& chain, const PlanInput& input) {
  const std::string complaint = validate_input(robot, input);
  if (!complaint.empty()) refuse(complaint);
  return Planner(robot, chain, input).plan();
}

PredictInput predict_input(const StrikePlan& plan, const ContactLaw& contact) noexcept {
  PredictInput in;
  in.q = plan.q_impact;
  in.qd = plan.qd_impact;
  in.normal = plan.normal;
  for (Eigen::Index i = 0; i < in.q.size(); ++i) {
    in.joints[at(static_cast<int>(i))] = (plan.passive >> i & 1U) != 0 ? JointHold::free : JointHold::controlled;
  }
  in.contact = contact;
  const double fastest = largest_magnitude(plan.qd_impact);
  if (fastest > 0.0) in.reference.travel_s = plan.back_swing_rad / fastest;
  in.reference.approach_s = plan.contact_time.seconds();
  in.reference.stop_s = (plan.stop_time - plan.contact_time).seconds();
  in.reference.return_s = (plan.strike.duration() - plan.stop_time).seconds();
  in.switch_lead_s = (plan.contact_time - plan.switch_time).seconds();
  in.passive_s = plan.passive != 0 ? plan.passive_time.seconds() : 1.0;
  return in;
}

namespace {

constexpr std::size_t kPosesShown = 8;
constexpr std::size_t kSelectionsShown = 8;
constexpr std::size_t kJointsALine = 8;

/// "APA": joint 1 first, A active, P passive.
std::string letters(std::uint32_t passive, int n) {
  std::string text;
  for (int i = 0; i < n; ++i) text += (passive >> i & 1U) != 0 ? 'P' : 'A';
  return text;
}

/// Numbers of all joints in columns, continued on lines of their own.
std::string columns_of(const std::string& label, const JointVector& values, double factor, int digits) {
  std::string text;
  for (Eigen::Index i = 0; i < values.size(); ++i) {
    if (static_cast<std::size_t>(i) % kJointsALine == 0)
      text += fmt::format("{}{:<14}", i == 0 ? "     " : "\n     ", i == 0 ? label : "");
    const double value = factor * values[i];
    const double shown = std::abs(value) < 0.5 * std::pow(10.0, -digits) ? 0.0 : value;  // no "-0.000"
    text += fmt::format("{:>7.{}f}", shown, digits);
  }
  return text + "\n";
}

}  // namespace

const char* unit_of(StrikeMeasure measure) noexcept {
  switch (measure) {
    case StrikeMeasure::load_ratio:
      return "1/(N s)";
    case StrikeMeasure::internal_impact:
      return "(no unit)";
    case StrikeMeasure::effective_mass:
      return "kg";
  }
  return "";
}

const char* describe(StrikeMeasure measure) noexcept {
  switch (measure) {
    case StrikeMeasure::load_ratio:
      return "largest load over rated per N s; least is best";
    case StrikeMeasure::internal_impact:
      return "internal impact measure (55); most is best";
    case StrikeMeasure::effective_mass:
      return "effective mass; most is best";
  }
  return "";
}

std::string report(const RobotDescription& robot, const StrikePlan& plan) {
  const int n = robot.dof();
  std::string text = plan.why + "\n\n";
  text += fmt::format("Poses, best first, by the impulse of an instant ({})\n", describe(plan.measure));
  text += fmt::format("  #  {:>10}  speed m/s  impulse N s  back-swing rad  swing s  S (P passive)\n",
                      fmt::format("{}", unit_of(plan.measure)));
  std::size_t shown = 0;
  for (const PoseCandidate& c : plan.poses) {
    if (++shown > kPosesShown) break;
    if (c.feasible) {
      text += fmt::format("{:>3}  {:>10.4g}  {:>9.3f}  {:>11.2f}  {:>14.2f}  {:>7.2f}  {}\n", shown, c.measure,
                          c.speed_m_s, c.impulse_n_s, c.back_swing_rad, c.swing_s, letters(c.passive, n));
    } else {
      text += fmt::format("{:>3}  not feasible\n", shown);
    }
    text += columns_of("q, rad", c.q, 1.0, 3);
    if (c.feasible) text += columns_of("load/rated, %", c.load_share, 100.0, 0);
    text += "     " + c.note + "\n";
  }
  if (plan.poses.size() > kPosesShown) text += fmt::format("     and {} more\n", plan.poses.size() - kPosesShown);

  text += "\nJoints of the chosen blow\n";
  text +=
      "                q'     limit  axis impulse, N m s, if  limits, N m s\n"
      "              rad/s   rad/s    free    held  planned    rated rep.peak  impact\n";
  for (int i = 0; i < n; ++i) {
    const JointLoad& load = plan.loads[at(i)];
    const bool passive = (plan.passive >> i & 1U) != 0;
    text += fmt::format("  {:<9} {:>7.3f} {:>7.3f} {:>7.3f} {:>7.3f}  {:>7.3f}  {:>7.3f}  {:>7.3f}  {}\n",
                        robot.joints[at(i)].name, plan.qd_impact[i], load.qd_limit_rad_s, load.free_nm_s,
                        load.held_nm_s, load.planned_nm_s, load.limits.rated_nm_s, load.limits.repeated_nm_s,
                        passive ? "passive" : "active");
  }
  const auto over_contact = std::count_if(plan.selections.begin(), plan.selections.end(),
                                          [](const auto& c) { return c.model != PredictionModel::instant; });
  text += fmt::format("\nSelections weighed: {}; load: largest {} over rated, per N s on the nail\n",
                      plan.selections_weighed, over_contact > 0 ? "peak torque predicted over the contact" : "impulse");
  text += "  S  load, 1/(N s)  blow, N s  predicted by\n";
  shown = 0;
  for (const SelectionCandidate& c : plan.selections) {
    if (++shown > kSelectionsShown) break;
    text += fmt::format("  {}  {:.4f}  {:.2f}  {}: {}\n", letters(c.passive, n), c.load_ratio_per_n_s, c.impulse_n_s,
                        describe(c.model), c.note);
  }
  if (plan.selections_weighed > static_cast<int>(kSelectionsShown)) {
    text += fmt::format("  and {} more\n", plan.selections_weighed - static_cast<int>(kSelectionsShown));
  }
  text += "\nMotion\n";
  text += fmt::format("  approach   {:.2f} s to the back-swing\n", plan.approach.duration().seconds());
  text += fmt::format("  swing      {:.2f} rad back, contact after {:.0f} ms, {}\n", plan.back_swing_rad,
                      1e3 * plan.contact_time.seconds(),
                      plan.passive == 0 ? std::string("nothing switches")
                                        : fmt::format("switch {:.0f} ms before it, passive at most {:.0f} ms",
                                                      1e3 * (plan.contact_time - plan.switch_time).seconds(),
                                                      1e3 * plan.passive_time.seconds()));
  text += fmt::format(
      "  face       {:.3f} m/s along the nail, {:.3f} m/s sideways, tilt {:.2f} deg, {:.2f} mm off centre\n",
      plan.speed_m_s, plan.lateral_speed_m_s, plan.tilt_rad * kDegrees, 1e3 * plan.lateral_m);
  text += fmt::format("  blow       {:.2f} N s in all: what drive and weight press while in contact is in it\n",
                      plan.impulse_n_s);
  text += fmt::format("             {:.2f} N s of the instant alone, effective mass {:.2f} kg\n",
                      plan.prediction.impulse_n_s, plan.effective_mass_kg);
  text += fmt::format("  follow     {:.1f} mm past the head{}{}\n", 1e3 * plan.follow_through_m,
                      plan.follow_through_note.empty() ? "" : ": ", plan.follow_through_note);
  text += fmt::format("  return     {:.2f} s\n", (plan.strike.duration() - plan.stop_time).seconds());
  return text;
}

}  // namespace mrr::sup
