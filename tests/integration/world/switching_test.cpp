// The switch, as the drives are asked for torque and as the wire carries it.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
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

}  // namespace
}  // namespace mrr::sim::test
