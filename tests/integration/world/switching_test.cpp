// The switch, as the drives are asked for torque and as the wire carries it.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <optional>
#include <vector>

#include "can_protocol/client.h"
#include "tests/integration/world/whole_robot.h"

namespace mrr::sim::test {
namespace {

constexpr std::uint32_t kSelectionId = can::kRpdo4CobId;

struct TorqueTick {
  Time at;
  fw::Law law = fw::Law::off;
  bool enabled = false;
  float command_nm = 0.0F;
  float active_nm = 0.0F;
  float passive_nm = 0.0F;
};
using TorqueTrace = std::vector<std::vector<TorqueTick>>;

TorqueTrace trace_of_job(const RobotDescription& robot, const char* board, std::uint64_t seed, sup::PassiveMode mode) {
  TorqueTrace trace(robot.joints.size());
  HammerJobOptions options = seeded(seed);
  options.session.mode = mode;
  (void)hammer(robot, board, options, [&trace](World& world) {
    world.on_tick = [&trace](int joint, Time at, const fw::ModuleStatus& status) {
      trace[static_cast<std::size_t>(joint)].push_back(
          {at, status.law, status.state == fw::DriveState::operation_enabled, status.torque_command_nm,
           status.active_torque_nm, status.passive_torque_nm});
    };
  });
  return trace;
}

constexpr float kRounding_nm = 1e-4F;

bool between(float value, float a, float b) {
  return value >= std::min(a, b) - kRounding_nm && value <= std::max(a, b) + kRounding_nm;
}

class TorqueAtTheSwitch : public testing::TestWithParam<std::uint64_t> {};
INSTANTIATE_TEST_SUITE_P(Seeds, TorqueAtTheSwitch, testing::Range<std::uint64_t>(1, 5));

TEST_P(TorqueAtTheSwitch, FallsMonotonicallyFromActiveToPassiveWithinTheBlend) {
  const RobotDescription robot = example("mrr3");
  int switches = 0;
  for (const sup::PassiveMode mode : {sup::PassiveMode::planned, sup::PassiveMode::always}) {
    const TorqueTrace trace = trace_of_job(robot, "hardwood", GetParam(), mode);
    for (std::size_t i = 0; i < trace.size(); ++i) {
      SCOPED_TRACE(robot.joints[i].name);
      const std::vector<TorqueTick>& ticks = trace[i];
      const auto blend_ticks =
          static_cast<std::size_t>(std::lround(robot.joints[i].control.passive_blend_s * robot.bus.loop_rate_hz));
      for (std::size_t k = 1; k + blend_ticks < ticks.size(); ++k) {
        if (!(ticks[k].law == fw::Law::passive && ticks[k - 1].law == fw::Law::active)) continue;
        ++switches;
        const float from_nm = ticks[k - 1].command_nm;
        const TorqueTick& last = ticks[k + blend_ticks - 1];
        EXPECT_NEAR(last.command_nm, last.passive_nm, kRounding_nm) << "the blend has not ended in time";
        for (std::size_t t = k; t < k + blend_ticks; ++t) {
          ASSERT_EQ(ticks[t].law, fw::Law::passive);
          EXPECT_TRUE(between(ticks[t].command_nm, ticks[t - 1].command_nm, last.command_nm))
              << "tick " << t - k << " at " << ticks[t].at.seconds() << " s: " << ticks[t - 1].command_nm << " -> "
              << ticks[t].command_nm << " on the way from " << from_nm << " to " << last.command_nm << " Nm";
        }
      }
    }
  }
  EXPECT_GE(switches, 3 + 9) << "at least one joint in three planned swings, three joints in three others";
}

TEST_P(TorqueAtTheSwitch, ComesBackAtABoundedRateAndNeverPastTheActiveTorque) {
  const RobotDescription robot = example("mrr3");
  int returns = 0;
  for (const char* board : {"hardwood", "styrofoam"}) {
    const TorqueTrace trace = trace_of_job(robot, board, GetParam(), sup::PassiveMode::planned);
    for (std::size_t i = 0; i < trace.size(); ++i) {
      SCOPED_TRACE(robot.joints[i].name);
      const std::vector<TorqueTick>& ticks = trace[i];
      const auto slew_nm =
          static_cast<float>(robot.joints[i].control.resume_torque_slew_nm_s / robot.bus.loop_rate_hz) + kRounding_nm;
      for (std::size_t k = 1; k < ticks.size(); ++k) {
        if (!(ticks[k].law == fw::Law::active && ticks[k - 1].law == fw::Law::passive)) continue;
        ++returns;
        for (std::size_t t = k; t < ticks.size() && ticks[t].law == fw::Law::active; ++t) {
          const TorqueTick& tick = ticks[t];
          const float before_nm = ticks[t - 1].command_nm;
          EXPECT_LE(std::abs(tick.command_nm - before_nm), slew_nm) << "at " << tick.at.seconds() << " s";
          EXPECT_TRUE(between(tick.command_nm, before_nm, tick.active_nm))
              << "at " << tick.at.seconds() << " s: " << before_nm << " -> " << tick.command_nm << " Nm, active law "
              << tick.active_nm << " Nm";
          if (std::abs(tick.command_nm - tick.active_nm) <= kRounding_nm) break;  // caught up
          ASSERT_LE(t, k + 200) << "still not caught up";
        }
      }
    }
  }
  EXPECT_GE(returns, 4);
}

TEST(DroppedSelection, IsRepeatedUntilAcknowledged) {
  const RobotDescription robot = example("mrr3");
  HammerJobOptions options = seeded(1);
  options.session.max_swings = 1;
  const auto arms_on_the_wire = [&](int dropped) {
    int arms = 0;
    const HammerJobResult job = hammer(robot, "hardwood", options, [&](World& world) {
      if (dropped > 0) {
        EXPECT_TRUE(world.bus().inject(WireFault::kDrop, kSelectionId, false, dropped));
      }
      world.on_frame = [&arms](const Delivery& delivery) {
        const auto command = can::parse_selection(delivery.frame);
        arms += command && command->action == can::SelectionAction::arm ? 1 : 0;
      };
    });
    EXPECT_EQ(job.truth.size(), 1U) << job.reason;
    EXPECT_TRUE(!job.truth.empty() && job.truth[0].hit) << job.reason;
    EXPECT_TRUE(job.within_limits) << job.limit_note;
    EXPECT_EQ(count(job.events, sup::EventKind::selection_acknowledged), 1);
    return arms;
  };
  const int undisturbed = arms_on_the_wire(0);
  EXPECT_GE(undisturbed, 1);
  EXPECT_GE(arms_on_the_wire(1), undisturbed + 1);
  EXPECT_GE(arms_on_the_wire(8), undisturbed + 8);
}

/// `receivers`: ports which lose every selection frame.
void expect_aborted_before_contact(std::uint32_t receivers) {
  const RobotDescription robot = example("mrr3");
  int passive_ticks = 0;
  double largest_force_n = 0.0;
  const HammerJobResult job = hammer(robot, "styrofoam", seeded(1), [&](World& world) {
    EXPECT_TRUE(world.bus().inject(WireFault::kDrop, kSelectionId, false, 1'000'000, receivers));
    world.on_tick = [&](int, Time, const fw::ModuleStatus& status) {
      passive_ticks += status.law == fw::Law::passive ? 1 : 0;
      largest_force_n = std::max(largest_force_n, world.plant().truth().contact_force_n);
    };
  });
  EXPECT_EQ(job.verdict, sup::Verdict::swing_aborted) << job.reason;
  ASSERT_EQ(job.swings.size(), 1U);
  EXPECT_EQ(job.swings[0].outcome.aborted, sup::AbortReason::not_acknowledged);
  EXPECT_FALSE(job.truth[0].hit);
  EXPECT_EQ(largest_force_n, 0.0) << "something was hit";
  EXPECT_EQ(passive_ticks, 0) << "some joint let go";
}

TEST(LostSelection, AbortsTheSwingBeforeAnythingIsHit) { expect_aborted_before_contact(0xFFFF'FFFFU); }

TEST(LostSelection, ByOneJointAbortsTheSwingBeforeAnythingIsHit) {
  for (unsigned port = 1; port <= 3; ++port) {
    SCOPED_TRACE(port);
    expect_aborted_before_contact(1U << port);
  }
}

TEST(NoisyWire, RepeatsCorruptedFramesAndFinishesTheJob) {
  const HammerJobResult job = hammer(example("mrr3"), "styrofoam", seeded(3), [](World& world) {
    world.bus().set_error_probability(2e-3);  // some ten error frames a second
  });
  EXPECT_TRUE(job.success()) << job.reason << " " << job.limit_note;
}

/// Swings that are armed 40 ms too late, so that the switch is pulled when the approach is seen to be there.
class PulledSwitch : public WatchedRobot {
 protected:
  /// From the end of the last frame that the condition became true with to the end of the order's frame, and on to the
  /// control tick in which the last joint is passive.
  struct Delays {
    Duration order, passive;
  };
  std::optional<Delays> swing(Duration waited) {
    supervisor().enable(true);
    if (!run_until([&] { return supervisor().activity() == sup::Activity::holding; })) return std::nullopt;
    run_for(waited);
    const TaskDescription& task = robot_.task;
    sup::PlanInput input;
    input.normal = task.normal;
    input.board_distance_m = task.nail_height_m;
    input.head_position_m = task.nail_position_m + task.nail_height_m * task.normal;
    input.mode = sup::PassiveMode::always;
    input.start = supervisor().reference_position();
    sup::StrikePlan plan = sup::plan(robot_, supervisor().chain(), input);
    plan.switch_time += milliseconds(40);
    Time fed_back, ordered, last_feedback;
    std::vector<Time> passive(robot_.joints.size());
    world_.on_frame = [&](const Delivery& delivery) {
      const std::uint32_t kind = delivery.frame.id & 0x780U;
      const bool feedback = kind == can::kTpdo1CobId || kind == can::kTpdo2CobId;
      if (feedback && delivery.frame.id != kSelectionId) last_feedback = delivery.at;
      const auto command = can::parse_selection(delivery.frame);
      if (!command || command->action != can::SelectionAction::now || ordered.ns != 0) return;
      ordered = delivery.at;
      fed_back = last_feedback;
    };
    world_.on_tick = [&](int joint, Time, const fw::ModuleStatus& status) {
      Time& since = passive[static_cast<std::size_t>(joint)];
      if (since.ns == 0 && status.law == fw::Law::passive) since = world_.now();
    };
    if (supervisor().execute(plan) != sup::Refusal::none) return std::nullopt;
    const bool pulled = run_until([&] { return supervisor().outcome().pulled; });
    run_for(milliseconds(10));
    world_.on_frame = {};
    world_.on_tick = {};
    if (!pulled || *std::min_element(passive.begin(), passive.end()) == Time{}) return std::nullopt;
    return Delays{ordered - fed_back, *std::max_element(passive.begin(), passive.end()) - ordered};
  }
};

// Event-triggered: the supervisor's cycle that sees it (1 ms at most), a frame (and another one that is on the wire),
// and a control tick.
TEST_F(PulledSwitch, IsInForceOneFrameAndOneTickAfterTheCycleThatSeesTheCondition) {
  constexpr Duration kCycle = milliseconds(1);
  constexpr Duration kTick = milliseconds(1);
  constexpr Duration kFrame = microseconds(135);
  Duration slowest_order{}, slowest_passive{};
  for (int k = 0; k < 6; ++k) {
    SCOPED_TRACE(k);
    // Another phase of the modules' ticks: their clocks drift.
    const std::optional<Delays> delays = swing(milliseconds(700 * k + 1));
    ASSERT_TRUE(delays.has_value());
    EXPECT_LE(delays->order, kCycle + kFrame * 2);
    EXPECT_LE(delays->passive, kTick + microseconds(1));
    slowest_order = std::max(slowest_order, delays->order);
    slowest_passive = std::max(slowest_passive, delays->passive);
    ASSERT_TRUE(run_until([&] { return supervisor().activity() == sup::Activity::holding; }));
  }
  RecordProperty("slowest_order_us", static_cast<int>(slowest_order.ns / 1000));
  RecordProperty("slowest_passive_us", static_cast<int>(slowest_passive.ns / 1000));
  std::printf("pulled switch: order on the bus after at most %d us, passive %d us later at most\n",
              static_cast<int>(slowest_order.ns / 1000), static_cast<int>(slowest_passive.ns / 1000));
}

}  // namespace
}  // namespace mrr::sim::test
