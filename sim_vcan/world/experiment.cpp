#include "sim_vcan/world/experiment.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "common/robot/errors.h"
#include "common/robot/yaml_reader.h"
#include "sim_vcan/world/world.h"
#include "supervisor/impact/external.h"

namespace mrr::sim {

namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr double kFastestSwing_rad_s = 2.6;
constexpr Duration kSwingTimeLimit = milliseconds(20'000);

std::size_t joint_index(const RobotDescription& robot, const std::string& name, const YamlReader& yaml,
                        const char* key) {
  for (std::size_t i = 0; i < robot.joints.size(); ++i) {
    if (robot.joints[i].name == name) return i;
  }
  yaml.fail(key, "the robot has no joint of that name");
}

/// The robot as the reference ran it: these gains, model torque instead of torque sensors (the supervisor still reads
/// them, to know when a blow is over), no compensation in passive mode.
RobotDescription experiment_robot(const RobotDescription& robot, const Experiment& experiment,
                                  const ExperimentSwing& swing, const Eigen::Vector3d& head) {
  RobotDescription changed = robot;
  changed.task.nail_height_m = swing.nail_height_m;
  // The blow falls in the home pose whatever the nail's depth: the board is lifted for each swing.
  changed.task.nail_position_m = head - swing.nail_height_m * changed.task.normal;
  for (JointDescription& joint : changed.joints) {
    joint.control.carried_departure_nm = 0.0;
    joint.control.compensator.enabled = false;
    joint.control.passive_compensation = 0.0;
    if (joint.name == experiment.swinging_joint || joint.name == experiment.passive_joint) {
      // Its hardwood swing peaks at 2.5 rad/s, above what 2000 motor rpm give: the module must not refuse it.
      joint.limits.velocity_rad_s = std::max(joint.limits.velocity_rad_s, kFastestSwing_rad_s);
      joint.control.position_gain_nm_rad = experiment.position_gain_nm_rad;
      joint.control.velocity_gain_nm_s_rad = experiment.velocity_gain_nm_s_rad;
      joint.control.friction_feedforward = experiment.friction_feedforward;
      joint.control.friction_by_reference = true;
    }
  }
  return changed;
}

/// The first time at which the trajectory's face is `gap_m` above the head.
Duration time_at_gap(const sup::Chain& chain, const sup::JointTrajectory& trajectory, const Eigen::Vector3d& head,
                     const Eigen::Vector3d& normal, double gap_m) {
  sup::JointMotion motion;
  for (Duration t; t < trajectory.duration(); t += microseconds(100)) {
    trajectory.sample(t, motion);
    if ((chain.face_pose(motion.q).position_m - head).dot(normal) <= gap_m) return t;
  }
  return trajectory.duration();
}

sup::StrikePlan plan_of(const RobotDescription& robot, const sup::Chain& chain, const ExperimentSeries& series,
                        const ExperimentSwing& swing, const Experiment& experiment, std::size_t swinging,
                        std::size_t passive, const Eigen::Vector3d& head, const sup::JointVector& start) {
  const auto joint = static_cast<Eigen::Index>(swinging);
  const sup::JointVector home = sup::JointVector::Zero(robot.dof());
  const sup::Jacobian J_h = chain.jacobian(home);
  const double arm_m = J_h.col(joint).head<3>().dot(robot.task.normal);
  const Duration knot = seconds(1.0 / robot.bus.knot_rate_hz);
  const Duration way = knot * std::llround(series.time_s / knot.seconds());

  sup::StrikePlan plan;
  plan.normal = robot.task.normal;
  plan.head_position_m = head;
  plan.q_stop = home;
  plan.q_stop[joint] = -swing.past_head_m / arm_m;
  plan.q_back_swing = plan.q_stop;
  plan.q_back_swing[joint] += series.travel_rad;
  plan.strike = sup::JointTrajectory(sup::at_rest(plan.q_back_swing));
  if (!plan.strike.append(sup::at_rest(plan.q_stop), way) ||
      !plan.strike.append(sup::at_rest(plan.q_back_swing), way)) {
    throw DescriptionError("experiment.yaml: the swing's time or travel cannot be used");
  }
  plan.approach = sup::JointTrajectory(sup::at_rest(start));
  if (!plan.approach.append(sup::at_rest(plan.q_back_swing), milliseconds(1000))) {
    throw DescriptionError("experiment.yaml: the robot cannot go to the start of the swing");
  }
  plan.contact_time = time_at_gap(chain, plan.strike, head, plan.normal, 0.0);
  plan.stop_time = way;
  plan.switch_time = time_at_gap(chain, plan.strike, head, plan.normal, experiment.passive_gap_m);
  plan.passive_time = milliseconds(400);
  plan.passive = 1U << passive;
  sup::JointMotion impact;
  plan.strike.sample(plan.contact_time, impact);
  plan.q_impact = impact.q;
  plan.qd_impact = impact.qd;
  plan.speed_m_s = -(chain.jacobian(impact.q) * impact.qd).head<3>().dot(plan.normal);
  return plan;
}

SimulatedSwing run_swing(const RobotDescription& robot, const PlantDescription& plant, const ExperimentSeries& series,
                         const ExperimentSwing& swing, const Experiment& experiment, std::size_t swinging,
                         std::size_t passive, const Eigen::Vector3d& head, std::uint64_t seed) {
  WorldOptions options;
  options.seed = seed;
  World world(robot, plant, options);
  std::vector<double> park;
  for (const JointDescription& joint : robot.joints) park.push_back(joint.park_rad);
  world.reset(park, swing.nail_height_m);
  world.supervisor().enable(true);

  SimulatedSwing result;
  result.swing = swing;
  result.switch_lead_ms = kNaN;
  bool executing = false;
  Time passive_since{-1};
  while (world.now() < Time{} + kSwingTimeLimit) {
    world.step();
    if (!world.supervisor_stepped()) continue;
    sup::Supervisor& supervisor = world.supervisor();
    supervisor.events().clear();
    if (!executing && supervisor.activity() == sup::Activity::holding) {
      const sup::StrikePlan plan = plan_of(robot, supervisor.chain(), series, swing, experiment, swinging, passive,
                                           head, supervisor.reference().q);
      if (supervisor.execute(plan) != sup::Refusal::none) break;
      executing = true;
    }
    const bool is_passive = world.module(static_cast<int>(passive)).status().law == fw::Law::passive;
    if (is_passive && passive_since.ns < 0) passive_since = world.mode_trace(static_cast<int>(passive)).passive_since;
    if (executing && supervisor.outcome().done && supervisor.activity() == sup::Activity::holding) break;
  }
  const ContactRecords& contacts = world.plant().contacts();
  if (contacts.empty()) return result;
  const auto blow =
      std::max_element(contacts.begin(), contacts.end(),
                       [](const ContactRecord& a, const ContactRecord& b) { return a.impulse_n_s < b.impulse_n_s; });
  result.hit = true;
  result.penetration_mm = blow->penetration_m * 1e3;
  result.contact_ms = blow->duration().seconds() * 1e3;
  result.impulse_n_s = blow->impulse_n_s;
  result.speed_m_s = blow->speed_at_start_m_s;
  result.effective_mass_kg =
      sup::effective_nail_mass_kg(blow->impulse_n_s, blow->duration().seconds(), blow->penetration_m);
  if (passive_since.ns >= 0) result.switch_lead_ms = (blow->start - passive_since).seconds() * 1e3;
  const PublishedSwing& published = swing.published;
  const auto near = [](double value, double target, double share, double slack) {
    return std::abs(value - target) <= std::max(share * std::abs(target), slack);
  };
  result.within =
      near(result.contact_ms, published.contact_ms, kContactTolerance, 0.0) &&
      near(result.impulse_n_s, published.impulse_n_s, kImpulseTolerance, 0.0) &&
      near(result.penetration_mm, published.penetration_mm, kPenetrationTolerance, kPenetrationTolerance_mm);
  return result;
}

}  // namespace

Experiment load_experiment(const RobotDescription& robot) {
  const std::filesystem::path file = robot.source / "experiment.yaml";
  if (!std::filesystem::is_regular_file(file)) {
    throw DescriptionError(file.string() + ": there is no such file; the published experiment belongs to robots/mrr3");
  }
  const YamlReader yaml = YamlReader::from_file(file);
  Experiment experiment;
  experiment.swinging_joint = yaml.text("swinging_joint");
  experiment.passive_joint = yaml.text("passive_joint");
  (void)joint_index(robot, experiment.swinging_joint, yaml, "swinging_joint");
  (void)joint_index(robot, experiment.passive_joint, yaml, "passive_joint");
  experiment.position_gain_nm_rad = yaml.number("position_gain", Unit::torsional_stiffness, Range::positive(1e5));
  experiment.velocity_gain_nm_s_rad = yaml.number("velocity_gain", Unit::torsional_damping, Range::positive(1e4));
  experiment.friction_feedforward = yaml.number("friction_feedforward", Unit::none, {0.0, 1.2});
  experiment.passive_gap_m = yaml.number("passive_gap", Unit::length, Range::positive(0.1));
  for (const YamlReader& section : yaml.sections("series", 1)) {
    ExperimentSeries series;
    series.board = section.text("board");
    series.travel_rad = section.number("travel", Unit::angle, Range::positive(3.0));
    series.time_s = section.number("time", Unit::time, Range::positive(10.0));
    if (section.has("measured_contact")) {
      const auto contact = section.numbers<2>("measured_contact", Unit::time, Range::positive(10.0));
      const auto impulse = section.numbers<2>("measured_impulse", Unit::impulse, Range::positive(1e3));
      series.contact_low_ms = contact[0] * 1e3;
      series.contact_high_ms = contact[1] * 1e3;
      series.impulse_low_n_s = impulse[0];
      series.impulse_high_n_s = impulse[1];
    }
    for (const YamlReader& entry : section.sections("swings", 1)) {
      ExperimentSwing swing;
      swing.name = entry.text("name");
      swing.nail_height_m = entry.number("nail_height", Unit::length, {0.0, 0.5});
      swing.past_head_m = entry.number("past_head", Unit::length, {-0.05, 0.1});
      swing.published.penetration_mm = entry.number("penetration", Unit::length, {0.0, 0.5}, kNaN) * 1e3;
      swing.published.contact_ms = entry.number("contact", Unit::time, {0.0, 10.0}, kNaN) * 1e3;
      swing.published.impulse_n_s = entry.number("impulse", Unit::impulse, {0.0, 1e3}, kNaN);
      swing.published.effective_mass_kg = entry.number("effective_mass", Unit::mass, {0.0, 1e6}, kNaN);
      series.swings.push_back(swing);
    }
    experiment.series.push_back(series);
  }
  yaml.finish();
  return experiment;
}

std::vector<SimulatedSeries> run_experiment(
    const RobotDescription& robot, const Experiment& experiment,
    const std::function<PlantDescription(const RobotDescription&, const std::string&)>& board, std::uint64_t seed,
    const std::function<void(int done, int of)>& progress) {
  std::size_t swinging = 0;
  std::size_t passive = 0;
  for (std::size_t i = 0; i < robot.joints.size(); ++i) {
    if (robot.joints[i].name == experiment.swinging_joint) swinging = i;
    if (robot.joints[i].name == experiment.passive_joint) passive = i;
  }
  int of = 0;
  for (const ExperimentSeries& series : experiment.series) of += static_cast<int>(series.swings.size());
  int done = 0;
  const Eigen::Vector3d head = sup::Chain(robot).face_pose(sup::JointVector::Zero(robot.dof())).position_m;
  std::vector<SimulatedSeries> results;
  for (const ExperimentSeries& series : experiment.series) {
    SimulatedSeries result;
    result.board = series.board;
    result.single_swings = series.contact_high_ms <= 0.0;
    result.contact_low_ms = series.contact_low_ms;
    result.contact_high_ms = series.contact_high_ms;
    result.impulse_low_n_s = series.impulse_low_n_s;
    result.impulse_high_n_s = series.impulse_high_n_s;
    for (const ExperimentSwing& swing : series.swings) {
      const RobotDescription changed = experiment_robot(robot, experiment, swing, head);
      SimulatedSwing simulated =
          run_swing(changed, board(changed, series.board), series, swing, experiment, swinging, passive, head, seed);
      if (!result.single_swings) {
        simulated.within =
            simulated.contact_ms >= series.contact_low_ms && simulated.contact_ms <= series.contact_high_ms &&
            simulated.impulse_n_s >= series.impulse_low_n_s && simulated.impulse_n_s <= series.impulse_high_n_s;
      }
      result.swings.push_back(simulated);
      if (progress) progress(++done, of);
    }
    results.push_back(result);
  }
  return results;
}

}  // namespace mrr::sim
