// Room: supervisor/daemon. The real-time side: the supervisor's core on a bus, requests in, events, rows and state out.
// May touch the supervisor's core, can_protocol and common. step(): no heap, no lock, no log.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <span>

#include "common/robot/robot.h"
#include "supervisor/daemon/latency.h"
#include "supervisor/daemon/spsc_queue.h"
#include "supervisor/supervisor.h"

namespace mrr::sup {

struct BusHealth {
  bool down = false;     ///< the interface is down or gone
  bool bus_off = false;  ///< the controller has left the bus
  std::int64_t received = 0;
  std::int64_t sent = 0;
  std::int64_t not_sent = 0;  ///< not taken by the kernel
  std::int64_t lost = 0;      ///< arrived, but not read in time
};

/// What the cycle needs of a CAN bus: a socket, or something in its place in tests.
class BusPort {
 public:
  virtual ~BusPort() = default;
  /// Some of what has arrived, oldest first; empty: nothing is left. Valid until the next call. Never waits.
  [[nodiscard]] virtual std::span<const can::ReceivedFrame> receive() noexcept = 0;
  /// Returns how many were taken; the others are dropped: nothing stale may ever move the robot.
  virtual std::size_t send(std::span<const can::Frame> frames) noexcept = 0;
  [[nodiscard]] virtual BusHealth health() const noexcept = 0;
};

enum class RequestKind : std::uint8_t { enable, disable, stop, reset, home, move, passive, active, calibrate, execute };

struct Request {
  RequestKind kind{};
  int joint = -1;
  const JointTrajectory* motion = nullptr;  ///< of move; stays valid until it was answered
  const StrikePlan* plan = nullptr;         ///< of execute
  CalibrationSettings calibration{};
};

struct Answer {
  Refusal refusal = Refusal::none;
  std::uint32_t command = 0;  ///< number
};

/// The robot at the end of a cycle.
struct RobotState {
  Time now;
  std::int64_t cycles = 0;  ///< 0: none yet
  Activity activity = Activity::disabled;
  std::array<NodeReport, kMaxJoints> nodes{};
  JointMotion reference;
  SwingOutcome outcome;
  CommandStatus command;
  CalibrationReport calibration;
  std::uint32_t let_go = 0;
  double force_n = 0.0;  ///< estimated at the face
  BusHealth bus;
  std::int64_t missed = 0;  ///< cycles left out because the process was late
  std::uint32_t dropped_events = 0;
};

/// One step of a recording.
struct RecordRow {
  double time_s = 0.0;
  int swing = 0;
  Activity activity{};
  double force_n = 0.0;
  struct Joint {
    double reference_rad = 0.0, position_rad = 0.0, reference_velocity_rad_s = 0.0, velocity_rad_s = 0.0,
           torque_nm = 0.0;
    bool passive = false;
  };
  std::array<Joint, kMaxJoints> joints{};
};

class Cycle {
 public:
  /// Both must outlive this. Throws DescriptionError.
  Cycle(const RobotDescription& robot, const SupervisorConfig& config, BusPort& bus);

  /// One step. Frames as Supervisor::step() wants them.
  void step(Time now, std::span<const can::ReceivedFrame> received) noexcept;
  /// A cycle was left out, or began late, or took so long.
  void count_missed(std::int64_t cycles) noexcept { missed_ += cycles; }
  void count_late(Duration late) noexcept { late_.add(late); }
  void count_work(Duration work) noexcept { work_.add(work); }

  /// Carries out a request at once and shows its effect: for whoever runs the cycle himself.
  [[nodiscard]] Answer carry_out(const Request& request) noexcept;

  // The other side.
  /// A request for the next step; its answer comes after the state that shows its effect.
  [[nodiscard]] Mailbox<Request, Answer>& mailbox() noexcept { return mailbox_; }
  [[nodiscard]] bool next_event(Event& event) noexcept { return events_.pop(event); }
  [[nodiscard]] bool next_row(RecordRow& row) noexcept { return rows_.pop(row); }
  [[nodiscard]] const RobotState& state() noexcept { return state_.read(); }
  /// Swing that rows are numbered with, from 1; 0: no recording.
  void record(int swing) noexcept { recorded_swing_.store(swing, std::memory_order_relaxed); }
  [[nodiscard]] std::int64_t dropped_rows() const noexcept { return dropped_rows_.load(std::memory_order_relaxed); }
  [[nodiscard]] int recorded_swing() const noexcept { return recorded_swing_.load(std::memory_order_relaxed); }
  [[nodiscard]] const LatencyHistogram& late() const noexcept { return late_; }
  [[nodiscard]] const LatencyHistogram& work() const noexcept { return work_; }
  /// Constant from construction on.
  [[nodiscard]] const Chain& chain() const noexcept { return supervisor_.chain(); }
  /// Only from the thread that steps.
  [[nodiscard]] const Supervisor& supervisor() const noexcept { return supervisor_; }

 private:
  [[nodiscard]] Answer handle(const Request& request) noexcept;
  void publish() noexcept;
  void add_row() noexcept;

  int dof_;
  Supervisor supervisor_;
  BusPort& bus_;
  can::TransmitQueue tx_;
  Time now_;
  std::int64_t cycles_ = 0;
  std::int64_t missed_ = 0;
  std::uint32_t dropped_events_ = 0;
  Mailbox<Request, Answer> mailbox_;
  SpscQueue<Event, 1024> events_;
  SpscQueue<RecordRow, 1024> rows_;
  Latest<RobotState> state_;
  std::atomic<int> recorded_swing_{0};
  std::atomic<std::int64_t> dropped_rows_{0};
  LatencyHistogram late_;
  LatencyHistogram work_;
};

}  // namespace mrr::sup
