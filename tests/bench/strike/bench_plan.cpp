// What planning a blow costs, whole and in parts: all inverse-kinematics branches, every selection matrix, speeds, and
// trajectories with their torques checked.

#include <benchmark/benchmark.h>

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <vector>

#include "supervisor/impact/selection.h"
#include "supervisor/strike/planner.h"

namespace {

using namespace mrr;  // NOLINT: a program of its own

/// An example robot with its nail, asked to strike from where it rests.
struct Case {
  explicit Case(std::int64_t joints)
      : robot(load_robot(std::filesystem::path(MRR_SOURCE_DIR) / "robots" / (joints == 3 ? "mrr3" : "arm7"))),
        chain(robot) {
    const TaskDescription& task = robot.task;
    request.normal = task.normal;
    request.head_position_m = task.nail_position_m + task.nail_height_m * task.normal;
    request.board_distance_m = task.nail_height_m;
    request.contact_duration_s = task.assumed_contact_s;
    request.start = sup::JointVector(robot.dof());
    for (int i = 0; i < robot.dof(); ++i) request.start[i] = robot.joints[static_cast<std::size_t>(i)].park_rad;
  }
  RobotDescription robot;
  sup::Chain chain;
  sup::PlanInput request;
};

/// Besides the mean, which whoever else runs on the machine spoils: the shortest, the median and the 99th percentile.
void complete_plan(benchmark::State& state) {
  Case arm(state.range(0));
  std::vector<double> ms;
  while (state.KeepRunning()) {
    ++arm.request.seed;  // no two plans begin their searches alike
    const auto begin = std::chrono::steady_clock::now();
    benchmark::DoNotOptimize(sup::plan(arm.robot, arm.chain, arm.request));
    ms.push_back(std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - begin).count());
  }
  std::sort(ms.begin(), ms.end());
  const auto at = [&](double share) {
    return ms[static_cast<std::size_t>(share * static_cast<double>(ms.size() - 1))];
  };
  state.counters["shortest_ms"] = at(0.0);
  state.counters["median_ms"] = at(0.5);
  state.counters["p99_ms"] = at(0.99);
}

void inverse_kinematics(benchmark::State& state) {
  const Case arm(state.range(0));
  sup::FaceTarget target;
  target.position_m = arm.request.head_position_m;
  target.normal = arm.request.normal;
  target.max_tilt_rad = arm.robot.hammer.max_tilt_rad;
  target.max_lateral_m = 0.25 * arm.robot.hammer.face_radius_m;
  sup::IkOptions options;
  while (state.KeepRunning()) {
    ++options.seed;
    benchmark::DoNotOptimize(sup::solve_face_on_point(arm.robot, arm.chain, target, arm.request.start, options));
  }
}

/// Axis impulses of all joints under all 2^n selections, from the pose on.
void every_selection(benchmark::State& state) {
  const Case arm(state.range(0));
  const int n = arm.robot.dof();
  sup::JointVector q = sup::JointVector::LinSpaced(n, 0.1, 0.7);
  std::array<double, kMaxJoints> extra{};
  extra.fill(0.9);
  while (state.KeepRunning()) {
    q[0] += 1e-9;
    const sup::SelectionSweep sweep(arm.chain, arm.chain.pose(q), Eigen::Vector3d::UnitZ(), extra);
    double worst = 0.0;
    sweep.for_each((1U << n) - 1U, 0, [&](const sup::SelectionBlow& blow) {
      for (const double load : blow.axis_nm_s_per_n_s) worst = std::max(worst, std::abs(load));
    });
    benchmark::DoNotOptimize(worst);
  }
}

BENCHMARK(complete_plan)->ArgName("joints")->Arg(3)->Arg(7)->Unit(benchmark::kMillisecond);
BENCHMARK(inverse_kinematics)->ArgName("joints")->Arg(3)->Arg(7)->Unit(benchmark::kMillisecond);
BENCHMARK(every_selection)->ArgName("joints")->Arg(3)->Arg(7)->Unit(benchmark::kMicrosecond);

}  // namespace
