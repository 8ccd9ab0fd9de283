// Room: sim_vcan/world. Modules, supervisor, plant and wire on one virtual clock: one seed, one run.
// Uses everything but cli. Host only; no I/O, no real clock.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <vector>

#include "common/robot/robot.h"
#include "module_fw/module.h"
#include "sim_vcan/plant/plant.h"
#include "sim_vcan/wire/bus.h"
#include "supervisor/supervisor.h"

namespace mrr::sim {

struct WorldOptions {
  std::uint64_t seed = 1;
  double max_clock_drift_ppm = 50.0;            ///< of a module's clock against the supervisor's
  Duration max_boot_delay = milliseconds(100);  ///< modules start within this
  int queue_capacity = 64;                      ///< frames waiting per node
  sup::SupervisorConfig supervisor;             ///< the expected configuration hashes are filled in
  /// If given, changes what is flashed into a module; the supervisor expects what the description says (tests).
  std::function<void(int joint, fw::ModuleConfig&)> flash;
};

/// When the commanded torque of a joint became what, on the world's clock. ns < 0: not yet.
struct JointModeTrace {
  Time passive_since{-1};   ///< the blend into passive torque has ended
  Time selected_since{-1};  ///< the last selection came into force
};

/// The plant's own seed within a run's; 0 stays 0 (all nominal). The emulator process draws the same world from it.
[[nodiscard]] std::uint64_t plant_seed(std::uint64_t run_seed);

class World {
 public:
  World(const RobotDescription& robot, const PlantDescription& plant, const WorldOptions& options);

  /// Puts the robot at rest at `position_rad` and the nail's head `nail_height_m` above the board. Once, before run().
  void reset(std::span<const double> position_rad, double nail_height_m);

  /// Goes on to the next instant in which somebody acts.
  void step();
  [[nodiscard]] Time now() const noexcept { return now_; }
  /// True once after each step of the supervisor: sessions are stepped then.
  [[nodiscard]] bool supervisor_stepped() const noexcept { return supervisor_stepped_; }

  [[nodiscard]] sup::Supervisor& supervisor() noexcept { return *supervisor_; }
  [[nodiscard]] const sup::Supervisor& supervisor() const noexcept { return *supervisor_; }
  [[nodiscard]] const fw::Module& module(int joint) const noexcept { return *modules_[at(joint)].module; }
  [[nodiscard]] Plant& plant() noexcept { return plant_; }
  [[nodiscard]] const Plant& plant() const noexcept { return plant_; }
  [[nodiscard]] Bus& bus() noexcept { return bus_; }
  [[nodiscard]] const JointModeTrace& mode_trace(int joint) const noexcept { return modules_[at(joint)].trace; }
  [[nodiscard]] int dof() const noexcept { return dof_; }
  [[nodiscard]] const RobotDescription& robot() const noexcept { return robot_; }

  /// Called for each frame at the end of its last bit.
  std::function<void(const Delivery&)> on_frame;
  /// Called after each control tick of a module.
  std::function<void(int joint, Time, const fw::ModuleStatus&)> on_tick;

 private:
  using Inbox = StaticVector<can::ReceivedFrame, 256>;
  struct Node {
    std::unique_ptr<fw::Module> module;
    Inbox inbox;
    Time clock_offset;           // own clock at world time 0
    std::int64_t drift_ppb = 0;  // own clock runs this much faster
    Time first_tick;             // own clock
    std::int64_t ticks = 0;
    Time next_tick;   // world clock
    Duration period;  // own clock
    std::int64_t blend_seen_ns = 0;
    std::int64_t selection_seen_ns = 0;
    JointModeTrace trace;

    [[nodiscard]] Time local(Time world) const noexcept;
    [[nodiscard]] Time world(Time local) const noexcept;
  };
  static constexpr std::size_t at(int i) noexcept { return static_cast<std::size_t>(i); }
  void deliver(const Delivery& delivery);
  void tick_module(int joint);
  void step_supervisor();
  void send_all(int port);

  RobotDescription robot_;
  int dof_;
  Plant plant_;
  Bus bus_;
  std::vector<Node> modules_;
  std::unique_ptr<sup::Supervisor> supervisor_;
  Inbox supervisor_inbox_;
  Duration supervisor_period_;
  Time next_supervisor_step_;
  bool supervisor_stepped_ = false;
  can::TransmitQueue tx_;
  Time now_;
};

}  // namespace mrr::sim
