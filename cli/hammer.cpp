#include "cli/hammer.h"
#include "cli/app.h"

#include <fmt/format.h>
#include <spawn.h>
#include <sys/wait.h>

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <fstream>
#include <memory>
#include <sstream>

#include "cli/exit_status.h"
#include "cli/files.h"
#include "cli/hammer_bus.h"
#include "cli/json.h"
#include "cli/print.h"
#include "cli/reference.h"
#include "cli/text.h"
#include "common/robot/errors.h"
#include "sim_vcan/world/hammer_job.h"
#include "supervisor/ledger/ledger_file.h"
#include "supervisor/report_json.h"

extern char** environ;

namespace mrr::cli {

namespace {

namespace fs = std::filesystem;

struct HammerArguments {
  std::string robot = "robots/mrr3";
  std::string board = "styrofoam";
  std::string out = "out";
  std::uint64_t seed = 1;
  double boot_delay_ms = 100.0;
  int swings = 0;
  std::string mode = "planned";
  bool as_printed = false;
  bool experiment = false;
  bool json = false;
  bool no_report = false;
  std::string bus;  ///< empty: the simulated robot on one clock
  std::string socket;
  std::string plant_socket;
  std::string ledger;
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
    int within = 0;
    int all = 0;
    for (const sim::SimulatedSeries& board : series) {
      all += static_cast<int>(board.swings.size());
      within += static_cast<int>(
          std::count_if(board.swings.begin(), board.swings.end(), [](const auto& swing) { return swing.within; }));
    }
    fmt::print("\n{}", wrapped(fmt::format("Verdict: {} of {} swings are as published, within the tolerances: {}.",
                                           within, all, within == all ? "reproduced" : "NOT reproduced"),
                               9));
    fmt::print("  files   {}/: {}experiment.json\n", out.string(),
               arguments.no_report || !reported ? "" : "report.html, ");
  }
  return experiment_reproduced(series) && reported ? kExitDone : kExitNotDone;
}

sup::PassiveMode passive_mode(const std::string& name) {
  if (name == "never") return sup::PassiveMode::never;
  return name == "always" ? sup::PassiveMode::always : sup::PassiveMode::planned;
}

/// What a job leaves behind, however it was run.
struct Job {
  RobotDescription robot;
  RunLabel label;
  Outcome outcome;
  std::string bus_log;
  std::string telemetry_csv;
  std::string ledger_text;  ///< empty: none was kept
  nlohmann::ordered_json ledger;
};

Job run_on_one_clock(const HammerArguments& arguments) {
  Job job;
  job.robot = load_robot(find_robot(arguments.robot));
  const RobotDescription& robot = job.robot;
  const sim::PlantDescription plant = sim::load_plant(robot, find_board(arguments.board));

  // What cannot be written to is said before anything swings.
  std::optional<sup::LedgerFile> ledger;
  if (!arguments.ledger.empty()) ledger.emplace(robot, arguments.ledger, sup::today_utc());

  sim::HammerJobOptions options;
  options.world.seed = arguments.seed;
  options.world.max_boot_delay = seconds(arguments.boot_delay_ms * 1e-3);
  options.session.seed = arguments.seed;
  options.session.max_swings = arguments.swings;
  options.session.mode = passive_mode(arguments.mode);
  options.session.formulation = arguments.as_printed ? sup::Formulation::as_printed : sup::Formulation::corrected;
  job.label = {arguments.board, arguments.seed, options.session.mode, options.session.formulation, ""};

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
  bar.clear();
  if (ledger) {
    for (const sup::SwingReport& swing : result.swings) ledger->enter(swing);
    job.ledger_text = sup::report(robot, ledger->ledger());
    job.ledger = sup::ledger_json(robot, ledger->ledger());
  }
  job.outcome = outcome_of(robot, result, wall_s);
  job.bus_log = bus_log.str();
  std::ostringstream csv;
  telemetry.write_csv(csv);
  job.telemetry_csv = csv.str();
  return job;
}

Job run_by_processes(const HammerArguments& arguments) {
  Job job;
  const std::string folder = arguments.robot.empty() ? robot_of_supervisor(arguments.socket) : arguments.robot;
  job.robot = load_robot(find_robot(folder));
  BusJob done = run_bus_job(job.robot, {.bus = arguments.bus,
                                        .socket = arguments.socket,
                                        .plant_socket = arguments.plant_socket,
                                        .mode = arguments.mode,
                                        .swings = arguments.swings,
                                        .seed = arguments.seed,
                                        .as_printed = arguments.as_printed});
  if (done.lost_frames > 0) {
    fmt::print(stderr, "mrr: {} frames are missing in bus.log: this machine was too busy to record them\n",
               done.lost_frames);
  }
  job.label = {done.board, arguments.seed, passive_mode(arguments.mode),
               arguments.as_printed ? sup::Formulation::as_printed : sup::Formulation::corrected, done.clock};
  job.outcome = std::move(done.outcome);
  job.bus_log = std::move(done.bus_log);
  job.telemetry_csv = std::move(done.telemetry_csv);
  return job;
}

int run(const HammerArguments& arguments) {
  require_folder(arguments.out);
  if (arguments.experiment) return run_published_experiment(arguments);
  const Job job = arguments.bus.empty() ? run_on_one_clock(arguments) : run_by_processes(arguments);

  // Nothing was ever swung, so there is nothing to report: the reason is all there is. If time ran out instead, what
  // was recorded is kept.
  if (job.outcome.swings.empty() && job.outcome.verdict != sup::describe(sup::Verdict::none)) {
    throw PlanError(fmt::format("{}: {}", (job.robot.source / "robot.yaml").string(), job.outcome.reason));
  }

  nlohmann::ordered_json json = result_json(job.robot, job.label, job.outcome);
  std::vector<ReproducedFigure> tables;
  if (arguments.as_printed) {
    tables = reproduce_tables(load_robot(find_robot("robots/mrr3")));
    json["tables"] = tables_json(tables);
  }
  if (!job.ledger.is_null()) json["ledger"] = job.ledger;
  const fs::path out = make_folder(arguments.out);
  std::error_code ignored;
  fs::remove(out / "experiment.json", ignored);
  write_whole(out / "bus.log", [&](std::ostream& file) { file << job.bus_log; });
  write_whole(out / "telemetry.csv", [&](std::ostream& file) { file << job.telemetry_csv; });
  write_whole(out / "result.json", [&](std::ostream& file) { file << json.dump(2) << '\n'; });
  // The report is drawn from what really happened.
  const bool wanted = !arguments.no_report && !job.outcome.swings.empty() && job.outcome.truth_known;
  const bool reported = !wanted || make_report(out);

  if (arguments.json) {
    fmt::print("{}\n", json.dump(2));
  } else {
    fmt::print("MRR: {} on {}, seed {}{}\n\n", job.robot.name, job.label.board, arguments.seed,
               arguments.bus.empty() ? std::string()
                                     : fmt::format(", processes on {} {}", arguments.bus,
                                                   job.label.processes == "lockstep" ? "in lockstep" : "in real time"));
    if (arguments.as_printed) fmt::print("{}\n", tables_text(tables));
    if (!json["plan"].is_null()) fmt::print("{}\n{}", plan_text(json["plan"]), swing_header(job.outcome.truth_known));
    for (const auto& swing : json["swings"]) fmt::print("{}", swing_text(swing));
    fmt::print("\n{}", verdict_text(job.robot, json));
    fmt::print("  files   {}/: {}bus.log, telemetry.csv, result.json\n", out.string(),
               wanted && reported ? "report.html, " : "");
    if (!job.ledger_text.empty()) fmt::print("\n{}", job.ledger_text);
    if (!job.outcome.truth_known)
      fmt::print("          no report.html: there is no plant to say what really happened\n");
  }
  if (!reported)
    fmt::print(stderr, "mrr: the report could not be made; the data it is made from are in {}\n", out.string());
  return job.outcome.success() && reported ? kExitDone : kExitNotDone;
}

}  // namespace

void add_hammer_command(CLI::App& app, int& status) {
  auto arguments = std::make_shared<HammerArguments>();
  CLI::App* command = app.add_subcommand("hammer", "Drive a nail: simulated on one clock, or by a robot on a CAN bus");
  CLI::Option* robot = command->add_option("--robot", arguments->robot,
                                           "Folder with robot.urdf and robot.yaml; with --bus the supervisor's");
  robot->type_name("DIR")->capture_default_str();
  CLI::Option* board = command->add_option("--board", arguments->board, "styrofoam, hardwood, or a board's YAML file")
                           ->type_name("NAME")
                           ->capture_default_str();
  CLI::Option* seed = command->add_option("--seed", arguments->seed, "Noise, clocks and tolerances; 0: all nominal");
  seed->capture_default_str()->check(whole_number())->type_name("N");
  CLI::Option* boot_delay = command
                                ->add_option("--boot-delay", arguments->boot_delay_ms,
                                             "Modules start within so many ms, drawn by the seed; it shifts the phase "
                                             "of their ticks. 0: all together")
                                ->type_name("MS")
                                ->check(between(0.0, 5000.0))
                                ->capture_default_str();
  command->add_option("--out", arguments->out, "Folder for the report and the recordings")
      ->type_name("DIR")
      ->capture_default_str();
  CLI::Option* swings =
      command->add_option("--swings", arguments->swings, "Largest number of swings (default: the task's)")
          ->type_name("N")
          ->check(CLI::Range(1, 1000));
  CLI::Option* mode =
      command->add_option("--mode", arguments->mode, "Passive switching: planned, never, or always all joints")
          ->check(CLI::IsMember({"planned", "never", "always"}))
          ->capture_default_str();
  CLI::Option* as_printed =
      command->add_flag("--as-printed", arguments->as_printed,
                        "Evaluate the reference's equations as printed, slips included, and show its tables");
  CLI::Option* experiment = command->add_flag("--experiment", arguments->experiment,
                                              "Repeat the reference's published hammering experiment and compare");
  CLI::Option* bus = command->add_option(
      "--bus", arguments->bus, "Let the robot on this CAN interface do it: mrr_supervisor must run (scripts/robot)");
  bus->type_name("IFACE");
  CLI::Option* socket = command->add_option("--socket", arguments->socket, "Socket of mrr_supervisor");
  socket->type_name("PATH")->needs(bus);
  command
      ->add_option("--plant-socket", arguments->plant_socket,
                   "Socket of mrr_plant, which knows what really happened (default: the usual place, if one is there)")
      ->type_name("PATH")
      ->needs(bus);
  CLI::Option* ledger =
      command->add_option("--ledger", arguments->ledger,
                          "Enter the blows into this account of what the gears have borne (made if not there)");
  ledger->type_name("FILE");
  // A robot on a bus has a supervisor that keeps it.
  bus->excludes(ledger);
  // Which board there is is the matter of the robot's surroundings, not of this command.
  bus->excludes(board);
  bus->excludes(boot_delay);
  // The experiment has boards, modes and swings of its own.
  for (CLI::Option* option : {board, swings, mode, as_printed, bus, boot_delay, ledger}) experiment->excludes(option);
  command->add_flag("--json", arguments->json, "Print one JSON object (docs/result.schema.json) and nothing else");
  command->add_flag("--no-report", arguments->no_report, "Do not make report.html");
  command->callback([arguments, seed, robot, &status] {
    // The experiment is a comparison of nominal values unless told otherwise.
    if (arguments->experiment && seed->count() == 0) arguments->seed = 0;
    if (!arguments->bus.empty() && robot->count() == 0) arguments->robot.clear();
    status = run(*arguments);
  });
}

}  // namespace mrr::cli
