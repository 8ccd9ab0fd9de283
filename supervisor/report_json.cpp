#include "supervisor/report_json.h"

#include <cmath>

namespace mrr::sup {

using Json = nlohmann::ordered_json;

Json number(double value) { return std::isfinite(value) ? Json(value) : Json(nullptr); }

namespace {

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

}  // namespace

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

const char* mode_name(PassiveMode mode) noexcept {
  switch (mode) {
    case PassiveMode::planned:
      return "planned";
    case PassiveMode::never:
      return "never";
    case PassiveMode::always:
      return "always";
  }
  return "unknown";
}

Json plan_json(const RobotDescription& robot, const StrikePlan& plan) {
  const bool over_contact = plan.blow.feasible && plan.blow.approaching;
  Json joints = Json::array();
  for (std::size_t i = 0; i < robot.joints.size(); ++i) {
    const JointLoad& load = plan.loads[i];
    joints.push_back({{"name", robot.joints[i].name},
                      {"passive", ((plan.passive >> i) & 1U) != 0},
                      {"free_nm_s", number(load.free_nm_s)},
                      {"held_nm_s", number(load.held_nm_s)},
                      {"planned_nm_s", number(load.planned_nm_s)},
                      {"peak_predicted_nm",
                       over_contact ? number(plan.blow.peak_torque_nm[static_cast<Eigen::Index>(i)]) : Json(nullptr)},
                      {"rated_limit_nm_s", number(load.limits.rated_nm_s)},
                      {"repeated_peak_limit_nm_s", number(load.limits.repeated_nm_s)}});
  }
  Json poses = Json::array();
  for (const PoseCandidate& pose : plan.poses) {
    poses.push_back({{"q_rad", list(pose.q)},
                     {"tilt_rad", number(pose.tilt_rad)},
                     {"speed_m_s", number(pose.speed_m_s)},
                     {"measure", number(pose.measure)},
                     {"passive", pose.passive},
                     {"load_share", list(pose.load_share)},
                     {"impulse_n_s", number(pose.impulse_n_s)},
                     {"back_swing_rad", number(pose.back_swing_rad)},
                     {"swing_s", number(pose.swing_s)},
                     {"feasible", pose.feasible},
                     {"note", pose.note}});
  }
  Json selections = Json::array();
  for (const SelectionCandidate& selection : plan.selections) {
    selections.push_back({{"passive", selection.passive},
                          {"feasible", selection.feasible},
                          {"model", describe(selection.model)},
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
          {"impulse_instant_n_s", number(plan.prediction.impulse_n_s)},
          {"effective_mass_kg", number(plan.effective_mass_kg)},
          {"follow_through_mm", number(plan.follow_through_m * 1e3)},
          {"contact_time_s", number(plan.contact_time.seconds())},
          {"switch_time_s", number(plan.switch_time.seconds())},
          {"joints", joints},
          {"poses", poses},
          {"selections", selections}};
}

const char* formulation_name(Formulation formulation) noexcept {
  switch (formulation) {
    case Formulation::corrected:
      return "corrected";
    case Formulation::as_printed:
      return "as_printed";
  }
  return "unknown";
}

Json assumed_json(const SwingReport& swing) {
  return {{"restitution", number(swing.restitution)},
          {"nail_mass_kg", number(swing.nail_mass_kg)},
          {"nail_height_mm", number(swing.head_height_before_m * 1e3)},
          {"speed_factor", number(swing.speed_factor)}};
}

Json seen_json(const SwingReport& swing) {
  const ContactReport& seen = swing.outcome.contact;
  return {{"contact_ms", number((seen.end - seen.start).seconds() * 1e3)},
          {"impulse_n_s", number(seen.impulse_n_s)},
          {"penetration_mm", number(seen.penetration_m * 1e3)},
          {"nail_height_mm", number(swing.head_height_after_m * 1e3)},
          {"nail_height_sd_mm", number(swing.head_sd_after_m * 1e3)}};
}

Json aborted_json(const SwingOutcome& outcome) {
  return outcome.aborted == AbortReason::none ? Json(nullptr) : Json(describe(outcome.aborted));
}

Json swing_json(const RobotDescription& robot, const SwingReport& swing) {
  Json joints = Json::array();
  for (std::size_t i = 0; i < robot.joints.size(); ++i) {
    const Time passive = swing.outcome.passive_seen[i];
    const TransmissionDescription& drive = robot.joints[i].transmission;
    joints.push_back({{"name", robot.joints[i].name},
                      {"passive", ((swing.plan.passive >> i) & 1U) != 0},
                      {"passive_seen_s", passive.ns < 0 ? Json(nullptr) : Json(passive.seconds())},
                      {"peak_torque_seen_nm", number(swing.outcome.peak_torque_nm[i])},
                      {"axis_impulse_predicted_nm_s", number(swing.plan.loads[i].planned_nm_s)},
                      {"rated_nm", drive.rated_nm},
                      {"repeated_peak_nm", drive.repeated_peak_nm}});
  }
  return {{"number", swing.number},
          {"aborted", aborted_json(swing.outcome)},
          {"began_s", number(swing.outcome.began.seconds())},
          {"planned_contact_s", number(swing.outcome.planned_contact.seconds())},
          {"impulse_predicted_n_s", number(swing.plan.impulse_n_s)},
          {"assumed", assumed_json(swing)},
          {"seen_by_robot", seen_json(swing)},
          {"plan", plan_json(robot, swing.plan)},
          {"joints", joints}};
}

Json ledger_json(const RobotDescription& robot, const Ledger& ledger) {
  Json joints = Json::array();
  for (std::size_t i = 0; i < robot.joints.size(); ++i) {
    const JointLedger& joint = ledger.joints[i];
    const TransmissionDescription& drive = robot.joints[i].transmission;
    const auto uses = [&](PulseShape shape) {
      return Json{{"rated", number(joint.use(drive, LoadLimit::rated, shape))},
                  {"repeated_peak", number(joint.use(drive, LoadLimit::repeated_peak, shape))},
                  {"momentary_peak", number(joint.use(drive, LoadLimit::momentary_peak, shape))}};
    };
    joints.push_back({{"name", robot.joints[i].name},
                      {"blows", joint.blows},
                      {"blows_not_seen", joint.unknown},
                      {"peaks_over_rated", joint.peaks_over[0]},
                      {"momentary_events", joint.momentary_events()},
                      {"peaks_over_momentary", joint.peaks_over[2]},
                      {"largest_peak_nm", number(joint.largest_peak_nm)},
                      {"largest_use_square", uses(PulseShape::square)},
                      {"largest_use_half_sine", uses(PulseShape::half_sine)},
                      {"life_share", number(joint.life_share())}});
  }
  return {{"since", ledger.since}, {"joints", joints}};
}

}  // namespace mrr::sup
