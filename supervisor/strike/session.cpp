#include "supervisor/strike/session.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <utility>

namespace mrr::sup {

namespace {
constexpr int kMisses = 2;                 // swings in a row that met nothing
constexpr double kFirstHeightSd_m = 1e-3;  // of the height the task says, one standard deviation
constexpr double kMayMove_m = 2e-4;        // by which a nail may have moved in a blow that seems to have left it
constexpr double kTellsApart = 2.0;        // standard deviations
constexpr double kSeenShare = 0.7;         // of rated: peaks seen may grow to this
constexpr double kMostFaster = 1.5;        // from one blow to the next
constexpr double kMostFactor = 2.5;        // over (59)

/// Names of the object dictionary as words.
std::string words(std::string name) {
  std::replace(name.begin(), name.end(), '_', ' ');
  return name;
}

/// What a swing may end in. Holding may be over within the step: joints are let go of, or still take over.
bool at_rest(Activity activity) {
  return activity == Activity::holding || activity == Activity::faulted || activity == Activity::disabled ||
         activity == Activity::bringing_up;
}
}  // namespace

const char* describe(SessionState state) noexcept {
  switch (state) {
    case SessionState::bring_up:
      return "bring-up";
    case SessionState::planning:
      return "planning";
    case SessionState::planned:
      return "planned";
    case SessionState::swinging:
      return "swinging";
    case SessionState::learning:
      return "learning";
    case SessionState::done:
      return "done";
  }
  return "?";
}

const char* describe(Verdict verdict) noexcept {
  switch (verdict) {
    case Verdict::none:
      return "none";
    case Verdict::flush:
      return "flush";
    case Verdict::nothing_moves:
      return "nothing_moves";
    case Verdict::swings_used_up:
      return "swings_used_up";
    case Verdict::nothing_hit:
      return "nothing_hit";
    case Verdict::plan_refused:
      return "plan_refused";
    case Verdict::swing_aborted:
      return "swing_aborted";
    case Verdict::not_ready:
      return "not_ready";
    case Verdict::joint_fault:
      return "joint_fault";
  }
  return "?";
}

HammerSession::HammerSession(const RobotDescription& robot, RobotPort& port, const SessionOptions& options)
    : robot_(robot),
      port_(port),
      chain_(robot),
      options_(options),
      estimator_(robot.task.assumed_contact_s),
      head_height_m_(robot.task.nail_height_m),
      head_sd_m_(kFirstHeightSd_m) {
  if (options_.max_swings <= 0) options_.max_swings = robot.task.max_swings;
}

void HammerSession::finish(Verdict verdict, std::string reason) {
  verdict_ = verdict;
  reason_ = std::move(reason);
  state_ = SessionState::done;
}

std::string HammerSession::bring_up_report(bool refused_only) const {
  std::string text;
  for (int i = 0; i < robot_.dof(); ++i) {
    const NodeReport node = port_.report(i);
    if (node.stage == NodeStage::enabled && node.measured.follows_knots()) continue;
    if (refused_only && node.stage != NodeStage::refused) continue;
    const JointDescription& joint = robot_.joints[static_cast<std::size_t>(i)];
    if (!text.empty()) text += "; ";
    if (node.stage == NodeStage::enabled) {
      text += fmt::format("joint {} ({}, node {}) is enabled but does not follow its set points: {}", i + 1, joint.name,
                          joint.node_id, words(can::name_of_code(node.measured.error_or_limit)));
      continue;
    }
    text += fmt::format("joint {} ({}, node {}) is {}: {}", i + 1, joint.name, joint.node_id, describe(node.stage),
                        describe(node.problem));
    if (node.problem == NodeProblem::fault) {
      const auto code = static_cast<std::uint16_t>(node.problem_detail);
      text += fmt::format(", {} ({:04X}h)", words(can::name_of_code(code)), code);
    } else if (node.problem_detail != 0) {
      text += fmt::format(" (0x{:08X})", node.problem_detail);
    }
  }
  return text;
}

PlanInput HammerSession::next_request() const {
  const TaskDescription& task = robot_.task;
  PlanInput request;
  request.normal = task.normal;
  request.head_position_m = task.nail_position_m + head_height_m_ * task.normal;
  request.board_distance_m = std::max(0.0, head_height_m_);
  request.restitution = estimator_.restitution();
  request.nail_mass_kg = estimator_.nail_mass_kg();
  request.contact_duration_s = estimator_.contact_duration_s();
  request.contact = estimator_.contact_law(head_height_m_);
  request.follow_through_m = estimator_.follow_through_for(std::min(head_height_m_, options_.largest_step_m));
  request.mode = options_.mode;
  request.formulation = options_.formulation;
  request.measure = options_.measure;
  request.start = port_.reference_position();
  request.speed_factor = speed_factor_;
  request.seed = options_.seed;
  return request;
}

/// How much faster than (59) the next blow may be. Loads grow with the speed: what the torque sensors saw says by how
/// much they may, with a reserve for the next blow being harder. Only where it saves a blow: a nail that moves, and
/// that another blow like this one would not finish.
double HammerSession::next_speed_factor(const SwingReport& swing, double moved_m) const {
  if (!options_.learn || !(moved_m > 0.0) || swing.head_height_after_m <= moved_m) return 1.0;
  if (!swing.outcome.torque_sensed) return 1.0;
  double use = 0.0;
  for (int i = 0; i < robot_.dof(); ++i) {
    const JointDescription& joint = robot_.joints[static_cast<std::size_t>(i)];
    if (!joint.sensors.torque_sensor) return 1.0;
    const double share = swing.outcome.peak_torque_nm[static_cast<std::size_t>(i)] / joint.transmission.rated_nm;
    if (!std::isfinite(share)) return 1.0;
    use = std::max(use, share);
  }
  if (!(use > 0.0)) return 1.0;
  return std::clamp(swing.speed_factor * std::min(kMostFaster, kSeenShare / use), 1.0, kMostFactor);
}

/// A plan at more than the speed of (59), if there is one with all peaks predicted below rated.
bool HammerSession::plan_faster() {
  try {
    plan_ = sup::plan(robot_, chain_, next_request());
  } catch (const PlanError&) {
    return false;
  }
  if (!plan_->blow.feasible) return false;
  for (int i = 0; i < robot_.dof(); ++i) {
    const double rated_nm = robot_.joints[static_cast<std::size_t>(i)].transmission.rated_nm;
    if (!(plan_->blow.peak_torque_nm[i] <= rated_nm)) return false;
  }
  return true;
}

void HammerSession::plan_next() {
  if (!(speed_factor_ > 1.0 && plan_faster())) {
    speed_factor_ = 1.0;
    try {
      plan_ = sup::plan(robot_, chain_, next_request());
    } catch (const PlanError& error) {
      finish(Verdict::plan_refused, error.what());
      return;
    }
  }
  // Planning takes long: whoever steps the session may have been asked to stop meanwhile.
  state_ = SessionState::planned;
}

void HammerSession::execute() {
  const Refusal refusal = port_.execute(*plan_);
  if (refusal != Refusal::none) {
    finish(Verdict::plan_refused, fmt::format("the swing was refused: {}", describe(refusal)));
    return;
  }
  state_ = SessionState::swinging;
}

void HammerSession::learn() {
  SwingReport report;
  report.number = static_cast<int>(swings_.size()) + 1;
  report.plan = *plan_;
  report.outcome = port_.outcome();
  report.head_height_before_m = head_height_m_;
  report.restitution = estimator_.restitution();
  report.speed_factor = speed_factor_;
  report.nail_mass_kg = estimator_.nail_mass_kg();
  report.head_height_after_m = head_height_m_;
  report.head_sd_after_m = head_sd_m_;
  const SwingOutcome& outcome = report.outcome;
  const ContactReport& contact = outcome.contact;

  const TaskDescription& task = robot_.task;
  double moved_m = 0.0;
  if (outcome.aborted == AbortReason::none && contact.phase == ContactPhase::over) {
    // A fresh measurement, not a sum of penetrations. One that cannot be told from what was known is another look at
    // the same place, and refines it.
    const SeenBlow look = estimator_.look(*plan_, contact);
    report.outcome.contact = look.contact;
    const Height& seen = look.head;
    const double seen_m = seen.m - task.nail_position_m.dot(task.normal);
    const double known_sd_m = std::hypot(head_sd_m_, kMayMove_m);
    const double both_m = std::hypot(known_sd_m, seen.sd_m);
    if (std::abs(head_height_m_ - seen_m) > kTellsApart * both_m) {
      report.head_height_after_m = seen_m;
      head_sd_m_ = seen.sd_m;
    } else {
      const double trust = known_sd_m * known_sd_m / (both_m * both_m);
      report.head_height_after_m = head_height_m_ + trust * (seen_m - head_height_m_);
      head_sd_m_ = known_sd_m * seen.sd_m / both_m;
    }
    report.head_sd_after_m = head_sd_m_;
    const double driven_m = head_height_m_ - report.head_height_after_m;
    if (driven_m > task.still_tolerance_m) moved_m = driven_m;
    ContactReport blow = contact;
    blow.penetration_m = moved_m;
    if (options_.learn) estimator_.learn(*plan_, blow);
  }
  speed_factor_ = next_speed_factor(report, moved_m);
  head_height_m_ = std::max(0.0, report.head_height_after_m);
  swings_.push_back(report);

  if (outcome.aborted == AbortReason::joint_fault) {
    finish(Verdict::joint_fault, fmt::format("a joint failed during swing {}: {}", report.number, bring_up_report()));
  } else if (outcome.aborted != AbortReason::none) {
    finish(Verdict::swing_aborted, fmt::format("swing {} was aborted: {}", report.number, describe(outcome.aborted)));
  } else if (contact.phase != ContactPhase::over && ++misses_in_a_row_ >= kMisses) {
    finish(Verdict::nothing_hit,
           fmt::format("{} swings in a row met nothing where the nail's head was expected, {:.1f} mm above the board",
                       misses_in_a_row_, report.head_height_before_m * 1e3));
  } else if (contact.phase != ContactPhase::over) {
    // A soft blow may go unfelt; where the head is will show in the next one.
    state_ = SessionState::planning;
  } else if (head_height_m_ <= task.flush_tolerance_m) {
    finish(Verdict::flush,
           fmt::format("the head is flush after {} swing{}", report.number, report.number == 1 ? "" : "s"));
  } else {
    misses_in_a_row_ = 0;
    still_in_a_row_ = moved_m > 0.0 ? 0 : still_in_a_row_ + 1;
    if (still_in_a_row_ >= task.still_swings && head_height_m_ - kTellsApart * head_sd_m_ <= task.flush_tolerance_m) {
      finish(Verdict::flush, fmt::format("the head is flush as far as the joints can tell ({:.1f} mm +- {:.1f} mm): {} "
                                         "swings in a row moved it no further",
                                         head_height_m_ * 1e3, head_sd_m_ * 1e3, still_in_a_row_));
    } else if (still_in_a_row_ >= task.still_swings) {
      finish(Verdict::nothing_moves,
             fmt::format("nothing moves: {} swings in a row drove the nail less than {:.1f} mm; "
                         "it stands {:.1f} mm proud",
                         still_in_a_row_, task.still_tolerance_m * 1e3, head_height_m_ * 1e3));
    } else if (report.number >= options_.max_swings) {
      finish(Verdict::swings_used_up, fmt::format("{} swings are used up; the nail stands {:.1f} mm proud",
                                                  report.number, head_height_m_ * 1e3));
    } else {
      state_ = SessionState::planning;
    }
  }
}

bool HammerSession::step(Time now) {
  switch (state_) {
    case SessionState::bring_up:
      if (!started_) {
        started_ = true;
        started_at_ = now;
        port_.enable(true);
      }
      if (port_.activity() == Activity::holding) {
        state_ = SessionState::planning;
      } else if (const std::string refused = bring_up_report(true); !refused.empty() && refused == bring_up_report()) {
        finish(Verdict::not_ready, refused);  // the others hold, and time does not change that
      } else if (now - started_at_ > options_.bring_up_timeout) {
        finish(Verdict::not_ready, fmt::format("bring-up did not end within {:.0f} s: {}",
                                               options_.bring_up_timeout.seconds(), bring_up_report()));
      }
      break;
    case SessionState::planning:
      if (port_.activity() == Activity::bringing_up) {  // a joint is still taking over
        state_ = SessionState::bring_up;
        started_at_ = now;
      } else {
        plan_next();
      }
      break;
    case SessionState::planned:
      execute();
      break;
    case SessionState::swinging:
      if (port_.outcome().done && at_rest(port_.activity())) state_ = SessionState::learning;
      break;
    case SessionState::learning:
      learn();
      break;
    case SessionState::done:
      break;
  }
  return state_ == SessionState::done;
}

}  // namespace mrr::sup
