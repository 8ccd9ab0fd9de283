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
#include "supervisor/strike/joint_norm.h"

namespace mrr::sup {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kTie = 0.02;                  // measures nearer than this share are equal
constexpr double kSlowDown = 0.9;              // one step of slowing down
constexpr double kLeastSpeedShare = 0.3;       // a blow slower than this share of what was wanted is not worth it
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

/// A pose that may be struck from, with everything known about it before trajectories.
struct Blow {
  FaceSolution pose;
  JointVector qd;
  double speed_m_s = 0.0;
  double wanted_speed_m_s = 0.0;
  std::uint32_t passive = 0;
  std::array<JointLoad, kMaxJoints> loads{};
  ImpactPrediction prediction;
  double measure = 0.0;
  std::vector<SelectionCandidate> selections;
  std::string why;  // if not feasible
  bool feasible = false;
};

class Planner {
 public:
  Planner(const RobotDescription& robot, const Chain& chain, const StrikeRequest& request)
      : robot_(robot), chain_(chain), request_(request), limits_(motion_limits(robot)), grid_(knot_period(robot)) {}

  StrikePlan plan();

 private:
  [[nodiscard]] int dof() const { return chain_.dof(); }
  [[nodiscard]] JointVector impact_speed_limits() const;
  [[nodiscard]] ImpactPrediction predict_with(const Blow& blow, const std::array<JointState, kMaxJoints>& joints) const;
  [[nodiscard]] std::array<JointState, kMaxJoints> states(const Blow& blow, std::uint32_t passive) const;
  void weigh(Blow& blow) const;
  bool select(Blow& blow) const;
  [[nodiscard]] double measure_of(const Blow& blow) const;
  [[nodiscard]] bool smaller_is_better() const { return request_.measure == StrikeMeasure::load_ratio; }
  [[nodiscard]] std::vector<std::size_t> ranked(const std::vector<Blow>& blows) const;

  std::optional<std::string> build(Blow& blow, StrikePlan& plan) const;
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
  void time_the_switch(const Blow& blow, StrikePlan& plan) const;

  const RobotDescription& robot_;
  const Chain& chain_;
  const StrikeRequest& request_;
  MotionLimits limits_;
  Duration grid_;
};

JointVector Planner::impact_speed_limits() const {
  JointVector qd(dof());
  const double share = robot_.task.max_speed_share * request_.speed_share;
  for (int i = 0; i < dof(); ++i) {
    // The design contact, not the learnt one: a soft nail's long contact is no reason to strike softer.
    const double by_gear = joint_speed_limit_rad_s(robot_.joints[at(i)], robot_.task.assumed_contact_s,
                                                   robot_.task.impacts_over_momentary_peak);
    qd[i] = share * std::min(by_gear, limits_.velocity_rad_s[i]);
  }
  return qd;
}

ImpactPrediction Planner::predict_with(const Blow& blow, const std::array<JointState, kMaxJoints>& joints) const {
  ImpactInput input;
  input.q = blow.pose.q;
  input.qd = blow.qd;
  input.normal = request_.normal;
  input.restitution = request_.restitution;
  input.nail_mass_kg = request_.nail_mass_kg;
  input.joints = joints;
  input.rotor_model = request_.rotors;
  input.formulation = request_.formulation;
  return predict(chain_, input);
}

std::array<JointState, kMaxJoints> Planner::states(const Blow& blow, std::uint32_t passive) const {
  std::array<JointState, kMaxJoints> joints{};
  for (int i = 0; i < dof(); ++i) {
    if ((passive >> i & 1U) == 0) joints[at(i)] = {JointHold::controlled, blow.loads[at(i)].controlled_inertia_kg_m2};
  }
  return joints;
}

/// Chooses the passive joints at this pose and speed. False: no selection stays below the repeated peak.
bool Planner::select(Blow& blow) const {
  const ImpactPrediction all_free = predict_with(blow, {});
  std::uint32_t candidates = 0;
  blow.selections.clear();
  blow.why.clear();
  for (int i = 0; i < dof(); ++i) {
    JointLoad& load = blow.loads[at(i)];
    const JointDescription& joint = robot_.joints[at(i)];
    std::array<JointState, kMaxJoints> held{};
    held[at(i)].hold = JointHold::held;
    const ImpactPrediction one_held = predict_with(blow, held);
    load.free_nm_s = all_free.feasible ? std::abs(all_free.axis_impulse_nm_s[i]) : kInfinity;
    load.held_nm_s = one_held.feasible ? std::abs(one_held.axis_impulse_nm_s[i]) : kInfinity;
    load.limits = impulse_limits(joint.transmission, request_.contact_duration_s);
    load.decision = decide_mode(load.held_nm_s, load.free_nm_s, load.limits);
    load.controlled_inertia_kg_m2 = controlled_extra_inertia(
        joint.control.position_gain_nm_rad, joint.control.velocity_gain_nm_s_rad, request_.contact_duration_s);
    if (load.decision == ModeDecision::refuse) {
      blow.why = fmt::format("{} would carry {:.3f} N m s even when free, repeated peak allows {:.3f}", joint.name,
                             load.free_nm_s, load.limits.repeated_nm_s);
    }
    if (load.decision != ModeDecision::active) candidates |= 1U << i;
  }
  if (!request_.passive && request_.mode == PassiveMode::planned && !blow.why.empty()) return false;

  std::array<double, kMaxJoints> rated{};
  for (int i = 0; i < dof(); ++i) rated[at(i)] = blow.loads[at(i)].limits.rated_nm_s;
  const std::span<const double> rated_limits(rated.data(), at(dof()));

  const auto weigh_selection = [&](std::uint32_t passive) {
    const ImpactPrediction prediction = predict_with(blow, states(blow, passive));
    SelectionCandidate c;
    c.passive = passive;
    c.impulse_n_s = prediction.impulse_n_s;
    c.load_ratio_per_n_s = load_ratio_per_impulse(prediction, rated_limits);
    c.feasible = prediction.feasible;
    for (int i = 0; c.feasible && i < dof(); ++i) {
      const double carried = std::abs(prediction.axis_impulse_nm_s[i]);
      const bool active = (passive >> i & 1U) == 0;
      if (active && carried > blow.loads[at(i)].limits.rated_nm_s) c.overloads_active = true;
      if (carried <= blow.loads[at(i)].limits.repeated_nm_s) continue;
      c.feasible = false;
      c.note = fmt::format("{} would carry {:.3f} N m s, repeated peak allows {:.3f}", robot_.joints[at(i)].name,
                           carried, blow.loads[at(i)].limits.repeated_nm_s);
    }
    if (!prediction.feasible) c.note = "the arm could not yield";
    blow.selections.push_back(c);
  };
  const std::uint32_t all = (1U << dof()) - 1U;
  if (request_.passive) {
    weigh_selection(*request_.passive);
  } else
    switch (request_.mode) {
      case PassiveMode::never:
        weigh_selection(0);
        break;
      case PassiveMode::always:
        weigh_selection(all);
        break;
      case PassiveMode::planned:
        // Every subset of the candidates, the empty one first.
        for (std::uint32_t subset = 0;; subset = (subset - candidates) & candidates) {
          weigh_selection(subset);
          if (subset == candidates) break;
        }
        break;
    }

  // Whoever would carry more than rated while active goes passive if anything helps; after that the lightest load wins.
  const auto better = [](const SelectionCandidate& a, const SelectionCandidate& b) {
    if (a.overloads_active != b.overloads_active) return b.overloads_active;
    return a.load_ratio_per_n_s < b.load_ratio_per_n_s;
  };
  const SelectionCandidate* best = nullptr;
  for (const SelectionCandidate& c : blow.selections) {
    if (c.feasible && (best == nullptr || better(c, *best))) best = &c;
  }
  if (best == nullptr) {
    blow.why = blow.selections.front().note;
    return false;
  }
  const double least = best->load_ratio_per_n_s;
  for (const SelectionCandidate& c : blow.selections) {
    const bool tie =
        c.feasible && c.overloads_active == best->overloads_active && c.load_ratio_per_n_s <= (1.0 + kTie) * least;
    if (tie && std::popcount(c.passive) < std::popcount(best->passive)) best = &c;
  }
  blow.passive = best->passive;
  for (SelectionCandidate& c : blow.selections) {
    if (&c == best) {
      c.note = "chosen";
    } else if (c.feasible && c.overloads_active && !best->overloads_active) {
      c.note = "a joint left active would carry more than its rated limit";
    } else if (c.feasible && c.load_ratio_per_n_s <= (1.0 + kTie) * least) {
      c.note = "no lighter, and not fewer joints passive";
    } else if (c.feasible) {
      c.note = fmt::format("loads {:.2f} times the best", c.load_ratio_per_n_s / least);
    }
  }
  blow.prediction = predict_with(blow, states(blow, blow.passive));
  for (int i = 0; i < dof(); ++i) {
    blow.loads[at(i)].planned_nm_s = std::abs(blow.prediction.axis_impulse_nm_s[i]);
  }
  return true;
}

double Planner::measure_of(const Blow& blow) const {
  switch (request_.measure) {
    case StrikeMeasure::load_ratio: {
      double ratio = 0.0;
      for (int i = 0; i < dof(); ++i) {
        ratio = std::max(ratio, blow.loads[at(i)].planned_nm_s / blow.loads[at(i)].limits.rated_nm_s);
      }
      return ratio / blow.prediction.impulse_n_s;
    }
    case StrikeMeasure::internal_impact:
      return internal_impact_measure(chain_, chain_.pose(blow.pose.q), chain_.reach_m(), request_.rotors,
                                     request_.formulation)
          .w_ii;
    case StrikeMeasure::effective_mass:
      return blow.prediction.effective_mass_kg;
  }
  return kInfinity;
}

/// Velocity, selection and measure of a pose; slows down until the gears stand it.
void Planner::weigh(Blow& blow) const {
  if (below_board(chain_.pose(blow.pose.q))) {
    blow.why = "a link would be inside the board in this pose";
    return;
  }
  const Jacobian J_h = chain_.jacobian(blow.pose.q);
  const JointVector limit = impact_speed_limits();
  const JointVector unit = unit_strike_velocity(J_h, request_.normal, limit);
  if (unit.isZero()) {
    blow.why = "the face cannot move along the nail in this pose";
    return;
  }
  double speed = kInfinity;
  for (int i = 0; i < dof(); ++i) {
    blow.loads[at(i)].qd_limit_rad_s = limit[i];
    if (std::abs(unit[i]) > 0.0) speed = std::min(speed, limit[i] / std::abs(unit[i]));
  }
  blow.wanted_speed_m_s = speed;
  for (double share = 1.0; share >= kLeastSpeedShare; share *= kSlowDown) {
    blow.speed_m_s = share * speed;
    blow.qd = unit * blow.speed_m_s;
    if (!select(blow)) continue;
    blow.measure = measure_of(blow);
    blow.feasible = std::isfinite(blow.measure);
    if (!blow.feasible) blow.why = "the predicted impulse is not usable";
    return;
  }
  blow.why += fmt::format(" (at {:.3f} m/s, the slowest blow worth striking here)", blow.speed_m_s);
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

/// Trajectories of a blow; slower if they ask too much of the joints. Returns why not.
std::optional<std::string> Planner::build(Blow& blow, StrikePlan& plan) const {
  std::optional<std::string> first;
  while (blow.speed_m_s >= kLeastSpeedShare * blow.wanted_speed_m_s) {
    const auto why = build_at_speed(blow, plan);
    if (!why) return std::nullopt;
    if (!first) first = why->sentence;
    if (!why->slower_helps) break;
    blow.qd *= kSlowDown * kSlowDown;
    blow.speed_m_s *= kSlowDown * kSlowDown;
    if (!select(blow)) break;
    blow.measure = measure_of(blow);
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

void Planner::time_the_switch(const Blow& blow, StrikePlan& plan) const {
  double blend_s = 0.0;
  double longest_s = kInfinity;
  for (int i = 0; i < dof(); ++i) {
    if ((blow.passive >> i & 1U) == 0) continue;
    const ControlDescription& control = robot_.joints[at(i)].control;
    blend_s = std::max(blend_s, control.passive_blend_s);
    longest_s = std::min(longest_s, control.max_passive_s);
  }
  // The blend must be over, and a knot has gone by, before contact.
  const double lead_s =
      std::min(std::max(robot_.task.switch_lead_s, blend_s + grid_.seconds()), plan.contact_time.seconds());
  plan.switch_time = plan.contact_time - seconds(lead_s);

  // Long enough for a contact longer than expected, short enough that no passive joint leaves its travel: it keeps the
  // speed of the swing up to contact, the predicted speed after it, and falls by what gravity exceeds friction.
  const ChainPose pose = chain_.pose(blow.pose.q);
  const JointVector g = chain_.gravity(pose);
  const JointMatrix M = chain_.mass_matrix(pose);
  double passive_s = std::min(lead_s + 1.6 * request_.contact_duration_s + 0.02, longest_s);
  for (int i = 0; i < dof(); ++i) {
    if ((blow.passive >> i & 1U) == 0) continue;
    const JointDescription& joint = robot_.joints[at(i)];
    const double left_nm = joint.friction.static_nm * (1.0 - joint.control.passive_compensation);
    const double fall = std::max(std::abs(g[i]) - left_nm, 0.0) / (M(i, i) + joint.reflected_inertia_kg_m2());
    const double before = std::abs(blow.qd[i]) * lead_s;
    const double after = std::abs(blow.qd[i] + blow.prediction.delta_qd[i]);
    const auto travel = [&](double t) { return before + after * std::max(t - lead_s, 0.0) + 0.5 * fall * t * t; };
    while (passive_s > lead_s && travel(passive_s) > 0.8 * joint.control.max_passive_travel_rad) passive_s -= 1e-3;
  }
  plan.passive_time = blow.passive == 0 ? Duration{} : seconds(passive_s);
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

  const Blow& blow = blows[chosen];
  plan.q_impact = blow.pose.q;
  plan.qd_impact = blow.qd;
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
  plan.selections = blow.selections;
  time_the_switch(blow, plan);

  for (std::size_t k = 0; k < blows.size(); ++k) {
    PoseCandidate& c = plan.poses.emplace_back();
    c.q = blows[k].pose.q;
    c.tilt_rad = blows[k].pose.tilt_rad;
    c.lateral_m = blows[k].pose.lateral_error_m;
    c.speed_m_s = blows[k].speed_m_s;
    c.passive = blows[k].passive;
    c.measure = blows[k].measure;
    c.feasible = blows[k].feasible;
    if (k == chosen) {
      c.note = "chosen";
    } else if (!blows[k].feasible) {
      c.note = blows[k].why;
    } else if (std::abs(c.measure - plan.measure_value) <= kTie * std::abs(plan.measure_value)) {
      c.note = "as good, but further from the present pose";
    } else {
      c.note = fmt::format("measure {:.4g} against {:.4g}", c.measure, plan.measure_value);
    }
  }

  int heaviest = 0;
  const auto share = [&](int i) { return plan.loads[at(i)].planned_nm_s / plan.loads[at(i)].limits.rated_nm_s; };
  for (int i = 1; i < dof(); ++i) {
    if (share(i) > share(heaviest)) heaviest = i;
  }
  plan.why = fmt::format(
      "Of {} pose{} this one serves best; at {:.3f} m/s{} the blow gives {:.2f} N s, passive: {}, and loads {} most, "
      "with "
      "{:.0f} % of what its rated torque allows.",
      blows.size(), blows.size() == 1 ? "" : "s", plan.speed_m_s,
      plan.speed_reduction < 0.999 ? fmt::format(" ({:.0f} % of the speed wanted)", 100.0 * plan.speed_reduction) : "",
      plan.impulse_n_s, names(robot_, plan.passive), robot_.joints[at(heaviest)].name, 100.0 * share(heaviest));
  return plan;
}

}  // namespace

void validate(const RobotDescription& robot, const StrikeRequest& r) {
  if (!r.head_position_m.allFinite()) refuse("strike request: head_position_m is not finite");
  if (!(std::abs(r.normal.norm() - 1.0) <= 1e-6)) {
    refuse(fmt::format("strike request: normal has length {:.6g}, must be 1", r.normal.norm()));
  }
  const auto in_range = [](const char* name, double value, double low, double high, const char* unit) {
    if (!(value >= low && value <= high)) {
      refuse(fmt::format("strike request: {} is {:.6g} {}, allowed {:.6g} to {:.6g} {}", name, value, unit, low, high,
                         unit));
    }
  };
  in_range("board_distance_m", r.board_distance_m, 0.0, 1.0, "m");
  in_range("restitution", r.restitution, 0.0, 1.0, "(no unit)");
  in_range("nail_mass_kg", r.nail_mass_kg, 1e-6, kInfinity, "kg");
  in_range("contact_duration_s", r.contact_duration_s, 1e-4, 1.0, "s");
  in_range("follow_through_m", r.follow_through_m, 0.0, 0.2, "m");
  in_range("speed_share", r.speed_share, 1e-3, 1.0, "(no unit)");
  if (r.start.size() != robot.dof()) {
    refuse(fmt::format("strike request: start has {} joints, the robot has {}", r.start.size(), robot.dof()));
  }
  if (!r.start.allFinite()) refuse("strike request: start is not finite");
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

StrikePlan plan_strike(const RobotDescription& robot, const Chain& chain, const StrikeRequest& request) {
  validate(robot, request);
  return Planner(robot, chain, request).plan();
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

std::string report(const RobotDescription& robot, const StrikePlan& plan) {
  const int n = robot.dof();
  const auto list = [](const JointVector& v, double factor) {
    std::string text;
    for (Eigen::Index i = 0; i < v.size(); ++i) text += fmt::format("{}{:.4f}", i == 0 ? "" : " ", factor * v[i]);
    return text;
  };
  const auto measure_name = [&] {
    switch (plan.measure) {
      case StrikeMeasure::load_ratio:
        return "load/rated per N s, least is best";
      case StrikeMeasure::internal_impact:
        return "internal impact measure (55), most is best";
      case StrikeMeasure::effective_mass:
        return "effective mass (kg), most is best";
    }
    return "";
  };
  const auto decision_name = [](ModeDecision d) {
    switch (d) {
      case ModeDecision::active:
        return "active";
      case ModeDecision::passive:
        return "passive";
      case ModeDecision::refuse:
        return "refuse";
    }
    return "";
  };
  std::string text = plan.why + "\n";
  text += fmt::format("  impact      q [{}] rad, q' [{}] rad/s\n", list(plan.q_impact, 1.0), list(plan.qd_impact, 1.0));
  text +=
      fmt::format("  face        {:.3f} m/s along the nail, {:.3f} sideways, tilt {:.2f} deg, {:.2f} mm off centre\n",
                  plan.speed_m_s, plan.lateral_speed_m_s, plan.tilt_rad * kDegrees, 1e3 * plan.lateral_m);
  text += fmt::format("  blow        {:.3f} N s, effective mass {:.2f} kg; measure {:.4g} ({})\n", plan.impulse_n_s,
                      plan.effective_mass_kg, plan.measure_value, measure_name());
  text += fmt::format(
      "  motion      back-swing {:.3f} rad, contact after {:.0f} ms, switch after {:.0f} ms, passive at most {:.0f} "
      "ms\n",
      plan.back_swing_rad, 1e3 * plan.contact_time.seconds(), 1e3 * plan.switch_time.seconds(),
      1e3 * plan.passive_time.seconds());
  text += fmt::format("  follow      {:.1f} mm past the head{}{}\n", 1e3 * plan.follow_through_m,
                      plan.follow_through_note.empty() ? "" : ": ", plan.follow_through_note);
  text += "  loads, N m s  free    held    planned rated   repeated table    planned\n";
  for (int i = 0; i < n; ++i) {
    const JointLoad& load = plan.loads[at(i)];
    text += fmt::format("  {:<11} {:<7.4f} {:<7.4f} {:<7.4f} {:<7.4f} {:<8.4f} {:<8} {}\n", robot.joints[at(i)].name,
                        load.free_nm_s, load.held_nm_s, load.planned_nm_s, load.limits.rated_nm_s,
                        load.limits.repeated_nm_s, decision_name(load.decision),
                        (plan.passive >> i & 1U) != 0 ? "passive" : "active");
  }
  text += "  selections\n";
  for (const SelectionCandidate& c : plan.selections) {
    text += fmt::format("    passive {:<24} {:.4f} per N s, {:.3f} N s: {}\n", names(robot, c.passive),
                        c.load_ratio_per_n_s, c.impulse_n_s, c.note);
  }
  text += "  poses\n";
  for (const PoseCandidate& c : plan.poses) {
    text += fmt::format("    q [{}] measure {:.4g}, {:.3f} m/s, tilt {:.2f} deg, passive {}: {}\n", list(c.q, 1.0),
                        c.measure, c.speed_m_s, c.tilt_rad * kDegrees, names(robot, c.passive), c.note);
  }
  return text;
}

}  // namespace mrr::sup
