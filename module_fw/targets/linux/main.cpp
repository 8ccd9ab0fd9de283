// Room: module_fw/targets/linux. mrr_module: one joint's firmware as a process on a CAN bus. Command line and signals.
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <charconv>
#include <csignal>
#include <system_error>

#include "common/robot/command_line.h"
#include "common/robot/errors.h"
#include "common/robot/places.h"
#include "module_fw/targets/host/module_config.h"
#include "module_fw/targets/linux/shell.h"

namespace {

using namespace mrr;

enum Exit : int { kDone = 0, kUnusable = 2, kDefect = 3 };

volatile int stop_requested = 0;

/// Index of the joint named or numbered (from 1) by `text`.
int find_joint(const RobotDescription& robot, const std::string& text) {
  for (int i = 0; i < robot.dof(); ++i) {
    if (robot.joints[static_cast<std::size_t>(i)].name == text) return i;
  }
  int number = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
  if (error == std::errc{} && end == text.data() + text.size() && number >= 1 && number <= robot.dof())
    return number - 1;
  std::string names;
  for (const JointDescription& joint : robot.joints)
    names = fmt::format("{}{}{}", names, names.empty() ? "" : ", ", joint.name);
  throw DescriptionError(fmt::format("--joint {}: {} has no such joint; give a number from 1 to {} or a name of {}.",
                                     text, robot.name, robot.dof(), names));
}

void run(const std::string& directory, const std::string& joint_text, fw::ShellOptions options, bool test_faults) {
  const RobotDescription robot = load_robot(find_robot(directory));
  const int joint = find_joint(robot, joint_text);
  if (options.can.empty()) options.can = robot.bus.interface;
  if (options.can == options.plant) {
    throw DescriptionError(
        fmt::format("--plant {0}: that is the robot's bus (--can {0}) too; the plant needs an interface of its own.",
                    options.plant));
  }
  options.number = joint + 1;
  options.name = robot.joints[static_cast<std::size_t>(joint)].name;
  fw::ModuleConfig config = fw::module_config(robot, joint);
  config.test_faults = test_faults;
  fw::Shell shell(config, options);
  shell.run(stop_requested);
  if (options.verbose) shell.print_statistics();
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{"mrr_module: the firmware of one joint as a process on a CAN bus."};
  app.set_version_flag("--version", MRR_VERSION);
  app.footer(
      "SIGTERM, SIGINT or SIGHUP stops the joint in order: controlled stop, brake, power stage off.\n"
      "Exit status: 0 stopped as asked, 2 unusable input (robot, joint, interface), 3 defect.");
  std::string robot;
  std::string joint;
  fw::ShellOptions options;
  bool test_faults = false;
  bool lockstep = false;
  bool realtime = false;
  app.add_option("--robot", robot, "Folder of the robot description, for example robots/mrr3")->required();
  app.add_option("--joint", joint, "Which joint: its number, from 1 at the base, or its name")->required();
  app.add_option("--can", options.can, "Interface of the robot's bus (default: the one in the robot description)");
  app.add_option("--plant", options.plant,
                 "Interface of the plant bus, where mrr_plant stands in for hardware. Without it there is none: the "
                 "module answers on the bus and refuses to enable");
  auto* l = app.add_flag("--lockstep", lockstep, "Expect the plant to be the clock (default: as the plant says)");
  app.add_flag("--realtime", realtime, "Tick on the own clock from the start, without waiting for the plant")
      ->excludes(l);
  app.add_flag("--test-faults", test_faults, "Add object 2F00h: writing an emergency code provokes that fault");
  app.add_option("--store", options.store, "File that keeps what 1010h stores (default: nothing is kept)");
  app.add_flag("--verbose", options.verbose, "Say more, and print statistics at the end");
  app.failure_message([](const CLI::App*, const CLI::Error& error) {
    return fmt::format("mrr_module: {}; see mrr_module --help\n", error.what());
  });
  try {
    refuse_empty_values(app);
    app.parse(argc, argv);
    if (lockstep && options.plant.empty()) {
      throw DescriptionError("--lockstep: there is no plant to be the clock; give --plant, or leave --lockstep out.");
    }
    options.pace = lockstep ? fw::Pace::lockstep : realtime ? fw::Pace::realtime : fw::Pace::as_plant;
    mrr::on_end([](int) { stop_requested = 1; });
    run(robot, joint, options, test_faults);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? kDone : kUnusable;
  } catch (const DescriptionError& error) {
    fmt::print(stderr, "mrr_module: {}\n", error.what());
    return kUnusable;
  } catch (const can::CanError& error) {
    fmt::print(stderr, "mrr_module: {}\n", error.what());
    return kUnusable;
  } catch (const std::system_error& error) {
    fmt::print(stderr, "mrr_module: --store {}\n", error.what());
    return kUnusable;
  } catch (const std::exception& error) {
    fmt::print(stderr, "mrr_module: internal error: {}\n", error.what());
    return kDefect;
  }
  return kDone;
}
