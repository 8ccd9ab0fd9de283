// mrr_plant_dump ROBOT_DIR [--time S] [--substep US] [--seed N] [--benchmark]
// Lets the arm swing without friction, motors and brakes, and prints what it is made of and how it moved, as JSON, for
// comparison with another simulator. With --benchmark: the cost of a substep instead, with everything switched on.
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <filesystem>
#include <string>

#include "common/core/random.h"
#include "sim_vcan/plant/plant.h"

namespace {

using mrr::sim::PerJoint;

void print_list(const char* name, const double* values, std::size_t count, const char* end) {
  std::printf("\"%s\": [", name);
  for (std::size_t i = 0; i < count; ++i) std::printf("%s%.17g", i == 0 ? "" : ", ", values[i]);
  std::printf("]%s", end);
}

void print_matrix(const char* name, const Eigen::Matrix3d& m, const char* end) {
  const Eigen::Matrix<double, 3, 3, Eigen::RowMajor> rows = m;
  print_list(name, rows.data(), 9, end);
}

int benchmark(const mrr::RobotDescription& robot) {
  mrr::sim::Plant plant(robot, mrr::sim::load_plant(robot, robot.source.parent_path() / "boards" / "styrofoam.yaml"),
                        1);
  const auto n = robot.joints.size();
  const PerJoint start{};
  plant.reset(std::span(start).first(n), robot.task.nail_height_m);
  double best_ns = 1e9;
  double sum_ns = 0.0;
  constexpr int kRounds = 50;
  constexpr int kMilliseconds = 100;
  for (int round = 0; round < kRounds; ++round) {
    for (std::size_t i = 0; i < n; ++i) {
      const auto duty = static_cast<std::int16_t>((round % 2 == 0 ? 1 : -1) * (2000 + 500 * static_cast<int>(i)));
      plant.set_actuator(static_cast<int>(i), {duty, true, true});
    }
    const auto begin = std::chrono::steady_clock::now();
    for (int k = 0; k < kMilliseconds; ++k) {
      for (std::size_t i = 0; i < n; ++i) (void)plant.sample(static_cast<int>(i));
      plant.step(mrr::milliseconds(1));
    }
    const std::chrono::duration<double, std::nano> spent = std::chrono::steady_clock::now() - begin;
    const double each = spent.count() / (kMilliseconds * 10);
    best_ns = std::min(best_ns, each);
    sum_ns += each;
  }
  std::printf(
      "%zu joints: %.0f ns per 100 us substep (best of %d rounds), %.0f ns on average, sensors included: %.0f x real "
      "time\n",
      n, best_ns, kRounds, sum_ns / kRounds, 1e5 / best_ns);
  return 0;
}

int dump(mrr::RobotDescription robot, double time_s, double substep_us, std::uint64_t seed) {
  robot.task.nail_position_m = {0.0, 0.0, -100.0};  // out of reach
  robot.gravity_m_s2 = {2.0, 1.0, -9.5};            // slanting, so that a vertical axis moves too
  mrr::sim::PlantDescription description = mrr::sim::default_plant(robot);
  for (std::size_t i = 0; i < robot.joints.size(); ++i) {
    auto& joint = description.joints[i];
    joint.friction = {};
    joint.drive.brake_torque_nm = 0.0;
    // One stiffness instead of three: what the other simulator can do.
    joint.spring.stiffness_nm_rad.fill(joint.spring.stiffness_nm_rad[0]);
  }
  description.stop_stiffness_nm_rad = description.stop_damping_nm_s_rad = 0.0;

  mrr::sim::Plant plant(robot, description, 0);
  const std::size_t n = robot.joints.size();
  mrr::Random random(seed, 99);
  PerJoint start{};
  for (std::size_t i = 0; i < n; ++i) start[i] = random.uniform(-1.0, 1.0);
  plant.reset(std::span(start).first(n), robot.task.nail_height_m);

  std::printf("{");
  print_list("gravity", robot.gravity_m_s2.data(), 3, ",\n \"joints\": [\n");
  for (std::size_t i = 0; i < n; ++i) {
    const mrr::JointDescription& joint = robot.joints[i];
    std::printf("  {");
    print_matrix("offset_rotation", joint.offset.rotation, ", ");
    print_list("offset_translation", joint.offset.translation_m.data(), 3, ", ");
    print_list("axis", joint.axis.data(), 3, ", ");
    print_list("mass", &joint.link.mass_kg, 1, ", ");
    print_list("com", joint.link.com_m.data(), 3, ", ");
    print_matrix("inertia", joint.link.inertia_kg_m2, ", ");
    std::printf("\"gear\": %.17g, \"rotor_inertia\": %.17g, \"stiffness\": %.17g, \"damping\": %.17g}%s\n",
                joint.transmission.gear_ratio, joint.motor.rotor_inertia_kg_m2,
                description.joints[i].spring.stiffness_nm_rad[0], description.joints[i].spring.damping_nm_s_rad,
                i + 1 < n ? "," : "],");
  }
  std::printf(" \"trajectory\": [\n");
  const mrr::Duration substep = mrr::seconds(1e-6 * substep_us);
  for (bool first = true;; first = false) {
    const mrr::sim::PlantTruth truth = plant.truth();
    std::printf("%s  {\"t\": %.9f, ", first ? "" : ",\n", truth.now.seconds());
    print_list("link", truth.link_position_rad.data(), n, ", ");
    print_list("motor", truth.motor_position_rad.data(), n, "}");
    if (truth.now.seconds() >= time_s) break;
    for (const mrr::Time next = truth.now + mrr::milliseconds(10); plant.now() < next;) {
      plant.step(std::min(substep, next - plant.now()));
    }
  }
  std::printf("\n]}\n");
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    std::filesystem::path folder;
    double time_s = 1.0;
    double substep_us = 100.0;
    std::uint64_t seed = 1;
    bool measure = false;
    for (int i = 1; i < argc; ++i) {
      const std::string word = argv[i];
      const auto value = [&] { return i + 1 < argc ? argv[++i] : ""; };
      if (word == "--time") {
        time_s = std::strtod(value(), nullptr);
      } else if (word == "--substep") {
        substep_us = std::strtod(value(), nullptr);
      } else if (word == "--seed") {
        seed = std::strtoull(value(), nullptr, 10);
      } else if (word == "--benchmark") {
        measure = true;
      } else {
        folder = word;
      }
    }
    if (folder.empty() || !(time_s > 0.0) || !(substep_us >= 1.0)) {
      std::fprintf(stderr, "usage: mrr_plant_dump ROBOT_DIR [--time S] [--substep US] [--seed N] [--benchmark]\n");
      return 2;
    }
    const mrr::RobotDescription robot = mrr::load_robot(folder);
    return measure ? benchmark(robot) : dump(robot, time_s, substep_us, seed);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "mrr_plant_dump: %s\n", error.what());
    return 1;
  }
}
