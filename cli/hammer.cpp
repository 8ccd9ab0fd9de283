#include "cli/hammer.h"

#include <fmt/format.h>
#include <spawn.h>
#include <sys/wait.h>

#include <chrono>
#include <filesystem>
#include <fstream>
#include <memory>
#include <sstream>

#include "cli/files.h"
#include "cli/json.h"
#include "cli/print.h"
#include "cli/reference.h"
#include "common/robot/errors.h"
#include "sim_vcan/world/hammer_job.h"

extern char** environ;

namespace mrr::cli {

namespace {

namespace fs = std::filesystem;

struct HammerArguments {
  std::string robot = "robots/mrr3";
  std::string board = "styrofoam";
  std::string out = "out";
  std::uint64_t seed = 1;
  int swings = 0;
  std::string mode = "planned";
  bool as_printed = false;
  bool experiment = false;
  bool json = false;
  bool no_report = false;
};

/// Runs tools/report.py on the folder; false if it failed. Its messages go to stderr.
bool make_report(const fs::path& out) {
  const std::string tool = (data_root() / "tools" / "report.py").string();
  const std::string folder = out.string();
  const char* const arguments[] = {"/usr/bin/python3", tool.c_str(), folder.c_str(), nullptr};
  pid_t child = 0;
  if (posix_spawn(&child, arguments[0], nullptr, nullptr, const_cast<char* const*>(arguments), environ) != 0)
    return false;
  int status = 0;
  return waitpid(child, &status, 0) == child && WIFEXITED(status) && WEXITSTATUS(status) == 0;
}

/// Says so before anything runs if no folder can be made of this.
void require_folder(const std::string& name) {
  if (name.empty()) throw DescriptionError("--out is empty; give a folder");
  std::error_code ignored;
  if (fs::exists(name, ignored) && !fs::is_directory(name, ignored)) {
    throw DescriptionError(fmt::format("--out {}: there is a file of that name; give a folder", name));
  }
}

/// Makes the folder for the files and takes away the report of an earlier run; throws DescriptionError.
fs::path make_folder(const std::string& name) {
  std::error_code error;
  fs::create_directories(name, error);
  if (error)
    throw DescriptionError(
        fmt::format("--out {}: cannot be made: {}; give a folder you may write to", name, error.message()));
  fs::remove(fs::path(name) / "report.html", error);
  return name;
}

/// The reference's experiment with the whole robot, published figures beside simulated ones.
int run_published_experiment(const HammerArguments& arguments) {
  const RobotDescription robot = load_robot(find_robot(arguments.robot));
  const sim::Experiment experiment = sim::load_experiment(robot);
  ProgressBar bar;
  const auto series = sim::run_experiment(
      robot, experiment,
      [](const RobotDescription& changed, const std::string& board) {
        return sim::load_plant(changed, find_board(board));
      },
      arguments.seed,
      [&bar](int done, int of) { bar.update(fmt::format("swing {} of {}", done, of), 1.0 * done / of); });
  bar.clear();
  nlohmann::ordered_json json = {{"schema_version", 1},
                                 {"robot", robot.name},
                                 {"seed", arguments.seed},
                                 {"reproduced", experiment_reproduced(series)},
                                 {"series", experiment_json(series)}};
  const fs::path out = make_folder(arguments.out);
  std::error_code ignored;
  for (const char* name : {"result.json", "telemetry.csv", "bus.log"}) fs::remove(out / name, ignored);
  write_whole(out / "experiment.json", [&](std::ostream& file) { file << json.dump(2) << '\n'; });
  const bool reported = arguments.no_report || make_report(out);
  if (arguments.json) {
    fmt::print("{}\n", json.dump(2));
  } else {
    fmt::print("MRR: the reference's hammering experiment, {}\n\n{}", robot.name, experiment_text(series));
    fmt::print("  files   {}/: {}experiment.json\n", out.string(),
               arguments.no_report || !reported ? "" : "report.html, ");
  }
  return experiment_reproduced(series) && reported ? kExitDone : kExitNotDone;
}

sup::PassiveMode passive_mode(const std::string& name) {
  if (name == "never") return sup::PassiveMode::never;
  return name == "always" ? sup::PassiveMode::always : sup::PassiveMode::planned;
}

int run(const HammerArguments& arguments) {
  require_folder(arguments.out);
  if (arguments.experiment) return run_published_experiment(arguments);
  const RobotDescription robot = load_robot(find_robot(arguments.robot));
  const sim::PlantDescription plant = sim::load_plant(robot, find_board(arguments.board));

  sim::HammerJobOptions options;
  options.world.seed = arguments.seed;
  options.session.seed = arguments.seed;
  options.session.max_swings = arguments.swings;
  options.session.mode = passive_mode(arguments.mode);
  options.session.formulation = arguments.as_printed ? sup::Formulation::as_printed : sup::Formulation::corrected;

  std::ostringstream bus_log;
  sim::CandumpWriter frames(bus_log, robot.bus.interface);
  sim::Telemetry telemetry(robot);
  ProgressBar bar;
  const auto began = std::chrono::steady_clock::now();
  const sim::HammerJobResult result = sim::run_hammer_job(
      robot, plant, options, &frames, &telemetry, [&](double simulated_s, int swings, double height_m) {
        bar.update(fmt::format("nail {:4.1f} mm, swing {}, {:4.1f} s", height_m * 1e3, swings + 1, simulated_s),
                   1.0 - height_m / robot.task.nail_height_m);
      });
  const double wall_s = std::chrono::duration<double>(std::chrono::steady_clock::now() - began).count();
  const double realtime_factor = result.simulated_s / wall_s;
  bar.clear();

  // Nothing was ever swung, so there is nothing to report: the reason is all there is. If time ran out instead, what
  // was recorded is kept.
  if (result.swings.empty() && result.verdict != sup::Verdict::none) {
    throw PlanError(fmt::format("{}: {}", (robot.source / "robot.yaml").string(), result.reason));
  }

  nlohmann::ordered_json json =
      result_json(robot, {arguments.board, arguments.seed, options.session.mode, options.session.formulation}, result,
                  realtime_factor);
  std::vector<ReproducedFigure> tables;
  if (arguments.as_printed) {
    tables = reproduce_tables(load_robot(find_robot("robots/mrr3")));
    json["tables"] = tables_json(tables);
  }
  const fs::path out = make_folder(arguments.out);
  std::error_code ignored;
  fs::remove(out / "experiment.json", ignored);
  write_whole(out / "bus.log", [&](std::ostream& file) { file << bus_log.view(); });
  write_whole(out / "telemetry.csv", [&](std::ostream& file) { telemetry.write_csv(file); });
  write_whole(out / "result.json", [&](std::ostream& file) { file << json.dump(2) << '\n'; });
  const bool reported = arguments.no_report || result.swings.empty() || make_report(out);

  if (arguments.json) {
    fmt::print("{}\n", json.dump(2));
  } else {
    fmt::print("MRR: {} on {}, seed {}\n\n", robot.name, arguments.board, arguments.seed);
    if (arguments.as_printed) fmt::print("{}\n", tables_text(tables));
    if (!result.swings.empty()) fmt::print("{}\n{}", plan_text(robot, result.swings.front().plan), swing_header());
    for (std::size_t k = 0; k < result.swings.size(); ++k) {
      fmt::print("{}", swing_text(robot, result.swings[k], result.truth[k]));
    }
    fmt::print("\n{}", verdict_text(robot, result, realtime_factor));
    fmt::print("  files   {}/: {}bus.log, telemetry.csv, result.json\n", out.string(),
               arguments.no_report || !reported ? "" : "report.html, ");
  }
  if (!reported)
    fmt::print(stderr, "mrr: the report could not be made; the data it is made from are in {}\n", out.string());
  return result.success() && reported ? kExitDone : kExitNotDone;
}

}  // namespace

void add_hammer_command(CLI::App& app, int& status) {
  const CLI::Validator whole_number(
      [](std::string& text) -> std::string {
        const bool digits = !text.empty() && text.find_first_not_of("0123456789") == std::string::npos;
        if (digits && text.size() <= 18) return {};
        return fmt::format("'{}' is not a whole number from 0 to 999999999999999999", text);
      },
      "", "whole number");
  auto arguments = std::make_shared<HammerArguments>();
  CLI::App* command =
      app.add_subcommand("hammer", "Drive a nail with the simulated robot, from switched off to verdict");
  command->add_option("--robot", arguments->robot, "Folder with robot.urdf and robot.yaml")->capture_default_str();
  command->add_option("--board", arguments->board, "styrofoam, hardwood, or a board's YAML file")
      ->capture_default_str();
  CLI::Option* seed = command->add_option("--seed", arguments->seed, "Noise, clocks and tolerances; 0: all nominal");
  seed->capture_default_str()->check(whole_number)->type_name("N");
  command->add_option("--out", arguments->out, "Folder for the report and the recordings")->capture_default_str();
  command->add_option("--swings", arguments->swings, "Largest number of swings (default: the task's)")
      ->check(CLI::Range(1, 1000));
  command->add_option("--mode", arguments->mode, "Passive switching: planned, never, or always all joints")
      ->check(CLI::IsMember({"planned", "never", "always"}))
      ->option_text("TEXT=planned");
  command->add_flag("--as-printed", arguments->as_printed,
                    "Evaluate the reference's equations as printed, slips included, and show its tables");
  command->add_flag(
      "--experiment", arguments->experiment,
      "Repeat the reference's published hammering experiment and compare; --board and --mode do not apply");
  command->add_flag("--json", arguments->json, "Print one JSON object (docs/result.schema.json) and nothing else");
  command->add_flag("--no-report", arguments->no_report, "Do not make report.html");
  command->callback([arguments, seed, &status] {
    // The experiment is a comparison of nominal values unless told otherwise.
    if (arguments->experiment && seed->count() == 0) arguments->seed = 0;
    status = run(*arguments);
  });
}

}  // namespace mrr::cli
