#include "cli/json.h"

#include <string>

#include "supervisor/report_json.h"

namespace mrr::cli {

namespace {

using Json = nlohmann::ordered_json;
using sup::number;

Json swing_json(const RobotDescription& robot, const sup::SwingReport& swing, const sim::SwingTruth& truth) {
  Json joints = Json::array();
  for (std::size_t i = 0; i < robot.joints.size(); ++i) {
    const sim::JointBlow& joint = truth.joints[i];
    const TransmissionDescription& drive = robot.joints[i].transmission;
    joints.push_back({{"name", robot.joints[i].name},
                      {"passive", joint.passive},
                      {"switch_lead_ms", number(joint.switch_lead_s * 1e3)},
                      {"peak_torque_nm", number(joint.peak_torque_nm)},
                      {"peak_torque_swing_nm", number(joint.peak_torque_swing_nm)},
                      {"axis_impulse_nm_s", number(joint.impulse_nm_s)},
                      {"axis_impulse_predicted_nm_s", number(swing.plan.loads[i].planned_nm_s)},
                      {"rated_nm", drive.rated_nm},
                      {"repeated_peak_nm", drive.repeated_peak_nm}});
  }
  return {{"number", swing.number},
          {"hit", truth.hit},
          {"aborted", sup::aborted_json(swing.outcome)},
          {"began_s", number(swing.outcome.began.seconds())},
          {"contact_start_s", truth.hit ? number(truth.contact_start.seconds()) : Json(nullptr)},
          {"nail_height_mm", number(truth.nail_height_m * 1e3)},
          {"penetration_mm", number(truth.penetration_m * 1e3)},
          {"contact_ms", number(truth.contact_s * 1e3)},
          {"impulse_predicted_n_s", number(swing.plan.impulse_n_s)},
          {"impulse_measured_n_s", number(truth.impulse_n_s)},
          {"peak_force_n", number(truth.peak_force_n)},
          {"effective_mass_kg", number(truth.effective_mass_kg)},
          {"restitution", number(truth.restitution)},
          {"speed_m_s", number(truth.speed_m_s)},
          {"assumed", sup::assumed_json(swing)},
          {"seen_by_robot", sup::seen_json(swing)},
          {"plan", sup::plan_json(robot, swing.plan)},
          {"joints", joints}};
}

}  // namespace

Json result_json(const RobotDescription& robot, const RunLabel& label, const sim::HammerJobResult& result,
                 double realtime_factor) {
  Json swings = Json::array();
  for (std::size_t k = 0; k < result.swings.size(); ++k) {
    swings.push_back(swing_json(robot, result.swings[k], result.truth[k]));
  }
  return {{"schema_version", 1},
          {"robot", robot.name},
          {"board", label.board},
          {"seed", label.seed},
          {"mode", sup::mode_name(label.mode)},
          {"formulation", sup::formulation_name(label.formulation)},
          {"flush", result.really_flush},
          {"success", result.success()},
          {"verdict", sup::describe(result.verdict)},
          {"reason", result.reason},
          {"within_limits", result.within_limits},
          {"limit_note", result.limit_note},
          {"nail_height_mm", number(result.nail_height_m * 1e3)},
          {"simulated_s", number(result.simulated_s)},
          {"realtime_factor", number(realtime_factor)},
          {"bus_load", number(result.bus_load)},
          {"bus_load_worst_case", number(result.bus_load_worst_case)},
          {"geometry", sup::geometry_json(robot)},
          {"plan", result.swings.empty() ? Json(nullptr) : sup::plan_json(robot, result.swings.front().plan)},
          {"swings", swings}};
}

}  // namespace mrr::cli
