// Room: supervisor/daemon. The two ways to make cycles on a real bus: on the wall clock in a real-time thread, or in
// lockstep with the plant. May touch can_protocol/socketcan, can_protocol/plant_io and this room.
#pragma once

#include <atomic>
#include <optional>
#include <string>
#include <thread>

#include "can_protocol/plant_io/plant_link.h"
#include "can_protocol/socketcan/can_socket.h"
#include "supervisor/daemon/cycle.h"
#include "supervisor/daemon/service.h"

namespace mrr::sup {

/// The robot's bus as a socket: whatever has the node id of one of its joints, and the heartbeats of other supervisors.
class SocketBus final : public BusPort {
 public:
  /// Throws can::CanError.
  SocketBus(const RobotDescription& robot, const std::string& interface);
  [[nodiscard]] std::span<const can::ReceivedFrame> receive() noexcept override { return socket_.receive(); }
  std::size_t send(std::span<const can::Frame> frames) noexcept override { return socket_.send(frames); }
  [[nodiscard]] BusHealth health() const noexcept override;
  [[nodiscard]] can::CanSocket& socket() noexcept { return socket_; }
  /// Listens for a moment: is there another supervisor?
  [[nodiscard]] bool another_supervisor();

 private:
  can::CanSocket socket_;
};

/// Cycles on CLOCK_MONOTONIC in a thread of their own, absolute times, a step each millisecond.
class RealtimeLoop {
 public:
  struct Granted {
    bool scheduling = false;
    bool memory = false;
    std::string refused;  ///< what was not granted and why; empty: everything
  };
  /// Locks memory and starts the thread.
  RealtimeLoop(Cycle& cycle, SocketBus& bus, Duration period);
  ~RealtimeLoop();
  RealtimeLoop(const RealtimeLoop&) = delete;
  RealtimeLoop& operator=(const RealtimeLoop&) = delete;

  /// Known once the constructor is done.
  [[nodiscard]] const Granted& granted() const noexcept { return granted_; }
  /// For Service: waits for the answer of the next cycle.
  [[nodiscard]] std::optional<Answer> call(const Request& request);

 private:
  void run() noexcept;

  Cycle& cycle_;
  SocketBus& bus_;
  Duration period_;
  Granted granted_;
  int priority_error_ = 0;
  std::atomic<bool> started_{false};
  std::atomic<bool> stop_{false};
  std::thread thread_;
};

/// Cycles when the plant says so. Everything in one thread, planning included: the clock waits.
class LockstepLoop {
 public:
  /// Throws can::CanError.
  LockstepLoop(Cycle& cycle, SocketBus& bus, const std::string& plant);
  /// Leaves, unless that was done with the last tick: the plant waits for nobody who is gone.
  ~LockstepLoop() { link_.leave(); }
  LockstepLoop(const LockstepLoop&) = delete;
  LockstepLoop& operator=(const LockstepLoop&) = delete;

  /// One tick of the plant with everything that belongs to it; waits for it up to `timeout`. `leaving`: the plant shall
  /// go on without. Throws DescriptionError if the plant is no lockstep plant.
  void run_once(Service& service, Duration timeout, bool leaving);

 private:
  Cycle& cycle_;
  SocketBus& bus_;
  std::string plant_;
  plant_io::PlantLink link_;
  Time last_tick_;
  std::int64_t ticks_ = 0;
};

}  // namespace mrr::sup
