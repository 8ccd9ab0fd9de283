// Every pair of situation and request, tried on a module: the arbiter's table is what happens, and docs/arbiter.md is
// what the table says.
#include "module_fw/actions/arbiter.h"

#include <gtest/gtest.h>

#include <fstream>
#include <sstream>

#include "tests/unit/module/module_bench.h"

namespace mrr::fw {
namespace {

using can::LimitCode;
using test::ModuleBench;

ModuleConfig configuration(Situation situation) {
  ModuleConfig c = test::module_config(test::hammer_joint());
  c.homing = {.switch_position_rad = 0.0F, .direction = -1, .fast_rad_s = 0.2F, .slow_rad_s = 0.02F};
  if (situation == Situation::calibration) c.limits.lower_rad = 0.0F;  // and the joint stands below it
  return c;
}

void move_up(ModuleBench& b) {
  const double start = b.seconds_now();
  const double here = double{b.status().reference_position_rad};
  // 1 rad/s within 0.2 s.
  b.trajectory = [=](double t) {
    const double x = t - start;
    const double ramp = std::min(x, 0.2);
    const double s = 2.5 * ramp * ramp + std::max(0.0, x - 0.2);
    return MotionState{static_cast<float>(here + s), static_cast<float>(5.0 * ramp), x < 0.2 ? 5.0F : 0.0F};
  };
  b.run(0.3);
}
void raise_voltage(ModuleBench& b) {
  b.spoil = [](RawSensors& raw) { raw.bus_voltage_adc = 9000; };
}

/// Brings a module into `situation`.
void enter(ModuleBench& b, Situation situation) {
  switch (situation) {
    case Situation::disabled:
      b.run(0.01);
      b.write(0x1019, 0, 240, 1);
      b.receive(can::nmt_frame(can::NmtCommand::start, b.config.node_id));
      b.run(0.1);
      break;
    case Situation::starting:
      enter(b, Situation::disabled);
      for (const std::uint16_t word : std::array<std::uint16_t, 3>{0x06, 0x07, 0x0F}) {
        b.command(word);
        b.run(0.002);
      }
      break;
    case Situation::motion:
      ASSERT_TRUE(b.enable());
      ASSERT_TRUE(b.follow_here());
      move_up(b);
      break;
    case Situation::passive:
      enter(b, Situation::motion);
      b.select(can::SelectionAction::now, false, 1);
      b.run(0.005);
      break;
    case Situation::homing:
      ASSERT_TRUE(b.enable());
      b.set_mode(6);
      b.run(0.01);
      b.command(0x1F);
      b.run(0.1);
      break;
    case Situation::calibration:
      b.joint.place(-0.06);
      ASSERT_TRUE(b.enable());
      b.set_mode(-5);
      b.run(0.01);
      b.command(0x1F);
      b.run(0.2);
      break;
    case Situation::user_stop:
      enter(b, Situation::motion);
      b.command(0x10F);
      b.run(0.002);
      break;
    case Situation::limit:
      enter(b, Situation::motion);
      b.trajectory = nullptr;
      ASSERT_TRUE(b.run_until([&] { return b.status().authority == Authority::limit; }, 0.1));
      break;
    case Situation::fault_reaction:
      enter(b, Situation::motion);
      raise_voltage(b);
      ASSERT_TRUE(b.run_until([&] { return b.status().state == DriveState::fault_reaction_active; }, 0.1));
      break;
    case Situation::fault:
      enter(b, Situation::fault_reaction);
      ASSERT_TRUE(b.run_until([&] { return b.status().state == DriveState::fault; }, 1.0));
      b.spoil = nullptr;
      b.run(0.01);
      break;
  }
  ASSERT_EQ(b.module.situation(), situation) << kSituationNames[static_cast<std::size_t>(situation)];
}

/// Makes the request; the bits of what goes on stay set. A calibration is asked for by its mode.
void make(ModuleBench& b, Situation situation, Request request, Mode calibration) {
  const std::uint16_t word = b.controlword;
  const float here = b.status().position_rad;
  switch (request) {
    case Request::set_points:
      if (b.mode != 8) b.set_mode(8);
      if (situation != Situation::motion) b.trajectory = [here](double) { return MotionState{here, 0.0F, 0.0F}; };
      break;
    case Request::selection:
      b.select(can::SelectionAction::now, situation == Situation::passive, 9);
      break;
    case Request::homing:
      b.mode = 6;
      b.command(static_cast<std::uint16_t>(word | 0x10U));
      break;
    case Request::calibration:
      b.mode = static_cast<std::int8_t>(calibration);
      b.command(static_cast<std::uint16_t>(word | 0x10U));
      if (situation == Situation::homing) {  // its start bit is set already: the action needs an edge of its own
        b.tick();
        b.command(static_cast<std::uint16_t>(word & ~0x10U));
        b.tick();
        b.command(static_cast<std::uint16_t>(word | 0x10U));
      }
      break;
    case Request::halt:
      b.command(static_cast<std::uint16_t>(word | 0x100U));
      break;
    case Request::quick_stop:
      b.command(0x02);
      break;
    case Request::limit:
      b.spoil = [=](RawSensors& raw) {
        raw.inputs |= situation == Situation::homing ? kInputNegativeLimit : kInputPositiveLimit;
      };
      break;
    case Request::disable:
      b.command(0x06);
      break;
    case Request::fault:
      b.spoil = [](RawSensors& raw) { raw.drive_temperature_adc = 1200; };
      break;
    case Request::fault_reset:
      b.command(static_cast<std::uint16_t>(word | 0x80U));
      break;
  }
}

/// Whether the request has effect now.
bool has_effect(ModuleBench& b, Situation situation, Request request, Mode calibration) {
  const ModuleStatus& s = b.status();
  switch (request) {
    case Request::set_points:
      return s.following_knots;
    case Request::selection:
      return s.law == (situation == Situation::passive ? Law::active : Law::passive);
    case Request::homing:
      return b.module.situation() == Situation::homing;
    case Request::calibration:
      return b.module.situation() == Situation::calibration && s.mode == calibration;
    case Request::halt:
      if (situation == Situation::disabled) {
        b.command(0x106);
        b.run(0.005);
        b.command(0x107);
        b.run(0.005);
        b.command(0x10F);
        b.run(0.3);
      }
      return b.status().authority == Authority::user_stop;
    case Request::quick_stop:
      return s.state == DriveState::quick_stop_active || s.state == DriveState::switch_on_disabled;
    case Request::limit:
      return s.limit == LimitCode::limit_switch || s.authority == Authority::limit ||
             (situation == Situation::homing && s.velocity_rad_s > 0.0F);  // it turns round
    case Request::disable:
      return s.state == DriveState::ready_to_switch_on;
    case Request::fault:
      for (const std::uint32_t entry : b.module.objects().error_history) {
        if (static_cast<std::uint16_t>(entry) == static_cast<std::uint16_t>(can::Emergency::drive_over_temperature))
          return true;
      }
      return false;
    case Request::fault_reset:
      return situation >= Situation::fault_reaction && s.state == DriveState::switch_on_disabled;
  }
  return false;
}

void try_pair(Situation situation, Request request, Mode calibration = Mode::torque_zero) {
  const Rule& r = rule(situation, request);
  ModuleBench b(test::hammer_joint(), configuration(situation));
  enter(b, situation);
  if (testing::Test::HasFatalFailure()) return;
  make(b, situation, request, calibration);
  // Long enough for one knot period; a joint that comes to rest takes longer.
  const bool slow = request == Request::limit && situation == Situation::homing;
  b.run(slow ? 0.2 : 0.010);
  // An action that is waited for has not ended, one that is pre-empted has.
  const Situation now = b.module.situation();
  if (r.verdict == Verdict::pre_empts) {
    EXPECT_NE(now, situation);
  } else if (request != Request::fault_reset || r.verdict == Verdict::refused) {
    const bool over = request == Request::disable && situation == Situation::disabled;
    if (!over) {
      EXPECT_EQ(now, situation);
    }
  }
  if (r.verdict == Verdict::refused || r.verdict == Verdict::waits) {
    EXPECT_FALSE(request != Request::quick_stop && has_effect(b, situation, request, calibration));
    switch (r.shown) {
      case Shown::statusword:
        break;
      case Shown::code:
        EXPECT_EQ(b.status().limit, r.code) << can::name_of_code(static_cast<std::uint16_t>(b.status().limit));
        break;
      case Shown::own_cause:
        EXPECT_NE(b.module.objects().error_or_limit, 0);
        break;
    }
  } else {
    EXPECT_TRUE(has_effect(b, situation, request, calibration));
  }
  if (r.verdict == Verdict::waits) {
    if (situation == Situation::homing || situation == Situation::calibration) {
      if (situation == Situation::calibration) b.run(1.5);  // it ends by itself, within the limits
      b.command(0x0F);                                      // what goes on is ended
      b.run(0.3);
      const float here = b.status().position_rad;
      b.trajectory = [here](double) { return MotionState{here, 0.0F, 0.0F}; };
      if (request == Request::homing) b.command(0x1F);
      b.run(0.05);
    } else {
      b.run(0.2);
      if (request == Request::homing || request == Request::calibration) {
        b.command(0x0F);
        b.run(0.01);
        b.command(0x1F);
        b.run(0.05);
      }
    }
    EXPECT_TRUE(has_effect(b, situation, request, calibration)) << "it has waited in vain";
  }
}

class ArbiterTable : public testing::TestWithParam<std::tuple<std::size_t, std::size_t>> {};

TEST_P(ArbiterTable, IsWhatHappens) {
  try_pair(static_cast<Situation>(std::get<0>(GetParam())), static_cast<Request>(std::get<1>(GetParam())));
}

// Limit recovery has nothing to do within the limits; where it has, it is what goes on in `calibration`.
TEST(Arbiter, TreatsTheCalibrationsAlike) {
  for (const Mode mode : {Mode::brake_test, Mode::identification}) {
    for (std::size_t s = 0; s < kSituations; ++s) {
      SCOPED_TRACE(std::string(kSituationNames[s]) + ", mode " + std::to_string(static_cast<int>(mode)));
      try_pair(static_cast<Situation>(s), Request::calibration, mode);
      if (testing::Test::HasFatalFailure()) return;
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Pairs, ArbiterTable,
                         testing::Combine(testing::Range(std::size_t{0}, kSituations),
                                          testing::Range(std::size_t{0}, kRequests)),
                         [](const auto& pair) {
                           return std::string(kSituationNames[std::get<0>(pair.param)]) + "_asked_for_" +
                                  kRequestNames[std::get<1>(pair.param)];
                         });

std::string words(const Rule& r) {
  std::string text;
  switch (r.verdict) {
    case Verdict::accepted:
      return "accepted";
    case Verdict::pre_empts:
      return "**pre-empts**";
    case Verdict::waits:
      text = "waits";
      break;
    case Verdict::refused:
      text = "refused";
      break;
  }
  if (r.shown == Shown::own_cause) text += ", its cause";
  if (r.shown == Shown::code)
    text += std::string(", ") + std::to_string(static_cast<int>(r.code)) + " " +
            can::name_of_code(static_cast<std::uint16_t>(r.code));
  return text;
}

TEST(Arbiter, ThePageIsWhatTheTableSays) {
  std::ostringstream table;
  table << "| |";
  for (const char* name : kRequestNames) table << ' ' << name << " |";
  table << "\n|";
  for (std::size_t i = 0; i <= kRequests; ++i) table << " --- |";
  table << '\n';
  for (std::size_t s = 0; s < kSituations; ++s) {
    table << "| " << kSituationNames[s] << " |";
    for (std::size_t r = 0; r < kRequests; ++r) table << ' ' << words(kArbiter[s][r]) << " |";
    table << '\n';
  }
  std::ifstream file(std::string(MRR_SOURCE_DIR) + "/docs/arbiter.md");
  std::stringstream page;
  page << file.rdbuf();
  EXPECT_NE(page.str().find(table.str()), std::string::npos) << "docs/arbiter.md must contain:\n" << table.str();
}

}  // namespace
}  // namespace mrr::fw
