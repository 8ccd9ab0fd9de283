// A slice of what the benchmark of the module prints: the goals of tracking and standing on the emulated joints.
#include <gtest/gtest.h>

#include "tests/bench/module/control_quality.h"

namespace mrr::fw {
namespace {

using namespace test;  // NOLINT: all of this file is about it

struct JointGoal {
  int joint;
  double rms_mrad;
};

class ControlQuality : public testing::TestWithParam<JointGoal> {
 protected:
  [[nodiscard]] QualityCase nominal() const {
    QualityCase c;
    c.joint = GetParam().joint;
    return c;
  }
};
INSTANTIATE_TEST_SUITE_P(Joints, ControlQuality, testing::Values(JointGoal{0, 1.3}, JointGoal{2, 0.5}));

TEST_P(ControlQuality, TracksWithFrictionKnownTooLow) {
  for (const Path path : {Path::sine, Path::swing}) {
    QualityCase c = nominal();
    c.path = path;
    const Tracking t = track(c, 5.0);
    ASSERT_TRUE(t.completed) << t.note;
    EXPECT_LE(t.rms_mrad, GetParam().rms_mrad);
    c.compensator = false;
    EXPECT_GT(track(c, 3.0).rms_mrad, 2.0 * t.rms_mrad) << "the compensator does nothing";
  }
}

TEST_P(ControlQuality, StandsStill) {
  const Standing s = stand(nominal(), 30.0);
  ASSERT_TRUE(s.completed);
  EXPECT_LE(s.peak_to_peak_mrad, 1.0);
  // What is left is the drift of the torque sensor.
  EXPECT_LE(s.last_peak_to_peak_mrad, 0.3) << "a limit cycle";
  EXPECT_LE(s.last_torque_peak_to_peak_nm, 1.5) << "a limit cycle";
  EXPECT_EQ(s.said_to_swing, 0.0);
}

// Load that is carried late pumps the arm on its spring: the base joint swung for ever with 10 Nm.
TEST_P(ControlQuality, StandsStillWithASlowTorqueSensor) {
  for (const double believed_hz : {50.0, 60.0}) {
    QualityCase c = nominal();
    c.torque_bandwidth_hz = 50.0;
    c.believed_bandwidth_hz = believed_hz;
    const Standing s = stand(c, 30.0);
    ASSERT_TRUE(s.completed);
    EXPECT_LE(s.peak_to_peak_mrad, 1.0) << believed_hz;
    EXPECT_LE(s.last_torque_peak_to_peak_nm, 2.5) << believed_hz << ": a limit cycle";
    EXPECT_EQ(s.said_to_swing, 0.0) << believed_hz;
  }
}

// Told that the sensor has 200 Hz: the base joint's torque swings, the joint hardly, and the module says so.
TEST_P(ControlQuality, ASlowTorqueSensorThatIsBelievedFastIsBoundedAndShown) {
  QualityCase c = nominal();
  c.torque_bandwidth_hz = 50.0;
  c.believed_bandwidth_hz = 200.0;
  const Standing s = stand(c, 30.0);
  ASSERT_TRUE(s.completed);
  EXPECT_LE(s.peak_to_peak_mrad, 1.0);
  EXPECT_LE(s.last_torque_peak_to_peak_nm, 15.0);
  if (GetParam().joint == 0) {
    EXPECT_GT(s.last_torque_peak_to_peak_nm, 3.0);
    EXPECT_GT(s.said_to_swing, 0.9);
  } else {
    EXPECT_EQ(s.said_to_swing, 0.0);
  }
}

TEST_P(ControlQuality, TracksWithAnotherPlantThanItKnows) {
  const auto tracked = [&](auto change) {
    QualityCase c = nominal();
    c.feedforward = 1.0;
    change(c);
    const Tracking t = track(c, 5.0);
    EXPECT_TRUE(t.completed) << t.note;
    return t.rms_mrad;
  };
  const double goal = GetParam().rms_mrad;
  EXPECT_LE(tracked([](QualityCase& c) { c.friction = 0.5; }), goal);
  EXPECT_LE(tracked([](QualityCase& c) { c.friction = 1.5; }), goal);
  EXPECT_LE(tracked([](QualityCase& c) { c.link_inertia = c.rotor_inertia = 1.2; }), goal);
  EXPECT_LE(tracked([](QualityCase& c) { c.torque_bandwidth_hz = 50.0; }), goal);
  EXPECT_LE(tracked([](QualityCase& c) { c.loop_hz = 500.0; }), goal);
}

TEST_P(ControlQuality, LosesItsTorqueSensorAndGoesOn) {
  QualityCase c = nominal();
  c.feedforward = 1.0;
  c.sensor_lost_at_s = 1.5;
  const Tracking t = track(c, 4.0);
  ASSERT_TRUE(t.completed) << t.note;
  EXPECT_EQ(t.limit, can::LimitCode::model_torque);
  EXPECT_LE(t.rms_mrad, GetParam().rms_mrad);
}

}  // namespace
}  // namespace mrr::fw
