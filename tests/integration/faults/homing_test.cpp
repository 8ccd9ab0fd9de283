// Every CiA 402 homing method on a joint of the emulated arm whose encoder has lost its zero: home switch, limit
// switches and index pulse are where the plant has them.
#include <gtest/gtest.h>

#include <algorithm>

#include "can_protocol/object_access.h"
#include "tests/bench/module/plant_joint.h"

namespace mrr::fw {
namespace {

using test::JointSetup;
using test::PlantBench;

constexpr double kHomeEdge = 0.45;
constexpr double kLower = 0.15;  // well above the nail
constexpr double kUpper = 0.8;

struct Case {
  int method;
  double start_rad;
  double edge_rad;  ///< of the switch that is looked for
  int index;        ///< the pulse after the edge in this direction; 0: the edge itself
};

// The home switch is closed above 0.45 rad. The method that meets or leaves it in the negative direction needs one that
// is closed below.
constexpr double kHere = 0.3;
constexpr Case kCases[] = {
    {17, kHere, kLower, 0},
    {18, kHere, kUpper, 0},
    {19, kHere, kHomeEdge, 0},
    {20, kHere, kHomeEdge, 0},
    {21, 0.6, kHomeEdge, 0},
    {22, 0.6, kHomeEdge, 0},
    {1, kHere, kLower, 1},
    {2, kHere, kUpper, -1},
    {3, kHere, kHomeEdge, -1},
    {4, kHere, kHomeEdge, 1},
    {5, 0.6, kHomeEdge, 1},
    {6, 0.6, kHomeEdge, -1},
    {33, kHere, kHere, -1},
    {34, kHere, kHere, 1},
    // From on the switch, and from beyond it, where the limit switch turns the search round.
    {19, 0.6, kHomeEdge, 0},
    {20, 0.6, kHomeEdge, 0},
    {21, kHere, kHomeEdge, 0},
    {22, kHere, kHomeEdge, 0},
    {17, 0.145, kLower, 0},
    {2, 0.81, kUpper, -1},
};

JointSetup joint_2(const Case& c) {
  JointSetup setup;
  setup.joint = 1;
  setup.pose_rad = {0.0, c.start_rad, 0.0};
  const bool closed_below = c.method == 5 || c.method == 6 || c.method == 21 || c.method == 22;
  setup.config = [](ModuleConfig& config) {
    config.sensing.encoder_absolute = false;
    config.homing.fast_rad_s = 0.3F;
    config.homing.slow_rad_s = 0.02F;
    config.homing.switch_position_rad = 1.0F;
    config.homing.index_position_rad = 1.0F;
  };
  setup.plant = [closed_below](RobotDescription& r, sim::PlantDescription& p) {
    r.joints[1].homing.switch_position_rad = kHomeEdge;
    r.joints[1].homing.direction = closed_below ? -1 : 1;
    r.joints[1].limits.lower_rad = kLower;
    r.joints[1].limits.upper_rad = kUpper;
    p.joints[1].sensor.limit_switch_margin_rad = 0.0;
    p.joints[1].sensor.home_switch_offset_rad = 0.0;
  };
  return setup;
}

class HomingMethod : public testing::TestWithParam<Case> {};

TEST_P(HomingMethod, FindsItsReference) {
  const Case& c = GetParam();
  PlantBench b(joint_2(c));
  ASSERT_TRUE(b.enable());
  ASSERT_FALSE(b.status().homed);
  b.write(0x6098, 0, static_cast<std::uint32_t>(c.method), 1);
  b.set_mode(6);
  b.run(0.01);
  b.command(0x1F);
  const auto is = [&](unsigned bit) { return (b.module.objects().statusword & bit) != 0; };
  ASSERT_TRUE(b.run_until([&] { return is(kStatusFollowing) || is(kStatusFollowingError); }, 40.0));
  ASSERT_TRUE(is(kStatusFollowing)) << "failed at " << b.joint.motor_q();
  EXPECT_TRUE(b.status().homed);
  b.run(0.5);
  EXPECT_NEAR(b.joint.motor_v(), 0.0, 0.005);
  EXPECT_EQ(b.status().fault, can::Emergency::none);
  // Where the joint is when it reads the reference.
  const double reference = 1.0 + b.joint.motor_q() - double{b.status().position_rad};
  const double turn = 2.0 * 3.141592653589793 / double{b.config.drive.gear_ratio};
  if (c.index == 0) {
    EXPECT_NEAR(reference, c.edge_rad, 0.004);  // the switch is on the link, which rings on its spring
  } else {
    EXPECT_GT(c.index * (reference - c.edge_rad), -0.004);
    EXPECT_LT(c.index * (reference - c.edge_rad), turn + 0.004);
  }
}

INSTANTIATE_TEST_SUITE_P(CiA402, HomingMethod, testing::ValuesIn(kCases), [](const auto& c) {
  return "method_" + std::to_string(c.param.method) + "_from_" +
         std::to_string(static_cast<int>(1000.0 * (c.param.start_rad + 1.0)));
});

TEST(HomingMethods, AreAllThatTheObjectsSayAndEachIsTried) {
  const can::ObjectDictionary od;
  const can::Entry& entry = can::entry_of(can::ObjectId::homing_method);
  std::vector<int> taken;
  for (int method = -128; method <= 127; ++method) {
    can::Value v;
    v.size = 1;
    v.bytes[0] = static_cast<std::uint8_t>(method);
    if (can::check_value(entry, v) == can::Abort::none) taken.push_back(method);
  }
  EXPECT_EQ(taken, std::vector<int>(od.supported_homing_method.begin(), od.supported_homing_method.end()));
  for (const int method : taken) {
    const bool elsewhere = method == -1 || method == 35 || method == 37;
    EXPECT_TRUE(elsewhere || std::ranges::any_of(kCases, [&](const Case& c) { return c.method == method; })) << method;
  }
}

TEST(HomingMethods, ASwitchThatBouncesIsNotLeftYet) {
  for (const int method : {17, 19}) {
    const Case& c = *std::ranges::find(kCases, method, &Case::method);
    const std::uint32_t contact = method == 17 ? kInputNegativeLimit : kInputHomeSwitch;
    PlantBench b(joint_2(c));
    ASSERT_TRUE(b.enable());
    int closed = 0;
    b.spoil = [&](RawSensors& raw) {
      if ((raw.inputs & contact) != 0) ++closed;
      if (closed == 3 || closed == 4) raw.inputs = static_cast<std::uint8_t>(raw.inputs & ~contact);
    };
    b.write(0x6098, 0, static_cast<std::uint32_t>(method), 1);
    b.set_mode(6);
    b.run(0.01);
    b.command(0x1F);
    const auto is = [&](unsigned bit) { return (b.module.objects().statusword & bit) != 0; };
    ASSERT_TRUE(b.run_until([&] { return is(kStatusFollowing) || is(kStatusFollowingError); }, 40.0));
    ASSERT_TRUE(is(kStatusFollowing));
    ASSERT_GT(closed, 4) << "it never bounced";
    EXPECT_NEAR(1.0 + b.joint.motor_q() - double{b.status().position_rad}, c.edge_rad, 0.004);
  }
}

TEST(HomingMethods, AJointThatIsHomedKeepsItsLimitsWhileItSeeksAnIndexPulse) {
  JointSetup setup = joint_2({33, kHere, kHere, -1});
  const auto config = setup.config;
  setup.config = [=](ModuleConfig& m) {
    config(m);
    m.sensing.encoder_absolute = true;
    m.homing.slow_rad_s = 0.2F;
    m.limits.lower_rad = static_cast<float>(kHere) - 0.01F;
  };
  PlantBench b(setup);
  b.spoil = [](RawSensors& raw) {
    raw.inputs = static_cast<std::uint8_t>(raw.inputs & ~unsigned{kInputIndexPulse});
  };  // it never comes
  ASSERT_TRUE(b.enable());
  ASSERT_TRUE(b.status().homed);
  b.write(0x6098, 0, 33, 1);
  b.set_mode(6);
  b.run(0.01);
  b.command(0x1F);
  ASSERT_TRUE(b.run_until([&] { return b.status().cause != can::Fault::none; }, 5.0));
  EXPECT_EQ(b.status().cause, can::Fault::position_limit);
  EXPECT_GT(b.joint.motor_q(), kLower + 0.02) << "only the limit switch ended it";
}

TEST(HomingMethods, ATimeoutEndsThem) {
  for (const int method : {17, 33}) {
    Case c{method, kHere, kLower, 0};
    JointSetup setup = joint_2(c);
    const auto config = setup.config;
    setup.config = [=](ModuleConfig& m) {
      config(m);
      m.homing.timeout = milliseconds(300);
      m.homing.slow_rad_s = 0.001F;
    };
    PlantBench b(setup);
    ASSERT_TRUE(b.enable());
    b.write(0x6098, 0, static_cast<std::uint32_t>(method), 1);
    b.set_mode(6);
    b.run(0.01);
    b.command(0x1F);
    ASSERT_TRUE(b.run_until([&] { return (b.module.objects().statusword & kStatusFollowingError) != 0; }, 2.0));
    b.run(0.3);
    EXPECT_FALSE(b.status().homed);
    EXPECT_EQ(b.module.objects().error_code, static_cast<int>(can::Emergency::homing_failed));
    EXPECT_NEAR(b.joint.motor_v(), 0.0, 0.01);
  }
}

}  // namespace
}  // namespace mrr::fw
