// The daemon without a CAN bus: cycle and service over frames handed round in memory, with the real module cores and
// the emulator, on a clock of the test's own. What the sanitizers see of it, and what it does when cycles are left out.
#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <memory>
#include <thread>
#include <vector>

#include "common/rpc/client.h"
#include "common/rpc/server.h"
#include "module_fw/targets/host/module_config.h"
#include "supervisor/daemon/cycle.h"
#include "supervisor/daemon/service.h"
#include "supervisor/strike/move.h"
#include "tests/integration/world/whole_robot.h"
#include "tests/unit/model/allocation_count.h"
#include "tests/unit/rpc/temporary_folder.h"

namespace mrr::sim::test {
namespace {

using sup::Activity;
using sup::CommandState;
using sup::NodeStage;

constexpr int kSupervisor = -1;

/// A bus as lockstep has it: what is sent in a tick is seen by all others in the next one, smaller identifiers first.
class TickBus final : public sup::BusPort {
 public:
  [[nodiscard]] std::span<const can::ReceivedFrame> receive() noexcept override { return {}; }
  std::size_t send(std::span<const can::Frame> frames) noexcept override {
    for (const can::Frame& frame : frames) post(kSupervisor, frame);
    return frames.size();
  }
  [[nodiscard]] sup::BusHealth health() const noexcept override {
    return {.received = static_cast<std::int64_t>(seen_), .sent = static_cast<std::int64_t>(sent_)};
  }
  void post(int from, const can::Frame& frame) noexcept {
    ++sent_;
    if (!next_.push_back({from, frame})) ++lost_;
  }
  void turn() noexcept {
    std::swap(now_, next_);
    next_.clear();
    std::stable_sort(now_.begin(), now_.end(), [](const Sent& a, const Sent& b) { return a.frame.id < b.frame.id; });
    seen_ += now_.size();
  }
  void read(int reader, Time at, StaticVector<can::ReceivedFrame, 512>& out) const noexcept {
    for (const Sent& sent : now_) {
      if (sent.from != reader) (void)out.push_back({sent.frame, at});
    }
  }
  [[nodiscard]] std::size_t lost() const noexcept { return lost_; }

 private:
  struct Sent {
    int from = 0;
    can::Frame frame;
  };
  StaticVector<Sent, 512> now_;
  StaticVector<Sent, 512> next_;
  std::size_t seen_ = 0;
  std::size_t sent_ = 0;
  std::size_t lost_ = 0;
};

sup::SupervisorConfig config_of(const RobotDescription& robot) {
  sup::SupervisorConfig config;
  config.start_disabled = true;
  for (int i = 0; i < robot.dof(); ++i) {
    config.configuration_hash[static_cast<std::size_t>(i)] = fw::module_config(robot, i).configuration_hash;
  }
  return config;
}

/// Modules, emulator and cycle, a millisecond at a time.
class Robot {
 public:
  Robot()
      : robot(example("mrr3")), plant_(robot, plant_on(robot, "styrofoam"), 0), cycle(robot, config_of(robot), bus_) {
    std::vector<double> park;
    for (const JointDescription& joint : robot.joints) park.push_back(joint.park_rad);
    plant_.reset(park, robot.task.nail_height_m);
    for (int i = 0; i < robot.dof(); ++i) modules_.push_back(std::make_unique<fw::Module>(fw::module_config(robot, i)));
  }
  /// `with_supervisor`: its shell woke up in time. If not, what arrives waits for it.
  void tick(bool with_supervisor = true) {
    bus_.turn();
    for (int i = 0; i < robot.dof(); ++i) {
      inbox_.clear();
      bus_.read(i, now, inbox_);
      fw::ActuatorCommand command;
      tx_.clear();
      modules_[static_cast<std::size_t>(i)]->step(now, plant_.sample(i), {inbox_.data(), inbox_.size()}, command, tx_);
      plant_.set_actuator(i, command);
      for (const can::Frame& frame : tx_) bus_.post(i, frame);
    }
    bus_.read(kSupervisor, now, waiting_);
    if (with_supervisor) {
      const long before = mrr::test::allocations.load();
      cycle.step(now, {waiting_.data(), waiting_.size()});
      allocations_in_steps += mrr::test::allocations.load() - before;
      waiting_.clear();
    } else {
      cycle.count_missed(1);
    }
    plant_.step(milliseconds(1));
    now += milliseconds(1);
  }
  template <typename Condition>
  [[nodiscard]] bool run_until(Condition&& condition, int limit_ms = 20'000) {
    for (int k = 0; k < limit_ms; ++k) {
      tick();
      if (condition()) return true;
    }
    return false;
  }
  /// Asks through the mailbox, as the other thread does, and runs until the answer is there.
  [[nodiscard]] sup::Answer ask(const sup::Request& request) {
    cycle.mailbox().ask(request);
    sup::Answer answer;
    EXPECT_TRUE(run_until([&] { return cycle.mailbox().replied(answer); }, 10));
    return answer;
  }
  [[nodiscard]] bool ended() {
    sup::Event event;
    while (cycle.next_event(event)) {
    }
    return cycle.state().command.state != CommandState::running;
  }
  [[nodiscard]] bool enable() {
    return run_until([&] { return cycle.state().nodes[2].stage == NodeStage::idle; }) &&
           ask({.kind = sup::RequestKind::enable}).refusal == sup::Refusal::none &&
           run_until([&] { return ended(); }) && cycle.state().command.state == CommandState::done;
  }
  [[nodiscard]] sup::JointTrajectory motion(int joint, double by_rad, double speed) {
    const sup::JointVector start = cycle.state().reference.q;
    sup::JointVector target = start;
    target[joint] += by_rad;
    return sup::plan_move(robot, cycle.chain(), start, target, speed, milliseconds(4));
  }

  RobotDescription robot;
  Time now = Time{} + milliseconds(1);
  long allocations_in_steps = 0;

 private:
  TickBus bus_;
  Plant plant_;
  std::vector<std::unique_ptr<fw::Module>> modules_;
  StaticVector<can::ReceivedFrame, 512> inbox_;
  StaticVector<can::ReceivedFrame, 512> waiting_;
  can::TransmitQueue tx_;

 public:
  sup::Cycle cycle;
};

TEST(DaemonCycle, AllocatesNothingFromBringUpToDisable) {
  if (!mrr::test::kCountsAllocations) GTEST_SKIP() << "the sanitizer owns malloc";
  Robot robot;
  robot.cycle.record(1);
  ASSERT_TRUE(robot.enable());
  const sup::JointTrajectory motion = robot.motion(0, 0.2, 0.5);
  ASSERT_EQ(robot.ask({.kind = sup::RequestKind::move, .motion = &motion}).refusal, sup::Refusal::none);
  ASSERT_TRUE(robot.run_until([&] { return robot.ended(); }));
  EXPECT_EQ(robot.cycle.state().command.state, CommandState::done);
  EXPECT_NEAR(robot.cycle.state().nodes[0].measured.position_rad, 0.2, 5e-3);
  (void)robot.ask({.kind = sup::RequestKind::disable});
  ASSERT_TRUE(robot.run_until([&] { return robot.ended(); }));
  EXPECT_EQ(robot.cycle.state().activity, Activity::disabled);
  sup::RecordRow row;
  EXPECT_TRUE(robot.cycle.next_row(row));
  EXPECT_EQ(robot.allocations_in_steps, 0);
  EXPECT_GT(mrr::test::allocations.load(), 0) << "nothing was counted at all";
}

// Cycles that were not made: the counter of SYNC and the set points go on in time, as if SYNCs were lost on the wire.
TEST(DaemonCycle, LeftOutCyclesMoveNothingInTime) {
  for (const int late_ms : {1, 2, 3, 4, 5}) {
    SCOPED_TRACE(late_ms);
    Robot robot;
    ASSERT_TRUE(robot.enable());
    const sup::JointTrajectory motion = robot.motion(0, 0.3, 0.3);
    ASSERT_EQ(robot.ask({.kind = sup::RequestKind::move, .motion = &motion}).refusal, sup::Refusal::none);
    const Time asked = robot.now;
    int left_out = 0;
    // A stall every 61 ms.
    for (int k = 0; !robot.ended() && k < 20'000; ++k) {
      const bool late = k % 61 < late_ms;  // no multiple of the SYNC period: every phase comes
      left_out += late ? 1 : 0;
      robot.tick(!late);
    }
    const sup::RobotState& state = robot.cycle.state();
    EXPECT_EQ(state.command.state, CommandState::done) << describe(state.command.failure);
    EXPECT_EQ(state.activity, Activity::holding);
    EXPECT_NEAR(state.nodes[0].measured.position_rad, 0.3, 5e-3);
    EXPECT_EQ(state.missed, left_out);
    // Left out, not made up for later: the motion took the time it was planned to take.
    EXPECT_LT(robot.now - asked, motion.duration() + milliseconds(30 + late_ms));
    EXPECT_EQ(state.nodes[0].fault, 0);
  }
}

// Long enough and the modules stop by their own watchdogs; the command then says so by name, and reset leads back.
TEST(DaemonCycle, ALongStallEndsInANamedResult) {
  Robot robot;
  ASSERT_TRUE(robot.enable());
  const sup::JointTrajectory motion = robot.motion(0, 0.5, 0.3);
  ASSERT_EQ(robot.ask({.kind = sup::RequestKind::move, .motion = &motion}).refusal, sup::Refusal::none);
  for (int k = 0; k < 300; ++k) robot.tick();
  for (int k = 0; k < 1000; ++k) robot.tick(false);
  ASSERT_TRUE(robot.run_until([&] { return robot.ended(); }));
  EXPECT_EQ(robot.cycle.state().command.state, CommandState::failed);
  EXPECT_TRUE(robot.cycle.state().command.failure == sup::CommandFailure::joint_fault ||
              robot.cycle.state().command.failure == sup::CommandFailure::not_following)
      << describe(robot.cycle.state().command.failure);
  EXPECT_LT(robot.cycle.state().nodes[0].measured.position_rad, 0.45) << "it went on by itself";
  for (int k = 0; k < 500; ++k) robot.tick();
  if (robot.cycle.state().activity == Activity::faulted) {
    EXPECT_NE(robot.cycle.state().nodes[0].fault, 0);
    (void)robot.ask({.kind = sup::RequestKind::reset});
  }
  EXPECT_TRUE(robot.run_until([&] { return robot.cycle.state().activity == Activity::holding; }));
}

TEST(DaemonService, EnablesMovesHammersAndDisablesForAClient) {
  mrr::test::TemporaryFolder folder;
  Robot robot;
  sup::LogBook log(spdlog::level::off);
  rpc::Server server(folder / "supervisor.sock");
  sup::ServiceOptions options;
  options.can = "memory";
  sup::Service service(
      robot.robot, options, robot.cycle,
      [&](const sup::Request& request) { return std::optional(robot.cycle.carry_out(request)); }, log);
  service.attach(server);
  service.set_clock_running(true);
  std::atomic<bool> stop{false};
  std::thread loop([&] {
    while (!stop.load()) {
      robot.tick();
      service.step();
      server.serve();
    }
  });

  const auto failure = [&]() -> std::string {
    rpc::Client client(folder / "supervisor.sock");
    constexpr std::chrono::seconds kPatience(60);
    (void)client.call("subscribe", rpc::Json::object(), kPatience);
    const auto done = [&](const char* method, const rpc::Json& params = rpc::Json::object()) -> std::string {
      const auto number = client.call(method, params, kPatience)["command"];
      while (true) {
        const auto event = client.next_event(kPatience);
        if (!event) return "no event";
        if ((*event)["kind"] != "command" || (*event)["value"] != number) continue;
        return (*event)["state"] == "done" ? "" : (*event)["text"].get<std::string>();
      }
    };
    for (int k = 0; k < 10'000; ++k) {
      const auto status = client.call("status", rpc::Json::object(), kPatience);
      if (status["joints"][2]["stage"] == "idle") break;
    }
    if (auto why = done("enable"); !why.empty()) return why;
    if (auto why = done("move", {{"positions_rad", {0.1, nullptr, nullptr}}, {"speed", 0.8}}); !why.empty()) return why;
    const auto status = client.call("status", rpc::Json::object(), kPatience);
    if (std::abs(status["joints"][0]["position_rad"].get<double>() - 0.1) > 5e-3) return status.dump();
    try {
      (void)client.call("move", {{"positions_rad", {9, nullptr, nullptr}}}, kPatience);
      return "9 rad was not refused";
    } catch (const rpc::Error&) {
    }
    // Letting go of all joints in the middle of a swing ends the job too.
    (void)client.call("hammer", {{"swings", 1}}, kPatience);
    bool swings = false;
    for (int k = 0; k < 10'000 && !swings; ++k) {
      swings = client.call("status", rpc::Json::object(), kPatience)["activity"] == "approaching";
    }
    if (!swings) return "the job never began to swing";
    if (auto why = done("disable"); !why.empty()) return why;
    rpc::Json job;
    for (int k = 0; k < 1'000; ++k) {
      job = client.call("job", rpc::Json::object(), kPatience);
      if (job["state"] == "done") break;
    }
    return job["state"] == "done" && job["verdict"] == "swing_aborted" ? "" : job.dump();
  };
  std::string why;
  try {
    why = failure();
  } catch (const std::exception& error) {
    why = error.what();
  }
  stop = true;
  loop.join();
  EXPECT_EQ(why, "");
  service.shut_down("the test is over");
  for (int k = 0; k < 1000 && !service.is_down(); ++k) {
    robot.tick();
    service.step();
  }
  EXPECT_TRUE(service.is_down());
}

}  // namespace
}  // namespace mrr::sim::test
