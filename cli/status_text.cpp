#include "cli/status_text.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>

#include "cli/text.h"

namespace mrr::cli {

using rpc::Json;

namespace {

constexpr double kDegrees = 180.0 / std::numbers::pi;
constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

/// NaN if the key is missing or null: unknown.
double number(const Json& object, const char* key) {
  const auto found = object.find(key);
  return found != object.end() && found->is_number() ? found->get<double>() : kNaN;
}

/// 0 if the key is missing or no whole number.
long long count(const Json& object, const char* key) {
  const auto found = object.find(key);
  return found != object.end() && found->is_number_integer() ? found->get<long long>() : 0;
}

std::string text(const Json& object, const char* key, const std::string& otherwise = "-") {
  const auto found = object.find(key);
  return found != object.end() && found->is_string() ? found->get<std::string>() : otherwise;
}

bool flag(const Json& object, const char* key) {
  const auto found = object.find(key);
  return found != object.end() && found->is_boolean() && found->get<bool>();
}

/// "-" for what is unknown, and no "-0.0".
std::string figure(double value, int digits) {
  if (!std::isfinite(value)) return "-";
  const bool zero = std::abs(value) < 0.5 * std::pow(10.0, -digits);
  return fmt::format("{:.{}f}", zero ? 0.0 : value, digits);
}

/// Cut at `width` columns; names may be long.
std::string fitted(std::string word, std::size_t width) {
  if (word.size() > width) word = word.substr(0, width - 1) + "~";
  return word;
}

std::string mode_word(const Json& joint) {
  const auto found = joint.find("mode");
  if (found == joint.end() || !found->is_number_integer()) return "-";
  switch (found->get<int>()) {
    case -1:
      return "passive";
    case 0:
      return "none";
    case 6:
      return "homing";
    case 8:
      return "follows";
    case 10:
      return "torque";
    default:
      return fmt::format("mode {}", found->get<int>());
  }
}

std::string clock_words(const Json& clock) {
  return text(clock, "kind") == "lockstep" ? "in lockstep with the plant" : "in real time";
}

/// A joint that is lost or refused reports no code.
std::string fault_words(const Json& fault) {
  if (count(fault, "code") == 0) return "no word from it, or refused";
  return fmt::format("{:04X}h {}", count(fault, "code"), text(fault, "name"));
}

}  // namespace

std::string status_text(const Json& hello, const Json& status) {
  const Json& bus = status.at("bus");
  const Json& clock = status.at("clock");
  std::string out = fmt::format("{} on {}, {}: {}{}\n\n", text(hello.at("robot"), "name"), text(bus, "interface"),
                                clock_words(clock), text(status, "activity"), flag(status, "ready") ? ", ready" : "");
  // Nothing below is of now then.
  if (!flag(clock, "running"))
    out += text(clock, "kind") == "lockstep"
               ? "  The plant does not tick, and it is the clock: what follows is its last\n"
                 "  tick. See that mrr_plant and all modules run.\n\n"
               : "  The clock stands still: what follows is not of now.\n\n";
  out += "  joint       stage          mode      position     speed   torque  winding\n";
  out += "                                            deg     deg/s       Nm     degC\n";
  std::string notes;
  for (const Json& joint : status.at("joints")) {
    const std::string name = text(joint, "name");
    out += fmt::format("  {:<11} {:<14} {:<8} {:>9} {:>9} {:>8} {:>8}\n", fitted(name, 11), text(joint, "stage"),
                       text(joint, "stage") == "idle" ? "-" : mode_word(joint),  // a mode is chosen, nothing follows it
                       figure(number(joint, "position_rad") * kDegrees, 2),
                       figure(number(joint, "velocity_rad_s") * kDegrees, 1), figure(number(joint, "torque_nm"), 1),
                       figure(number(joint, "winding_c"), 0));
    if (joint.contains("problem") && joint["problem"].is_string())
      notes += wrapped(fmt::format("  {}: {}", name, text(joint, "problem")), 6);
    if (joint.contains("fault") && joint["fault"].is_object()) {
      const Json& fault = joint["fault"];
      notes += wrapped(fmt::format("  {}: first fault {} at {} s; mrr fault says more", name, fault_words(fault),
                                   figure(number(fault, "time_s"), 3)),
                       6);
    }
    if (joint.contains("active_limit") && joint["active_limit"].is_string())
      notes += wrapped(fmt::format("  {}: limited by {}", name, text(joint, "active_limit")), 6);
    if (joint.contains("homed") && joint["homed"].is_boolean() && !flag(joint, "homed"))
      notes += wrapped(fmt::format("  {}: not homed; mrr home {}", name, name), 6);
  }
  if (text(status, "activity") == "faulted")
    notes += "  A joint was lost or in fault: mrr fault says why; then mrr reset.\n";
  if (!notes.empty()) out += '\n' + notes;
  out += '\n';
  out += wrapped(fmt::format("  bus      {}{}; {} % of the bit rate in the worst case; {} frames sent, {} received, {} "
                             "not taken",
                             text(bus, "state"),
                             bus.contains("problem") && bus["problem"].is_string() ? ": " + text(bus, "problem") : "",
                             figure(number(bus, "load_computed") * 100.0, 0), count(bus, "frames_sent"),
                             count(bus, "frames_received"), count(bus, "transmit_failures")),
                 11);
  std::string pace;
  if (clock.contains("late_us") && clock["late_us"].is_object() && text(clock, "kind") != "lockstep") {
    const Json& late = clock["late_us"];
    pace = fmt::format("; late by {} us (median), {} us (99 %), {} us (worst)", figure(number(late, "p50"), 0),
                       figure(number(late, "p99"), 0), figure(number(late, "max"), 0));
  }
  out +=
      wrapped(fmt::format("  clock    {} s, {}; {} cycles of {} us, {} missed{}", figure(number(status, "time_s"), 1),
                          flag(clock, "running") ? "running" : "stands still", count(clock, "cycles"),
                          figure(number(clock, "period_us"), 0), count(clock, "missed"), pace),
              11);
  if (status.contains("ledger") && status["ledger"].is_object()) {
    const Json& ledger = status["ledger"];
    std::string gears;
    long long blows = 0;
    for (const Json& joint : ledger.at("joints")) {
      const long long events = count(joint, "momentary_events");
      gears += fmt::format("{}{} {:.1g} %", gears.empty() ? "" : ", ", text(joint, "name"),
                           number(joint, "life_share") * 100.0);
      if (events > 0) gears += fmt::format(" ({} peak{} above the repeated peak)", events, events == 1 ? "" : "s");
      blows = std::max(blows, count(joint, "blows"));
    }
    out += wrapped(fmt::format("  gears    life used in {} blow{} since {}: {}", blows, blows == 1 ? "" : "s",
                               text(ledger, "since"), gears),
                   11);
    if (!text(ledger, "problem", "").empty()) out += wrapped(fmt::format("           {}", text(ledger, "problem")), 11);
  }
  if (status.contains("command") && status["command"].is_object()) {
    const Json& command = status["command"];
    const std::string reason = text(command, "reason", "");
    out += wrapped(fmt::format("  command  {} {}: {}{}", count(command, "number"), text(command, "method"),
                               text(command, "state"), reason.empty() ? "" : ", " + reason),
                   11);
  }
  if (status.contains("job") && status["job"].is_object()) {
    const Json& job = status["job"];
    const long long swings = count(job, "swings");
    std::string verdict = text(job, "verdict");  // as in result.json: swing_aborted
    std::replace(verdict.begin(), verdict.end(), '_', ' ');
    out += wrapped(fmt::format("  job      {}: {}, {} swing{} so far, nail {} mm proud as the robot sees it",
                               count(job, "job"), text(job, "state") == "done" ? verdict : "running", swings,
                               swings == 1 ? "" : "s", figure(number(job, "nail_height_mm"), 1)),
                   11);
  }
  return out;
}

std::string remedy(int code) {
  struct Entry {
    int first, last;
    const char* text;
  };
  // By classes of CiA 301 and 402; the narrower one first.
  static constexpr std::array<Entry, 19> kEntries{{
      {0x2130, 0x2130, "look for a short between the motor's phases or in its cable"},
      {0x2300, 0x23FF, "look for a blocked joint or a short in the motor's cable, then mrr reset"},
      {0x2000, 0x2FFF, "let the drive rest; look for a blocked joint or a load above its rating, then mrr reset"},
      {0x3110, 0x311F, "the supply is too high: look at the power supply and the brake resistor, then mrr reset"},
      {0x3200, 0x321F, "the supply is too high: brake more gently or look at the brake resistor, then mrr reset"},
      {0x3000, 0x3FFF, "the supply is too low or out of range: look at the power supply, then mrr reset"},
      {0x4000, 0x4FFF, "let it cool down, then mrr reset; swing less often if it comes back"},
      {0x5000, 0x5FFF, "look at the module's electronics and cables, then mrr reset"},
      {0x6000, 0x6FFF, "restart the module; if it comes back, flash it anew"},
      {0x7120, 0x712F, "look at the brake and at what blocks the joint, then mrr reset"},
      {0x7300, 0x73FF, "look at the encoder or torque sensor and its cable, then mrr reset and mrr home"},
      {0x7000, 0x7FFF, "look at the sensor or actuator named, and its cable, then mrr reset"},
      {0x8110, 0x811F, "the bus is overloaded or its wiring bad: look at terminators and bit rate, then mrr reset"},
      {0x8120, 0x813F, "the supervisor was not heard: see that mrr_supervisor runs and the bus is up, then mrr reset"},
      {0x8140, 0x814F, "the bus was off: look at terminators, cables and bit rate, then mrr reset"},
      {0x8200, 0x82FF, "a frame of wrong length arrived: look for another master on the bus, then mrr reset"},
      {0x8600, 0x86FF, "move more slowly, or look for what is in the way, then mrr reset"},
      {0x8000, 0x8FFF, "look at the bus and at the joint, then mrr reset"},
      {0xFF00, 0xFFFF, "look at what the module says about it (docs/module.md), then mrr reset"},
  }};
  for (const Entry& entry : kEntries) {
    if (code >= entry.first && code <= entry.last) return entry.text;
  }
  return "look at the joint, then mrr reset";
}

std::string faults_text(const Json& faults) {
  std::string out;
  const Json& active = faults.at("active");
  if (active.empty()) {
    out += "No faults.\n";
  } else {
    out += fmt::format("{} fault{}, the first of each joint:\n", active.size(), active.size() == 1 ? "" : "s");
  }
  for (const Json& fault : active) {
    out += wrapped(fmt::format("  {}  {} at {} s: {}", text(fault, "joint"), fault_words(fault),
                               figure(number(fault, "time_s"), 3), text(fault, "text", "no more is known")),
                   6);
    out += wrapped(fmt::format("      remedy: {}", remedy(static_cast<int>(count(fault, "code")))), 14);
  }
  const Json& history = faults.at("history");
  if (!history.empty()) out += "\nNewest first:\n         s  joint        code\n";
  for (const Json& fault : history) {
    out += fmt::format("{:>10}  {:<12} {}\n", figure(number(fault, "time_s"), 3), fitted(text(fault, "joint"), 12),
                       fault_words(fault));
  }
  return out;
}

std::string log_line(const Json& line) {
  const std::string level = text(line, "level");
  return fmt::format("{:>10} s  {:<7}  {}\n", figure(number(line, "time_s"), 3), level, text(line, "text", ""));
}

std::string event_line(const Json& event) {
  const std::string joint = text(event, "joint", "");
  const std::string words = text(event, "text", text(event, "kind"));
  // The supervisor's sentence may begin with the joint itself.
  const bool named = joint.empty() || words.find(joint) != std::string::npos;
  std::string out =
      fmt::format("{:>10} s  {}{}\n", figure(number(event, "time_s"), 3), named ? "" : joint + ": ", words);
  if (event.contains("dropped") && event["dropped"].is_number_integer())
    out = fmt::format("            ({} events were lost)\n", event["dropped"].get<long long>()) + out;
  return out;
}

void TorqueHistory::add(const Json& status) {
  const Json& now = status.at("joints");
  joints.resize(now.size());
  for (std::size_t i = 0; i < now.size(); ++i) {
    joints[i].push_back(number(now[i], "torque_nm"));
    while (joints[i].size() > length) joints[i].pop_front();
  }
}

std::string monitor_text(const Json& hello, const Json& status, const TorqueHistory& history, std::size_t columns,
                         bool utf8) {
  static constexpr std::array<const char*, 9> kBlocks{"▁", "▁", "▂", "▃", "▄", "▅", "▆", "▇", "█"};
  static constexpr std::array<const char*, 9> kAscii{"_", "_", ".", ".", "-", "=", "+", "*", "#"};
  const auto& levels = utf8 ? kBlocks : kAscii;
  const std::size_t bar = std::clamp<std::size_t>((std::max<std::size_t>(columns, 60) - 42) / 2, 9, 40);
  const std::size_t curve = bar;
  std::string out = fmt::format("{}, {}{}, {} s\n", text(hello.at("robot"), "name"), text(status, "activity"),
                                flag(status, "ready") ? ", ready" : "", figure(number(status, "time_s"), 1));
  out += fmt::format("  {:<10} {:<8} {:>8} {:<{}} {:>7} {}\n", "joint", "mode", "deg", "  within its limits", bar + 2,
                     "Nm", "recent torque");
  const Json& limits = hello.at("robot").at("joints");
  const Json& joints = status.at("joints");
  for (std::size_t i = 0; i < joints.size(); ++i) {
    const Json& joint = joints[i];
    const double position = number(joint, "position_rad");
    std::string track(bar, ' ');
    if (i < limits.size()) {
      const double lower = number(limits[i], "lower_rad");
      const double upper = number(limits[i], "upper_rad");
      const auto cell = [&](double at_rad) {
        const double share = (at_rad - lower) / (upper - lower);
        if (!(share >= 0.0 && share <= 1.0)) return bar;
        return std::min(bar - 1, static_cast<std::size_t>(share * static_cast<double>(bar)));
      };
      if (const std::size_t zero = cell(0.0); zero < bar) track[zero] = ':';
      if (const std::size_t goal = cell(number(joint, "reference_rad")); goal < bar) track[goal] = 'x';
      if (const std::size_t here = cell(position); here < bar) track[here] = '#';
    }
    std::string torque_curve;
    if (i < history.joints.size()) {
      const std::deque<double>& values = history.joints[i];
      double largest = 1.0;  // Nm: less than this is noise and stays low
      for (const double value : values) {
        if (std::isfinite(value)) largest = std::max(largest, std::abs(value));
      }
      const std::size_t shown = std::min(values.size(), curve);
      for (std::size_t k = values.size() - shown; k < values.size(); ++k) {
        const double value = values[k];
        torque_curve +=
            std::isfinite(value) ? levels[static_cast<std::size_t>(std::lround(8.0 * std::abs(value) / largest))] : " ";
      }
    }
    const bool well = text(joint, "stage") == "enabled" || text(joint, "stage") == "idle";
    out += fmt::format("  {:<10} {:<8} {:>8} [{}] {:>7} {}\n", fitted(text(joint, "name"), 10),
                       well ? mode_word(joint) : fitted(text(joint, "stage"), 8), figure(position * kDegrees, 2), track,
                       figure(number(joint, "torque_nm"), 1), torque_curve);
  }
  return out;
}

std::string sample_header(const Json& hello) {
  std::string out = "time_s\tactivity";
  for (const Json& joint : hello.at("robot").at("joints")) {
    const std::string name = text(joint, "name");
    out += fmt::format("\t{}_mode\t{}_position_deg\t{}_speed_deg_s\t{}_torque_nm", name, name, name, name);
  }
  return out + '\n';
}

std::string sample_line(const Json& status) {
  std::string out = fmt::format("{}\t{}", figure(number(status, "time_s"), 3), text(status, "activity"));
  for (const Json& joint : status.at("joints")) {
    out += fmt::format("\t{}\t{}\t{}\t{}", mode_word(joint), figure(number(joint, "position_rad") * kDegrees, 3),
                       figure(number(joint, "velocity_rad_s") * kDegrees, 2), figure(number(joint, "torque_nm"), 2));
  }
  return out + '\n';
}

}  // namespace mrr::cli
