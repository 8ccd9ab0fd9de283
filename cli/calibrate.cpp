#include "cli/calibrate.h"

#include <fmt/format.h>
#include <unistd.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <memory>
#include <sstream>
#include <string>
#include <vector>

#include "cli/app.h"
#include "cli/robot_commands.h"
#include "cli/text.h"
#include "cli/unified_diff.h"
#include "common/robot/edit_robot.h"
#include "common/robot/errors.h"
#include "common/rpc/runtime_dir.h"

namespace mrr::cli {

using rpc::Json;

namespace {

struct Arguments {
  std::string socket;
  std::string joint;
  std::string what = "friction";
  double travel_rad = 0.0;
  double speed_rad_s = 0.0;
  double torque_nm = 0.0;
  double timeout_s = 1800.0;
  bool keep_torque_constants = false;
  bool write = false;
  bool json = false;
};

/// A bar while it goes on: on a terminal in place, in a pipe a line each tenth.
class Progress {
 public:
  Progress(std::string label, bool quiet) : label_(std::move(label)), quiet_(quiet) {}
  void show(int percent) {
    if (quiet_) return;
    if (!block_.terminal() && percent / 10 <= shown_ / 10) return;
    shown_ = percent;
    constexpr int kBar = 30;
    const auto full = static_cast<std::size_t>(kBar * percent / 100);
    block_.show(
        fmt::format("{} [{}{}] {:3} %\n", label_, std::string(full, '#'), std::string(kBar - full, '.'), percent));
  }

 private:
  std::string label_;
  bool quiet_;
  int shown_ = -1;
  LiveBlock block_;
};

std::string direction_line(const char* name, const Json& f) {
  return fmt::format("  {:<9}{:10.3f}{:10.3f}{:12.0f}{:10.3f}\n", name, f.at("coulomb_nm").get<double>(),
                     f.at("static_nm").get<double>(), f.at("stribeck_decay_s2_rad2").get<double>(),
                     f.at("viscous_nm_s_rad").get<double>());
}

std::string result_text(const Json& result) {
  const auto joint = result.at("joint").get<std::string>();
  if (const Json& fit = result.at("friction"); fit.is_object()) {
    return fmt::format(
        "Friction of {}, joint side\n  motion     Coulomb    static    Stribeck   viscous\n"
        "                  Nm        Nm    s^2/rad^2   Nm s/rad\n{}{}"
        "  torque constants {:.4f} Nm/A for positive, {:.4f} Nm/A for negative torque\n"
        "  residual {:.3f} Nm rms over {} points\n",
        joint, direction_line("positive", fit.at("positive")), direction_line("negative", fit.at("negative")),
        fit.at("torque_constant_positive_nm_a").get<double>(), fit.at("torque_constant_negative_nm_a").get<double>(),
        fit.at("residual_nm").get<double>(), fit.at("points").get<int>());
  }
  if (result.at("torque_offset_nm").is_number()) {
    return fmt::format(
        "The torque sensor of {} reads {:.3f} Nm too high (the joint carries {:.2f} Nm by the model); it is "
        "corrected until the module restarts\n",
        joint, result.at("torque_offset_nm").get<double>(), result.at("load_nm").get<double>());
  }
  if (result.at("slip_rad").is_number()) {
    return fmt::format("The brake of {} gave way by {:.2f} mrad under torque\n", joint,
                       result.at("slip_rad").get<double>() * 1e3);
  }
  return {};
}

/// What of the result robot.yaml has a key for.
std::vector<JointEdit> edits_of(const Json& result, bool keep_torque_constants) {
  const auto joint = result.at("joint").get<std::string>();
  std::vector<JointEdit> edits;
  if (const Json& fit = result.at("friction"); fit.is_object()) {
    // An offset of the torque sensor makes one direction look harder, the other easier: friction is the mean.
    const auto mean = [&](const char* key) {
      return 0.5 * (fit.at("positive").at(key).get<double>() + fit.at("negative").at(key).get<double>());
    };
    edits.push_back({joint, "friction", "coulomb", fmt::format("{:.3g} Nm", mean("coulomb_nm"))});
    edits.push_back({joint, "friction", "static", fmt::format("{:.3g} Nm", mean("static_nm"))});
    edits.push_back(
        {joint, "friction", "stribeck_decay", fmt::format("{:.4g} s^2/rad^2", mean("stribeck_decay_s2_rad2"))});
    edits.push_back({joint, "friction", "viscous", fmt::format("{:.3g} Nm s/rad", mean("viscous_nm_s_rad"))});
    if (!keep_torque_constants) {
      for (const char* sign : {"positive", "negative"}) {
        const double constant = fit.at(fmt::format("torque_constant_{}_nm_a", sign)).get<double>();
        edits.push_back(
            {joint, "motor", fmt::format("torque_constant_{}", sign), fmt::format("{:.4g} Nm/A", constant)});
      }
    }
  }
  if (const Json& offset = result.at("torque_offset_nm"); offset.is_number()) {
    edits.push_back({joint, "calibration", "torque_offset", fmt::format("{:.3f} Nm", offset.get<double>())});
  }
  return edits;
}

std::string text_of(const std::filesystem::path& file) {
  std::ifstream in(file, std::ios::binary);
  std::ostringstream text;
  text << in.rdbuf();
  if (!in || !in.is_open()) {
    throw DescriptionError(fmt::format(
        "{}: the robot's file cannot be read here; run the command where mrr_supervisor runs", file.string()));
  }
  return text.str();
}

int calibrate(const Arguments& arguments) {
  catch_interrupts();
  rpc::Client client(rpc::socket_path(arguments.socket, "supervisor.sock"), "mrr_supervisor");
  const std::filesystem::path folder = greet(client).at("robot").at("source").get<std::string>();
  const std::filesystem::path file = folder / "robot.yaml";
  Json params = {{"joint", joint_parameter(arguments.joint)}, {"what", arguments.what}};
  if (arguments.travel_rad > 0.0) params["travel_rad"] = arguments.travel_rad;
  if (arguments.speed_rad_s > 0.0) params["speed_rad_s"] = arguments.speed_rad_s;
  if (arguments.torque_nm > 0.0) params["torque_nm"] = arguments.torque_nm;
  client.call("subscribe", {{"events", {"command"}}});
  const auto number = client.call("calibrate", params).at("command").get<std::int64_t>();
  CommandEnd end;
  {
    Progress progress(fmt::format("{} of joint {}", arguments.what, arguments.joint), arguments.json);
    end = await_command(client, "calibrate", number, arguments.timeout_s, true,
                        [&] { progress.show(client.call("calibration").at("progress_percent").get<int>()); });
  }
  const Json result = client.call("calibration");
  const bool ours = result.at("command") == number;
  if (ours && !arguments.json) fmt::print("{}", result_text(result));
  if (end.status != kExitDone || !ours) {
    if (arguments.json) fmt::print("{}\n", Json{{"result", ours ? result : Json(nullptr)}, {"written", false}}.dump(2));
    fmt::print(stderr, "mrr: {}\n", end.reason);
    return end.status;
  }

  const std::vector<JointEdit> edits = edits_of(result, arguments.keep_torque_constants);
  const std::string before = edits.empty() ? "" : text_of(file);
  const std::string after = edits.empty() ? "" : with_values(before, file, edits);
  const bool differs = before != after;
  const bool writes = arguments.write && differs;
  if (!arguments.json) {
    std::fflush(stdout);
    fmt::print("{}", unified_diff(before, after, file.string(), isatty(STDOUT_FILENO) == 1));
  }
  if (writes) {
    try {
      replace_robot_yaml(folder, before, after);
    } catch (const DescriptionError& error) {
      const bool constants = result.at("friction").is_object() && !arguments.keep_torque_constants;
      fmt::print(stderr, "mrr: not written: {}{}\n", error.what(),
                 constants ? " --keep-torque-constants writes the friction alone." : "");
      return kExitNotDone;
    }
  }
  if (arguments.json) {
    fmt::print("{}\n", Json{{"result", result},
                            {"file", edits.empty() ? Json(nullptr) : Json(file.string())},
                            {"diff", unified_diff(before, after, file.string(), false)},
                            {"written", writes}}
                           .dump(2));
  } else if (writes) {
    fmt::print(
        "{}",
        wrapped(
            fmt::format("{} is written. The robot runs on with what it was started with: restart modules and "
                        "supervisor, and an emulator (scripts/robot down, scripts/robot up); until then mrr_supervisor "
                        "refuses enable, reset, home, calibrate and hammer.",
                        file.string()),
            0));
  } else if (differs) {
    fmt::print("Nothing was written; --write does it.\n");
  } else if (!edits.empty()) {
    fmt::print("{} says so already.\n", file.string());
  }
  return kExitDone;
}

}  // namespace

void add_calibrate_command(CLI::App& app, int& status) {
  auto a = std::make_shared<Arguments>();
  CLI::App* one =
      app.add_subcommand("calibrate", "Let a joint identify its friction, zero its torque sensor, test its brake");
  add_socket_option(*one, a->socket);
  one->add_option("JOINT", a->joint, "Name, or number from 1 at the base")->required();
  one->add_option("--what", a->what, "What is calibrated: friction, torque-zero, brake")
      ->check(CLI::IsMember({"friction", "torque-zero", "brake"}))
      ->type_name("")
      ->capture_default_str();
  one->add_option("--travel", a->travel_rad, "friction: to either side of where the joint stands, rad (default 0.3)")
      ->check(between(0.1, 3.0))
      ->type_name("RAD");
  one->add_option("--speed", a->speed_rad_s, "friction: of the fastest pass, rad/s (default 1)")
      ->check(between(0.1, 10.0))
      ->type_name("RAD/S");
  one->add_option("--torque", a->torque_nm, "brake: pushes with it, Nm (default: 1.5 of the rated torque)")
      ->check(between(0.1, 10000.0))
      ->type_name("NM");
  one->add_option("--timeout", a->timeout_s, "Wait at most this long, s of wall time")
      ->check(between(0.1, 86400.0))
      ->type_name("SECONDS")
      ->capture_default_str();
  one->add_flag("--keep-torque-constants", a->keep_torque_constants,
                "friction: leave the torque constants as they are");
  one->add_flag("--write", a->write, "Write what was found into the robot's YAML; otherwise only the diff is shown");
  one->add_flag("--json", a->json, "Print the result, the diff and whether it was written, for programs");
  one->footer(
      "Zero the torque sensor before friction is identified. Friction takes one to two minutes: the joint moves to and "
      "fro "
      "about where it stands, the others hold. Ctrl-C stops it. A written file is checked first, its comments stay.");
  one->callback([a, &status] { status = calibrate(*a); });
}

}  // namespace mrr::cli
