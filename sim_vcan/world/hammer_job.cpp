#include "sim_vcan/world/hammer_job.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "supervisor/impact/external.h"
#include "supervisor/master/bus_budget.h"

namespace mrr::sim {

namespace {

constexpr double kMoved_m = 5e-5;  // less is below what a ruler shows: the effective mass is then infinite

/// What is watched while a swing goes on.
struct SwingWatch {
  std::size_t contacts_before = 0;
  double height_before_m = 0.0;
  std::vector<double> peak_swing_nm;
  std::vector<Time> passive_since;
  std::vector<bool> was_passive;
};

SwingTruth conclude(const World& world, const SwingWatch& watch, const sup::SwingReport& report) {
  const auto dof = static_cast<std::size_t>(world.dof());
  const PlantTruth now = world.plant().truth();
  const ContactRecords& contacts = world.plant().contacts();
  SwingTruth truth;
  truth.nail_height_m = now.nail_height_m;
  truth.penetration_m = watch.height_before_m - now.nail_height_m;
  truth.joints.resize(dof);
  // A blow may rebound: the contact with the largest impulse is the blow.
  const ContactRecord* blow = nullptr;
  for (std::size_t i = watch.contacts_before; i < contacts.size(); ++i) {
    if (blow == nullptr || contacts[i].impulse_n_s > blow->impulse_n_s) blow = &contacts[i];
  }
  for (std::size_t i = 0; i < dof; ++i) {
    truth.joints[i].passive = ((report.plan.passive >> i) & 1U) != 0;
    truth.joints[i].peak_torque_swing_nm = watch.peak_swing_nm[i];
    truth.joints[i].switch_lead_s = std::numeric_limits<double>::quiet_NaN();
  }
  if (blow == nullptr) return truth;
  truth.hit = true;
  truth.contact_start = blow->start;
  truth.contact_s = blow->duration().seconds();
  truth.impulse_n_s = blow->impulse_n_s;
  truth.peak_force_n = blow->peak_force_n;
  truth.speed_m_s = blow->speed_at_start_m_s;
  truth.effective_mass_kg = truth.penetration_m > kMoved_m
                                ? sup::effective_nail_mass_kg(truth.impulse_n_s, truth.contact_s, truth.penetration_m)
                                : std::numeric_limits<double>::infinity();
  truth.restitution = blow->speed_at_start_m_s > 0.0 ? -blow->speed_at_end_m_s / blow->speed_at_start_m_s : 0.0;
  for (std::size_t i = 0; i < dof; ++i) {
    truth.joints[i].peak_torque_nm = blow->peak_transmission_torque_nm[i];
    truth.joints[i].peak_torque_swing_nm =
        std::max(truth.joints[i].peak_torque_swing_nm, truth.joints[i].peak_torque_nm);
    truth.joints[i].impulse_nm_s = blow->transmission_impulse_nm_s[i];
    if (truth.joints[i].passive && watch.was_passive[i]) {
      truth.joints[i].switch_lead_s = (blow->start - watch.passive_since[i]).seconds();
    }
  }
  return truth;
}

void judge(const RobotDescription& robot, HammerJobResult& result) {
  for (std::size_t k = 0; k < result.truth.size(); ++k) {
    for (std::size_t i = 0; i < result.truth[k].joints.size(); ++i) {
      const JointBlow& joint = result.truth[k].joints[i];
      const JointDescription& description = robot.joints[i];
      std::string note;
      if (joint.peak_torque_swing_nm > description.transmission.repeated_peak_nm) {
        note = fmt::format("swing {}: {} carried {:.1f} Nm, above its repeated peak of {:.1f} Nm", k + 1,
                           description.name, joint.peak_torque_swing_nm, description.transmission.repeated_peak_nm);
      } else if (joint.passive && result.truth[k].hit && !(joint.switch_lead_s > 0.0)) {
        note = fmt::format("swing {}: {} was not passive before contact", k + 1, description.name);
      }
      if (!note.empty() && result.within_limits) {
        result.within_limits = false;
        result.limit_note = note;
      }
    }
  }
}

}  // namespace

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
  const auto begin_watch = [&] {
    watch = SwingWatch{world.plant().contacts().size(), world.plant().truth().nail_height_m,
                       std::vector<double>(dof, 0.0), std::vector<Time>(dof), std::vector<bool>(dof, false)};
  };
  begin_watch();
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
      const PlantTruth truth = world.plant().truth();
      for (std::size_t i = 0; i < dof; ++i) {
        watch.peak_swing_nm[i] = std::max(watch.peak_swing_nm[i], std::abs(truth.transmission_torque_nm[i]));
        // The first time in this swing that the joint is wholly passive.
        const fw::ModuleStatus& status = world.module(static_cast<int>(i)).status();
        const Time since = world.mode_trace(static_cast<int>(i)).passive_since;
        if (!watch.was_passive[i] && status.law == fw::Law::passive && since >= world.supervisor().outcome().began) {
          watch.was_passive[i] = true;
          watch.passive_since[i] = since;
        }
      }
    }
    if (telemetry != nullptr) telemetry->sample(world, static_cast<int>(session.swings().size()) + 1);
    over = session.step(world.now());
    if (session.swings().size() > result.truth.size()) {
      result.truth.push_back(conclude(world, watch, session.swings().back()));
      begin_watch();
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
  judge(robot, result);
  return result;
}

}  // namespace mrr::sim
