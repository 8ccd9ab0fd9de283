#include "sim_vcan/world/hammer_job.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "supervisor/master/bus_budget.h"

namespace mrr::sim {

std::string broken_limit(const RobotDescription& robot, std::span<const SwingTruth> swings) {
  for (std::size_t k = 0; k < swings.size(); ++k) {
    for (std::size_t i = 0; i < swings[k].joints.size(); ++i) {
      const JointBlow& joint = swings[k].joints[i];
      const JointDescription& description = robot.joints[i];
      if (joint.peak_torque_swing_nm > description.transmission.repeated_peak_nm) {
        return fmt::format("swing {}: {} carried {:.1f} Nm, above its repeated peak of {:.1f} Nm", k + 1,
                           description.name, joint.peak_torque_swing_nm, description.transmission.repeated_peak_nm);
      }
      if (joint.passive && swings[k].hit && !(joint.switch_lead_s > 0.0))
        return fmt::format("swing {}: {} was not passive before contact", k + 1, description.name);
    }
  }
  return {};
}

HammerJobResult run_hammer_job(const RobotDescription& robot, const PlantDescription& plant,
                               const HammerJobOptions& options, CandumpWriter* frames, Telemetry* telemetry,
                               const Progress& progress, const std::function<void(World&)>& prepare) {
  World world(robot, plant, options.world);
  if (frames != nullptr) {
    world.on_frame = [frames](const Delivery& delivery) { frames->write(delivery.frame, delivery.at); };
  }
  if (prepare) prepare(world);
  std::vector<double> park;
  for (const JointDescription& joint : robot.joints) park.push_back(joint.park_rad);
  world.reset(park, robot.task.nail_height_m);
  sup::HammerSession session(robot, world.supervisor(), options.session);

  HammerJobResult result;
  const auto dof = static_cast<std::size_t>(world.dof());
  SwingWatch watch;
  watch.begin(world.plant());
  bool over = false;
  Time next_progress;
  while (!over && world.now() < Time{} + options.time_limit) {
    world.step();
    if (!world.supervisor_stepped()) continue;
    for (const sup::Event& event : world.supervisor().events()) result.events.push_back(event);
    world.supervisor().events().clear();

    const sup::Activity activity = world.supervisor().activity();
    const bool in_swing = activity == sup::Activity::swinging || activity == sup::Activity::resuming ||
                          activity == sup::Activity::returning;
    if (in_swing) {
      watch.observe(world.plant().truth());
      for (std::size_t i = 0; i < dof; ++i) {
        // The first time in this swing that the joint is wholly passive.
        const fw::ModuleStatus& status = world.module(static_cast<int>(i)).status();
        const Time since = world.mode_trace(static_cast<int>(i)).passive_since;
        if (status.law == fw::Law::passive && since >= world.supervisor().outcome().began)
          watch.passive_since(i, since);
      }
    }
    if (telemetry != nullptr) telemetry->sample(world, static_cast<int>(session.swings().size()) + 1);
    over = session.step(world.now());
    if (session.swings().size() > result.truth.size()) {
      result.truth.push_back(watch.conclude(world.plant(), session.swings().back().plan.passive));
      watch.begin(world.plant());
    }
    if (progress && world.now() >= next_progress) {
      progress(world.now().seconds(), static_cast<int>(session.swings().size()), world.plant().truth().nail_height_m);
      next_progress = world.now() + milliseconds(50);
    }
  }
  result.verdict = session.verdict();
  result.reason = over ? session.reason()
                       : fmt::format("{:.0f} s of simulated time are used up; the robot was {}",
                                     options.time_limit.seconds(), sup::describe(world.supervisor().activity()));
  result.swings = session.swings();
  result.nail_height_m = world.plant().truth().nail_height_m;
  result.really_flush = result.nail_height_m <= robot.task.flush_tolerance_m;
  result.simulated_s = world.now().seconds();
  result.bus_load = world.bus().statistics().load();
  result.bus_load_worst_case = sup::bus_budget(robot).load;
  result.limit_note = broken_limit(robot, result.truth);
  result.within_limits = result.limit_note.empty();
  return result;
}

}  // namespace mrr::sim
