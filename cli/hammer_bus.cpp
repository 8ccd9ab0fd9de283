#include "cli/hammer_bus.h"

#include <fmt/format.h>
#include <poll.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <fstream>
#include <iterator>
#include <limits>
#include <memory>
#include <optional>
#include <sstream>
#include <string_view>
#include <thread>
#include <utility>
#include <vector>

#include "can_protocol/bit_timing.h"
#include "can_protocol/plant_io/plant_frames.h"
#include "can_protocol/socketcan/can_socket.h"
#include "cli/print.h"
#include "cli/robot_commands.h"
#include "cli/text.h"
#include "common/robot/errors.h"
#include "common/rpc/client.h"
#include "common/rpc/runtime_dir.h"
#include "sim_vcan/wire/candump.h"
#include "supervisor/master/bus_budget.h"

namespace mrr::cli {

using rpc::Json;
using namespace std::chrono_literals;
using Clock = std::chrono::steady_clock;
namespace fs = std::filesystem;

namespace {

constexpr auto kBringUpLimit = 60s;  // wall time; lockstep may be slow
constexpr auto kStopLimit = 5s;      // for the supervisor to end a job we leave

/// A job that nobody watches must not go on striking: unless release() was called, sends `stop` until the job is over.
class JobGuard {
 public:
  JobGuard(std::string socket, rpc::Client& supervisor) : socket_(std::move(socket)), supervisor_(&supervisor) {}
  JobGuard(const JobGuard&) = delete;
  JobGuard& operator=(const JobGuard&) = delete;
  ~JobGuard() {
    const auto end = Clock::now() + kStopLimit;
    while (supervisor_ != nullptr && Clock::now() < end) {
      if (stopped()) return;
      std::this_thread::sleep_for(50ms);
    }
  }
  void release() { supervisor_ = nullptr; }

 private:
  bool stopped() noexcept {
    try {
      supervisor_->call("stop", Json::object(), 500ms);
      const Json status = supervisor_->call("status", Json::object(), 500ms);
      return !status.at("job").is_object() || status["job"].value("state", "") == "done";
    } catch (const rpc::ConnectionError&) {
      // The connection may be what failed: another one.
      try {
        own_ = std::make_unique<rpc::Client>(rpc::socket_path(socket_, "supervisor.sock"), "mrr_supervisor");
        supervisor_ = own_.get();
      } catch (const std::exception&) {
        return false;
      }
    } catch (const std::exception&) {
      return false;
    }
    return false;
  }

  std::string socket_;
  rpc::Client* supervisor_;
  std::unique_ptr<rpc::Client> own_;
};

/// Every frame on the robot's bus. In lockstep each gets the simulated time of the tick in which it was sent, so that
/// the log is of the same clock as everything else; within a tick by identifier, as everybody takes them.
class Recorder {
 public:
  Recorder(const std::string& bus, const std::string& plant_bus) : bus_(can::CanSocket::open(bus)) {
    if (plant_bus.empty()) return;
    const can::CanFilter ticks{plant_io::kTickId, 0x7FF};
    plant_.emplace(can::CanSocket::open(plant_bus, {.filters = std::span(&ticks, 1), .fd = true}));
  }

  /// Takes what has arrived; waits at most `timeout` for something.
  void take(std::chrono::milliseconds timeout, int also_fd) {
    std::array<pollfd, 3> fds{{{bus_.fd(), POLLIN, 0}, {also_fd, POLLIN, 0}, {plant_ ? plant_->fd() : -1, POLLIN, 0}}};
    // Ticks come by the thousand: they do not wake us, frames of the robot's bus do.
    ::poll(fds.data(), 2, static_cast<int>(timeout.count()));
    for (auto batch = bus_.receive(); !batch.empty(); batch = bus_.receive())
      frames_.insert(frames_.end(), batch.begin(), batch.end());
    if (!plant_) return;
    for (auto batch = plant_->receive(); !batch.empty(); batch = plant_->receive()) {
      for (const can::ReceivedFrame& frame : batch) {
        if (const auto tick = plant_io::decode_tick(frame.frame)) ticks_.emplace_back(frame.at, tick->now);
      }
    }
  }

  [[nodiscard]] std::uint64_t lost() const { return static_cast<std::uint64_t>(bus_.statistics().receive_overflow); }

  /// The log, and how much of `bit_rates` the frames would have taken on a wire.
  [[nodiscard]] std::string log(const std::string& interface, const can::BitRates& bit_rates, double& load) {
    std::vector<can::ReceivedFrame> timed = frames_;
    if (plant_) {
      std::size_t next = 0;
      Time simulated;
      bool known = false;
      std::vector<can::ReceivedFrame> kept;
      for (can::ReceivedFrame frame : timed) {
        while (next < ticks_.size() && ticks_[next].first <= frame.at) {
          simulated = ticks_[next++].second;
          known = true;
        }
        if (!known) continue;  // before the first tick that was seen
        frame.at = simulated;
        kept.push_back(frame);
      }
      std::stable_sort(kept.begin(), kept.end(), [](const can::ReceivedFrame& a, const can::ReceivedFrame& b) {
        return std::pair(a.at, can::arbitration_key(a.frame)) < std::pair(b.at, can::arbitration_key(b.frame));
      });
      timed = std::move(kept);
    }
    std::ostringstream out;
    sim::CandumpWriter writer(out, interface);
    Duration busy;
    for (const can::ReceivedFrame& frame : timed) {
      writer.write(frame.frame, frame.at);
      busy += can::wire_bits(frame.frame).time(bit_rates);
    }
    const Duration span = timed.empty() ? Duration{} : timed.back().at - timed.front().at;
    load = span.ns > 0 ? busy.seconds() / span.seconds() : 0.0;
    return out.str();
  }

 private:
  can::CanSocket bus_;
  std::optional<can::CanSocket> plant_;
  std::vector<can::ReceivedFrame> frames_;
  std::vector<std::pair<Time, Time>> ticks_;  // arrival, simulated
};

/// Until `done` says so; throws ConnectionError with `what` if that takes too long.
template <typename Done>
void wait_for(rpc::Client& supervisor, Recorder& recorder, const std::string& what, Done done) {
  const auto end = Clock::now() + kBringUpLimit;
  for (;;) {
    recorder.take(20ms, -1);
    const Json status = supervisor.call("status");
    if (done(status)) return;
    if (interrupted()) {
      supervisor.call("stop");
      throw Interrupted();
    }
    if (Clock::now() < end) continue;
    std::string why;
    for (const Json& joint : status.at("joints")) {
      if (joint.at("stage") != "enabled") {
        why += fmt::format("; {} is {}{}", joint.at("name").get<std::string>(), joint.at("stage").get<std::string>(),
                           joint.at("problem").is_string() ? ": " + joint.at("problem").get<std::string>() : "");
      }
    }
    throw rpc::ConnectionError(fmt::format("{} after {} s{}", what, kBringUpLimit / 1s, why));
  }
}

/// A row for each of the supervisor's steps, with the columns the robot itself knows.
std::string own_recording(rpc::Client& supervisor) {
  std::string csv;
  std::size_t row = 0;
  for (;;) {
    const Json part = supervisor.call("recording", {{"from_row", row}, {"max_rows", 2000}});
    if (row == 0) {
      for (const Json& column : part.at("columns"))
        csv += fmt::format("{}{}", csv.empty() ? "" : ",", column.get<std::string>());
      csv += '\n';
    }
    for (const Json& values : part.at("rows")) {
      std::string line;
      for (const Json& value : values)
        fmt::format_to(std::back_inserter(line), "{}{:.9g}", line.empty() ? "" : ",",
                       value.is_number() ? value.get<double>() : std::numeric_limits<double>::quiet_NaN());
      csv += line + '\n';
    }
    if (part.at("rows").empty()) return csv;
    row += part.at("rows").size();
  }
}

std::string content_and_remove(const std::string& path) {
  std::ostringstream text;
  text << std::ifstream(path, std::ios::binary).rdbuf();
  std::error_code ignored;
  fs::remove(path, ignored);
  return text.str();
}

}  // namespace

std::string robot_of_supervisor(const std::string& socket) {
  rpc::Client client(rpc::socket_path(socket, "supervisor.sock"), "mrr_supervisor");
  return greet(client).at("robot").value("source", "");
}

BusJob run_bus_job(const RobotDescription& robot, const BusJobOptions& options) {
  catch_interrupts();
  rpc::Client supervisor(rpc::socket_path(options.socket, "supervisor.sock"), "mrr_supervisor");
  const Json hello = greet(supervisor);
  const auto name = hello.at("robot").at("name").get<std::string>();
  if (name != robot.name) {
    throw DescriptionError(fmt::format(
        "--robot is {}, but mrr_supervisor there runs {}; leave --robot out or give its folder", robot.name, name));
  }
  const auto bus = hello.at("bus").at("interface").get<std::string>();
  if (bus != options.bus) {
    throw DescriptionError(
        fmt::format("--bus is {}, but the robot there is on {}; give --bus {}", options.bus, bus, bus));
  }
  std::unique_ptr<rpc::Client> plant;
  try {
    plant = std::make_unique<rpc::Client>(rpc::socket_path(options.plant_socket, "plant.sock"), "mrr_plant");
  } catch (const rpc::ConnectionError&) {
    if (!options.plant_socket.empty()) throw;  // asked for by name
  }

  BusJob job;
  job.board = "unknown";
  job.clock = hello.at("clock").at("kind").get<std::string>();
  const Json& plant_bus = hello.at("clock").at("plant_interface");
  const bool lockstep = job.clock == "lockstep";
  Recorder recorder(options.bus, lockstep && plant_bus.is_string() ? plant_bus.get<std::string>() : std::string());

  bool put_back = false;
  std::size_t seen_before = 0;  // swings of earlier jobs
  if (plant) {
    // A nail that was struck before: a new one, and the arm at rest where a job begins. Sensors jump by that, so the
    // drives are off meanwhile.
    const Json truth = plant->call("truth");
    job.board = truth.value("board", "unknown");
    const bool used = std::abs(truth.at("nail_height_m").get<double>() - robot.task.nail_height_m) > 1e-4 ||
                      truth.at("swings").get<int>() > 0;
    if (used) {
      // Putting the arm back ends what somebody else does: the supervisor would refuse the job, and so do we.
      const auto activity = supervisor.call("status").at("activity").get<std::string>();
      static constexpr std::array<std::string_view, 4> kIdle{"disabled", "bringing up", "holding", "faulted"};
      if (std::find(kIdle.begin(), kIdle.end(), activity) == kIdle.end())
        throw rpc::ConnectionError(fmt::format("the robot is {}; stop it first", activity));
      supervisor.call("disable");
      wait_for(supervisor, recorder, "the robot has not let go",
               [](const Json& status) { return status.at("activity") == "disabled"; });
      plant->call("reset");
      put_back = true;
    }
    seen_before = plant->call("truth").at("swings").get<std::size_t>();
    plant->call("recording_start");
  }
  const Json before = supervisor.call("status");
  const double began_s = before.at("time_s").get<double>();
  const auto began = Clock::now();
  if (!before.at("ready").get<bool>()) {
    int number = supervisor.call("enable").at("command").get<int>();
    wait_for(supervisor, recorder, "the robot is not ready", [&](const Json& status) {
      const Json& joints = status.at("joints");
      const bool faulted =
          std::any_of(joints.begin(), joints.end(), [](const Json& joint) { return joint.at("stage") == "faulted"; });
      // A joint takes the arm that was put back for a broken encoder: that fault is ours to acknowledge, no other.
      if (faulted && std::exchange(put_back, false)) {
        number = supervisor.call("reset").at("command").get<int>();
        return false;
      }
      const Json& command = status.at("command");
      if (command.is_object() && command.at("number") == number && command.at("state") == "failed") {
        throw rpc::ConnectionError(
            fmt::format("the robot is not ready: {}; mrr status shows it", command.at("reason").get<std::string>()));
      }
      return status.at("ready").get<bool>();
    });
  }

  supervisor.call("subscribe", {{"events", {"swing", "job"}}});
  Json request = {{"mode", options.mode}, {"seed", options.seed}, {"as_printed", options.as_printed}};
  if (options.swings > 0) request["swings"] = options.swings;
  JobGuard guard(options.socket, supervisor);
  const int number = [&] {
    try {
      return supervisor.call("hammer", request).at("job").get<int>();
    } catch (const rpc::Error&) {
      guard.release();  // refused: there is no job of ours, perhaps one of somebody else's
      throw;
    }
  }();
  ProgressBar bar;
  int swings = 0;
  auto next_look = Clock::now();
  for (bool over = false; !over;) {
    recorder.take(20ms, supervisor.fd());
    while (const auto event = supervisor.next_event(0ms)) {
      if (event->value("kind", "") == "swing") ++swings;
      over = over || (event->value("kind", "") == "job" && event->value("value", 0) == number);
    }
    if (interrupted()) throw Interrupted();
    if (Clock::now() < next_look) continue;
    // Now and then: events may be lost.
    next_look = Clock::now() + 300ms;
    const Json status = supervisor.call("status");
    over = over || (status.at("job").is_object() && status["job"].value("state", "") == "done");
    if (!bar.terminal()) continue;
    const double height_m = plant ? plant->call("truth").at("nail_height_m").get<double>()
                                  : status["job"].value("nail_height_mm", 0.0) * 1e-3;
    bar.update(fmt::format("nail {:4.1f} mm, swing {}, {:4.1f} s", height_m * 1e3, swings + 1,
                           status.at("time_s").get<double>() - began_s),
               1.0 - height_m / robot.task.nail_height_m);
  }
  guard.release();
  const double wall_s = std::chrono::duration<double>(Clock::now() - began).count();
  bar.clear();

  const Json report = supervisor.call("job", {{"job", number}});
  Outcome& outcome = job.outcome;
  outcome.verdict = report.at("verdict").get<std::string>();
  outcome.reason = report.at("reason").get<std::string>();
  outcome.plan = report.at("plan");
  outcome.swings = report.at("swings");
  outcome.wall_s = wall_s;
  outcome.simulated_s = (report.at("ended_s").is_number() ? report["ended_s"].get<double>() : began_s) - began_s;
  outcome.nail_height_m = report.at("nail_height_mm").get<double>() * 1e-3;
  outcome.truth_known = plant != nullptr;
  if (plant) {
    Json really;
    // The plant closes a swing when it hears of the next: a tick after the job's end.
    const auto end = Clock::now() + 2s;
    do {
      really = plant->call("swings").at("swings");
      recorder.take(10ms, -1);
    } while (really.size() < seen_before + outcome.swings.size() && Clock::now() < end);
    if (really.size() < seen_before + outcome.swings.size()) {
      throw rpc::ConnectionError(fmt::format("mrr_plant has seen {} of {} swings; restart it before the next job",
                                             really.size() - seen_before, outcome.swings.size()));
    }
    for (std::size_t k = 0; k < outcome.swings.size(); ++k) {
      sim::SwingTruth truth = swing_truth(really[seen_before + k]);
      const Json& joints = outcome.swings[k].at("joints");
      for (std::size_t i = 0; i < truth.joints.size(); ++i)
        truth.joints[i].passive = joints.at(i).at("passive").get<bool>();
      outcome.truth.push_back(std::move(truth));
    }
    outcome.nail_height_m = plant->call("truth").at("nail_height_m").get<double>();
    job.telemetry_csv =
        content_and_remove(plant->call("recording_stop", Json::object(), 30s).at("path").get<std::string>());
  } else {
    job.telemetry_csv = own_recording(supervisor);
  }
  recorder.take(0ms, -1);
  job.bus_log = recorder.log(options.bus, {.nominal = static_cast<std::int64_t>(robot.bus.bit_rate)}, outcome.bus_load);
  job.lost_frames = recorder.lost();
  outcome.bus_load_worst_case = sup::bus_budget(robot).load;
  conclude(robot, outcome);
  return job;
}

}  // namespace mrr::cli
