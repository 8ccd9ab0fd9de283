#include "cli/robot_commands.h"
#include "cli/app.h"

#include <fmt/format.h>

#include <charconv>
#include <chrono>
#include <cmath>
#include <memory>
#include <numbers>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "cli/status_text.h"
#include "cli/text.h"
#include "common/rpc/runtime_dir.h"

namespace mrr::cli {

using rpc::Json;
using namespace std::chrono_literals;
using Clock = std::chrono::steady_clock;

namespace {

struct Arguments {
  std::string socket;
  std::string joint;
  std::vector<std::string> targets;
  std::vector<JointTarget> parsed;
  double speed = 0.2;
  double timeout_s = 60.0;
  double period_s = 0.5;
  int count = 0;
  bool all = false;
  bool json = false;
  bool watch = false;
  bool follow = false;
  bool no_wait = false;
};

rpc::Client connect(const Arguments& arguments) {
  return rpc::Client(rpc::socket_path(arguments.socket, "supervisor.sock"), "mrr_supervisor");
}

void pause(double period_s) {
  const auto end = Clock::now() + std::chrono::duration<double>(period_s);
  while (!interrupted() && Clock::now() < end) std::this_thread::sleep_for(20ms);
}

/// Stops what moves; the answer to Ctrl-C. Never throws: it is called where something already went wrong.
void stop_quietly(rpc::Client& client) {
  try {
    client.call("stop", Json::object(), 1s);
  } catch (const std::exception& error) {
    fmt::print(stderr, "mrr: and the stop was refused: {}\n", error.what());
  }
}

/// Sends a command and waits until it has ended, as await_command(). `label`: before what is said when it is accepted
/// or done.
int command(const Arguments& arguments, const std::string& method, const Json& params, bool moves,
            const std::string& label = {}) {
  catch_interrupts();
  rpc::Client client = connect(arguments);
  if (method != "stop") (void)greet(client);  // a stop waits for nothing
  client.call("subscribe", {{"events", {"command"}}});
  const Json accepted = client.call(method, params);
  const auto number = accepted.at("command").get<std::int64_t>();
  if (arguments.no_wait) {
    fmt::print("{}{}: accepted\n", label, method);
    return kExitDone;
  }
  const CommandEnd end = await_command(client, method, number, arguments.timeout_s, moves);
  if (end.status == kExitDone) {
    fmt::print("{}{}: done\n", label, method);
  } else {
    fmt::print(stderr, "mrr: {}\n", end.reason);
  }
  return end.status;
}

int show_status(const Arguments& arguments) {
  catch_interrupts();
  rpc::Client client = connect(arguments);
  const Json hello = greet(client);
  if (!arguments.watch) {
    const Json status = client.call("status");
    fmt::print("{}", arguments.json ? status.dump(2) + '\n' : status_text(hello, status));
    return kExitDone;
  }
  LiveBlock block;
  while (!interrupted()) {
    const Json status = client.call("status");
    block.show(arguments.json ? status.dump() + '\n' : status_text(hello, status));
    pause(arguments.period_s);
  }
  return kExitDone;
}

int monitor(const Arguments& arguments) {
  catch_interrupts();
  rpc::Client client = connect(arguments);
  const Json hello = greet(client);
  client.call("subscribe");
  LiveBlock block;
  TorqueHistory history(200);
  std::vector<std::string> lines;  // the last events
  if (!block.terminal() && !arguments.json) block.show(sample_header(hello));
  for (int k = 0; !interrupted() && (arguments.count == 0 || k < arguments.count); ++k) {
    const auto next =
        Clock::now() + std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(arguments.period_s));
    const Json status = client.call("status");
    if (arguments.json) {
      block.show(status.dump() + '\n');
    } else if (!block.terminal()) {
      block.show(sample_line(status));
    } else {
      history.add(status);
      std::string text = monitor_text(hello, status, history, LiveBlock::columns(), LiveBlock::utf8()) + '\n';
      for (const std::string& line : lines) text += line.substr(0, LiveBlock::columns() - 1) + '\n';
      block.show(text + "Ctrl-C ends\n");
    }
    while (!interrupted()) {
      const auto left = std::chrono::ceil<std::chrono::milliseconds>(next - Clock::now());
      const auto event = client.next_event(std::max(left, std::chrono::milliseconds(0)));
      if (event) {
        std::string line = event_line(*event);
        line.pop_back();  // its newline
        lines.push_back(std::move(line));
        if (lines.size() > 8) lines.erase(lines.begin());
      }
      if (!event && Clock::now() >= next) break;
    }
  }
  return kExitDone;
}

int show_faults(const Arguments& arguments) {
  rpc::Client client = connect(arguments);
  const Json faults = client.call("faults");
  fmt::print("{}", arguments.json ? faults.dump(2) + '\n' : faults_text(faults));
  if (!faults.at("active").empty()) return kExitNotDone;
  // A joint that was lost and is back has no fault, and the robot waits for reset all the same.
  if (client.call("status").at("activity") != "faulted") return kExitDone;
  if (!arguments.json) fmt::print("The robot waits for mrr reset: a joint was lost or in fault, and is back.\n");
  return kExitNotDone;
}

int show_log(const Arguments& arguments) {
  catch_interrupts();
  rpc::Client client = connect(arguments);
  if (arguments.follow) client.call("subscribe");
  const Json lines = client.call("log", {{"count", arguments.count}}).at("lines");
  for (const Json& line : lines) fmt::print("{}", arguments.json ? line.dump() + '\n' : log_line(line));
  while (arguments.follow && !interrupted()) {
    std::fflush(stdout);
    if (const auto event = client.next_event(500ms))
      fmt::print("{}", arguments.json ? event->dump() + '\n' : event_line(*event));
  }
  return kExitDone;
}

int home(const Arguments& arguments) {
  if (!arguments.all) return command(arguments, "home", {{"joint", joint_parameter(arguments.joint)}}, true);
  Json joints;
  {
    rpc::Client client = connect(arguments);
    joints = greet(client).at("robot").at("joints");
  }
  // From the tip to the base: a joint that looks for its switch then carries as little as it can.
  for (auto joint = joints.rbegin(); joint != joints.rend(); ++joint) {
    const auto name = joint->at("name").get<std::string>();
    const int status = command(arguments, "home", {{"joint", name}}, true, name + ": ");
    if (status != kExitDone) return status;
  }
  return kExitDone;
}

int move(const Arguments& arguments) {
  Json positions = Json::object();
  for (const JointTarget& target : arguments.parsed) {
    std::string name = target.joint;
    if (const Json number = joint_parameter(name); number.is_number()) {
      rpc::Client client = connect(arguments);
      const Json joints = greet(client).at("robot").at("joints");
      const int index = number.get<int>();
      if (index < 1 || index > static_cast<int>(joints.size()))
        throw std::invalid_argument(fmt::format("joint {} is not from 1 to {}", index, joints.size()));
      name = joints[static_cast<std::size_t>(index - 1)].at("name").get<std::string>();
    }
    if (positions.contains(name)) throw std::invalid_argument(fmt::format("{} is named twice", name));
    positions[name] = target.position_rad;
  }
  return command(arguments, "move", {{"positions_rad", positions}, {"speed", arguments.speed}}, true);
}

}  // namespace

Json greet(rpc::Client& client) {
  Json hello = client.call("hello");
  const auto version = hello.is_object() ? hello.find("interface_version") : hello.end();
  if (version == hello.end() || !version->is_number_integer())
    throw rpc::ConnectionError("what answers at the socket is not mrr_supervisor; name its socket with --socket");
  if (*version != rpc::kInterfaceVersion) {
    throw rpc::ConnectionError(
        fmt::format("mrr_supervisor there speaks interface version {}, this command version {}; install both from one "
                    "release",
                    version->dump(), rpc::kInterfaceVersion));
  }
  return hello;
}

Json joint_parameter(const std::string& joint) {
  int number = 0;
  const auto [end, error] = std::from_chars(joint.data(), joint.data() + joint.size(), number);
  if (error == std::errc() && end == joint.data() + joint.size()) return number;
  return joint;
}

CommandEnd await_command(rpc::Client& client, const std::string& method, std::int64_t number, double timeout_s,
                         bool moves, const std::function<void()>& meanwhile) {
  const auto end = Clock::now() + std::chrono::duration<double>(timeout_s);
  while (!interrupted()) {
    // Events may be lost and commands may end before the subscription is seen: status is asked now and then as well.
    std::string state;
    std::string reason;
    if (const auto event = client.next_event(200ms)) {
      if (event->value("value", std::int64_t{-1}) != number) continue;
      state = event->value("state", "");
      reason = event->value("text", "");
    } else {
      const Json last = client.call("status").value("command", Json());
      if (last.is_object() && last.value("number", std::int64_t{-1}) == number) {
        state = last.value("state", "");
        reason = last.value("reason", "");
      } else if (last.is_object() && last.value("number", std::int64_t{-1}) > number) {
        state = "failed";
        reason = fmt::format("another client's {} took its place", last.value("method", "command"));
      }
    }
    if (meanwhile) meanwhile();
    if (state == "done") return {};
    if (state == "failed") {
      return {kExitNotDone, fmt::format("{} failed: {}", method, reason.empty() ? "no reason given" : reason)};
    }
    if (Clock::now() >= end) {
      if (moves) stop_quietly(client);
      return {kExitNotDone, fmt::format("{} has not ended within {:g} s{}; mrr status shows why", method, timeout_s,
                                        moves ? ", so the robot was stopped" : "")};
    }
  }
  if (moves) stop_quietly(client);
  return {kExitInterrupted, fmt::format("interrupted; {}", moves ? "the robot was stopped" : method + " goes on")};
}

JointTarget parse_target(const std::string& text) {
  const auto bad = [&text](const char* why) {
    return std::invalid_argument(fmt::format("'{}' {}; write it as joint_2=30deg or 2=-0.5rad", text, why));
  };
  const std::size_t equals = text.find('=');
  if (equals == std::string::npos || equals == 0) throw bad("is not JOINT=POSITION");
  JointTarget target;
  target.joint = text.substr(0, equals);
  const char* begin = text.data() + equals + 1;
  const char* const end = text.data() + text.size();
  if (begin != end && *begin == '+') ++begin;
  const auto [unit, error] = std::from_chars(begin, end, target.position_rad);
  if (error != std::errc() || !std::isfinite(target.position_rad)) throw bad("has no finite number");
  const std::string name(unit, end);
  if (name == "deg") {
    target.position_rad *= std::numbers::pi / 180.0;
  } else if (name != "rad") {
    throw bad(name.empty() ? "has no unit" : "has a unit that is neither deg nor rad");
  }
  return target;
}

ExitStatus exit_status_of(const rpc::Error& error) noexcept {
  // Codes of docs/rpc.md: outside_limits, unknown_joint.
  if (error.code() == rpc::kInvalidParams || error.code() == 3 || error.code() == 4) return kExitUsage;
  if (error.code() == rpc::kInternalError || error.code() == rpc::kParseError) return kExitInternal;
  return kExitNotDone;
}

void add_socket_option(CLI::App& command, std::string& socket) {
  command.add_option("--socket", socket, "Socket of mrr_supervisor (default: supervisor.sock in the runtime folder)")
      ->type_name("PATH");
}

void add_robot_commands(CLI::App& app, int& status) {
  const auto add = [&app](const char* name, const char* description, const std::shared_ptr<Arguments>& arguments) {
    CLI::App* one = app.add_subcommand(name, description);
    add_socket_option(*one, arguments->socket);
    return one;
  };
  const auto add_json = [](CLI::App* one, const std::shared_ptr<Arguments>& arguments, const char* description) {
    return one->add_flag("--json", arguments->json, description);
  };
  const auto add_wait = [](CLI::App* one, const std::shared_ptr<Arguments>& arguments) {
    CLI::Option* no_wait = one->add_flag("--no-wait", arguments->no_wait, "Return as soon as it is accepted");
    one->add_option("--timeout", arguments->timeout_s, "Wait at most this long, s of wall time")
        ->check(between(0.1, 86400.0))
        ->type_name("SECONDS")
        ->capture_default_str()
        ->excludes(no_wait);
  };
  const auto new_arguments = [] { return std::make_shared<Arguments>(); };

  {
    auto a = new_arguments();
    CLI::App* one = add("status", "Show what the robot does and how each joint is", a);
    CLI::Option* watch = one->add_flag("-w,--watch", a->watch, "Keep showing it until Ctrl-C");
    one->add_option("--period", a->period_s, "Time between two looks, s of wall time")
        ->check(between(0.05, 3600.0))
        ->type_name("SECONDS")
        ->capture_default_str()
        ->needs(watch);
    add_json(one, a, "Print the answer as docs/rpc.md has it; with --watch one line each time");
    one->callback([a, &status] { status = show_status(*a); });
  }
  struct Simple {
    const char* name;
    const char* description;
    bool moves;
  };
  for (const Simple& simple :
       {Simple{"enable", "Bring all joints up; they hold where they are", false},
        Simple{"disable", "Stop, set the brakes and switch the drives off", false},
        Simple{"stop", "Stop whatever moves, then hold; ends a job", false},
        Simple{"reset", "Acknowledge the faults there are and bring the joints up again", false}}) {
    auto a = new_arguments();
    CLI::App* one = add(simple.name, simple.description, a);
    add_wait(one, a);
    one->callback([a, &status, simple] { status = command(*a, simple.name, Json::object(), simple.moves); });
  }
  {
    auto a = new_arguments();
    CLI::App* one = add("home", "Let a joint find its zero", a);
    CLI::Option* joint = one->add_option("JOINT", a->joint, "Name, or number from 1 at the base");
    CLI::Option* all = one->add_flag("--all", a->all, "Every joint, one after the other from the tip to the base");
    joint->excludes(all);
    add_wait(one, a);
    one->callback([a, joint, all, &status] {
      if (joint->count() == 0 && all->count() == 0) throw CLI::RequiredError("JOINT or --all");
      status = home(*a);
    });
  }
  {
    auto a = new_arguments();
    CLI::App* one = add("move", "Move joints, all together and from rest to rest", a);
    one->add_option("TARGET", a->targets, "JOINT=POSITION with its unit, deg or rad: joint_2=30deg 3=-0.5rad")
        ->required()
        ->type_name(" ");
    one->add_option("--speed", a->speed, "Share of the joints' speed limits, above 0 to 1")
        ->check(between(0.001, 1.0))
        ->type_name("SHARE")
        ->capture_default_str();
    add_wait(one, a);
    one->callback([a, &status] {
      a->parsed.clear();
      for (const std::string& target : a->targets) a->parsed.push_back(parse_target(target));
      status = move(*a);
    });
  }
  for (const auto& [name, description] :
       {std::pair{"passive", "Let a joint go: it gives way until its longest time or travel, then comes back"},
        std::pair{"active", "Let a passive joint hold again, where it is"}}) {
    auto a = new_arguments();
    CLI::App* one = add(name, description, a);
    one->add_option("JOINT", a->joint, "Name, or number from 1 at the base")->required();
    add_wait(one, a);
    one->callback([a, &status, method = std::string(name)] {
      status = command(*a, method, {{"joint", joint_parameter(a->joint)}}, false);
    });
  }
  {
    auto a = new_arguments();
    CLI::App* one = add("fault", "List the faults: the first of each joint, when, why and what to do", a);
    add_json(one, a, "Print the answer as docs/rpc.md has it");
    one->footer("Exit status 1 if there is a fault, or one that waits for mrr reset.");
    one->callback([a, &status] { status = show_faults(*a); });
  }
  {
    auto a = new_arguments();
    a->period_s = 0.1;
    CLI::App* one = add("monitor", "Watch joints and events live: position bars and torque curves", a);
    one->add_option("--period", a->period_s, "Time between two samples, s of wall time")
        ->check(between(0.01, 3600.0))
        ->type_name("SECONDS")
        ->capture_default_str();
    one->add_option("-n,--count", a->count, "End after this many samples (default: Ctrl-C ends)")
        ->check(CLI::Range(1, 1000000000))
        ->type_name("N");
    add_json(one, a, "One status a line, as docs/rpc.md has it");
    one->footer("In a pipe: tab-separated samples below a header line.");
    one->callback([a, &status] { status = monitor(*a); });
  }
  {
    auto a = new_arguments();
    a->count = 20;
    CLI::App* one = add("log", "Show what the supervisor has logged", a);
    one->add_option("-n,--count", a->count, "The last so many lines")
        ->check(CLI::Range(1, 1000))
        ->type_name("N")
        ->capture_default_str();
    one->add_flag("-f,--follow", a->follow, "Then print events as they come, until Ctrl-C");
    add_json(one, a, "One object a line, as docs/rpc.md has it");
    one->callback([a, &status] { status = show_log(*a); });
  }
}

}  // namespace mrr::cli
