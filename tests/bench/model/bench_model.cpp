// Kinematics and dynamics beside Orocos KDL on the same arms and states.
// KDL is called through KdlReference: its conversion to Eigen, and what it allocates, are in its figures.

#include <benchmark/benchmark.h>

#include <array>
#include <filesystem>

#include "common/core/random.h"
#include "supervisor/impact/external.h"
#include "supervisor/model/chain.h"
#include "supervisor/model/kdl_reference.h"

namespace {

using namespace mrr;  // NOLINT: a program of its own

/// An arm and states to go round, so that nothing is computed twice from the same numbers.
struct Case {
  explicit Case(std::int64_t joints)
      : robot(load_robot(std::filesystem::path(MRR_SOURCE_DIR) / "robots" / (joints == 3 ? "mrr3" : "arm7"))),
        chain(robot),
        kdl(robot) {
    Random random(1, static_cast<std::uint64_t>(joints));
    const auto draw = [&] {
      sup::JointVector v(robot.dof());
      for (double& x : v) x = random.uniform(-1.0, 1.0);
      return v;
    };
    for (std::size_t i = 0; i < kStates; ++i) {
      q[i] = draw();
      qd[i] = draw();
      qdd[i] = draw();
    }
  }
  std::size_t next() { return at = (at + 1) % kStates; }

  static constexpr std::size_t kStates = 64;
  RobotDescription robot;
  sup::Chain chain;
  sup::KdlReference kdl;
  std::array<sup::JointVector, kStates> q, qd, qdd;
  std::size_t at = 0;
};

template <typename Work>
void on_states(benchmark::State& state, Work&& work) {
  Case arm(state.range(0));
  while (state.KeepRunning()) benchmark::DoNotOptimize(work(arm, arm.next()));
}

void face_pose(benchmark::State& state) {
  on_states(state, [](Case& arm, std::size_t i) { return arm.chain.face_pose(arm.q[i]); });
}
void face_pose_kdl(benchmark::State& state) {
  on_states(state, [](Case& arm, std::size_t i) { return arm.kdl.face_pose(arm.q[i]); });
}
void jacobian(benchmark::State& state) {
  on_states(state, [](Case& arm, std::size_t i) { return arm.chain.jacobian(arm.q[i]); });
}
void jacobian_kdl(benchmark::State& state) {
  on_states(state, [](Case& arm, std::size_t i) { return arm.kdl.jacobian(arm.q[i]); });
}
void mass_matrix(benchmark::State& state) {
  on_states(state, [](Case& arm, std::size_t i) { return arm.chain.mass_matrix(arm.q[i]); });
}
void mass_matrix_kdl(benchmark::State& state) {
  on_states(state, [](Case& arm, std::size_t i) { return arm.kdl.mass_matrix(arm.q[i]); });
}
void inverse_dynamics(benchmark::State& state) {
  on_states(state,
            [](Case& arm, std::size_t i) { return arm.chain.inverse_dynamics(arm.q[i], arm.qd[i], arm.qdd[i]); });
}
void inverse_dynamics_kdl(benchmark::State& state) {
  on_states(state, [](Case& arm, std::size_t i) { return arm.kdl.inverse_dynamics(arm.q[i], arm.qd[i], arm.qdd[i]); });
}
void predict(benchmark::State& state) {
  on_states(state, [](Case& arm, std::size_t i) {
    sup::ImpactInput input;
    input.q = arm.q[i];
    input.qd = arm.qd[i];
    return sup::predict(arm.chain, input);
  });
}

BENCHMARK(face_pose)->ArgName("joints")->Arg(3)->Arg(7);
BENCHMARK(face_pose_kdl)->ArgName("joints")->Arg(3)->Arg(7);
BENCHMARK(jacobian)->ArgName("joints")->Arg(3)->Arg(7);
BENCHMARK(jacobian_kdl)->ArgName("joints")->Arg(3)->Arg(7);
BENCHMARK(mass_matrix)->ArgName("joints")->Arg(3)->Arg(7);
BENCHMARK(mass_matrix_kdl)->ArgName("joints")->Arg(3)->Arg(7);
BENCHMARK(inverse_dynamics)->ArgName("joints")->Arg(3)->Arg(7);
BENCHMARK(inverse_dynamics_kdl)->ArgName("joints")->Arg(3)->Arg(7);
BENCHMARK(predict)->ArgName("joints")->Arg(3)->Arg(7);

}  // namespace
