// The supervisor's state machine when it is disturbed: stops, faults, lost and rebooted joints, commands that went
// stale.
#include <gtest/gtest.h>

#include <limits>
#include <vector>

#include "tests/integration/world/whole_robot.h"

namespace mrr::sim::test {
namespace {

using sup::Activity;
using sup::EventKind;

int port_of(int joint) { return joint + 1; }

/// A robot with one planned swing that the test may run, without a session.
class Supervised : public WatchedRobot {
 protected:
  Supervised() {
    world_.on_frame = [this](const Delivery& delivery) {
      if (delivery.frame.id == 0x181 && !delivery.frame.extended) selections_.push_back(delivery.at);
    };
    world_.on_tick = [this](int joint, Time, const fw::ModuleStatus& status) {
      rejected_[at(joint)] = status.knots_rejected;
      if (status.law == fw::Law::passive) was_passive_[at(joint)] = true;
    };
  }
  static std::size_t at(int i) { return static_cast<std::size_t>(i); }

  using WatchedRobot::run_until;
  [[nodiscard]] bool run_until(Activity activity) {
    return run_until([&] { return supervisor().activity() == activity; });
  }
  [[nodiscard]] sup::StrikePlan plan() {
    sup::PlanInput request;
    request.normal = robot_.task.normal;
    request.head_position_m = robot_.task.nail_position_m + robot_.task.nail_height_m * request.normal;
    request.board_distance_m = robot_.task.nail_height_m;
    request.mode = sup::PassiveMode::always;
    request.start = supervisor().reference().q;
    return sup::plan(robot_, supervisor().chain(), request);
  }
  void enable() {
    supervisor().enable(true);
    ASSERT_TRUE(run_until(Activity::holding));
  }
  /// Runs a swing up to `before` the planned contact.
  void swing_until(Duration before) {
    enable();
    ASSERT_EQ(supervisor().execute(plan()), sup::Refusal::none);
    ASSERT_TRUE(run_until([&] {
      return supervisor().activity() == Activity::swinging &&
             world_.now() >= supervisor().outcome().planned_contact - before;
    }));
  }
  [[nodiscard]] bool nobody_was_passive() const {
    for (const bool was : was_passive_) {
      if (was) return false;
    }
    return true;
  }
  [[nodiscard]] int announced(EventKind kind, int joint) const {
    int n = 0;
    for (const sup::Event& event : events_) n += event.kind == kind && event.joint == joint ? 1 : 0;
    return n;
  }

  std::vector<Time> selections_;
  std::array<std::uint32_t, kMaxJoints> rejected_{};
  std::array<bool, kMaxJoints> was_passive_{};
};

TEST_F(Supervised, StopOnTheWayInIsFollowedByEveryJoint) {
  swing_until(milliseconds(120));
  ASSERT_GT(supervisor().reference().qd.cwiseAbs().maxCoeff(), 0.3) << "rad/s: slow, nothing to stop";
  const auto rejected_before = rejected_;
  supervisor().stop();
  ASSERT_TRUE(run_until([&] { return supervisor().activity() == Activity::stopping; }, milliseconds(10)));
  run_for(milliseconds(40));
  EXPECT_EQ(rejected_, rejected_before) << "a stopping motion must not jump";
}

TEST_F(Supervised, StopWhileTheSwitchIsArmedWithdrawsIt) {
  swing_until(milliseconds(300));
  ASSERT_EQ(count(events_, EventKind::selection_acknowledged), 1);
  supervisor().stop();
  ASSERT_TRUE(run_until(Activity::holding));
  run_for(milliseconds(1'000));
  EXPECT_EQ(supervisor().activity(), Activity::holding);
  EXPECT_EQ(supervisor().outcome().aborted, sup::AbortReason::stop_requested);
  EXPECT_EQ(count(events_, EventKind::selection_cancelled), 1);
  EXPECT_TRUE(nobody_was_passive());
  EXPECT_TRUE(world_.plant().contacts().empty());
}

TEST_F(Supervised, StopAfterTheBlowHoldsInsteadOfReturning) {
  swing_until(milliseconds(50));
  ASSERT_TRUE(run_until(Activity::resuming));
  supervisor().stop();
  ASSERT_TRUE(run_until(Activity::holding));
  EXPECT_TRUE(supervisor().outcome().done);
  EXPECT_EQ(supervisor().outcome().aborted, sup::AbortReason::stop_requested);
  const sup::JointVector q = supervisor().measured_position();
  EXPECT_GT((q - plan().q_back_swing).cwiseAbs().maxCoeff(), 0.05) << "rad: it went back all the same";
}

TEST_F(Supervised, RepeatedStopsAreOneStop) {
  swing_until(milliseconds(400));
  const Time end = world_.now() + milliseconds(3'000);
  while (supervisor().activity() != Activity::holding && world_.now() < end) {
    supervisor().stop();
    step();
  }
  EXPECT_EQ(supervisor().activity(), Activity::holding);
  EXPECT_EQ(count(events_, EventKind::swing_aborted), 1);
}

TEST_F(Supervised, JointLostWithTheSwitchArmedInTimeWithdrawsItForTheOthers) {
  swing_until(milliseconds(350));
  ASSERT_EQ(count(events_, EventKind::selection_acknowledged), 1);
  world_.bus().connect(port_of(0), false);
  ASSERT_TRUE(run_until(Activity::faulted));
  run_for(milliseconds(1'500));
  EXPECT_FALSE(was_passive_[1]);
  EXPECT_FALSE(was_passive_[2]);
  EXPECT_TRUE(world_.plant().contacts().empty());
}

TEST_F(Supervised, AFaultLeavesNoSelectionToBeRepeated) {
  swing_until(milliseconds(450));
  ASSERT_EQ(count(events_, EventKind::selection_armed), 0);
  // Gone just before the switch is armed: it cannot acknowledge.
  ASSERT_TRUE(run_until([&] { return supervisor().outcome().switch_effective - world_.now() <= milliseconds(410); }));
  world_.bus().connect(port_of(2), false);
  ASSERT_TRUE(run_until(Activity::faulted));
  run_for(milliseconds(300));
  selections_.clear();
  run_for(milliseconds(500));
  EXPECT_TRUE(selections_.empty()) << selections_.size() << " stale selections went out";
  world_.bus().connect(port_of(2), true);
  run_for(milliseconds(500));
  supervisor().recover();
  ASSERT_TRUE(run_until(Activity::holding));
  was_passive_ = {};
  run_for(milliseconds(1'500));
  EXPECT_TRUE(nobody_was_passive());
  EXPECT_EQ(supervisor().activity(), Activity::holding);
}

TEST_F(Supervised, JointThatRebootsOnTheWayInAbortsTheSwing) {
  swing_until(milliseconds(600));
  const std::uint8_t id = robot_.joints[0].node_id;
  ASSERT_TRUE(world_.bus().send(0, can::nmt_frame(can::NmtCommand::reset_node, id), world_.now()));
  ASSERT_TRUE(run_until(Activity::faulted)) << describe(supervisor().activity());
  EXPECT_EQ(supervisor().outcome().aborted, sup::AbortReason::joint_fault);
  EXPECT_EQ(announced(EventKind::fault, 0), 1);
  run_for(milliseconds(2'000));
  EXPECT_EQ(supervisor().activity(), Activity::faulted) << "nobody acknowledged it";
  EXPECT_TRUE(world_.plant().contacts().empty());
  supervisor().recover();
  EXPECT_TRUE(run_until(Activity::holding));
}

TEST_F(Supervised, FaultDuringBringUpIsAnnouncedOnceAndMayBeRecovered) {
  enable();
  world_.bus().connect(port_of(1), false);
  ASSERT_TRUE(run_until(Activity::faulted));
  supervisor().recover();  // too early: the joint is still away
  run_for(milliseconds(500));
  EXPECT_EQ(supervisor().activity(), Activity::bringing_up);
  events_.clear();
  world_.bus().connect(port_of(1), true);
  run_for(milliseconds(2'000));
  EXPECT_LE(announced(EventKind::fault, 1), 1);
  EXPECT_EQ(supervisor().dropped_events(), 0U);
  EXPECT_EQ(supervisor().activity(), Activity::bringing_up);
  supervisor().recover();
  EXPECT_TRUE(run_until(Activity::holding));
}

TEST_F(Supervised, RecoverWithoutAFaultDoesNotAcknowledgeALaterOne) {
  supervisor().enable(true);
  run_for(milliseconds(50));
  ASSERT_EQ(supervisor().activity(), Activity::bringing_up);
  supervisor().recover();
  ASSERT_TRUE(run_until(Activity::holding));
  world_.bus().connect(port_of(1), false);
  ASSERT_TRUE(run_until(Activity::faulted));
  run_for(milliseconds(200));
  EXPECT_EQ(supervisor().activity(), Activity::faulted);
}

TEST_F(Supervised, JointWhoseDataStopsIsLostLongBeforeItsHeartbeatIsMissed) {
  swing_until(milliseconds(600));
  const Time cut = world_.now();
  world_.bus().connect(port_of(0), false);
  ASSERT_TRUE(run_until(Activity::faulted));
  EXPECT_LE((world_.now() - cut).ns, milliseconds(40).ns);
}

TEST_F(Supervised, FaultResetIsNotRepeatedForEver) {
  enable();
  world_.bus().connect(port_of(1), false);
  run_for(milliseconds(2'000));  // its own watchdogs have put it into fault
  // A fault that stays: no set points and no heartbeat reach it, but it is heard.
  world_.bus().connect(port_of(1), true);
  ASSERT_TRUE(run_until([&] { return supervisor().node(1).stage() == sup::NodeStage::faulted; }));
  int words = 0;
  const auto id = static_cast<std::uint32_t>(can::kRpdo1CobId + robot_.joints[1].node_id);
  world_.on_frame = [&](const Delivery& delivery) { words += delivery.frame.id == id ? 1 : 0; };
  world_.bus().inject(WireFault::kDrop, id, false, std::numeric_limits<int>::max());
  supervisor().recover();
  run_for(milliseconds(3'000));
  EXPECT_GE(words, 1);
  EXPECT_LE(words, 20) << "of one acknowledgement that was lost on the wire";
  EXPECT_EQ(supervisor().node(1).stage(), sup::NodeStage::faulted);
}

TEST_F(Supervised, AnAcknowledgementDoesNotOutlastTheLossOfTheJoint) {
  enable();
  world_.bus().connect(port_of(1), false);
  run_for(milliseconds(2'000));  // its own watchdogs have put it into fault
  world_.bus().connect(port_of(1), true);
  ASSERT_TRUE(run_until([&] { return supervisor().node(1).stage() == sup::NodeStage::faulted; }));
  run_for(milliseconds(100));
  world_.bus().connect(port_of(1), false);
  run_for(milliseconds(420));
  ASSERT_EQ(supervisor().node(1).stage(), sup::NodeStage::faulted);
  supervisor().recover();  // some resets are left when it is given up as lost
  ASSERT_TRUE(run_until([&] { return supervisor().node(1).stage() == sup::NodeStage::lost; }, milliseconds(140)));
  world_.bus().connect(port_of(1), true);
  run_for(milliseconds(2'000));
  EXPECT_EQ(supervisor().node(1).stage(), sup::NodeStage::faulted) << "acknowledged by nobody";
}

TEST_F(Supervised, SyncDeliveredTwiceDisturbsNoSwing) {
  swing_until(milliseconds(600));
  const auto rejected_before = rejected_;
  std::uint32_t missing = 0;
  for (int i = 0; i < robot_.dof(); ++i) missing += world_.module(i).status().knots_missing;
  bool doubled = false;
  const auto before = world_.on_frame;
  world_.on_frame = [&](const Delivery& delivery) {
    before(delivery);
    // After the last set point of the cycle.
    const auto last = static_cast<std::uint32_t>(can::kRpdo3CobId + robot_.joints[2].node_id);
    if (delivery.frame.id != last || doubled) return;
    doubled = true;
    (void)world_.bus().send(0, can::sync_frame(world_.module(0).status().sync_counter), delivery.at);
  };
  ASSERT_TRUE(run_until(Activity::holding));
  ASSERT_TRUE(doubled);
  for (int i = 0; i < robot_.dof(); ++i) missing -= world_.module(i).status().knots_missing;
  EXPECT_EQ(missing, 0U);
  EXPECT_EQ(rejected_, rejected_before);
  EXPECT_EQ(supervisor().outcome().aborted, sup::AbortReason::none);
}

TEST_F(Supervised, SwingWhoseSwitchComesAfterItsEndIsRefused) {
  enable();
  sup::StrikePlan late = plan();
  late.switch_time = late.strike.duration() + milliseconds(1);
  EXPECT_EQ(supervisor().execute(late), sup::Refusal::not_usable);
  sup::StrikePlan foreign = plan();
  foreign.passive |= 1U << 3U;
  EXPECT_EQ(supervisor().execute(foreign), sup::Refusal::not_usable);
}

TEST(SupervisorStart, KnotRateTooFastForTheSyncCounterIsRefused) {
  RobotDescription robot = example("mrr3");
  robot.bus.knot_rate_hz = 1000.0;
  robot.bus.bit_rate = 1e7;  // the load is not the point here
  EXPECT_THROW(sup::Supervisor(robot, {}), DescriptionError);
}

}  // namespace
}  // namespace mrr::sim::test
