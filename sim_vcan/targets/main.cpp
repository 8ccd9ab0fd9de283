// Room: sim_vcan/targets. mrr_plant: the emulator in place of hardware. Command line and signals.
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <csignal>

#include "common/robot/command_line.h"
#include "common/robot/errors.h"
#include "common/robot/places.h"
#include "common/rpc/runtime_dir.h"
#include "sim_vcan/targets/plant_host.h"

namespace {

using namespace mrr;

enum Exit : int { kDone = 0, kUnusable = 2, kDefect = 3 };

volatile int stop_requested = 0;

void run(const std::string& robot_name, const std::string& board, const std::string& socket,
         const sim::PlantHostOptions& options) {
  const RobotDescription robot = load_robot(find_robot(robot_name));
  sim::PlantHost host(robot, sim::load_plant(robot, find_board(board)), options);
  if (socket.empty()) rpc::runtime_dir();
  rpc::Server server(rpc::socket_path(socket, "plant.sock"));
  host.serve(server);
  host.run(stop_requested);
  if (options.verbose) host.print_statistics();
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{"mrr_plant: the emulator in place of hardware, behind the plant bus."};
  app.set_version_flag("--version", MRR_VERSION);
  app.footer("Exit status: 0 stopped as asked, 2 unusable input (robot, board, interface, socket), 3 defect.");
  std::string robot;
  std::string board = "styrofoam";
  std::string socket;
  sim::PlantHostOptions options;
  bool lockstep = false;
  bool realtime = false;
  app.add_option("--robot", robot, "Folder of the robot description, for example robots/mrr3")->required();
  app.add_option("--board", board, "styrofoam, hardwood, or a board's YAML file")->capture_default_str();
  app.add_option("--plant", options.interface, "Interface of the plant bus, for example vcan1")->required();
  auto* l =
      app.add_flag("--lockstep", lockstep,
                   "Be the clock: wait for everybody in every millisecond, as fast as the machine goes (default)");
  app.add_flag("--realtime", realtime, "Run on the wall clock and wait for nobody")->excludes(l);
  app.add_option("--seed", options.seed, "Noise and tolerances; 0: all nominal")
      ->check([](const std::string& text) {
        const bool digits = !text.empty() && text.find_first_not_of("0123456789") == std::string::npos;
        return digits && text.size() <= 18 ? std::string()
                                           : fmt::format("{} is no whole number of at most 18 digits", text);
      })
      ->capture_default_str();
  app.add_flag("--expect-supervisor", options.expect_supervisor,
               "Lockstep: begin when the supervisor is there too (mrr_supervisor --plant)");
  app.add_option("--ticks", options.ticks, "Stop after this many milliseconds of simulated time (default: go on)")
      ->check(CLI::NonNegativeNumber);
  app.add_option("--socket", socket, "Control socket (default: plant.sock in the runtime folder)");
  app.add_flag("--verbose", options.verbose, "Say more, and print statistics at the end");
  app.failure_message([](const CLI::App*, const CLI::Error& error) {
    return fmt::format("mrr_plant: {}; see mrr_plant --help\n", error.what());
  });
  try {
    refuse_empty_values(app);
    app.parse(argc, argv);
    options.lockstep = !realtime;
    mrr::on_end([](int) { stop_requested = 1; });
    run(robot, board, socket, options);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? kDone : kUnusable;
  } catch (const DescriptionError& error) {
    fmt::print(stderr, "mrr_plant: {}\n", error.what());
    return kUnusable;
  } catch (const can::CanError& error) {
    fmt::print(stderr, "mrr_plant: {}\n", error.what());
    return kUnusable;
  } catch (const rpc::ConnectionError& error) {
    fmt::print(stderr, "mrr_plant: {}\n", error.what());
    return kUnusable;
  } catch (const std::exception& error) {
    fmt::print(stderr, "mrr_plant: internal error: {}\n", error.what());
    return kDefect;
  }
  return kDone;
}
