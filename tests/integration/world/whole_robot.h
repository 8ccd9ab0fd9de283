// The whole robot for tests: the example arms, the boards, jobs in the world, and what a test may do to them.
#pragma once

#include <gtest/gtest.h>

#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "common/robot/robot.h"
#include "sim_vcan/world/hammer_job.h"

namespace mrr::sim::test {

inline const std::filesystem::path kRobots = std::filesystem::path(MRR_SOURCE_DIR) / "robots";

inline RobotDescription example(const char* name) { return load_robot(kRobots / name); }

inline PlantDescription plant_on(const RobotDescription& robot, const std::string& board) {
  return load_plant(robot, kRobots / "boards" / (board + ".yaml"));
}

inline HammerJobOptions seeded(std::uint64_t seed) {
  HammerJobOptions options;
  options.world.seed = seed;
  options.session.seed = seed;
  return options;
}

inline HammerJobResult hammer(const RobotDescription& robot, const std::string& board, const HammerJobOptions& options,
                              const std::function<void(World&)>& prepare = {}) {
  return run_hammer_job(robot, plant_on(robot, board), options, nullptr, nullptr, {}, prepare);
}

/// A world at rest in its park position, for tests that look on after the session's end.
inline void put_to_rest(World& world) {
  std::vector<double> park;
  for (const JointDescription& joint : world.robot().joints) park.push_back(joint.park_rad);
  world.reset(park, world.robot().task.nail_height_m);
}

inline int count(const std::vector<sup::Event>& events, sup::EventKind kind) {
  int n = 0;
  for (const sup::Event& event : events) n += event.kind == kind ? 1 : 0;
  return n;
}

/// A robot at rest in its world, step by step, so that a test may interfere. Events are kept.
class WatchedWorld {
 public:
  explicit WatchedWorld(const RobotDescription& robot, const std::string& board = "styrofoam", std::uint64_t seed = 1)
      : robot_(robot), world_(robot_, plant_on(robot_, board), seeded(seed).world) {
    put_to_rest(world_);
  }
  WatchedWorld(const WatchedWorld&) = delete;
  WatchedWorld& operator=(const WatchedWorld&) = delete;
  virtual ~WatchedWorld() = default;

  [[nodiscard]] sup::Supervisor& supervisor() { return world_.supervisor(); }
  /// One instant; true if the supervisor stepped.
  bool step() {
    world_.step();
    if (!world_.supervisor_stepped()) return false;
    for (const sup::Event& event : supervisor().events()) events_.push_back(event);
    supervisor().events().clear();
    supervisor_stepped();
    return true;
  }
  template <typename Condition>
  [[nodiscard]] bool run_until(Condition&& condition, Duration limit = milliseconds(20'000)) {
    const Time end = world_.now() + limit;
    while (world_.now() < end) {
      if (step() && condition()) return true;
    }
    return false;
  }
  void run_for(Duration time) {
    const Time end = world_.now() + time;
    while (world_.now() < end) step();
  }

  const RobotDescription robot_;
  World world_;
  std::vector<sup::Event> events_;

 private:
  virtual void supervisor_stepped() {}
};

/// mrr3 on foam with no session: the test is the one who asks.
class WatchedRobot : public testing::Test, protected WatchedWorld {
 protected:
  WatchedRobot() : WatchedWorld(example("mrr3")) {}
};

inline bool planned_passive(const sup::StrikePlan& plan, std::size_t joint) {
  return ((plan.passive >> joint) & 1U) != 0;
}

}  // namespace mrr::sim::test
