// Room: supervisor/daemon. mrr_supervisor: the supervisor as a process on a CAN bus. Command line and signals.
// The one place of this room that looks at module_fw: what a module was told is compared by its configuration's hash.
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <csignal>
#include <memory>

#include "common/robot/command_line.h"
#include "common/robot/errors.h"
#include "common/robot/places.h"
#include "common/rpc/runtime_dir.h"
#include "module_fw/targets/host/module_config.h"
#include "supervisor/daemon/loops.h"
#include "supervisor/ledger/ledger_file.h"

namespace {

using namespace mrr;

enum Exit : int { kDone = 0, kNotDone = 1, kUnusable = 2, kDefect = 3 };

volatile std::sig_atomic_t signal_received = 0;

constexpr Duration kStopTime = milliseconds(5000);  // for a controlled stop and the brakes, then exit anyway
constexpr auto kServicePeriod = std::chrono::milliseconds(2);
constexpr Duration kServeEvery = milliseconds(2);

struct Arguments {
  std::string robot;
  std::string can;
  std::string plant;
  std::string socket;
  std::string ledger;
  std::string log_level = "info";
  int test_switch_late_ms = 0;
};

/// Goes on until somebody wants an end and the joints are let go of. `turn` makes cycles, or waits while they are
/// made.
/// @returns whether the joints were let go of in time.
template <typename Turn>
bool serve(sup::Service& service, Turn&& turn) {
  std::optional<Time> stop_by;
  while (true) {
    if (signal_received != 0) service.shut_down(signal_received == SIGINT ? "interrupted" : "told to terminate");
    if (service.shutting_down() && !stop_by) stop_by = can::monotonic_now() + kStopTime;
    const bool down = service.shutting_down() && service.is_down();
    turn(down);
    if (down) return true;
    if (stop_by && can::monotonic_now() > *stop_by) return false;
  }
}

bool run_realtime(const RobotDescription& robot, sup::ServiceOptions options, sup::Cycle& cycle, sup::SocketBus& bus,
                  rpc::Server& server, sup::LogBook& log, Duration period) {
  sup::RealtimeLoop loop(cycle, bus, period);
  options.realtime_scheduling = loop.granted().scheduling;
  options.memory_locked = loop.granted().memory;
  if (!loop.granted().refused.empty()) {
    log.warn(fmt::format("{}: cycles will come late at times; allow it with CAP_SYS_NICE and CAP_IPC_LOCK",
                         loop.granted().refused));
  }
  sup::Service service(
      robot, options, cycle, [&loop](const sup::Request& request) { return loop.call(request); }, log);
  service.attach(server);
  service.set_clock_running(true);
  return serve(service, [&](bool) {
    server.poll(kServicePeriod);
    service.step();
  });
}

bool run_lockstep(const RobotDescription& robot, const sup::ServiceOptions& options, sup::Cycle& cycle,
                  sup::SocketBus& bus, rpc::Server& server, sup::LogBook& log) {
  sup::LockstepLoop loop(cycle, bus, options.plant);
  sup::Service service(
      robot, options, cycle, [&cycle](const sup::Request& request) { return std::optional(cycle.carry_out(request)); },
      log);
  service.attach(server);
  log.info(fmt::format("in lockstep with the plant on {}", options.plant));
  Time served;
  return serve(service, [&](bool leaving) {
    loop.run_once(service, milliseconds(20), leaving);
    const Time now = can::monotonic_now();
    if (now - served < kServeEvery) return;
    served = now;
    server.serve();
  });
}

spdlog::level::level_enum level_of(const std::string& name) {
  return name == "debug"     ? spdlog::level::debug
         : name == "warning" ? spdlog::level::warn
         : name == "error"   ? spdlog::level::err
                             : spdlog::level::info;
}

int run(const Arguments& arguments) {
  const RobotDescription robot = load_robot(find_robot(arguments.robot));
  sup::LogBook log(level_of(arguments.log_level));
  sup::ServiceOptions options;
  options.can = arguments.can.empty() ? robot.bus.interface : arguments.can;
  options.plant = arguments.plant;
  options.protocol_hash = can::kProtocolHash;
  options.test_switch_late = milliseconds(arguments.test_switch_late_ms);
  if (arguments.socket.empty()) (void)rpc::runtime_dir();
  rpc::Server server(rpc::socket_path(arguments.socket, "supervisor.sock"));
  sup::SocketBus bus(robot, options.can);
  if (bus.another_supervisor()) {
    throw DescriptionError(fmt::format("--can {}: another supervisor is on this bus; stop it first", options.can));
  }
  // Gears of a robot in lockstep are emulated: their account is kept only where asked for.
  std::optional<sup::LedgerFile> ledger;
  if (!arguments.ledger.empty() || arguments.plant.empty()) {
    ledger.emplace(robot,
                   arguments.ledger.empty() ? sup::default_ledger(robot) : std::filesystem::path(arguments.ledger),
                   sup::today_utc());
    options.ledger = &*ledger;
    log.info(fmt::format("{} {}", ledger->begun() ? "a new ledger of the gears is begun in" : "ledger of the gears:",
                         ledger->file().string()));
  }
  sup::SupervisorConfig config;
  config.start_disabled = true;
  for (int i = 0; i < robot.dof(); ++i) {
    config.configuration_hash[static_cast<std::size_t>(i)] = fw::module_config(robot, i).configuration_hash;
  }
  const auto cycle = std::make_unique<sup::Cycle>(robot, config, bus);
  log.info(fmt::format("{} on {}, listening on {}", robot.name, options.can, server.socket().string()));
  const bool down = options.plant.empty() ? run_realtime(robot, options, *cycle, bus, server, log, config.step)
                                          : run_lockstep(robot, options, *cycle, bus, server, log);
  if (down) {
    log.info("stopped; the joints are let go of");
  } else {
    log.error(fmt::format("not all joints could be let go of within {:.0f} s; they brake by their own watchdogs",
                          kStopTime.seconds()));
  }
  return down ? kDone : kNotDone;
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{"mrr_supervisor: drives the joints of a robot over CAN; talk to it with mrr, or by JSON-RPC."};
  app.set_version_flag("--version", MRR_VERSION);
  app.footer(
      "SIGTERM, SIGINT or SIGHUP: controlled stop, brakes, exit.\n"
      "Exit status: 0 stopped as asked, 1 stopped, but not all joints could be let go of in time, 2 unusable input\n"
      "(robot, interface, socket), 3 defect.");
  Arguments arguments;
  app.add_option("--robot", arguments.robot, "Folder of the robot description, for example robots/mrr3")->required();
  app.add_option("--can", arguments.can, "Interface of the robot's bus (default: the one in the robot description)");
  app.add_option("--plant", arguments.plant,
                 "Interface of the plant bus: go in lockstep with mrr_plant --lockstep. Without it cycles are made on "
                 "the wall clock");
  app.add_option("--socket", arguments.socket,
                 "Unix socket for clients (default: supervisor.sock in $MRR_RUNTIME_DIR, $XDG_RUNTIME_DIR/mrr or "
                 "/tmp/mrr-UID)");
  app.add_option(
      "--ledger", arguments.ledger,
      "File that keeps what the gears have borne (default: ledger-ROBOT in $MRR_STATE_DIR, $STATE_DIRECTORY, "
      "$XDG_STATE_HOME/mrr or ~/.local/state/mrr; with --plant none)");
  app.add_option("--log-level", arguments.log_level, "debug, info, warning or error")
      ->check(CLI::IsMember({"debug", "info", "warning", "error"}))
      ->option_text("TEXT=info");
  app.add_option("--test-switch-late", arguments.test_switch_late_ms,
                 "For tests: arm each switch so many ms late, so that it has to be pulled when contact comes")
      ->check(CLI::Range(0, 200))
      ->option_text("INT");
  app.failure_message([](const CLI::App*, const CLI::Error& error) {
    return fmt::format("mrr_supervisor: {}; see mrr_supervisor --help\n", error.what());
  });
  try {
    refuse_empty_values(app);
    app.parse(argc, argv);
    mrr::on_end([](int number) { signal_received = number; });
    return run(arguments);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? kDone : kUnusable;
  } catch (const DescriptionError& error) {
    fmt::print(stderr, "mrr_supervisor: {}\n", error.what());
    return kUnusable;
  } catch (const can::CanError& error) {
    fmt::print(stderr, "mrr_supervisor: {}\n", error.what());
    return kUnusable;
  } catch (const rpc::ConnectionError& error) {
    fmt::print(stderr, "mrr_supervisor: {}\n", error.what());
    return kUnusable;
  } catch (const std::exception& error) {
    fmt::print(stderr, "mrr_supervisor: internal error: {}\n", error.what());
    return kDefect;
  }
}
