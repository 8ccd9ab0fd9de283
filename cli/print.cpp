#include "cli/print.h"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numbers>

namespace mrr::cli {

namespace {

constexpr std::size_t kWidth = 79;

/// Breaks `text` at blanks so that no line is wider than the terminal; continued lines are indented.
std::string wrapped(const std::string& text, std::size_t indent) {
  const std::size_t margin = std::min(text.find_first_not_of(' '), text.size());
  std::string out = text.substr(0, margin);
  std::size_t column = 0;
  std::size_t at = margin;
  while (at < text.size()) {
    std::size_t end = text.find(' ', at);
    if (end == std::string::npos) end = text.size();
    const std::string word = text.substr(at, end - at);
    if (column > 0 && margin + column + 1 + word.size() > kWidth) {
      out += '\n';
      out.append(indent, ' ');
      column = indent;
    } else if (column > 0) {
      out += ' ';
      ++column;
    }
    out += word;
    column += word.size();
    at = end + 1;
  }
  return out + "\n";
}

std::string numbers(const sup::JointVector& values, int digits) {
  std::string text;
  for (const double value : values) {
    const bool zero = std::abs(value) < 0.5 * std::pow(10.0, -digits);  // no "-0.000"
    text += fmt::format("{}{:.{}f}", text.empty() ? "" : " ", zero ? 0.0 : value, digits);
  }
  return text;
}

std::string mass(double kg, int width) {
  return std::isfinite(kg) ? fmt::format("{:{}.1f}", kg, width) : fmt::format("{:>{}}", "inf", width);
}

}  // namespace

std::string plan_text(const RobotDescription& robot, const sup::StrikePlan& plan) {
  std::string text = "Plan\n";
  text += wrapped("  why     " + plan.why, 10);
  text += wrapped(fmt::format("  pose    [{}] rad, one of {} weighed; tilt {:.1f} deg", numbers(plan.q_impact, 3),
                              plan.poses.size(), plan.tilt_rad * 180.0 / std::numbers::pi),
                  10);
  text += wrapped(
      fmt::format("  speed   {:.3f} m/s along the nail, joints [{}] rad/s", plan.speed_m_s, numbers(plan.qd_impact, 3)),
      10);
  text += fmt::format("  blow    {:.2f} N s predicted, effective mass of the arm {:.2f} kg\n", plan.impulse_n_s,
                      plan.effective_mass_kg);
  text += fmt::format(
      "  swing   {:.2f} rad back, contact after {:.0f} ms, {},\n"
      "          reference to {:.1f} mm past the head\n",
      plan.back_swing_rad, plan.contact_time.seconds() * 1e3,
      plan.passive == 0
          ? std::string("nothing switches")
          : fmt::format("switch {:.0f} ms before it", (plan.contact_time - plan.switch_time).seconds() * 1e3),
      plan.follow_through_m * 1e3);
  text += "  axis impulses, N m s   free    held  planned   rated  rep.peak  at impact\n";
  for (int i = 0; i < robot.dof(); ++i) {
    const auto k = static_cast<std::size_t>(i);
    const sup::JointLoad& load = plan.loads[k];
    text += fmt::format("    {:<18} {:>6.3f}  {:>6.3f}   {:>6.3f}  {:>6.3f}    {:>6.3f}  {}\n", robot.joints[k].name,
                        load.free_nm_s, load.held_nm_s, load.planned_nm_s, load.limits.rated_nm_s,
                        load.limits.repeated_nm_s, ((plan.passive >> k) & 1U) != 0 ? "passive" : "active");
  }
  return text;
}

std::string swing_header() {
  return "Swings: nail height after each; M* effective mass of the nail, e restitution;\n"
         "        per joint the largest torque its gear carried while in contact\n"
         "   #   nail mm  moved mm  contact ms  impulse N s pred/meas    M* kg      e\n";
}

std::string swing_text(const RobotDescription& robot, const sup::SwingReport& swing, const sim::SwingTruth& truth) {
  std::string text;
  if (truth.hit) {
    text = fmt::format("  {:>2}   {:>7.1f}  {:>8.1f}  {:>10.0f}     {:>6.2f} / {:<6.2f}        {}  {:>6.2f}\n",
                       swing.number, truth.nail_height_m * 1e3, truth.penetration_m * 1e3, truth.contact_s * 1e3,
                       swing.plan.impulse_n_s, truth.impulse_n_s, mass(truth.effective_mass_kg, 7), truth.restitution);
  } else {
    text = fmt::format("  {:>2}   {:>7.1f}   nothing hit{}\n", swing.number, truth.nail_height_m * 1e3,
                       swing.outcome.aborted != sup::AbortReason::none
                           ? fmt::format(": {}", sup::describe(swing.outcome.aborted))
                           : "");
  }
  for (std::size_t i = 0; i < truth.joints.size(); ++i) {
    const sim::JointBlow& joint = truth.joints[i];
    const JointDescription& description = robot.joints[i];
    std::string lead;
    if (joint.passive) {
      lead = std::isfinite(joint.switch_lead_s) ? fmt::format("passive, lead {:.1f} ms", joint.switch_lead_s * 1e3)
                                                : "was not passive in time";
    } else {
      lead = "active";
    }
    text += fmt::format("        {:<10} {:>6.1f} Nm ({:g} rated, {:g} rep.peak)  {}\n", description.name,
                        joint.peak_torque_nm, description.transmission.rated_nm,
                        description.transmission.repeated_peak_nm, lead);
  }
  return text;
}

std::string verdict_text(const RobotDescription& robot, const sim::HammerJobResult& result, double realtime_factor) {
  std::string text = wrapped(fmt::format("Verdict: {}.", result.reason), 9);
  text += fmt::format("  nail    really {:.2f} mm proud: {} (tolerance {:.1f} mm)\n", result.nail_height_m * 1e3,
                      result.really_flush ? "flush" : "not flush", robot.task.flush_tolerance_m * 1e3);
  text += result.within_limits ? "  limits  kept: no transmission above its repeated peak, no switch too late\n"
                               : wrapped("  limits  broken: " + result.limit_note, 10);
  text += fmt::format("  bus     {:.0f} % loaded on the simulated wire, {:.0f} % computed for the worst case\n",
                      result.bus_load * 100.0, result.bus_load_worst_case * 100.0);
  text += fmt::format("  time    {:.1f} s simulated, {:.0f} x real time\n", result.simulated_s, realtime_factor);
  return text;
}

ProgressBar::ProgressBar() : terminal_(isatty(STDERR_FILENO) == 1) {}

ProgressBar::~ProgressBar() { clear(); }

void ProgressBar::update(const std::string& what, double done) {
  if (!terminal_) return;
  constexpr std::size_t kCells = 30;
  const auto filled = static_cast<std::size_t>(std::clamp(done, 0.0, 1.0) * kCells);
  fmt::print(stderr, "\r[{}{}] {:<46}", std::string(filled, '#'), std::string(kCells - filled, '.'), what);
  std::fflush(stderr);
  drawn_ = true;
}

void ProgressBar::clear() {
  if (!drawn_) return;
  fmt::print(stderr, "\r{}\r", std::string(kWidth, ' '));
  std::fflush(stderr);
  drawn_ = false;
}

}  // namespace mrr::cli
