#include "cli/print.h"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <numbers>

#include "cli/text.h"

namespace mrr::cli {

namespace {

using Json = nlohmann::ordered_json;

/// NaN: unknown.
double number(const Json& value) {
  return value.is_number() ? value.get<double>() : std::numeric_limits<double>::quiet_NaN();
}

std::string numbers(const Json& values, int digits) {
  std::string text;
  for (const Json& one : values) {
    const double value = number(one);
    const bool zero = std::abs(value) < 0.5 * std::pow(10.0, -digits);  // no "-0.000"
    text += fmt::format("{}{:.{}f}", text.empty() ? "" : " ", zero ? 0.0 : value, digits);
  }
  return text;
}

}  // namespace

std::string plan_text(const Json& plan) {
  const auto of = [&plan](const char* key) { return number(plan.at(key)); };
  const Json& joints = plan.at("joints");
  const bool switches =
      std::any_of(joints.begin(), joints.end(), [](const Json& joint) { return joint.at("passive").get<bool>(); });
  double back_swing_rad = 0.0;
  for (std::size_t i = 0; i < joints.size(); ++i) {
    back_swing_rad =
        std::max(back_swing_rad, std::abs(number(plan.at("q_impact_rad")[i]) - number(plan.at("q_back_swing_rad")[i])));
  }
  std::string text = "Plan\n";
  text += wrapped("  why     " + plan.at("why").get<std::string>(), 10);
  text +=
      wrapped(fmt::format("  pose    [{}] rad, one of {} weighed; tilt {:.1f} deg", numbers(plan.at("q_impact_rad"), 3),
                          plan.at("poses").size(), of("tilt_rad") * 180.0 / std::numbers::pi),
              10);
  text += wrapped(fmt::format("  speed   {:.3f} m/s along the nail, joints [{}] rad/s", of("speed_m_s"),
                              numbers(plan.at("qd_impact_rad_s"), 3)),
                  10);
  text += wrapped(fmt::format("  blow    {:.2f} N s predicted, effective mass of the arm {:.2f} kg",
                              of("impulse_predicted_n_s"), of("effective_mass_kg")),
                  10);
  text += wrapped(
      fmt::format("  swing   {:.2f} rad back, contact after {:.0f} ms, {}, reference to {:.1f} mm past the head",
                  back_swing_rad, of("contact_time_s") * 1e3,
                  switches
                      ? fmt::format("switch {:.0f} ms before it", (of("contact_time_s") - of("switch_time_s")) * 1e3)
                      : std::string("nothing switches"),
                  of("follow_through_mm")),
      10);
  text += "  axis impulses, N m s   free    held  planned   rated  rep.peak  at impact\n";
  for (const Json& joint : joints) {
    text += fmt::format("    {:<18} {:>6.3f}  {:>6.3f}   {:>6.3f}  {:>6.3f}    {:>6.3f}  {}\n",
                        joint.at("name").get<std::string>(), number(joint.at("free_nm_s")),
                        number(joint.at("held_nm_s")), number(joint.at("planned_nm_s")),
                        number(joint.at("rated_limit_nm_s")), number(joint.at("repeated_peak_limit_nm_s")),
                        joint.at("passive").get<bool>() ? "passive" : "active");
  }
  return text;
}

std::string swing_header(bool truth_known) {
  return truth_known ? "Swings: nail height after each; M* effective mass of the nail, e restitution;\n"
                       "        per joint the largest torque its gear carried while in contact\n"
                       "   #   nail mm  moved mm  contact ms  impulse N s pred/meas    M* kg      e\n"
                     : "Swings as the robot felt them; nobody was there to say what really happened.\n"
                       "        Per joint the largest torque its sensor showed while in contact\n"
                       "   #   nail mm  moved mm  contact ms  impulse N s pred/felt\n";
}

std::string swing_text(const Json& swing) {
  const auto of = [&swing](const char* key) { return number(swing.at(key)); };
  const int count = swing.at("number").get<int>();
  const bool aborted = swing.at("aborted").is_string();
  const std::string why = aborted ? ": " + swing.at("aborted").get<std::string>() : "";
  const bool known = swing.at("hit").is_boolean();
  const Json& seen = swing.at("seen_by_robot");
  const bool hit = known ? swing.at("hit").get<bool>() : number(seen.at("contact_ms")) > 0.0;
  std::string text;
  if (known && hit) {
    const double mass_kg = of("effective_mass_kg");
    text = fmt::format("  {:>2}   {:>7.1f}  {:>8.1f}  {:>10.0f}     {:>6.2f} / {:<6.2f}        {}  {:>6.2f}\n", count,
                       of("nail_height_mm"), of("penetration_mm"), of("contact_ms"), of("impulse_predicted_n_s"),
                       of("impulse_measured_n_s"),
                       std::isfinite(mass_kg) ? fmt::format("{:7.1f}", mass_kg) : fmt::format("{:>7}", "inf"),
                       of("restitution"));
  } else if (known) {
    text = fmt::format("  {:>2}   {:>7.1f}   nothing hit{}\n", count, of("nail_height_mm"), why);
  } else if (hit) {
    text = fmt::format("  {:>2}   {:>7.1f}  {:>8.1f}  {:>10.0f}     {:>6.2f} / {:<6.2f}\n", count,
                       number(seen.at("nail_height_mm")), number(seen.at("penetration_mm")),
                       number(seen.at("contact_ms")), of("impulse_predicted_n_s"), number(seen.at("impulse_n_s")));
  } else {
    text = fmt::format("  {:>2}   {:>7.1f}   nothing felt{}\n", count, number(seen.at("nail_height_mm")), why);
  }
  for (const Json& joint : swing.at("joints")) {
    const double lead_ms = number(joint.at("switch_lead_ms"));
    std::string lead = "active";
    if (joint.at("passive").get<bool>()) {
      lead = std::isfinite(lead_ms) ? fmt::format("passive, lead {:.1f} ms", lead_ms)
             : known                ? "was not passive in time"
                                    : "passive";
    }
    text += fmt::format("        {:<10} {:>6.1f} Nm ({:g} rated, {:g} rep.peak)  {}\n",
                        joint.at("name").get<std::string>(), number(joint.at("peak_torque_nm")),
                        number(joint.at("rated_nm")), number(joint.at("repeated_peak_nm")), lead);
  }
  return text;
}

std::string verdict_text(const RobotDescription& robot, const Json& result) {
  const auto of = [&result](const char* key) { return number(result.at(key)); };
  const bool known = result.at("truth_known").get<bool>();
  const bool processes = result.at("processes").is_string();
  std::string text = wrapped(fmt::format("Verdict: {}.", result.at("reason").get<std::string>()), 9);
  text +=
      wrapped(fmt::format("  nail    {} {:.2f} mm proud: {} (tolerance {:.1f} mm)",
                          known ? "really" : "by what the robot felt", of("nail_height_mm"),
                          result.at("flush").get<bool>() ? "flush" : "not flush", robot.task.flush_tolerance_m * 1e3),
              10);
  if (!known) {
    text += "  limits  not known: no plant to ask\n";
  } else if (result.at("within_limits").get<bool>()) {
    text += "  limits  kept: no transmission above its repeated peak, no switch too late\n";
  } else {
    text += wrapped("  limits  broken: " + result.at("limit_note").get<std::string>(), 10);
  }
  text += wrapped(
      fmt::format("  bus     {:.0f} % loaded {}, {:.0f} % computed for the worst case", of("bus_load") * 100.0,
                  processes ? "by the frames recorded" : "on the simulated wire", of("bus_load_worst_case") * 100.0),
      10);
  const double factor = of("realtime_factor");
  if (processes && result.at("processes") == "realtime") {
    text += fmt::format("  time    {:.1f} s in real time\n", of("simulated_s"));
  } else {
    text += fmt::format("  time    {:.1f} s simulated, {:.{}f} x real time\n", of("simulated_s"), factor,
                        factor < 10.0 ? 1 : 0);
  }
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
