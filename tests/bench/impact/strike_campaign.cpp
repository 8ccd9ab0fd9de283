// How well blows are predicted: seeded strikes all over the workspace, each run in the emulator with the real modules,
// supervisor and wire, each predicted by every model. One row per strike and joint, as CSV;
// strike_table.py makes the table of docs/impulse_prediction.md from it.

#include <fmt/format.h>
#include <fmt/ostream.h>

#include <CLI/CLI.hpp>
#include <chrono>
#include <cmath>
#include <fstream>
#include <map>
#include <numbers>
#include <optional>
#include <sstream>
#include <string>

#include "common/core/random.h"
#include "common/robot/errors.h"
#include "sim_vcan/world/world.h"
#include "supervisor/impact/prediction.h"

namespace {

using namespace mrr;  // NOLINT: a program of its own

constexpr std::array kBoards{"hardwood", "styrofoam"};
constexpr int kRobots = 9;           // tried by the model "several"
constexpr double kLeastShare = 0.2;  // of the largest contact's impulse: less is a graze before the blow
constexpr std::uint64_t kWorldApart = 1'000'000;
constexpr double kLeastLever_m = 0.02;     // a joint with less is not moved by a blow
constexpr std::size_t kTruthPerJoint = 3;  // impulse, peak, before

std::uint64_t other_world = 0;

struct Strike {
  int number = 0;
  std::string board;
  RobotDescription robot;  // with the nail of this strike
  sim::PlantDescription plant;
  sup::PlanInput request;
  sup::StrikePlan plan;
  std::uint64_t seed = 1;  // of the world; 0: everything is as described
};

std::size_t at(int i) { return static_cast<std::size_t>(i); }

/// Draws a strike; none if the planner refuses it. `selection`: these joints passive instead of those drawn.
std::optional<Strike> draw(const RobotDescription& robot, int number, bool nominal = false,
                           std::optional<std::uint32_t> selection = {}) {
  Random random(static_cast<std::uint64_t>(number) + 1, 77);
  Strike s;
  s.number = number;
  s.seed = nominal ? 0 : static_cast<std::uint64_t>(number) + 1 + kWorldApart * other_world;
  s.robot = robot;
  s.board = kBoards[static_cast<std::size_t>(number) % kBoards.size()];
  s.plant = sim::load_plant(robot, std::filesystem::path(MRR_SOURCE_DIR) / "robots" / "boards" / (s.board + ".yaml"));
  const sup::Chain chain(robot);
  const int n = robot.dof();
  sup::JointVector q(n);
  for (int i = 0; i < n; ++i) {
    const JointLimits& l = robot.joints[at(i)].limits;
    q[i] = random.uniform(l.lower_rad + 0.1, l.upper_rad - 0.1);
  }
  const double height_m = s.board == "hardwood" ? s.plant.board.nail_length_m : random.uniform(0.01, 0.04);
  const sup::Pose face = chain.face_pose(q);
  const Eigen::Vector3d normal = -face.rotation.col(2);
  s.robot.task.normal = normal;
  s.robot.task.nail_position_m = face.position_m - height_m * normal;
  s.robot.task.nail_height_m = height_m;
  s.request.head_position_m = face.position_m;
  s.request.normal = normal;
  s.request.board_distance_m = height_m;
  s.request.contact_duration_s = robot.task.assumed_contact_s;
  s.request.follow_through_m = random.uniform(0.003, s.board == "hardwood" ? 0.008 : 0.02);
  s.request.speed_share = random.uniform(0.1, 1.0);
  std::uint32_t passive = 0;
  for (int i = 0; i < n; ++i) {
    if (random.uniform() < 0.5) passive |= 1U << i;
  }
  s.request.passive = selection.value_or(passive);
  // From a little above the nail, so that the approach is a short one.
  const sup::JointVector limits = sup::JointVector::Ones(n);
  const sup::JointVector away = -sup::unit_strike_velocity(chain.jacobian(q), normal, limits);
  s.request.start = q + 0.1 * away;
  for (int i = 0; i < n; ++i) {
    const JointLimits& l = robot.joints[at(i)].limits;
    if (!(s.request.start[i] > l.lower_rad && s.request.start[i] < l.upper_rad)) return std::nullopt;
  }
  try {
    s.plan = sup::plan(s.robot, chain, s.request);
  } catch (const PlanError&) {
    return std::nullopt;
  }
  return s;
}

struct Truth {
  std::string outcome;  // "hit", or why it does not count
  double contact_s = 0.0, impulse = 0.0, peak_force = 0.0, penetration = 0.0, speed = 0.0, lateral = 0.0;
  double early_s = 0.0;       // contact before the planned instant
  std::vector<double> joint;  // kTruthPerJoint each
};

/// Blows as a force sensor with a threshold sees them: from first touch until the force has been below a share of its
/// peak for a while. What follows (the arm resting on the nail until it is called back) is not the blow.
class BlowWatch {
 public:
  explicit BlowWatch(std::size_t dof) : dof_(dof) {}
  /// Call after every event; between events the force and the torques are taken as linear.
  void step(const sim::PlantTruth& now) {
    const double dt = (now.now - last_.now).seconds();
    if (!open_ && now.contact_force_n > 0.0 && dt > 0.0) {
      open_ = true;
      blow_ = {};
      blow_.joint.assign(dof_ * kTruthPerJoint, 0.0);
      blow_.speed = -normal_speed(last_);
      blow_.lateral = now.face_lateral_m;
      blow_.early_s = -last_.now.seconds();
      start_ = last_.now;
      start_height_m_ = last_.nail_height_m;
      for (std::size_t i = 0; i < dof_; ++i) {
        blow_.joint[kTruthPerJoint * i + 1] = std::abs(last_.transmission_torque_nm[i]);
        blow_.joint[kTruthPerJoint * i + 2] = last_.transmission_torque_nm[i];
      }
      low_since_ = Time{-1};
    }
    if (open_ && dt > 0.0) {
      blow_.impulse += 0.5 * dt * (last_.contact_force_n + now.contact_force_n);
      blow_.peak_force = std::max(blow_.peak_force, now.contact_force_n);
      for (std::size_t i = 0; i < dof_; ++i) {
        const double torque = now.transmission_torque_nm[i];
        blow_.joint[kTruthPerJoint * i] += 0.5 * dt * (last_.transmission_torque_nm[i] + torque);
        double& peak = blow_.joint[kTruthPerJoint * i + 1];
        peak = std::max(peak, std::abs(torque));
      }
      blow_.contact_s = (now.now - start_).seconds();
      blow_.penetration = start_height_m_ - now.nail_height_m;
      if (!(now.contact_force_n < sup::kBlowOverShare * blow_.peak_force)) {
        low_since_ = Time{-1};
      } else if (low_since_.ns < 0) {
        low_since_ = now.now;
        kept_ = blow_;
      } else if ((now.now - low_since_).seconds() > sup::kBlowOver_s) {
        open_ = false;
        blows_.push_back(kept_);
      }
    }
    last_ = now;
  }
  void set_normal(const Eigen::Vector3d& normal) { normal_ = normal; }
  /// The first that is one: a graze before it, and what follows, are not.
  [[nodiscard]] const Truth* blow() const {
    double largest = 0.0;
    for (const Truth& t : blows_) largest = std::max(largest, t.impulse);
    for (const Truth& t : blows_) {
      if (t.impulse >= kLeastShare * largest) return &t;
    }
    return nullptr;
  }

 private:
  [[nodiscard]] double normal_speed(const sim::PlantTruth& t) const { return normal_.dot(t.face_velocity_m_s); }
  std::size_t dof_;
  Eigen::Vector3d normal_ = Eigen::Vector3d::UnitZ();
  bool open_ = false;
  Truth blow_, kept_;
  std::vector<Truth> blows_;
  sim::PlantTruth last_;
  Time start_, low_since_{-1};
  double start_height_m_ = 0.0;
};

/// `trace_path`, if not empty: what the emulator does, per millisecond.
Truth simulate(const Strike& s, const std::string& trace_path = {}) {
  Truth truth;
  truth.joint.assign(at(s.robot.dof()) * kTruthPerJoint, 0.0);
  sim::WorldOptions options;
  options.seed = s.seed;
  sim::World world(s.robot, s.plant, options);
  const sup::JointVector& start = s.request.start;
  world.reset({start.data(), at(s.robot.dof())}, s.robot.task.nail_height_m);
  sup::Supervisor& supervisor = world.supervisor();
  supervisor.enable(true);
  while (supervisor.activity() != sup::Activity::holding) {
    world.step();
    if (world.now() > Time{} + milliseconds(8000)) {
      truth.outcome = "not ready";
      return truth;
    }
  }
  // The arm sags a little as the brakes let go: the same blow, approached from where it is.
  sup::PlanInput request = s.request;
  request.start = supervisor.reference().q;
  sup::StrikePlan plan;
  try {
    plan = sup::plan(s.robot, supervisor.chain(), request);
  } catch (const PlanError&) {
    truth.outcome = "refused by the planner from where the arm is";
    return truth;
  }
  if (!((plan.q_impact - s.plan.q_impact).cwiseAbs().maxCoeff() < 1e-5 && plan.passive == s.plan.passive &&
        std::abs(plan.speed_m_s - s.plan.speed_m_s) < 1e-6)) {
    truth.outcome = "planned differently from where the arm is";
    return truth;
  }
  if (const sup::Refusal refusal = supervisor.execute(plan); refusal != sup::Refusal::none) {
    truth.outcome = sup::describe(refusal);
    return truth;
  }
  const Time until = world.now() + plan.approach.duration() + plan.strike.duration() + milliseconds(8000);
  std::ofstream trace;
  if (!trace_path.empty()) trace.open(trace_path);
  BlowWatch watch(at(s.robot.dof()));
  watch.set_normal(s.request.normal);
  while (!supervisor.outcome().done && world.now() < until) {
    world.step();
    if (supervisor.activity() >= sup::Activity::swinging) watch.step(world.plant().truth());
    if (trace.is_open() && world.supervisor_stepped() && supervisor.activity() >= sup::Activity::swinging) {
      const sim::PlantTruth now = world.plant().truth();
      fmt::print(trace, "{:.4f} {} {:.3f} {:.5f} {:.4f}", (now.now - supervisor.outcome().planned_contact).seconds(),
                 static_cast<int>(supervisor.activity()), now.contact_force_n, now.face_gap_m, now.face_lateral_m);
      for (int i = 0; i < world.dof(); ++i) {
        fmt::print(trace, " {} {:.4f} {:.4f} {:.3f} {:.3f}", static_cast<int>(world.module(i).status().law),
                   now.link_position_rad[at(i)], now.motor_velocity_rad_s[at(i)], now.transmission_torque_nm[at(i)],
                   now.motor_torque_nm[at(i)]);
      }
      fmt::print(trace, "\n");
    }
  }
  const Truth* blow = watch.blow();
  if (supervisor.outcome().aborted != sup::AbortReason::none) {
    truth.outcome = sup::describe(supervisor.outcome().aborted);
  } else if (blow == nullptr) {
    truth.outcome = "nothing hit";
  } else {
    truth.outcome = "hit";
  }
  if (blow == nullptr) return truth;
  const std::string outcome = truth.outcome;
  truth = *blow;
  truth.outcome = outcome;
  truth.early_s += supervisor.outcome().planned_contact.seconds();
  return truth;
}

/// Emulated strikes, kept in a file so that a model can be changed without emulating again.
class Archive {
 public:
  explicit Archive(const std::string& path) : path_(path) {
    if (path.empty()) return;
    std::ifstream in(path);
    for (std::string line; std::getline(in, line);) {
      std::istringstream fields(line);
      std::string key, outcome;
      std::getline(fields, key, ';');
      std::getline(fields, outcome, ';');
      Truth t;
      t.outcome = outcome;
      fields >> t.contact_s >> t.impulse >> t.peak_force >> t.penetration >> t.speed >> t.lateral >> t.early_s;
      for (double x = 0.0; fields >> x;) t.joint.push_back(x);
      kept_[key] = t;
    }
    out_.open(path, std::ios::app);
  }
  Truth get(const std::string& robot, const Strike& s) {
    std::string key =
        fmt::format("{} {} {:.12g} {}", robot, s.seed == 0 ? -1 - s.number : static_cast<std::int64_t>(s.seed),
                    s.plan.speed_m_s, s.plan.passive);
    for (const double x : s.plan.q_impact) key += fmt::format(" {:.10g}", x);
    if (const auto it = kept_.find(key); it != kept_.end()) return it->second;
    const Truth t = simulate(s);
    if (out_.is_open()) {
      fmt::print(out_, "{};{};{:.17g} {:.17g} {:.17g} {:.17g} {:.17g} {:.17g} {:.17g}", key, t.outcome, t.contact_s,
                 t.impulse, t.peak_force, t.penetration, t.speed, t.lateral, t.early_s);
      for (const double x : t.joint) fmt::print(out_, " {:.17g}", x);
      fmt::print(out_, "\n");
      out_.flush();
    }
    return t;
  }

 private:
  std::string path_;
  std::map<std::string, Truth> kept_;
  std::ofstream out_;
};

sup::ContactLaw law_of(const Strike& s) {
  const sim::BoardDescription& b = s.plant.board;  // as the descriptions say it; the emulated one is drawn around it
  sup::ContactLaw law;
  law.face_stiffness_n_m = s.plant.face.stiffness_n_m;
  law.face_damping_s_m = s.plant.face.damping_s_m;
  law.nail_resistance_n =
      b.nail_resistance_n + b.nail_resistance_slope_n_m * (b.nail_length_m - s.robot.task.nail_height_m);
  law.nail_resistance_slope_n_m = b.nail_resistance_slope_n_m;
  law.nail_damping_n_s_m = b.nail_damping_n_s_m;
  law.nail_room_m = s.robot.task.nail_height_m;
  return law;
}

struct Model {
  std::string name;
  sup::Prediction prediction;
};

std::vector<Model> predict_all(const sup::StrikeArm& arm, const Strike& s) {
  const sup::PredictInput law = sup::predict_input(s.plan, law_of(s));
  std::vector<Model> models;
  // As before anything is known of the nail: e = 1, rigid board, the task's contact. All joints free, as (30) has it,
  // printed and corrected; and with active joints as extra inertia.
  sup::PredictInput assumed = law;
  assumed.restitution = 1.0;
  assumed.contact_s = s.robot.task.assumed_contact_s;
  sup::PredictInput all_free = assumed;
  all_free.joints.fill(sup::JointHold::free);
  sup::PredictInput printed = all_free;
  printed.rotor_model = sup::RotorModel::lower;
  printed.formulation = sup::Formulation::as_printed;
  using sup::PredictionModel;
  models.push_back({"printed", sup::predict(arm, printed, PredictionModel::instant)});
  models.push_back({"free", sup::predict(arm, all_free, PredictionModel::instant)});
  models.push_back({"assumed", sup::predict(arm, assumed, PredictionModel::instant)});
  // With the contact law known.
  sup::PredictInput free_law = law;
  free_law.joints.fill(sup::JointHold::free);
  models.push_back({"free_law", sup::predict(arm, free_law, PredictionModel::instant)});
  models.push_back({"instant", sup::predict(arm, law, PredictionModel::instant)});
  models.push_back({"finite", sup::predict(arm, law, PredictionModel::finite_time)});
  models.push_back({"resolved", sup::predict(arm, law, PredictionModel::resolved)});
  sup::PredictInput several = law;
  several.robots = kRobots;
  models.push_back({"several", sup::predict(arm, several, PredictionModel::resolved)});
  return models;
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{"Seeded strikes in the emulator beside their predictions."};
  int strikes = 600;
  std::string robot_name = "mrr3";
  std::string out_path = "strikes.csv";
  std::string archive_path;
  app.add_option("--strikes", strikes, "how many that count")->capture_default_str();
  int first = 0;
  app.add_option("--first", first, "number of the first strike drawn: those published are not those tuned on")
      ->capture_default_str();
  app.add_option("--world", other_world, "each strike with another robot and nail of the same descriptions");
  app.add_option("--robot", robot_name, "folder under robots/")->capture_default_str();
  app.add_option("--out", out_path, "CSV to write")->capture_default_str();
  app.add_option("--archive", archive_path, "keeps emulated strikes from run to run");
  bool nominal = false;
  app.add_flag("--nominal", nominal, "robot and nail are exactly as described, sensors without noise");
  bool every_selection = false;
  app.add_flag("--every-selection", every_selection,
               "every strike with each set of passive joints, those without a lever left active");
  int trace = -1;
  app.add_option("--trace", trace, "emulate this strike alone and write its motion to --out");
  CLI11_PARSE(app, argc, argv);

  const RobotDescription robot = load_robot(std::filesystem::path(MRR_SOURCE_DIR) / "robots" / robot_name);
  if (trace >= 0) {
    const auto s = draw(robot, trace);
    if (s) fmt::print("{}\n", simulate(*s, out_path).outcome);
    return s ? 0 : 1;
  }
  const sup::StrikeArm arm(robot);
  Archive archive(archive_path);
  std::ofstream out(out_path);
  bool header = false;
  int counted = 0;
  std::map<std::string, int> others;
  int number = first;
  // The sets of passive joints that a strike is made with; none: as drawn.
  const auto selections_of = [&](int strike) {
    std::vector<std::optional<std::uint32_t>> sets;
    if (!every_selection) return std::vector<std::optional<std::uint32_t>>{std::nullopt};
    const std::optional<Strike> s = draw(robot, strike, nominal, 0U);
    if (!s) return sets;
    const sup::JointVector lever = arm.chain.jacobian(s->plan.q_impact).topRows<3>().transpose() * s->plan.normal;
    std::uint32_t without = 0;
    for (int i = 0; i < robot.dof(); ++i) {
      if (!(std::abs(lever[i]) > kLeastLever_m)) without |= 1U << i;
    }
    for (std::uint32_t mask = 0; mask < 1U << robot.dof(); ++mask) {
      if ((mask & without) == 0) sets.emplace_back(mask);
    }
    return sets;
  };
  const auto enter = [&](std::optional<std::uint32_t> selection) {
    const std::optional<Strike> s = draw(robot, number, nominal, selection);
    if (!s) {
      ++others["refused by the planner"];
      return;
    }
    const Truth truth = archive.get(robot_name, *s);
    if (truth.outcome != "hit") {
      ++others[truth.outcome];
      return;
    }
    ++counted;
    const std::vector<Model> models = predict_all(arm, *s);
    if (!header) {
      header = true;
      fmt::print(out,
                 "strike,robot,board,joint,passive,mask,speed_share,rated,lever,q,qd,contact_s,impulse,peak_force,"
                 "penetration,speed,lateral,early_s,height,follow,stop_s,weight,true_impulse,true_peak,true_before");
      for (const Model& m : models) {
        fmt::print(out, ",{0}_P,{0}_t,{0}_start,{0}_pen,{0}_impulse,{0}_blow,{0}_peak,{0}_before", m.name);
        fmt::print(out, ",{0}_low,{0}_high,{0}_peak_low,{0}_peak_high", m.name);
      }
      fmt::print(out, "\n");
    }
    const sup::Jacobian J = arm.chain.jacobian(s->plan.q_impact);
    const sup::JointVector lever = J.topRows<3>().transpose() * s->plan.normal;
    const sup::JointVector weight = -arm.chain.gravity(s->plan.q_impact);
    for (int i = 0; i < robot.dof(); ++i) {
      const double* joint = &truth.joint[kTruthPerJoint * at(i)];
      fmt::print(out, "{},{},{},{},{},{}", s->number, robot_name, s->board, i + 1, s->plan.passive >> i & 1U,
                 s->plan.passive);
      for (const double x :
           {s->request.speed_share, robot.joints[at(i)].transmission.rated_nm, lever[i], s->plan.q_impact[i],
            s->plan.qd_impact[i], truth.contact_s, truth.impulse, truth.peak_force, truth.penetration, truth.speed,
            truth.lateral, truth.early_s, s->robot.task.nail_height_m, s->plan.follow_through_m,
            (s->plan.stop_time - s->plan.contact_time).seconds(), weight[i], -joint[0], joint[1], -joint[2]}) {
        fmt::print(out, ",{:.6g}", x);
      }
      for (const Model& m : models) {
        const sup::Prediction& p = m.prediction;
        fmt::print(out, ",{:.5f},{:.5f},{:.5f},{:.5f},{:.6f},{:.6f},{:.5f},{:.5f}", p.impulse_n_s, p.contact_s,
                   p.start_s, p.penetration_m, p.axis_impulse_nm_s[i], p.blow_impulse_nm_s[i], p.peak_torque_nm[i],
                   p.carried_before_nm[i]);
        fmt::print(out, ",{:.6f},{:.6f},{:.5f},{:.5f}", p.axis_impulse_low_nm_s[i], p.axis_impulse_high_nm_s[i],
                   p.peak_torque_low_nm[i], p.peak_torque_high_nm[i]);
      }
      fmt::print(out, "\n");
    }
  };
  for (; counted < strikes; ++number) {
    for (const auto& selection : selections_of(number)) enter(selection);
  }
  fmt::print("{} strikes of {} drawn", counted, number - first);
  for (const auto& [why, count] : others) fmt::print("; {}: {}", why, count);
  fmt::print("\n");
  // What the resolved model costs, here and now.
  const std::optional<Strike> one = [&] {
    for (int k = 0;; ++k) {
      if (auto s = draw(robot, k)) return s;
    }
  }();
  const sup::PredictInput input = sup::predict_input(one->plan, law_of(*one));
  for (const auto model :
       {sup::PredictionModel::instant, sup::PredictionModel::finite_time, sup::PredictionModel::resolved}) {
    double best = 1e9;
    for (int round = 0; round < 30; ++round) {
      const auto begin = std::chrono::steady_clock::now();
      double sum = 0.0;
      for (int k = 0; k < 10; ++k) sum += sup::predict(arm, input, model).impulse_n_s;
      const double us =
          std::chrono::duration<double, std::micro>(std::chrono::steady_clock::now() - begin).count() / 10.0;
      if (std::isfinite(sum)) best = std::min(best, us);
    }
    fmt::print("{}: {:.2f} us\n", sup::describe(model), best);
  }
  return 0;
}
