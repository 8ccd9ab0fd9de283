// The plant as others use it: the same seed gives the same run, seeds differ in their ranges, nothing allocates.
#include <gtest/gtest.h>

#include <atomic>
#include <cstdlib>
#include <cstring>
#include <new>

#include "common/core/random.h"
#include "common/robot/errors.h"
#include "tests/unit/plant/reference_arm.h"

namespace {
std::atomic<long> allocations{0};
}

void* operator new(std::size_t size) {
  ++allocations;
  if (void* memory = std::malloc(size)) return memory;
  throw std::bad_alloc();
}
void operator delete(void* memory) noexcept { std::free(memory); }
void operator delete(void* memory, std::size_t) noexcept { std::free(memory); }

namespace mrr::sim::test {
namespace {

/// Bytes of all sensor samples of half a second of vigorous motion, contact included.
std::vector<std::int32_t> run(std::uint64_t seed) {
  const RobotDescription robot = reference_arm();
  Plant plant(robot, default_plant(robot), seed);
  plant.reset(std::array{0.0, 0.3, 0.0}, 0.04);
  std::vector<std::int32_t> trace;
  for (int k = 0; k < 700; ++k) {
    for (int i = 0; i < 3; ++i) {
      const fw::RawSensors raw = plant.sample(i);
      trace.insert(trace.end(), {raw.encoder_count, raw.torque_adc, raw.current_adc, raw.winding_temperature_adc,
                                 raw.drive_temperature_adc, raw.bus_voltage_adc, raw.inputs, raw.fresh});
      plant.set_actuator(i, torque_command(plant, i, 9.0 * std::sin(0.013 * k * (i + 1))));
    }
    plant.step(microseconds(950 + (k * 37) % 100));
  }
  trace.push_back(static_cast<std::int32_t>(plant.contact_count()));
  return trace;
}

TEST(PlantInterface, SameSeedSameRun) {
  EXPECT_EQ(run(0), run(0));
  EXPECT_EQ(run(7), run(7));
  EXPECT_NE(run(7), run(8));
}

TEST(PlantInterface, ResetStartsTheSameRunAgain) {
  const RobotDescription robot = reference_arm();
  Plant plant(robot, default_plant(robot), 3);
  const auto go = [&] {
    plant.reset(std::array{0.1, 0.4, 0.0}, 0.03);
    for (int i = 0; i < 3; ++i) plant.set_actuator(i, {500, true, true});
    for (int k = 0; k < 300; ++k) {
      for (int i = 0; i < 3; ++i) plant.sample(i);
      plant.step(milliseconds(1));
    }
    const PlantTruth truth = plant.truth();
    return std::pair(truth.motor_position_rad, plant.sample(1).torque_adc);
  };
  EXPECT_EQ(go(), go());
}

// How the time is cut into calls matters to the integrator's error, not to the clock.
TEST(PlantInterface, TimeAddsUpExactly) {
  const RobotDescription robot = reference_arm();
  Plant plant(robot, default_plant(robot), 0);
  plant.step(nanoseconds(1'234'567));
  plant.step(nanoseconds(37));
  plant.step(nanoseconds(0));
  plant.step(nanoseconds(-5));
  EXPECT_EQ(plant.now().ns, 1'234'604);
  for (int i = 0; i < 3; ++i) EXPECT_TRUE(std::isfinite(plant.truth().link_position_rad[static_cast<std::size_t>(i)]));
}

TEST(PlantInterface, OddStepsGiveTheSameMotion) {
  const RobotDescription robot = reference_arm();
  Plant even(robot, default_plant(robot), 0);
  Plant odd(robot, default_plant(robot), 0);
  for (Plant* plant : {&even, &odd}) {
    plant->reset(std::array{0.0, 0.5, 0.2}, 0.04);
    for (int i = 0; i < 3; ++i) plant->set_actuator(i, {0, false, true});
  }
  Random random(1);
  for (Time t; t < Time{} + milliseconds(300);) {
    const Duration dt = nanoseconds(1 + static_cast<std::int64_t>(random.below(400'000)));
    odd.step(dt);
    t += dt;
    even.step(t - even.now());
  }
  for (std::size_t i = 0; i < 3; ++i) {
    EXPECT_NEAR(odd.truth().link_position_rad[i], even.truth().link_position_rad[i], 1e-9);
  }
  even.step(milliseconds(200));
  for (int k = 0; k < 2000; ++k) odd.step(microseconds(100));
  for (std::size_t i = 0; i < 3; ++i) {
    EXPECT_NEAR(odd.truth().link_position_rad[i], even.truth().link_position_rad[i], 1e-9);
  }
}

TEST(PlantInterface, SeedZeroIsNominalAndOthersStayInTheirRanges) {
  const RobotDescription robot = reference_arm();
  const PlantDescription description = default_plant(robot);
  const Plant nominal(robot, description, 0);
  EXPECT_EQ(nominal.actual_description().joints[1].friction.coulomb_nm[0], 3.9);
  EXPECT_EQ(nominal.actual_robot().task.nail_position_m, robot.task.nail_position_m);
  EXPECT_EQ(nominal.truth().nail_height_m, 0.04);

  double low = 10.0;
  double high = 0.0;
  double low_height = 1.0;
  for (std::uint64_t seed = 1; seed <= 200; ++seed) {
    Plant plant(robot, description, seed);
    plant.reset(std::array{0.0, 0.5, 0.0}, 0.03);
    const JointTruth& joint = plant.actual_description().joints[1];
    low = std::min(low, joint.friction.coulomb_nm[0]);
    high = std::max(high, joint.friction.coulomb_nm[0]);
    low_height = std::min(low_height, plant.truth().nail_height_m);
    EXPECT_NEAR(joint.friction.static_nm[0] / joint.friction.coulomb_nm[0], 4.6 / 3.9, 1e-12);
    EXPECT_NEAR(joint.drive.torque_constant_nm_a[0], 0.21, 0.02 * 0.21);
    EXPECT_NEAR(plant.truth().nail_height_m, 0.03, 5e-4);
    const Eigen::Vector3d moved = plant.actual_robot().task.nail_position_m - robot.task.nail_position_m;
    EXPECT_LE(moved.norm(), 5e-4 * std::sqrt(2.0));
    EXPECT_NEAR(moved.z(), 0.0, 1e-15);
  }
  EXPECT_GE(low, 3.9 * 0.95);
  EXPECT_LE(high, 3.9 * 1.05);
  EXPECT_LT(low, 3.9 * 0.96);  // and the ranges are used
  EXPECT_GT(high, 3.9 * 1.04);
  EXPECT_LT(low_height, 0.03 - 4e-4);
}

TEST(PlantInterface, SteppingAndSamplingDoNotAllocate) {
  const RobotDescription robot = reference_arm();
  Plant plant(robot, default_plant(robot), 5);
  plant.reset(std::array{0.0, 0.1, 0.0}, 0.04);
  const long before = allocations;
  for (int k = 0; k < 500; ++k) {
    for (int i = 0; i < 3; ++i) {
      plant.sample(i);
      plant.set_actuator(i, {0, false, true});
    }
    plant.step(milliseconds(1));
    (void)plant.truth();
  }
  EXPECT_EQ(allocations, before);
  EXPECT_GE(plant.contact_count(), 1U);  // the blow was part of it
}

TEST(PlantInterface, RefusesDescriptionsThatDoNotFit) {
  const RobotDescription robot = reference_arm();
  PlantDescription two = default_plant(robot);
  two.joints.pop_back();
  EXPECT_THROW(Plant(robot, two, 0), DescriptionError);
  PlantDescription soft = default_plant(robot);
  soft.joints[0].spring.stiffness_nm_rad[1] = 0.0;
  EXPECT_THROW(Plant(robot, soft, 0), DescriptionError);
  PlantDescription upside_down = default_plant(robot);
  upside_down.joints[0].friction.static_nm[1] = 1.0;
  EXPECT_THROW(Plant(robot, upside_down, 0), DescriptionError);
  RobotDescription nothing = robot;
  nothing.joints.clear();
  EXPECT_THROW(Plant(nothing, default_plant(nothing), 0), DescriptionError);
  Plant plant(robot, default_plant(robot), 0);
  EXPECT_THROW(plant.reset(std::array{0.0, 0.0}, 0.04), DescriptionError);
}

// A wild command must not make numbers that are not numbers.
TEST(PlantInterface, SurvivesFullCommandsForALongTime) {
  const RobotDescription robot = reference_arm();
  Plant plant(robot, default_plant(robot), 9);
  plant.reset(std::array{0.0, 0.5, 0.0}, 0.04);
  Random random(2);
  for (int k = 0; k < 10000; ++k) {
    for (int i = 0; i < 3; ++i) {
      const auto duty = static_cast<std::int16_t>(static_cast<int>(random.below(65535)) - 32767);
      if (random.below(20) == 0) plant.set_actuator(i, {duty, random.below(8) != 0, random.below(8) != 0});
    }
    plant.step(milliseconds(1));
  }
  const PlantTruth truth = plant.truth();
  for (std::size_t i = 0; i < 3; ++i) {
    EXPECT_LT(std::abs(truth.link_velocity_rad_s[i]), 50.0);
    EXPECT_LT(std::abs(truth.link_position_rad[i]), 3.0);
    EXPECT_LT(std::abs(truth.transmission_torque_nm[i]), 1000.0);
  }
}

}  // namespace
}  // namespace mrr::sim::test
