#include "cli/json.h"

#include <cmath>
#include <string>

namespace mrr::cli {

namespace {

using Json = nlohmann::ordered_json;

Json number(double value) { return std::isfinite(value) ? Json(value) : Json(nullptr); }

template <typename Vector>
Json list(const Vector& values) {
  Json array = Json::array();
  for (const double value : values) array.push_back(number(value));
  return array;
}

Json frame(const FrameOffset& offset) {
  Json rows = Json::array();
  for (int row = 0; row < 3; ++row) rows.push_back(list(Eigen::Vector3d(offset.rotation.row(row))));
  return {{"rotation", rows}, {"translation_m", list(offset.translation_m)}};
}

/// What a drawing of the arm needs: the chain, the face, the nail.
Json geometry_json(const RobotDescription& robot) {
  Json joints = Json::array();
  for (const JointDescription& joint : robot.joints) {
    Json entry = frame(joint.offset);
    entry["name"] = joint.name;
    entry["axis"] = list(joint.axis);
    joints.push_back(entry);
  }
  return {{"joints", joints},
          {"face", frame(robot.hammer.face)},
          {"face_radius_mm", number(robot.hammer.face_radius_m * 1e3)},
          {"nail_position_m", list(robot.task.nail_position_m)},
          {"nail_normal", list(robot.task.normal)},
          {"nail_height_mm", number(robot.task.nail_height_m * 1e3)},
          {"flush_tolerance_mm", number(robot.task.flush_tolerance_m * 1e3)}};
}

const char* mode_name(sup::PassiveMode mode) {
  switch (mode) {
    case sup::PassiveMode::planned:
      return "planned";
    case sup::PassiveMode::never:
      return "never";
    case sup::PassiveMode::always:
      return "always";
  }
  return "unknown";
}

Json plan_json(const RobotDescription& robot, const sup::StrikePlan& plan) {
  Json joints = Json::array();
  for (std::size_t i = 0; i < robot.joints.size(); ++i) {
    const sup::JointLoad& load = plan.loads[i];
    joints.push_back({{"name", robot.joints[i].name},
                      {"passive", ((plan.passive >> i) & 1U) != 0},
                      {"free_nm_s", number(load.free_nm_s)},
                      {"held_nm_s", number(load.held_nm_s)},
                      {"planned_nm_s", number(load.planned_nm_s)},
                      {"rated_limit_nm_s", number(load.limits.rated_nm_s)},
                      {"repeated_peak_limit_nm_s", number(load.limits.repeated_nm_s)}});
  }
  Json poses = Json::array();
  for (const sup::PoseCandidate& pose : plan.poses) {
    poses.push_back({{"q_rad", list(pose.q)},
                     {"tilt_rad", number(pose.tilt_rad)},
                     {"speed_m_s", number(pose.speed_m_s)},
                     {"measure", number(pose.measure)},
                     {"feasible", pose.feasible},
                     {"note", pose.note}});
  }
  Json selections = Json::array();
  for (const sup::SelectionCandidate& selection : plan.selections) {
    selections.push_back({{"passive", selection.passive},
                          {"feasible", selection.feasible},
                          {"load_ratio_per_n_s", number(selection.load_ratio_per_n_s)},
                          {"impulse_n_s", number(selection.impulse_n_s)},
                          {"note", selection.note}});
  }
  return {{"why", plan.why},
          {"q_impact_rad", list(plan.q_impact)},
          {"qd_impact_rad_s", list(plan.qd_impact)},
          {"q_back_swing_rad", list(plan.q_back_swing)},
          {"speed_m_s", number(plan.speed_m_s)},
          {"tilt_rad", number(plan.tilt_rad)},
          {"impulse_predicted_n_s", number(plan.impulse_n_s)},
          {"effective_mass_kg", number(plan.effective_mass_kg)},
          {"follow_through_mm", number(plan.follow_through_m * 1e3)},
          {"contact_time_s", number(plan.contact_time.seconds())},
          {"switch_time_s", number(plan.switch_time.seconds())},
          {"joints", joints},
          {"poses", poses},
          {"selections", selections}};
}

Json swing_json(const RobotDescription& robot, const sup::SwingReport& swing, const sim::SwingTruth& truth) {
  const sup::ContactReport& seen = swing.outcome.contact;
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
          {"aborted", swing.outcome.aborted == sup::AbortReason::none ? Json(nullptr)
                                                                      : Json(sup::describe(swing.outcome.aborted))},
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
          {"assumed",
           {{"restitution", number(swing.restitution)},
            {"nail_mass_kg", number(swing.nail_mass_kg)},
            {"nail_height_mm", number(swing.head_height_before_m * 1e3)}}},
          {"seen_by_robot",
           {{"contact_ms", number((seen.end - seen.start).seconds() * 1e3)},
            {"impulse_n_s", number(seen.impulse_n_s)},
            {"penetration_mm", number(seen.penetration_m * 1e3)},
            {"nail_height_mm", number(swing.head_height_after_m * 1e3)}}},
          {"plan", plan_json(robot, swing.plan)},
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
          {"mode", mode_name(label.mode)},
          {"formulation", label.formulation == sup::Formulation::as_printed ? "as_printed" : "corrected"},
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
          {"geometry", geometry_json(robot)},
          {"plan", result.swings.empty() ? Json(nullptr) : plan_json(robot, result.swings.front().plan)},
          {"swings", swings}};
}

}  // namespace mrr::cli
