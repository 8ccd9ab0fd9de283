#include "cli/json.h"

#include <limits>

#include "supervisor/report_json.h"

namespace mrr::cli {

namespace {

using Json = nlohmann::ordered_json;
using sup::number;

/// What the robot knows of a swing, completed with what really happened; nullptr: nobody knows.
Json swing_json(const Json& robot, const sim::SwingTruth* truth) {
  const auto known = [truth](auto value) { return truth != nullptr ? number(value(*truth)) : Json(nullptr); };
  using Truth = sim::SwingTruth;
  Json joints = Json::array();
  const Json& of_robot = robot.at("joints");
  for (std::size_t i = 0; i < of_robot.size(); ++i) {
    const Json& joint = of_robot[i];
    const sim::JointBlow* blow = truth != nullptr ? &truth->joints.at(i) : nullptr;
    joints.push_back(
        {{"name", joint.at("name")},
         {"passive", joint.at("passive")},
         {"switch_lead_ms", blow != nullptr ? number(blow->switch_lead_s * 1e3) : Json(nullptr)},
         {"peak_torque_nm", blow != nullptr ? number(blow->peak_torque_nm) : joint.at("peak_torque_seen_nm")},
         {"peak_torque_swing_nm", blow != nullptr ? number(blow->peak_torque_swing_nm) : Json(nullptr)},
         {"axis_impulse_nm_s", blow != nullptr ? number(blow->impulse_nm_s) : Json(nullptr)},
         {"axis_impulse_predicted_nm_s", joint.at("axis_impulse_predicted_nm_s")},
         {"rated_nm", joint.at("rated_nm")},
         {"repeated_peak_nm", joint.at("repeated_peak_nm")}});
  }
  return {{"number", robot.at("number")},
          {"hit", truth != nullptr ? Json(truth->hit) : Json(nullptr)},
          {"aborted", robot.at("aborted")},
          {"began_s", robot.at("began_s")},
          {"contact_start_s", truth != nullptr && truth->hit ? number(truth->contact_start.seconds()) : Json(nullptr)},
          {"nail_height_mm", known([](const Truth& t) { return t.nail_height_m * 1e3; })},
          {"penetration_mm", known([](const Truth& t) { return t.penetration_m * 1e3; })},
          {"contact_ms", known([](const Truth& t) { return t.contact_s * 1e3; })},
          {"impulse_predicted_n_s", robot.at("impulse_predicted_n_s")},
          {"impulse_measured_n_s", known([](const Truth& t) { return t.impulse_n_s; })},
          {"peak_force_n", known([](const Truth& t) { return t.peak_force_n; })},
          {"effective_mass_kg", known([](const Truth& t) { return t.effective_mass_kg; })},
          {"restitution", known([](const Truth& t) { return t.restitution; })},
          {"speed_m_s", known([](const Truth& t) { return t.speed_m_s; })},
          {"assumed", robot.at("assumed")},
          {"seen_by_robot", robot.at("seen_by_robot")},
          {"plan", robot.at("plan")},
          {"joints", joints}};
}

double value_of(const Json& object, const char* key, double otherwise) {
  const Json& value = object.at(key);
  return value.is_number() ? value.get<double>() : otherwise;
}

}  // namespace

sim::SwingTruth swing_truth(const Json& swing) {
  constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
  sim::SwingTruth truth;
  truth.hit = swing.at("hit").get<bool>();
  truth.contact_start = Time{} + seconds(value_of(swing, "contact_start_s", 0.0));
  truth.contact_s = value_of(swing, "contact_s", 0.0);
  truth.impulse_n_s = value_of(swing, "impulse_n_s", 0.0);
  truth.peak_force_n = value_of(swing, "peak_force_n", 0.0);
  truth.penetration_m = value_of(swing, "penetration_m", 0.0);
  truth.nail_height_m = value_of(swing, "nail_height_m", kNaN);
  truth.speed_m_s = value_of(swing, "speed_m_s", 0.0);
  // Nothing moved: no number stands for it.
  truth.effective_mass_kg = value_of(swing, "effective_mass_kg", std::numeric_limits<double>::infinity());
  truth.restitution = value_of(swing, "restitution", 0.0);
  for (const Json& joint : swing.at("joints")) {
    sim::JointBlow& blow = truth.joints.emplace_back();
    blow.passive = joint.at("passive").get<bool>();
    blow.switch_lead_s = value_of(joint, "switch_lead_s", kNaN);
    blow.peak_torque_nm = value_of(joint, "peak_torque_nm", kNaN);
    blow.peak_torque_swing_nm = value_of(joint, "peak_torque_swing_nm", kNaN);
    blow.impulse_nm_s = value_of(joint, "impulse_nm_s", kNaN);
  }
  return truth;
}

Outcome outcome_of(const RobotDescription& robot, const sim::HammerJobResult& result, double wall_s) {
  Outcome outcome;
  outcome.verdict = sup::describe(result.verdict);
  outcome.reason = result.reason;
  outcome.plan = result.swings.empty() ? Json(nullptr) : sup::plan_json(robot, result.swings.front().plan);
  outcome.swings = Json::array();
  for (const sup::SwingReport& swing : result.swings) outcome.swings.push_back(sup::swing_json(robot, swing));
  outcome.truth = result.truth;
  outcome.nail_height_m = result.nail_height_m;
  outcome.simulated_s = result.simulated_s;
  outcome.wall_s = wall_s;
  outcome.bus_load = result.bus_load;
  outcome.bus_load_worst_case = result.bus_load_worst_case;
  conclude(robot, outcome);
  return outcome;
}

void conclude(const RobotDescription& robot, Outcome& outcome) {
  outcome.really_flush = outcome.nail_height_m <= robot.task.flush_tolerance_m;
  outcome.limit_note = outcome.truth_known ? sim::broken_limit(robot, outcome.truth) : std::string();
  outcome.within_limits = outcome.limit_note.empty();
}

Json result_json(const RobotDescription& robot, const RunLabel& label, const Outcome& outcome) {
  Json swings = Json::array();
  for (std::size_t k = 0; k < outcome.swings.size(); ++k)
    swings.push_back(swing_json(outcome.swings[k], k < outcome.truth.size() ? &outcome.truth[k] : nullptr));
  const bool known = outcome.truth_known;
  return {{"schema_version", 1},
          {"robot", robot.name},
          {"board", label.board},
          {"seed", label.seed},
          {"mode", sup::mode_name(label.mode)},
          {"formulation", sup::formulation_name(label.formulation)},
          {"processes", label.processes.empty() ? Json(nullptr) : Json(label.processes)},
          {"truth_known", known},
          {"flush", outcome.really_flush},
          {"success", outcome.success()},
          {"verdict", outcome.verdict},
          {"reason", outcome.reason},
          {"within_limits", known ? Json(outcome.within_limits) : Json(nullptr)},
          {"limit_note", outcome.limit_note},
          {"nail_height_mm", number(outcome.nail_height_m * 1e3)},
          {"simulated_s", number(outcome.simulated_s)},
          {"realtime_factor", number(outcome.simulated_s / outcome.wall_s)},
          {"bus_load", number(outcome.bus_load)},
          {"bus_load_worst_case", number(outcome.bus_load_worst_case)},
          {"geometry", sup::geometry_json(robot)},
          {"plan", outcome.plan},
          {"swings", swings}};
}

}  // namespace mrr::cli
