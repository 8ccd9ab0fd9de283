// What the whole robot does when a part of it fails: no joint is forgotten, nothing is struck, the reason has a name.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "module_fw/targets/host/module_config.h"
#include "tests/integration/world/whole_robot.h"

namespace mrr::sim::test {
namespace {

using testing::HasSubstr;
using testing::Not;

int port_of(int joint) { return joint + 1; }

/// A robot with a job.
class Job : public WatchedWorld {
 public:
  explicit Job(const RobotDescription& robot) : WatchedWorld(robot) {}

  [[nodiscard]] bool swinging() { return supervisor().activity() == sup::Activity::swinging; }
  [[nodiscard]] Time planned_contact() { return supervisor().outcome().planned_contact; }

  sup::HammerSession session_{robot_, supervisor(), seeded(1).session};
  bool over_ = false;

 private:
  void supervisor_stepped() override { over_ = session_.step(world_.now()); }
};

/// All joints but `lost` rest, enabled or braked, and stay where they are for `time`.
void expect_rest(Job& job, int lost, Duration time) {
  const PlantTruth before = job.world_.plant().truth();
  const Time end = job.world_.now() + time;
  double fastest = 0.0;
  while (job.world_.now() < end) {
    job.step();
    const PlantTruth now = job.world_.plant().truth();
    for (std::size_t i = 0; i < job.robot_.joints.size(); ++i) {
      fastest = std::max(fastest, std::abs(now.motor_velocity_rad_s[i]));
    }
  }
  EXPECT_LT(fastest, 0.02) << "rad/s, some joint still moves";
  const PlantTruth after = job.world_.plant().truth();
  for (int i = 0; i < job.robot_.dof(); ++i) {
    const auto k = static_cast<std::size_t>(i);
    SCOPED_TRACE(job.robot_.joints[k].name);
    EXPECT_NEAR(after.motor_position_rad[k], before.motor_position_rad[k], 2e-3);
    const fw::ModuleStatus& status = job.world_.module(i).status();
    if (i == lost) {
      // It hears nobody: its own watchdogs must have braked it.
      EXPECT_EQ(status.state, fw::DriveState::fault);
      EXPECT_FALSE(after.brake_released[k]);
    } else {
      EXPECT_EQ(status.state, fw::DriveState::operation_enabled);
      EXPECT_EQ(status.law, fw::Law::active);
    }
  }
}

class EveryJoint : public testing::TestWithParam<int> {};
INSTANTIATE_TEST_SUITE_P(Joints, EveryJoint, testing::Range(0, 3));

TEST_P(EveryJoint, ThatNeverBootsIsNamedAndTheOthersComeUp) {
  const int absent = GetParam();
  const RobotDescription robot = example("mrr3");
  std::vector<fw::ModuleStatus> last(robot.joints.size());
  const HammerJobResult job = hammer(robot, "styrofoam", seeded(1), [&](World& world) {
    world.bus().connect(port_of(absent), false);
    world.on_tick = [&last](int joint, Time, const fw::ModuleStatus& status) {
      last[static_cast<std::size_t>(joint)] = status;
    };
  });
  EXPECT_EQ(job.verdict, sup::Verdict::not_ready);
  EXPECT_TRUE(job.swings.empty());
  for (int i = 0; i < robot.dof(); ++i) {
    const auto k = static_cast<std::size_t>(i);
    if (i == absent) {
      EXPECT_THAT(job.reason, HasSubstr(robot.joints[k].name));
      EXPECT_NE(last[k].state, fw::DriveState::operation_enabled);
    } else {
      EXPECT_THAT(job.reason, Not(HasSubstr(robot.joints[k].name)));
      EXPECT_EQ(last[k].state, fw::DriveState::operation_enabled) << robot.joints[k].name;
      EXPECT_TRUE(last[k].brake_released);
    }
  }
}

TEST_P(EveryJoint, WithAnotherConfigurationIsRefusedByName) {
  const int other = GetParam();
  const RobotDescription robot = example("mrr3");
  std::vector<bool> was_enabled(robot.joints.size(), false);
  HammerJobOptions options = seeded(1);
  options.world.flash = [other](int joint, fw::ModuleConfig& config) {
    if (joint != other) return;
    config.drive.gear_ratio *= 1.01F;
    config.configuration_hash = fw::configuration_hash(config);
  };
  const HammerJobResult job = hammer(robot, "styrofoam", options, [&was_enabled](World& world) {
    world.on_tick = [&was_enabled](int joint, Time, const fw::ModuleStatus& status) {
      if (status.state == fw::DriveState::operation_enabled) was_enabled[static_cast<std::size_t>(joint)] = true;
    };
  });
  EXPECT_EQ(job.verdict, sup::Verdict::not_ready);
  EXPECT_THAT(job.reason, HasSubstr(robot.joints[static_cast<std::size_t>(other)].name));
  EXPECT_THAT(job.reason, HasSubstr("configuration"));
  for (int i = 0; i < robot.dof(); ++i) EXPECT_EQ(was_enabled[static_cast<std::size_t>(i)], i != other);
}

TEST_P(EveryJoint, LostDuringTheBackSwingStopsAllAndTheOthersHold) {
  const int lost = GetParam();
  Job job(example("mrr3"));
  ASSERT_TRUE(job.run_until([&] { return job.world_.supervisor().activity() == sup::Activity::approaching; },
                            milliseconds(10'000)));
  job.run_for(milliseconds(150));
  job.world_.bus().connect(port_of(lost), false);
  ASSERT_TRUE(job.run_until([&] { return job.over_; }, milliseconds(5'000)));
  EXPECT_EQ(job.session_.verdict(), sup::Verdict::joint_fault) << job.session_.reason();
  EXPECT_THAT(job.session_.reason(), HasSubstr(job.robot_.joints[static_cast<std::size_t>(lost)].name));
  job.run_for(milliseconds(1'000));
  expect_rest(job, lost, milliseconds(500));
  EXPECT_TRUE(job.world_.plant().contacts().empty()) << "something was struck";
}

TEST_P(EveryJoint, LostOnTheWayInStopsAllAndTheOthersHold) {
  const int lost = GetParam();
  for (const int before_ms : {900, 300, 50}) {
    SCOPED_TRACE(before_ms);
    Job job(example("mrr3"));
    ASSERT_TRUE(job.run_until(
        [&] { return job.swinging() && job.world_.now() >= job.planned_contact() - milliseconds(before_ms); },
        milliseconds(20'000)));
    job.world_.bus().connect(port_of(lost), false);
    ASSERT_TRUE(job.run_until([&] { return job.over_; }, milliseconds(5'000)));
    EXPECT_EQ(job.session_.verdict(), sup::Verdict::joint_fault) << job.session_.reason();
    EXPECT_THAT(job.session_.reason(), HasSubstr(job.robot_.joints[static_cast<std::size_t>(lost)].name));
    if (before_ms >= 300) {
      EXPECT_TRUE(job.world_.plant().contacts().empty()) << "there was time to stop, and something was struck";
    }
    job.run_for(milliseconds(1'500));
    expect_rest(job, lost, milliseconds(500));
    for (int i = 0; i < job.robot_.dof(); ++i) {
      const double limit_nm = job.robot_.joints[static_cast<std::size_t>(i)].transmission.repeated_peak_nm;
      EXPECT_LT(std::abs(job.world_.plant().truth().transmission_torque_nm[static_cast<std::size_t>(i)]), limit_nm);
    }
  }
}

TEST(Supervisor, LostAfterArmingLeavesTheSwitchToTheModulesAndTheArmComesToRest) {
  Job job(example("mrr3"));
  ASSERT_TRUE(
      job.run_until([&] { return job.swinging() && job.world_.now() >= job.planned_contact() - milliseconds(100); },
                    milliseconds(20'000)));
  ASSERT_EQ(count(job.events_, sup::EventKind::selection_acknowledged), 1);
  const sup::StrikePlan plan = *job.session_.plan();
  ASSERT_NE(plan.passive, 0U);
  job.world_.bus().connect(0, false);
  std::vector<bool> went_passive(job.robot_.joints.size(), false);
  job.world_.on_tick = [&](int joint, Time, const fw::ModuleStatus& status) {
    if (status.law == fw::Law::passive) went_passive[static_cast<std::size_t>(joint)] = true;
  };
  job.run_for(milliseconds(4'000));
  for (std::size_t i = 0; i < went_passive.size(); ++i) {
    EXPECT_EQ(went_passive[i], planned_passive(plan, i)) << job.robot_.joints[i].name;
  }
  const PlantTruth before = job.world_.plant().truth();
  job.run_for(milliseconds(500));
  const PlantTruth after = job.world_.plant().truth();
  for (std::size_t i = 0; i < went_passive.size(); ++i) {
    EXPECT_NEAR(after.motor_position_rad[i], before.motor_position_rad[i], 2e-3);
    EXPECT_NEAR(after.motor_velocity_rad_s[i], 0.0, 0.02);
    EXPECT_FALSE(after.brake_released[i]) << job.robot_.joints[i].name;
  }
}

}  // namespace
}  // namespace mrr::sim::test
