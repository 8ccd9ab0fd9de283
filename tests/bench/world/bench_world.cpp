// How fast the world runs, and what one step of each core costs. The cost of steps is a distribution, not an average,
// so it is measured in jobs and printed as a table after the benchmarks.

#include <benchmark/benchmark.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "module_fw/targets/host/module_config.h"
#include "sim_vcan/world/hammer_job.h"

namespace {

using namespace mrr;  // NOLINT: a program of its own

const std::filesystem::path kRobots = std::filesystem::path(MRR_SOURCE_DIR) / "robots";
constexpr const char* kBoard = "hardwood";
constexpr Duration kTick = milliseconds(1);

const char* robot_name(std::int64_t joints) { return joints == 3 ? "mrr3" : "arm7"; }

sim::PlantDescription plant_of(const RobotDescription& robot) {
  return sim::load_plant(robot, kRobots / "boards" / (std::string(kBoard) + ".yaml"));
}

std::vector<double> park_of(const RobotDescription& robot) {
  std::vector<double> park;
  for (const JointDescription& joint : robot.joints) park.push_back(joint.park_rad);
  return park;
}

/// Whole jobs, planning included, nothing recorded.
void whole_job(benchmark::State& state) {
  const RobotDescription robot = load_robot(kRobots / robot_name(state.range(0)));
  const sim::PlantDescription plant = plant_of(robot);
  double simulated_s = 0.0;
  std::uint64_t seed = 0;
  while (state.KeepRunning()) {
    sim::HammerJobOptions options;
    options.world.seed = ++seed;
    options.session.seed = seed;
    simulated_s += sim::run_hammer_job(robot, plant, options).simulated_s;
  }
  state.counters["simulated_s_per_s"] = benchmark::Counter(simulated_s, benchmark::Counter::kIsRate);
}
BENCHMARK(whole_job)->ArgName("joints")->Arg(3)->Arg(7)->Unit(benchmark::kMillisecond);

/// The physics alone, motors off.
void plant_substep(benchmark::State& state) {
  const RobotDescription robot = load_robot(kRobots / robot_name(state.range(0)));
  sim::Plant plant(robot, plant_of(robot), 1);
  plant.reset(park_of(robot), robot.task.nail_height_m);
  while (state.KeepRunning()) plant.step(sim::kPlantSubstep);
}
BENCHMARK(plant_substep)->ArgName("joints")->Arg(3)->Arg(7);

using Clock = std::chrono::steady_clock;

class Costs {
 public:
  template <typename Work>
  void measure(Work&& work) {
    const Clock::time_point began = Clock::now();
    work();
    ns_.push_back(std::chrono::nanoseconds(Clock::now() - began).count());
  }
  void print(const char* what, int joints) {
    std::sort(ns_.begin(), ns_.end());
    std::printf("  %-16s %6d %9zu %9lld %9lld %9lld %9lld\n", what, joints, ns_.size(), at(0.5), at(0.99), at(0.999),
                at(1.0));
  }
  [[nodiscard]] std::size_t size() const { return ns_.size(); }

 private:
  [[nodiscard]] long long at(double share) const {
    return ns_[static_cast<std::size_t>(share * static_cast<double>(ns_.size() - 1))];
  }
  std::vector<long long> ns_;
};

struct StepCosts {
  Costs module, supervisor, plant, wire;
};

/// One job in a world of its own, whose clocks are all the same, so that each core can be measured by itself.
void measure_job(const RobotDescription& robot, std::uint64_t seed, StepCosts& costs) {
  const int dof = robot.dof();
  sim::Plant plant(robot, plant_of(robot), seed);
  plant.reset(park_of(robot), robot.task.nail_height_m);
  sim::Bus bus({.ports = dof + 1, .queue_capacity = 64});
  sup::SupervisorConfig config;
  std::vector<std::unique_ptr<fw::Module>> modules;
  for (int i = 0; i < dof; ++i) {
    const fw::ModuleConfig module = fw::module_config(robot, i);
    config.configuration_hash[static_cast<std::size_t>(i)] = module.configuration_hash;
    modules.push_back(std::make_unique<fw::Module>(module));
  }
  sup::Supervisor supervisor(robot, config);
  sup::SessionOptions options;
  options.seed = seed;
  sup::HammerSession session(robot, supervisor, options);
  std::vector<StaticVector<can::ReceivedFrame, 256>> inbox(static_cast<std::size_t>(dof) + 1);
  can::TransmitQueue tx;
  const auto send = [&](int port, Time now) {
    for (const can::Frame& frame : tx) (void)bus.send(port, frame, now);
    tx.clear();
  };
  constexpr Duration kLongest = milliseconds(120'000);
  for (Time now; now < Time{} + kLongest; now += kTick) {
    costs.plant.measure([&] { plant.step(kTick); });
    costs.wire.measure([&] {
      bus.advance(now, [&](const sim::Delivery& delivery) {
        for (int port = 0; port <= dof; ++port) {
          if (delivery.reaches(port))
            (void)inbox[static_cast<std::size_t>(port)].push_back({delivery.frame, delivery.at});
        }
      });
    });
    for (int i = 0; i < dof; ++i) {
      auto& mail = inbox[static_cast<std::size_t>(i) + 1];
      const fw::RawSensors sensors = plant.sample(i);
      fw::ActuatorCommand command;
      costs.module.measure([&] {
        modules[static_cast<std::size_t>(i)]->step(now, sensors, {mail.data(), mail.size()}, command, tx);
      });
      mail.clear();
      plant.set_actuator(i, command);
      send(i + 1, now);
    }
    costs.supervisor.measure([&] { supervisor.step(now, {inbox[0].data(), inbox[0].size()}, tx); });
    inbox[0].clear();
    send(0, now);
    supervisor.events().clear();
    if (session.step(now)) break;
  }
  if (session.swings().empty()) std::printf("  (no swing was made: %s)\n", session.reason().c_str());
}

void print_step_costs() {
  Costs clock;
  for (int i = 0; i < 100'000; ++i) clock.measure([] {});
  std::printf("\nOne step in jobs on %s, ns; plant and wire: of 1 ms. Reading the clock is in all figures.\n", kBoard);
  std::printf("  %-16s %6s %9s %9s %9s %9s %9s\n", "", "joints", "steps", "median", "p99", "p99.9", "max");
  clock.print("nothing (clock)", 0);
  for (const int joints : {3, 7}) {
    const RobotDescription robot = load_robot(kRobots / robot_name(joints));
    StepCosts costs;
    constexpr std::size_t kModuleSteps = 100'000;
    for (std::uint64_t seed = 1; costs.module.size() < kModuleSteps && seed < 50; ++seed) {
      measure_job(robot, seed, costs);
    }
    costs.module.print("module.step", joints);
    costs.supervisor.print("supervisor.step", joints);
    costs.plant.print("plant.step", joints);
    costs.wire.print("wire.advance", joints);
  }
}

}  // namespace

int main(int argc, char** argv) {
  benchmark::Initialize(&argc, argv);
  if (benchmark::ReportUnrecognizedArguments(argc, argv)) return 1;
  benchmark::RunSpecifiedBenchmarks();
  benchmark::Shutdown();
  print_step_costs();
}
