// Commands beside swings, in the whole one-clock robot: enable, disable, home, move, passive and active, recovery.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <vector>

#include "supervisor/strike/move.h"
#include "tests/integration/world/whole_robot.h"

namespace mrr::sim::test {
namespace {

using sup::Activity;
using sup::CommandFailure;
using sup::CommandKind;
using sup::CommandState;
using sup::EventKind;
using sup::NodeStage;
using sup::Refusal;

int port_of(int joint) { return joint + 1; }

class Commands : public WatchedRobot {
 protected:
  /// Runs until the last command has ended; whether it was done.
  [[nodiscard]] bool done(Duration limit = milliseconds(120'000)) {
    return run_until([&] { return supervisor().command().state != CommandState::running; }, limit) &&
           supervisor().command().state == CommandState::done;
  }
  void enable() {
    supervisor().enable(true);
    ASSERT_TRUE(done());
    ASSERT_EQ(supervisor().activity(), Activity::holding);
  }
  [[nodiscard]] sup::JointTrajectory to(int joint, double by_rad, double speed = 0.5) {
    sup::JointVector target = supervisor().reference().q;
    target[joint] += by_rad;
    return sup::plan_move(robot_, supervisor().chain(), supervisor().reference().q, target, speed, milliseconds(4));
  }
  [[nodiscard]] bool braked(int joint) const {
    return !world_.plant().truth().brake_released[static_cast<std::size_t>(joint)];
  }
};

TEST_F(Commands, DisableStopsTheMotionThenBrakesAllJoints) {
  enable();
  ASSERT_EQ(supervisor().move(to(0, 0.5)), Refusal::none);
  run_for(milliseconds(200));
  ASSERT_EQ(supervisor().activity(), Activity::moving);
  supervisor().enable(false);
  ASSERT_TRUE(run_until([&] { return supervisor().activity() == Activity::stopping; }, milliseconds(10)));
  ASSERT_TRUE(done());
  EXPECT_EQ(supervisor().activity(), Activity::disabled);
  run_for(milliseconds(500));
  for (int i = 0; i < robot_.dof(); ++i) EXPECT_TRUE(braked(i)) << i;
  enable();  // and back
}

TEST_F(Commands, MoveArrivesAndHolds) {
  enable();
  const double from = supervisor().measured_position()[0];
  ASSERT_EQ(supervisor().move(to(0, 0.3)), Refusal::none);
  ASSERT_TRUE(done());
  EXPECT_EQ(supervisor().activity(), Activity::holding);
  run_for(milliseconds(300));
  EXPECT_NEAR(supervisor().measured_position()[0], from + 0.3, 2e-3);
  EXPECT_EQ(count(events_, EventKind::motion_ended), 1);
}

TEST_F(Commands, MoveIsRefusedWhenNotHoldingOrFromElsewhere) {
  const sup::JointTrajectory motion = to(0, 0.3);
  EXPECT_EQ(supervisor().move(motion), Refusal::not_ready);
  enable();
  sup::JointVector elsewhere = supervisor().reference().q;
  elsewhere[0] += 0.1;
  sup::JointTrajectory foreign{sup::at_rest(elsewhere)};
  ASSERT_TRUE(foreign.append(sup::at_rest(supervisor().reference().q), milliseconds(1000)));
  EXPECT_EQ(supervisor().move(foreign), Refusal::wrong_start);
  EXPECT_EQ(supervisor().move({}), Refusal::not_usable);
  EXPECT_EQ(supervisor().activity(), Activity::holding);
}

TEST_F(Commands, MovesOutsideLimitsAreNotPlanned) {
  sup::JointVector target = supervisor().reference().q;
  target[1] = robot_.joints[1].limits.upper_rad + 0.01;
  try {
    (void)sup::plan_move(robot_, supervisor().chain(), supervisor().reference().q, target, 0.5, milliseconds(4));
    FAIL() << "planned";
  } catch (const PlanError& error) {
    EXPECT_THAT(error.what(), testing::HasSubstr(robot_.joints[1].name));
  }
}

TEST_F(Commands, StopEndsAMoveAndIsThenDone) {
  enable();
  ASSERT_EQ(supervisor().move(to(0, 0.8)), Refusal::none);
  run_for(milliseconds(250));
  supervisor().stop();
  ASSERT_TRUE(done());
  EXPECT_EQ(supervisor().command().kind, CommandKind::stop);
  EXPECT_EQ(supervisor().activity(), Activity::holding);
  run_for(milliseconds(300));
  const double at = supervisor().measured_position()[0];
  run_for(milliseconds(500));
  EXPECT_NEAR(supervisor().measured_position()[0], at, 2e-3);
}

TEST_F(Commands, AJointMayBeLetGoAgainAtAnyTime) {
  enable();
  // While it is passive, on its way back, just back, and long since back.
  for (const std::int64_t after_ms : {1, 50, 300, 480, 495, 500, 505, 510, 520, 540, 600, 1500}) {
    ASSERT_EQ(supervisor().set_passive(0), Refusal::none) << after_ms;
    ASSERT_TRUE(done(milliseconds(500))) << after_ms << " ms: " << describe(supervisor().command().failure);
    run_for(milliseconds(after_ms));
  }
  ASSERT_TRUE(run_until([&] { return supervisor().activity() == Activity::holding; }, milliseconds(3000)));
  run_for(milliseconds(500));
  EXPECT_EQ(supervisor().activity(), Activity::holding);
  EXPECT_EQ(count(events_, EventKind::fault), 0);
}

TEST_F(Commands, OneJointPassiveComesBackByItselfAndIsHeldWhereItIs) {
  enable();
  ASSERT_EQ(supervisor().set_passive(0), Refusal::none);
  ASSERT_TRUE(done(milliseconds(500)));
  EXPECT_EQ(supervisor().activity(), Activity::passive);
  EXPECT_EQ(supervisor().node(0).measured().mode_display, -1);
  EXPECT_EQ(supervisor().node(1).measured().mode_display, 8);
  ASSERT_TRUE(run_until([&] { return supervisor().activity() == Activity::holding; }, milliseconds(3000)));
  EXPECT_EQ(count(events_, EventKind::joint_passive), 1);
  EXPECT_EQ(count(events_, EventKind::joint_active), 1);
  run_for(milliseconds(1000));
  EXPECT_EQ(supervisor().activity(), Activity::holding);
  EXPECT_EQ(count(events_, EventKind::joint_passive), 1) << "let go again by a stale selection";
}

TEST_F(Commands, ActiveTakesAJointBackAtOnce) {
  enable();
  ASSERT_EQ(supervisor().set_passive(0), Refusal::none);
  ASSERT_EQ(supervisor().set_active(1), Refusal::not_passive);
  ASSERT_TRUE(done(milliseconds(500)));
  const Time began = world_.now();
  ASSERT_EQ(supervisor().set_active(0), Refusal::none);
  ASSERT_TRUE(done(milliseconds(400)));
  EXPECT_LT((world_.now() - began).ns, milliseconds(300).ns);
  ASSERT_TRUE(run_until([&] { return supervisor().activity() == Activity::holding; }, milliseconds(500)));
  EXPECT_EQ(supervisor().set_active(0), Refusal::not_passive);
}

TEST_F(Commands, HomingMeetsTheSwitchAndTheRobotHoldsAgain) {
  enable();
  ASSERT_EQ(supervisor().home(0), Refusal::none);
  ASSERT_EQ(supervisor().move(to(1, 0.1)), Refusal::not_ready);
  ASSERT_TRUE(done()) << describe(supervisor().command().failure);
  EXPECT_EQ(count(events_, EventKind::homing_ended), 1);
  ASSERT_TRUE(run_until([&] { return supervisor().activity() == Activity::holding; }, milliseconds(1000)));
  EXPECT_NEAR(supervisor().measured_position()[0], robot_.joints[0].homing.switch_position_rad, 0.02);
  EXPECT_EQ(supervisor().home(7), Refusal::unknown_joint);
}

TEST_F(Commands, HomingCanBeStopped) {
  enable();
  ASSERT_EQ(supervisor().home(0), Refusal::none);
  run_for(milliseconds(800));
  supervisor().stop();
  ASSERT_TRUE(done(milliseconds(3000)));
  ASSERT_TRUE(run_until([&] { return supervisor().activity() == Activity::holding; }, milliseconds(2000)));
  const double at = supervisor().measured_position()[0];
  run_for(milliseconds(500));
  EXPECT_NEAR(supervisor().measured_position()[0], at, 2e-3);
}

TEST_F(Commands, HomingStopsWhenAnotherJointFails) {
  enable();
  ASSERT_EQ(supervisor().home(0), Refusal::none);
  run_for(milliseconds(800));
  ASSERT_GT(std::abs(supervisor().node(0).measured().velocity_rad_s), 0.01) << "it does not move, nothing to stop";
  world_.bus().connect(port_of(2), false);
  ASSERT_TRUE(run_until([&] { return supervisor().activity() == Activity::faulted; }, milliseconds(200)));
  EXPECT_EQ(supervisor().command().failure, CommandFailure::joint_fault);
  EXPECT_EQ(count(events_, EventKind::homing_ended), 1);
  supervisor().stop();
  EXPECT_EQ(supervisor().command().state, CommandState::running);
  ASSERT_TRUE(done(milliseconds(3000)));
  EXPECT_EQ(supervisor().node(0).measured().mode_display, 8) << "done, but still homing";
  const double at = supervisor().measured_position()[0];
  run_for(milliseconds(500));
  EXPECT_NEAR(supervisor().measured_position()[0], at, 2e-3);
}

TEST_F(Commands, HomingIsRefusedWhileAnotherJointIsNotThere) {
  world_.bus().connect(port_of(2), false);
  supervisor().enable(true);
  ASSERT_TRUE(run_until([&] { return supervisor().node(0).stage() == NodeStage::enabled; }));
  ASSERT_EQ(supervisor().activity(), Activity::bringing_up);
  EXPECT_EQ(supervisor().home(0), Refusal::not_ready);
  run_for(milliseconds(100));
  EXPECT_EQ(supervisor().activity(), Activity::bringing_up);
}

TEST_F(Commands, AfterAFailedEnableNobodyIsEnabledUnasked) {
  for (const bool stopped : {false, true}) {
    SCOPED_TRACE(stopped ? "stopped" : "timed out");
    world_.bus().connect(port_of(2), false);
    supervisor().enable(true);
    if (stopped) {
      ASSERT_TRUE(run_until([&] { return supervisor().node(0).stage() == NodeStage::enabled; }));
      supervisor().stop();
      ASSERT_TRUE(done());
    } else {
      ASSERT_FALSE(done());
      EXPECT_EQ(supervisor().command().failure, CommandFailure::timed_out);
    }
    EXPECT_FALSE(braked(0)) << "what is enabled holds";
    world_.bus().connect(port_of(2), true);
    const std::uint8_t id = robot_.joints[2].node_id;
    ASSERT_TRUE(world_.bus().send(0, can::nmt_frame(can::NmtCommand::reset_node, id), world_.now()));  // powered up
    run_for(milliseconds(3000));
    EXPECT_EQ(supervisor().node(2).stage(), NodeStage::idle);
    EXPECT_TRUE(braked(2));
    enable();
    supervisor().enable(false);
    ASSERT_TRUE(done());
  }
}

TEST_F(Commands, DisableInASwingEndsTheSession) {
  sup::HammerSession session(robot_, supervisor(), sup::SessionOptions{});
  bool asked = false;
  bool over = false;
  ASSERT_TRUE(run_until([&] {
    over = session.step(world_.now());
    if (!asked && supervisor().activity() == Activity::approaching) {
      supervisor().enable(false);
      asked = true;
    }
    return over;
  }));
  EXPECT_TRUE(asked);
  EXPECT_EQ(session.verdict(), sup::Verdict::swing_aborted);
  EXPECT_EQ(supervisor().activity(), Activity::disabled);
}

TEST_F(Commands, APlanIsNotExecutedInTheStepThatMadeIt) {
  sup::HammerSession session(robot_, supervisor(), sup::SessionOptions{});
  ASSERT_TRUE(run_until([&] {
    session.step(world_.now());
    return session.plan() != nullptr;
  }));
  EXPECT_EQ(session.state(), sup::SessionState::planned);
  EXPECT_EQ(supervisor().activity(), Activity::holding) << "a stop that came meanwhile must be heard first";
  session.step(world_.now());
  EXPECT_EQ(session.state(), sup::SessionState::swinging);
}

TEST_F(Commands, AJointThatComesBackStaysBrakedUntilRecover) {
  enable();
  world_.bus().connect(port_of(1), false);
  ASSERT_TRUE(run_until([&] { return supervisor().activity() == Activity::faulted; }, milliseconds(200)));
  // Back before its own watchdogs notice.
  world_.bus().connect(port_of(1), true);
  const std::uint8_t id = robot_.joints[1].node_id;
  ASSERT_TRUE(world_.bus().send(0, can::nmt_frame(can::NmtCommand::reset_node, id), world_.now()));  // as if restarted
  run_for(milliseconds(3000));
  EXPECT_EQ(supervisor().activity(), Activity::faulted);
  EXPECT_EQ(supervisor().node(1).stage(), NodeStage::idle) << describe(supervisor().node(1).stage());
  EXPECT_TRUE(braked(1));
  EXPECT_FALSE(braked(0));
  supervisor().recover();
  ASSERT_TRUE(done());
  EXPECT_EQ(supervisor().activity(), Activity::holding);
}

TEST_F(Commands, DisableAfterAFaultLetsGoOfTheOthers) {
  enable();
  world_.bus().connect(port_of(1), false);
  ASSERT_TRUE(run_until([&] { return supervisor().activity() == Activity::faulted; }, milliseconds(200)));
  const std::uint32_t number = supervisor().command().number;
  supervisor().enable(false);
  EXPECT_EQ(supervisor().command().number, number + 1);
  ASSERT_TRUE(done());
  EXPECT_EQ(supervisor().activity(), Activity::disabled);
  run_for(milliseconds(500));
  EXPECT_TRUE(braked(0));
  EXPECT_TRUE(braked(2));
}

TEST_F(Commands, RefusedNodeIsAskedAgainOnRecover) {
  WorldOptions options = seeded(1).world;
  options.flash = [](int joint, fw::ModuleConfig& config) {
    if (joint == 1) config.configuration_hash ^= 1U;
  };
  World world(robot_, plant_on(robot_, "styrofoam"), options);
  put_to_rest(world);
  world.supervisor().enable(true);
  int identified = 0;
  const auto run = [&](Duration time) {
    const Time end = world.now() + time;
    while (world.now() < end) {
      world.step();
      if (!world.supervisor_stepped()) continue;
      for (const sup::Event& event : world.supervisor().events()) {
        identified += event.kind == EventKind::node_stage && event.joint == 1 &&
                              static_cast<NodeStage>(event.value) == NodeStage::identifying
                          ? 1
                          : 0;
      }
      world.supervisor().events().clear();
    }
  };
  run(milliseconds(2000));
  ASSERT_EQ(world.supervisor().node(1).stage(), NodeStage::refused);
  identified = 0;
  world.supervisor().recover();
  run(milliseconds(1000));
  EXPECT_EQ(identified, 1);
  EXPECT_EQ(world.supervisor().node(1).stage(), NodeStage::refused) << "it still has the wrong configuration";
}

TEST_F(Commands, ALateFaultLeavesTheArmedSwitchAsALateStopDoes) {
  for (const bool fault : {true, false}) {
    SCOPED_TRACE(fault ? "a joint is lost" : "a stop is asked for");
    World world(robot_, plant_on(robot_, "styrofoam"), seeded(1).world);
    put_to_rest(world);
    std::array<bool, kMaxJoints> was_passive{};
    world.on_tick = [&](int joint, Time, const fw::ModuleStatus& status) {
      if (status.law == fw::Law::passive) was_passive[static_cast<std::size_t>(joint)] = true;
    };
    sup::Supervisor& supervisor = world.supervisor();
    sup::SessionOptions options;
    options.mode = sup::PassiveMode::always;
    sup::HammerSession session(robot_, supervisor, options);
    const auto late = [&] {
      return supervisor.activity() == Activity::swinging &&
             supervisor.outcome().switch_effective - world.now() <= milliseconds(60);
    };
    while (world.now() < Time{} + milliseconds(20'000) && !late()) {
      world.step();
      if (!world.supervisor_stepped()) continue;
      supervisor.events().clear();
      session.step(world.now());
    }
    ASSERT_TRUE(late());
    if (fault) {
      world.bus().connect(port_of(0), false);
    } else {
      supervisor.stop();
    }
    const Time end = world.now() + milliseconds(2'500);
    while (world.now() < end) {
      world.step();
      supervisor.events().clear();
    }
    EXPECT_TRUE(was_passive[1]);
    EXPECT_TRUE(was_passive[2]);
    EXPECT_EQ(supervisor.activity(), fault ? Activity::faulted : Activity::holding);
    EXPECT_EQ(world.module(1).status().law, fw::Law::active) << "nobody stays let go";
    EXPECT_TRUE(supervisor.outcome().done);
  }
}

}  // namespace
}  // namespace mrr::sim::test
