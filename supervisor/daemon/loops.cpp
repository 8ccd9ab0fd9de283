#include "supervisor/daemon/loops.h"

#include <fmt/format.h>
#include <pthread.h>

#include <csignal>

#include "can_protocol/client.h"
#include "common/realtime/realtime.h"
#include "common/robot/errors.h"

namespace mrr::sup {

namespace {

constexpr Duration kListen = milliseconds(150);       // three heartbeats of a supervisor
constexpr Duration kAnswerTime = milliseconds(500);   // far more than a cycle, even on a busy machine
constexpr Duration kClockCheck = milliseconds(1000);  // the system's time may be stepped: look again
constexpr Duration kPlantSilence = milliseconds(1000);
constexpr std::uint32_t kNodeIdMask = 0x07F;
/// A cycle's work is timed now and then only: reading the clock is dear in some virtual machines.
constexpr std::int64_t kTimedTicks = 16;

can::CanSocket open_socket(const RobotDescription& robot, const std::string& interface) {
  StaticVector<can::CanFilter, kMaxJoints + 1> filters;
  (void)filters.push_back({can::kHeartbeatCobId + can::kSupervisorNodeId});
  for (const JointDescription& joint : robot.joints) (void)filters.push_back({joint.node_id, kNodeIdMask});
  return can::CanSocket::open(interface, {.filters = {filters.data(), filters.size()}});
}

}  // namespace

SocketBus::SocketBus(const RobotDescription& robot, const std::string& interface)
    : socket_(open_socket(robot, interface)) {}

BusHealth SocketBus::health() const noexcept {
  const can::CanSocketStatistics& s = socket_.statistics();
  return {socket_.link_down(), socket_.bus_off(), s.received, s.sent, s.send_dropped, s.receive_overflow};
}

bool SocketBus::another_supervisor() {
  const Time end = can::monotonic_now() + kListen;
  for (Time now = can::monotonic_now(); now < end; now = can::monotonic_now()) {
    for (const can::ReceivedFrame& received : socket_.receive(end - now)) {
      const auto heartbeat = can::parse_heartbeat(received.frame);
      if (heartbeat && heartbeat->node_id == can::kSupervisorNodeId) return true;
    }
  }
  return false;
}

// ---------------------------------------------------------------------------------------------- real time

RealtimeLoop::RealtimeLoop(Cycle& cycle, SocketBus& bus, Duration period) : cycle_(cycle), bus_(bus), period_(period) {
  const std::string memory = realtime::lock_memory();
  granted_.memory = memory.empty();
  thread_ = std::thread([this] { run(); });
  while (!started_.load(std::memory_order_acquire)) std::this_thread::yield();
  granted_.scheduling = priority_error_ == 0;
  granted_.refused = realtime::joined(memory, realtime::describe_priority(priority_error_));
}

RealtimeLoop::~RealtimeLoop() {
  stop_.store(true, std::memory_order_relaxed);
  thread_.join();
}

void RealtimeLoop::run() noexcept {
  sigset_t all;
  sigfillset(&all);
  ::pthread_sigmask(SIG_SETMASK, &all, nullptr);
  priority_error_ = realtime::take_priority(realtime::kSupervisorPriority);
  started_.store(true, std::memory_order_release);

  StaticVector<can::ReceivedFrame, 512> inbox;
  bus_.socket().discard_received();
  Time scheduled = can::monotonic_now();
  Time clock_checked = scheduled;
  std::int64_t cycles = 0;
  while (!stop_.load(std::memory_order_relaxed)) {
    scheduled += period_;
    realtime::sleep_until(scheduled);
    const Time woke = can::monotonic_now();
    cycle_.count_late(woke - scheduled);
    const std::int64_t missed = (woke - scheduled) / period_;
    if (missed > 0) cycle_.count_missed(missed);
    scheduled += period_ * missed;

    inbox.clear();
    for (bool more = true; more && inbox.capacity() - inbox.size() >= can::CanSocket::kBatch;) {
      const std::span<const can::ReceivedFrame> frames = bus_.receive();
      for (const can::ReceivedFrame& frame : frames) (void)inbox.push_back(frame);
      more = frames.size() == can::CanSocket::kBatch;
    }
    cycle_.step(scheduled, {inbox.data(), inbox.size()});
    if (woke - clock_checked > kClockCheck) {
      bus_.socket().measure_clock_offset();
      clock_checked = woke;
    }
    if (++cycles % kTimedTicks == 0) cycle_.count_work(can::monotonic_now() - woke);
  }
}

std::optional<Answer> RealtimeLoop::call(const Request& request) {
  Mailbox<Request, Answer>& mailbox = cycle_.mailbox();
  mailbox.ask(request);
  const Time end = can::monotonic_now() + kAnswerTime;
  Answer answer;
  while (!mailbox.replied(answer)) {
    // Withdrawn or answered, never both: what the request points at may go afterwards.
    if (can::monotonic_now() > end && mailbox.withdraw()) return std::nullopt;
    std::this_thread::sleep_for(std::chrono::microseconds(200));
  }
  return answer;
}

// ---------------------------------------------------------------------------------------------- lockstep

LockstepLoop::LockstepLoop(Cycle& cycle, SocketBus& bus, const std::string& plant)
    : cycle_(cycle), bus_(bus), plant_(plant), link_(plant, plant_io::kSupervisor) {}

void LockstepLoop::run_once(Service& service, Duration timeout, bool leaving) {
  const std::optional<plant_io::OwnTick> tick = link_.wait(timeout);
  if (!tick) {
    if (can::monotonic_now() - last_tick_ > kPlantSilence) {
      service.set_clock_running(false);
      // What is said while time stands still must not come as new when it goes on.
      link_.forget();
      bus_.socket().discard_received();
    }
    return;
  }
  if (!tick->lockstep) {
    throw DescriptionError(
        fmt::format("--plant {}: the plant there runs on the wall clock; start it with --lockstep, "
                    "or the supervisor without --plant",
                    plant_));
  }
  const bool timed = ticks_++ % kTimedTicks == 0;
  const std::span<const can::ReceivedFrame> frames = link_.robot_frames(bus_.socket(), *tick);
  const Time before = timed ? can::monotonic_now() : Time{};
  cycle_.step(tick->now, frames);
  if (timed) {
    last_tick_ = can::monotonic_now();
    cycle_.count_work(last_tick_ - before);
  }
  service.set_clock_running(true);
  service.step();
  const Supervisor& supervisor = cycle_.supervisor();
  link_.answer(*tick,
               plant_io::encode(plant_io::SupervisorTelemetry{static_cast<std::uint8_t>(supervisor.activity()),
                                                              static_cast<std::uint16_t>(cycle_.recorded_swing()),
                                                              static_cast<float>(supervisor.observer().force_n())}),
               leaving);
  if (tick->ending) {
    link_.forget();
    service.set_clock_running(false);
  }
}

}  // namespace mrr::sup
