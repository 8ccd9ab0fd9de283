// The emulator's drives against closed forms: friction, current loop, winding, brake, torque constants, sensors.
#include <gtest/gtest.h>

#include <memory>

#include "tests/unit/plant/reference_arm.h"

namespace mrr::sim::test {
namespace {

/// One joint of the reference arm turning about the vertical: no gravity, nothing else moves.
struct Bench {
  explicit Bench(int joint, void (*change)(PlantDescription&) = nullptr) : robot(reference_arm()) {
    robot.joints = {robot.joints[static_cast<std::size_t>(joint)]};
    robot.gravity_m_s2.setZero();
    robot.joints[0].limits = {.lower_rad = -1000.0, .upper_rad = 1000.0};
    robot.task.nail_position_m = {0, 0, -100.0};
    PlantDescription description = default_plant(robot);
    if (change != nullptr) change(description);
    plant = std::make_unique<Plant>(robot, description, 0);
    plant->reset(std::array{0.0}, 0.04);
    plant->set_actuator(0, {0, true, true});
    plant->step(milliseconds(200));  // the brake lets go
  }
  void command_current(double ampere) {
    const double counts = ampere / robot.joints[0].sensors.current_full_scale_a * 32767.0;
    plant->set_actuator(0, {static_cast<std::int16_t>(std::lround(counts)), true, true});
  }
  /// Slowly growing hand torque until the joint has turned by 1 mrad: what it took.
  double breakaway(double direction, double rate_nm_s) {
    const double start = plant->truth().motor_position_rad[0];
    double torque = 0.0;
    while (std::abs(torque) < 60.0) {
      torque += direction * rate_nm_s * 1e-3;
      plant->set_external_torque(0, torque);
      plant->step(milliseconds(1));
      if (direction * (plant->truth().motor_position_rad[0] - start) > 5e-3) break;
    }
    return torque;
  }
  RobotDescription robot;
  std::unique_ptr<Plant> plant;
};

void base_of_the_benchmark(PlantDescription& plant) { plant.joints[0].friction.static_nm = {36.3, 36.2}; }

// Table 2: the torque that turns the base joint by hand, without current and with the two preset currents.
TEST(Friction, BaseJointNeedsThePublishedTorqueByHand) {
  EXPECT_NEAR(Bench(0, base_of_the_benchmark).breakaway(+1.0, 5.0), 36.3, 0.4);
  EXPECT_NEAR(-Bench(0, base_of_the_benchmark).breakaway(-1.0, 5.0), 36.2, 0.4);

  Bench forward(0, base_of_the_benchmark);
  forward.command_current(1.5);
  forward.plant->step(milliseconds(500));
  EXPECT_LT(std::abs(forward.plant->truth().motor_velocity_rad_s[0]), 1e-4);  // the preset alone does not move it
  EXPECT_NEAR(forward.breakaway(+1.0, 5.0), 7.6, 0.4);
  Bench backward(0, base_of_the_benchmark);
  backward.command_current(-1.2);
  backward.plant->step(milliseconds(500));
  EXPECT_LT(std::abs(backward.plant->truth().motor_velocity_rad_s[0]), 1e-4);
  EXPECT_NEAR(-backward.breakaway(-1.0, 5.0), 5.7, 0.4);
}

// At rest up to static friction, within the bristles' give.
TEST(Friction, HoldsBelowStaticFriction) {
  Bench bench(2);
  for (const double torque : {4.4, -4.4}) {
    for (int k = 1; k <= 100; ++k) {  // laid on gently: a sudden load would twist the spring twice as far
      bench.plant->set_external_torque(0, 0.01 * k * torque);
      bench.plant->step(milliseconds(10));
    }
    bench.plant->step(milliseconds(500));
    const PlantTruth truth = bench.plant->truth();
    EXPECT_LT(std::abs(truth.motor_velocity_rad_s[0]), 2e-4);
    EXPECT_LT(std::abs(truth.motor_position_rad[0]), 2e-3);
    EXPECT_NEAR(truth.friction_torque_nm[0], torque, 0.05);
  }
}

// Turned at a steady speed the friction is equation (5), in either direction.
TEST(Friction, SteadySpeedGivesTheStribeckCurve) {
  for (const double speed : {0.02, 0.03, 0.1, 0.5, 1.5, -0.05, -0.8}) {
    Bench bench(2);
    // A stiff speed servo outside of the joint: its torque minus inertia is the friction.
    double torque = 0.0;
    for (int k = 0; k < 4000; ++k) {
      const PlantTruth truth = bench.plant->truth();
      torque = 400.0 * (speed - truth.link_velocity_rad_s[0]) + truth.friction_torque_nm[0];
      bench.plant->set_external_torque(0, torque);
      bench.plant->step(microseconds(100));
    }
    const PlantTruth truth = bench.plant->truth();
    ASSERT_NEAR(truth.motor_velocity_rad_s[0], speed, 0.02 * std::abs(speed));
    const double v = truth.motor_velocity_rad_s[0];
    const double expected = std::copysign(3.9 + 0.7 * std::exp(-v * v / (0.03 * 0.03)), v) + 2.0 * v;
    EXPECT_NEAR(truth.friction_torque_nm[0], expected, 0.01 * std::abs(expected)) << speed;
  }
}

TEST(Friction, NeverGivesEnergy) {
  Bench bench(2);
  double least = 0.0;
  for (int k = 0; k < 3000; ++k) {
    bench.plant->set_external_torque(0, 9.0 * std::sin(0.02 * k) + 6.0 * std::sin(0.31 * k));
    bench.plant->step(milliseconds(1));
    least = std::min(least, bench.plant->truth().energy.friction_work_j);
  }
  EXPECT_GE(least, -1e-6);
  EXPECT_GT(bench.plant->truth().energy.friction_work_j, 1.0);
}

TEST(Drive, CurrentFollowsAsAFirstOrderLag) {
  Bench bench(2, [](PlantDescription& p) {
    p.joints[0].drive.current_bandwidth_hz = 500.0;
    p.joints[0].friction = {};
  });
  bench.command_current(1.0);
  for (int k = 1; k <= 10; ++k) {
    bench.plant->step(microseconds(100));
    const double expected = 1.0 - std::exp(-2.0 * std::numbers::pi * 500.0 * 1e-4 * k);
    EXPECT_NEAR(bench.plant->truth().current_a[0], expected, 1e-4);
  }
  bench.plant->set_actuator(0, {20000, false, true});  // stage off: the current dies, whatever the duty says
  bench.plant->step(milliseconds(5));
  EXPECT_NEAR(bench.plant->truth().current_a[0], 0.0, 1e-6);
}

TEST(Drive, CurrentStopsAtItsPeakAndTorqueHasAConstantPerDirection) {
  Bench bench(2, [](PlantDescription& p) { p.joints[0].drive.torque_constant_nm_a = {0.2, 0.24}; });
  bench.command_current(9.0);
  bench.plant->step(milliseconds(10));
  EXPECT_NEAR(bench.plant->truth().current_a[0], 2.2, 1e-9);
  EXPECT_NEAR(bench.plant->truth().motor_torque_nm[0], 2.2 * 101.0 * 0.2, 1e-9);
  bench.command_current(-9.0);
  bench.plant->step(milliseconds(10));
  EXPECT_NEAR(bench.plant->truth().motor_torque_nm[0], -2.2 * 101.0 * 0.24, 1e-9);
}

TEST(Drive, WindingWarmsTowardsWhatItsContinuousCurrentAllows) {
  Bench bench(2, [](PlantDescription& p) {
    p.joints[0].friction.coulomb_nm = p.joints[0].friction.static_nm = {90, 90};
  });
  bench.command_current(1.0);  // continuous
  bench.plant->step(seconds(60.0));
  const double after_one = 25.0 + 95.0 * (1.0 - std::exp(-1.0));
  EXPECT_NEAR(bench.plant->truth().winding_temperature_c[0], after_one, 0.5);
  EXPECT_EQ(bench.plant->sample(0).winding_temperature_adc,
            std::lround(10.0 * bench.plant->truth().winding_temperature_c[0]));
}

TEST(Drive, BrakeHoldsGravityAndLetsGoAfterItsDelay) {
  RobotDescription robot = reference_arm();
  robot.task.nail_position_m = {0, 0, -100.0};
  Plant plant(robot, default_plant(robot), 0);
  plant.reset(std::array{0.0, 0.0, 0.0}, 0.04);
  plant.step(milliseconds(500));
  PlantTruth truth = plant.truth();
  EXPECT_NEAR(truth.link_position_rad[1], 0.0, 1e-6);  // it starts in balance and stays there
  EXPECT_NEAR(truth.transmission_torque_nm[1], 13.68495, 1e-3);
  EXPECT_NEAR(truth.brake_torque_nm[1], -13.68495, 1e-3);
  EXPECT_FALSE(plant.sample(1).inputs & fw::kInputBrakeReleased);

  const double release = plant.actual_description().joints[1].drive.brake_release_s;
  plant.set_actuator(1, {0, false, true});
  plant.step(seconds(release - 0.002));
  EXPECT_NEAR(plant.truth().link_position_rad[1], 0.0, 1e-6);
  plant.step(milliseconds(300));
  EXPECT_TRUE(plant.sample(1).inputs & fw::kInputBrakeReleased);
  EXPECT_LT(plant.truth().link_position_rad[1], -0.1);  // nothing holds it any more: gravity beats friction

  plant.set_actuator(1, {0, false, false});
  plant.step(milliseconds(600));
  const double caught = plant.truth().motor_position_rad[1];
  plant.step(milliseconds(500));
  EXPECT_NEAR(plant.truth().motor_position_rad[1], caught, 1e-5);
}

TEST(Drive, BrakeSlipsAtItsTorque) {
  Bench bench(2, [](PlantDescription& p) {
    p.joints[0].friction = {};
    p.joints[0].drive.brake_torque_nm = 20.0;
  });
  bench.plant->set_actuator(0, {0, false, false});
  bench.plant->step(milliseconds(100));
  bench.plant->set_external_torque(0, 19.0);
  bench.plant->step(milliseconds(50));
  // A step of load overshoots; what must not be is a slide that goes on.
  bench.plant->step(milliseconds(1000));
  const double held = bench.plant->truth().motor_position_rad[0];
  bench.plant->step(milliseconds(500));
  EXPECT_NEAR(bench.plant->truth().motor_position_rad[0], held, 1e-5);
  bench.plant->set_external_torque(0, 24.0);
  bench.plant->step(milliseconds(500));
  EXPECT_GT(bench.plant->truth().motor_position_rad[0], held + 0.5);
  EXPECT_NEAR(bench.plant->truth().brake_torque_nm[0], 20.0, 1e-9);
}

TEST(Sensors, CountsAreWhatTheScalesSay) {
  const RobotDescription robot = reference_arm();
  PlantDescription description = default_plant(robot);
  for (JointTruth& joint : description.joints)
    joint.sensor = {.torque_noise_nm = 0, .torque_drift_nm = 0, .current_noise_a = 0};
  Plant plant(robot, description, 0);
  plant.reset(std::array{0.3, 0.0, -0.2}, 0.04);
  plant.step(milliseconds(100));
  const PlantTruth truth = plant.truth();
  for (int i = 0; i < 3; ++i) {
    const auto j = static_cast<std::size_t>(i);
    const fw::RawSensors raw = plant.sample(i);
    const double counts_per_rad = robot.joints[j].transmission.gear_ratio * 16384.0 / (2.0 * std::numbers::pi);
    EXPECT_EQ(raw.encoder_count, static_cast<std::int32_t>(std::floor(truth.motor_position_rad[j] * counts_per_rad)));
    const double full_scale = robot.joints[j].sensors.torque_full_scale_nm;
    EXPECT_NEAR(full_scale * raw.torque_adc / 32767.0, truth.transmission_torque_nm[j], full_scale / 32767.0);
    EXPECT_EQ(raw.bus_voltage_adc, 4800);
    EXPECT_EQ(raw.fresh,
              fw::kFreshEncoder | fw::kFreshTorque | fw::kFreshCurrent | fw::kFreshTemperature | fw::kFreshBusVoltage);
  }
}

TEST(Sensors, TorqueNoiseHasTheDescribedSizeAndBandwidth) {
  Bench bench(2, [](PlantDescription& p) {
    p.joints[0].friction = {};
    p.joints[0].sensor.torque_drift_nm = 0.0;
  });
  double sum = 0.0;
  double squares = 0.0;
  constexpr int kCount = 20000;
  for (int k = 0; k < kCount; ++k) {
    const double torque = 100.0 * bench.plant->sample(0).torque_adc / 32767.0;
    sum += torque;
    squares += torque * torque;
  }
  EXPECT_NEAR(sum / kCount, 0.0, 0.003);
  EXPECT_NEAR(std::sqrt(squares / kCount), 0.07, 0.002);
}

TEST(Sensors, SwitchesCloseWhereTheyAre) {
  RobotDescription robot = reference_arm();
  robot.joints[2].homing.switch_position_rad = -1.0;
  Plant plant(robot, default_plant(robot), 0);
  const auto inputs = [&](double q) {
    plant.reset(std::array{0.0, 0.0, q}, 0.04);
    return plant.sample(2).inputs;
  };
  EXPECT_FALSE(inputs(0.0) & (fw::kInputHomeSwitch | fw::kInputNegativeLimit | fw::kInputPositiveLimit));
  EXPECT_TRUE(inputs(-1.001) & fw::kInputHomeSwitch);
  EXPECT_FALSE(inputs(-2.4) & fw::kInputNegativeLimit);
  EXPECT_TRUE(inputs(-2.43) & fw::kInputNegativeLimit);
  EXPECT_TRUE(inputs(2.43) & fw::kInputPositiveLimit);
}

TEST(Sensors, IndexPulsesOncePerMotorTurn) {
  Bench bench(2, [](PlantDescription& p) { p.joints[0].friction.viscous_nm_s_rad = 5.0; });
  bench.plant->sample(0);
  bench.plant->set_external_torque(0, 8.0);
  int pulses = 0;
  for (int k = 0; k < 2000; ++k) {
    bench.plant->step(milliseconds(1));
    if (bench.plant->sample(0).inputs & fw::kInputIndexPulse) ++pulses;
  }
  const double turns = bench.plant->truth().motor_position_rad[0] * 101.0 / (2.0 * std::numbers::pi);
  ASSERT_GT(turns, 10.0);
  EXPECT_EQ(pulses, static_cast<int>(std::floor(turns)));
}

TEST(EndStops, CatchARunawayJoint) {
  const RobotDescription robot = reference_arm();
  Plant plant(robot, default_plant(robot), 0);
  plant.reset(std::array{2.3, 1.5, 0.0}, 0.04);
  plant.set_actuator(0, {32767, true, true});
  double highest = 0.0;
  for (int k = 0; k < 1500; ++k) {
    plant.step(milliseconds(1));
    highest = std::max(highest, plant.truth().link_position_rad[0]);
  }
  EXPECT_GT(highest, 2.46);
  EXPECT_LT(highest, 2.56);
}

}  // namespace
}  // namespace mrr::sim::test
