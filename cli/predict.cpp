#include <fmt/format.h>

#include <cmath>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <stdexcept>

#include "cli/exit_status.h"
#include "cli/plan_commands.h"
#include "cli/text.h"
#include "common/robot/places.h"
#include "supervisor/report_json.h"

namespace mrr::cli {

namespace {

using Json = nlohmann::ordered_json;

constexpr std::array kModels{sup::PredictionModel::instant, sup::PredictionModel::finite_time,
                             sup::PredictionModel::resolved};

struct PredictArguments {
  StrikeOptions strike;
  std::string q;
  std::string qd;
  std::string held;
  std::string model = "all";
  std::string board;
  int robots = 9;
  bool json = false;
};

const char* hold_name(sup::JointHold hold) {
  switch (hold) {
    case sup::JointHold::free:
      return "passive";
    case sup::JointHold::held:
      return "held";
    case sup::JointHold::controlled:
      return "active";
  }
  return "";
}

/// The blow to predict: as planned, or one that is given.
sup::PredictInput blow_of(const RobotDescription& robot, const PredictArguments& a, double height_m) {
  const sup::ContactLaw law = contact_law(robot, a.board.empty() ? "hardwood" : a.board, height_m);
  sup::PredictInput in;
  if (a.q.empty() != a.qd.empty()) {
    throw std::invalid_argument(
        "--q and --qd belong together: give both, or neither for the blow that `mrr plan` plans");
  }
  if (a.q.empty()) {
    in = sup::predict_input(sup::plan(robot, sup::Chain(robot), plan_input(robot, a.strike)), law);
  } else {
    in.q = joint_values(robot, "--q", a.q);
    in.qd = joint_values(robot, "--qd", a.qd);
    in.normal = robot.task.normal;
    in.contact = law;
    in.switch_lead_s = robot.task.switch_lead_s;
    const std::uint32_t passive = a.strike.passive.empty() ? 0 : joint_mask(robot, "--passive", a.strike.passive);
    for (int i = 0; i < robot.dof(); ++i) {
      in.joints[static_cast<std::size_t>(i)] =
          (passive >> i & 1U) != 0 ? sup::JointHold::free : sup::JointHold::controlled;
    }
    const double fastest = in.qd.size() > 0 ? in.qd.cwiseAbs().maxCoeff() : 0.0;
    if (fastest > 0.0) in.reference.travel_s = robot.task.back_swing_rad / fastest;
  }
  const std::uint32_t held = a.held.empty() ? 0 : joint_mask(robot, "--held", a.held);
  for (int i = 0; i < robot.dof(); ++i) {
    if ((held >> i & 1U) != 0) in.joints[static_cast<std::size_t>(i)] = sup::JointHold::held;
  }
  if (a.board.empty()) {
    // No board: the blow as the options describe it, for the model of an instant.
    in.restitution = a.strike.restitution;
    if (a.strike.nail_mass_kg > 0.0) in.nail_mass_kg = a.strike.nail_mass_kg;
    in.contact_s = a.strike.contact_ms > 0.0 ? 1e-3 * a.strike.contact_ms : robot.task.assumed_contact_s;
  }
  return in;
}

/// No "-0.000".
double shown(double value, double smallest) { return std::abs(value) < smallest ? 0.0 : value; }

Json list(const sup::JointVector& values) {
  Json array = Json::array();
  for (const double value : values) array.push_back(sup::number(value));
  return array;
}

Json model_json(sup::PredictionModel model, const sup::Prediction& p) {
  return {{"model", sup::describe(model)},
          {"feasible", p.feasible},
          {"approaching", p.approaching},
          {"impulse_n_s", sup::number(p.impulse_n_s)},
          {"contact_s", sup::number(p.contact_s)},
          {"peak_force_n", sup::number(p.peak_force_n)},
          {"penetration_m", sup::number(p.penetration_m)},
          {"speed_before_m_s", sup::number(p.speed_before_m_s)},
          {"speed_after_m_s", sup::number(p.speed_after_m_s)},
          {"effective_mass_kg", sup::number(p.effective_mass_kg)},
          {"delta_qd_rad_s", list(p.delta_qd)},
          {"axis_impulse_nm_s", list(p.axis_impulse_nm_s)},
          {"blow_impulse_nm_s", list(p.blow_impulse_nm_s)},
          {"carried_before_nm", list(p.carried_before_nm)},
          {"peak_torque_nm", list(p.peak_torque_nm)},
          {"impulse_low_n_s", sup::number(p.impulse_low_n_s)},
          {"impulse_high_n_s", sup::number(p.impulse_high_n_s)},
          {"axis_impulse_low_nm_s", list(p.axis_impulse_low_nm_s)},
          {"axis_impulse_high_nm_s", list(p.axis_impulse_high_nm_s)},
          {"peak_torque_low_nm", list(p.peak_torque_low_nm)},
          {"peak_torque_high_nm", list(p.peak_torque_high_nm)}};
}

/// What the blow may be with other robots of this description.
void print_range(const RobotDescription& robot, const sup::Prediction& p, int robots) {
  fmt::print(
      "\nSmallest and largest over {} robots of this description\n"
      "  nail      {:>8.3f} {:>8.3f} N s\n"
      "  joint     all, N m s          peak, N m\n",
      robots, p.impulse_low_n_s, p.impulse_high_n_s);
  for (int i = 0; i < robot.dof(); ++i) {
    fmt::print("  {:<8}  {:>8.4f} {:>8.4f}   {:>7.2f} {:>7.2f}\n", robot.joints[static_cast<std::size_t>(i)].name,
               shown(p.axis_impulse_low_nm_s[i], 5e-5), shown(p.axis_impulse_high_nm_s[i], 5e-5),
               p.peak_torque_low_nm[i], p.peak_torque_high_nm[i]);
  }
}

int run_predict(const PredictArguments& a) {
  const RobotDescription robot = load_robot(find_robot(a.strike.robot));
  const sup::StrikeArm arm(robot);
  const double height_m = a.strike.height_mm < 0.0 ? robot.task.nail_height_m : 1e-3 * a.strike.height_mm;
  sup::PredictInput in = blow_of(robot, a, height_m);
  in.robots = a.robots;
  Json models = Json::array();
  std::vector<std::pair<sup::PredictionModel, sup::Prediction>> made;
  for (const sup::PredictionModel model : kModels) {
    const bool wanted = a.model == "all" ||
                        a.model == (model == sup::PredictionModel::finite_time ? "finite_time" : sup::describe(model));
    // A board is needed to say how a contact goes on in time.
    if (!wanted || (a.board.empty() && model != sup::PredictionModel::instant && a.model == "all")) continue;
    if (a.board.empty() && model != sup::PredictionModel::instant) {
      throw std::invalid_argument(
          fmt::format("--model {}: follows the contact in time and must know what is struck; give "
                      "--board styrofoam, hardwood or a board's YAML file",
                      a.model));
    }
    const std::string complaint = sup::validate_input(arm, in, model);
    if (!complaint.empty()) throw PlanError(complaint);
    made.emplace_back(model, sup::predict(arm, in, model));
  }
  bool feasible = true;
  for (const auto& [model, prediction] : made) {
    models.push_back(model_json(model, prediction));
    feasible = feasible && prediction.feasible;
  }
  if (a.json) {
    Json holds = Json::array();
    for (int i = 0; i < robot.dof(); ++i) holds.push_back(hold_name(in.joints[static_cast<std::size_t>(i)]));
    const Json all = {{"schema_version", 1},     {"robot", robot.name}, {"q_rad", list(in.q)},
                      {"qd_rad_s", list(in.qd)}, {"joints", holds},     {"models", models}};
    fmt::print("{}\n", all.dump(2));
    return feasible ? kExitDone : kExitNotDone;
  }
  fmt::print("Prediction for {}, {}\n\n", robot.name,
             a.board.empty() ? fmt::format("e {:g}, M* {}, contact {:g} ms", in.restitution,
                                           std::isfinite(in.nail_mass_kg) ? fmt::format("{:g} kg", in.nail_mass_kg)
                                                                          : std::string("infinite"),
                                           1e3 * in.contact_s)
                             : fmt::format("on {}, nail {:.1f} mm proud", a.board, 1e3 * height_m));
  fmt::print(
      "  model        impulse  contact  peak force  deeper  speed before, after  mass\n"
      "               N s      ms       N           mm      m/s                  kg\n");
  for (const auto& [model, p] : made) {
    if (!p.feasible) {
      fmt::print("  {:<12} nothing yields: the impulse would have no bound\n", sup::describe(model));
      continue;
    }
    fmt::print("  {:<12} {:<8.3f} {:<8.1f} {:<11} {:<7} {:>6.3f}, {:>6.3f}       {:.3g}\n", sup::describe(model),
               p.impulse_n_s, 1e3 * p.contact_s, p.peak_force_n > 0.0 ? fmt::format("{:.1f}", p.peak_force_n) : "-",
               model == sup::PredictionModel::instant ? "-" : fmt::format("{:.2f}", 1e3 * p.penetration_m),
               p.speed_before_m_s, p.speed_after_m_s, p.effective_mass_kg);
  }
  for (const auto& [model, p] : made) {
    if (!p.feasible) continue;
    if (!p.approaching) {
      fmt::print("\nThe face does not approach the nail: nothing is struck.\n");
      break;
    }
    fmt::print(
        "\nJoints, {} (impulse: of the blow; all: with what was carried before)\n"
        "  joint     q      q'     jump of q'  impulse  all      peak    of rep.peak\n"
        "            rad    rad/s  rad/s       N m s    N m s    N m     %\n",
        sup::describe(model));
    for (int i = 0; i < robot.dof(); ++i) {
      const JointDescription& joint = robot.joints[static_cast<std::size_t>(i)];
      fmt::print("  {:<8} {:>6.3f} {:>6.3f} {:>7.3f} {:>11.4f} {:>8.4f} {:>7.2f} {:>6.0f}  {}\n", joint.name, in.q[i],
                 in.qd[i], shown(p.delta_qd[i], 5e-4), shown(p.blow_impulse_nm_s[i], 5e-5),
                 shown(p.axis_impulse_nm_s[i], 5e-5), p.peak_torque_nm[i],
                 100.0 * p.peak_torque_nm[i] / joint.transmission.repeated_peak_nm,
                 hold_name(in.joints[static_cast<std::size_t>(i)]));
    }
    if (model == sup::PredictionModel::resolved && a.robots > 1) print_range(robot, p, a.robots);
  }
  return feasible ? kExitDone : kExitNotDone;
}

}  // namespace

void add_predict_command(CLI::App& app, int& status) {
  auto arguments = std::make_shared<PredictArguments>();
  CLI::App* command =
      app.add_subcommand("predict", "Predict what a blow does to nail and joints, by three models; moves nothing");
  add_strike_options(*command, arguments->strike);
  command->add_option("--q", arguments->q, "Pose at impact, rad, comma separated (default: as planned)")
      ->type_name("RAD,...");
  command->add_option("--qd", arguments->qd, "Joint speeds at impact, rad/s, comma separated")->type_name("RAD/S,...");
  command
      ->add_option("--held", arguments->held,
                   "Joints that do not move whatever happens: names or numbers, comma separated")
      ->type_name("JOINT,...");
  command->add_option("--model", arguments->model, "instant, finite_time, resolved, or all that apply")
      ->check(CLI::IsMember({"all", "instant", "finite_time", "resolved"}))
      ->capture_default_str();
  command
      ->add_option("--board", arguments->board,
                   "styrofoam, hardwood, or a board's YAML file (default: e, M* and contact as given)")
      ->type_name("NAME");
  command->add_option("--robots", arguments->robots, "Robots of this description the resolved model tries")
      ->check(CLI::Range(1, sup::kMostRobots))
      ->capture_default_str();
  command->add_flag("--json", arguments->json, "Print one JSON object and nothing else");
  command->callback([arguments, &status] { status = run_predict(*arguments); });
}

}  // namespace mrr::cli
