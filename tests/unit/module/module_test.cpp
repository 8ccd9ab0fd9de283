// The whole module, led by real frames.
#include "module_fw/module.h"

#include <gtest/gtest.h>

#include <bit>

#include <cmath>

#include "tests/unit/module/module_bench.h"

namespace mrr::fw {
namespace {

using can::Emergency;
using can::LimitCode;
using test::ModuleBench;

// A quintic from rest to rest, as the supervisor's planner makes them.
struct RestToRest {
  double from, to, start_s, duration_s;
  MotionState operator()(double t) const {
    const double s = std::clamp((t - start_s) / duration_s, 0.0, 1.0);
    const double d = to - from;
    const double p = s * s * s * (10 - 15 * s + 6 * s * s);
    const double v = 30 * s * s * (1 - 2 * s + s * s) / duration_s;
    const double a = 60 * s * (1 - 3 * s + 2 * s * s) / (duration_s * duration_s);
    return {static_cast<float>(from + d * p), static_cast<float>(d * v), static_cast<float>(d * a)};
  }
};

TEST(Module, WalksThroughTheStatesOfCia402) {
  ModuleBench b;
  b.run(0.01);
  EXPECT_EQ(b.status().state, DriveState::switch_on_disabled);
  b.receive(can::nmt_frame(can::NmtCommand::start, b.config.node_id));
  b.run(0.01);
  const auto word = [&] { return b.module.objects().statusword & 0x6FU; };
  EXPECT_EQ(word() & 0x4FU, 0x40U);
  b.command(0x06);
  b.run(0.002);
  EXPECT_EQ(word(), 0x21U);
  b.command(0x07);
  b.run(0.002);
  EXPECT_EQ(word(), 0x23U);
  b.command(0x0F);
  b.run(0.002);
  EXPECT_EQ(word(), 0x27U);
  b.command(0x02);  // quick stop
  b.run(0.002);
  EXPECT_EQ(word(), 0x07U);
  b.command(0x0F);
  b.run(0.002);
  EXPECT_EQ(word(), 0x27U);
  b.command(0x07);
  b.run(0.002);
  EXPECT_EQ(word(), 0x23U);
  b.command(0x06);
  b.run(0.002);
  EXPECT_EQ(word(), 0x21U);
  b.command(0x00);
  b.run(0.002);
  EXPECT_EQ(word() & 0x4FU, 0x40U);
}

TEST(Module, ReleasesTheBrakeOnlyUnderTorqueAndEngagesItBeforeTorqueGoes) {
  auto p = test::hammer_joint();
  p.gravity_nm = 10.0;
  ModuleBench b(p);
  double lowest = 1e9;
  double highest = -1e9;
  b.each_tick = [&](const ModuleStatus&) {
    lowest = std::min(lowest, b.joint.motor_q);
    highest = std::max(highest, b.joint.motor_q);
    EXPECT_TRUE(b.actuator.power_stage_enabled || !b.actuator.brake_release);
  };
  b.joint.place(0.3);
  ASSERT_TRUE(b.enable());
  b.run(0.2);
  EXPECT_NEAR(b.joint.torque(), 9.55, 1.5);
  b.command(0x06);
  ASSERT_TRUE(b.run_until([&] { return !b.actuator.power_stage_enabled; }, 0.5));
  b.run(0.1);
  EXPECT_LT(highest - lowest, 0.004) << "the joint sagged on the way up or down";
}

TEST(Module, DoesNotMoveWhenEnabledWhateverTheOldTargetWas) {
  ModuleBench b;
  b.joint.place(0.5);
  b.trajectory = [](double) { return MotionState{-0.4F, 0.0F, 0.0F}; };
  ASSERT_TRUE(b.enable());
  b.run(0.5);
  EXPECT_NEAR(b.joint.motor_q, 0.5, 1e-3);
  EXPECT_FALSE(b.status().following_knots);
  EXPECT_EQ(b.status().limit, LimitCode::holding);
}

TEST(Module, FollowsAQuinticWithinAMillradian) {
  ModuleBench b;
  ASSERT_TRUE(b.enable());
  ASSERT_TRUE(b.follow_here());
  b.run(1.0);  // the difference at resynchronisation has faded
  const double from = double(b.module.objects().target_position_urad) * 1e-6;
  const RestToRest move{from, from + 0.6, b.seconds_now() + 0.05, 0.6};
  b.trajectory = move;
  double worst_error = 0.0;
  double worst_reference = 0.0;
  b.each_tick = [&](const ModuleStatus& s) {
    const MotionState wanted = move(b.seconds_now());
    worst_reference =
        std::max(worst_reference, std::abs(double(s.reference_position_rad) - double(wanted.position_rad)));
    worst_error = std::max(worst_error, std::abs(double(s.position_rad) - double(wanted.position_rad)));
  };
  b.run(0.8);
  EXPECT_LT(worst_reference, 3e-6);
  EXPECT_LT(worst_error, 1.5e-3);
  EXPECT_EQ(b.status().knots_rejected, 0U);
  EXPECT_EQ(b.status().knots_missing, 0U);
  EXPECT_EQ(b.status().fault, Emergency::none);
}

TEST(Module, FollowsAClientThatSendsPositionsAlone) {
  ModuleBench b;
  ASSERT_TRUE(b.enable());
  b.run(0.05);
  const double from = b.status().reference_position_rad;
  const RestToRest move{from, from + 0.3, b.seconds_now() + 0.2, 1.0};
  for (int i = 0; i < 1500; ++i) {
    if (i % 4 == 0)
      b.receive(can::pack_rpdo2(
          b.config.node_id,
          {static_cast<std::int32_t>(std::lround(1e6 * double(move(b.seconds_now()).position_rad))), 0}));
    b.tick();
  }
  EXPECT_TRUE(b.status().following_knots);
  EXPECT_NEAR(b.status().position_rad, from + 0.3, 1e-3);
}

TEST(Module, ContinuesOneMissingKnotAndStopsAtTheSecond) {
  for (const int lost : {1, 2, 50}) {
    ModuleBench b;
    ASSERT_TRUE(b.enable());
    ASSERT_TRUE(b.follow_here());
    const double from = b.status().reference_position_rad;
    const RestToRest move{from, from + 0.8, b.seconds_now() + 0.02, 0.8};
    b.trajectory = move;
    b.run(0.4);
    ASSERT_GT(b.status().velocity_rad_s, 1.0F);
    b.drop_knots = lost;
    double worst_step = 0.0;
    double last = b.status().reference_velocity_rad_s;
    b.each_tick = [&](const ModuleStatus& s) {
      worst_step = std::max(worst_step, std::abs(double(s.reference_velocity_rad_s) - last));
      last = s.reference_velocity_rad_s;
    };
    b.run(0.3);
    EXPECT_LT(worst_step, 0.04) << "reference velocity jumped";
    if (lost == 1) {
      EXPECT_TRUE(b.status().following_knots);
      EXPECT_EQ(b.status().fault, Emergency::none);
    } else {
      EXPECT_FALSE(b.status().following_knots) << "knots that are far away must not be followed again";
      EXPECT_EQ(b.status().limit, LimitCode::knots_lost);
      EXPECT_EQ(b.status().state, DriveState::operation_enabled);
      EXPECT_NEAR(b.status().velocity_rad_s, 0.0, 0.01);
      ASSERT_TRUE(b.follow_here()) << "a knot at the held position takes over again";
    }
  }
}

TEST(Module, RefusesKnotsThatJumpAndDoesNotCountThemAsAlive) {
  ModuleBench b;
  ASSERT_TRUE(b.enable());
  ASSERT_TRUE(b.follow_here());
  const float here = b.status().reference_position_rad;
  b.trajectory = [here](double) { return MotionState{here + 0.02F, 0.0F, 0.0F}; };
  b.run(0.1);
  EXPECT_FALSE(b.status().following_knots);
  EXPECT_GT(b.status().knots_rejected, 0U);
  EXPECT_NEAR(b.joint.motor_q, here, 1e-3);
}

TEST(Module, ASenderThatRepeatsItselfIsNotAlive) {
  ModuleBench b;
  ASSERT_TRUE(b.enable());
  ASSERT_TRUE(b.follow_here());
  const float here = b.status().reference_position_rad;
  const std::uint16_t frozen = b.sequence;
  b.trajectory = [&, here](double) {
    b.sequence = static_cast<std::uint16_t>(frozen - 1U);  // send_knot counts it up again
    return MotionState{here, 0.0F, 0.0F};
  };
  b.run(0.1);
  EXPECT_GT(b.module.objects().count_stale_knots, 0U);
  EXPECT_FALSE(b.status().following_knots);
  EXPECT_EQ(b.status().limit, LimitCode::knots_lost);
  b.trajectory = [here](double) { return MotionState{here, 0.0F, 0.0F}; };
  b.run(0.02);
  EXPECT_TRUE(b.status().following_knots);
}

TEST(Module, SelectionNowSwitchesInThisTickAndIsAcknowledged) {
  ModuleBench b;
  ASSERT_TRUE(b.enable());
  ASSERT_TRUE(b.follow_here());
  b.select(can::SelectionAction::now, false, 7);
  const Time at = b.now;
  b.tick();
  EXPECT_EQ(b.status().law, Law::passive);
  EXPECT_EQ(b.status().selection_executed_at, at);
  EXPECT_EQ(b.module.objects().modes_of_operation_display, -1);
  EXPECT_EQ(can::acknowledged_sequence(b.status().selection_acknowledged), 7);
  b.run(0.01);
  EXPECT_LE(b.status().blend_ended_at - at, b.config.passive.blend);
  EXPECT_GT(b.status().blend_ended_at, at);
  b.select(can::SelectionAction::now, true, 8);
  b.tick();
  EXPECT_EQ(b.status().law, Law::active);
  EXPECT_EQ(b.module.objects().modes_of_operation_display, 8);
}

TEST(Module, ArmedSelectionIsExecutedAtItsInstantEvenWithoutASupervisor) {
  for (const bool supervisor_dies : {false, true}) {
    ModuleBench b;
    ASSERT_TRUE(b.enable());
    ASSERT_TRUE(b.follow_here());
    b.run(0.1);
    const auto target = static_cast<std::uint8_t>((b.sync_counter + 10 - 1) % 240 + 1);
    const Time last_sync = b.now - b.config.tick * ((b.now.ns / b.config.tick.ns + 3) % 4 + 1);
    b.select(can::SelectionAction::arm, false, 3, target, 1500);
    b.tick();
    EXPECT_EQ(b.status().selection_acknowledged, can::acknowledgement_byte(3, can::SelectionState::armed));
    EXPECT_EQ(b.status().law, Law::active);
    if (supervisor_dies) {
      b.trajectory = nullptr;
      b.sync = false;
    }
    ASSERT_TRUE(b.run_until([&] { return b.status().law == Law::passive; }, 0.2));
    const Time wanted = last_sync + milliseconds(40) + microseconds(1500);
    EXPECT_GE(b.status().selection_executed_at, wanted - microseconds(5));
    EXPECT_LT(b.status().selection_executed_at, wanted + b.config.tick + microseconds(5));
    // And back by itself.
    ASSERT_TRUE(b.run_until([&] { return b.status().law == Law::active; }, 0.6));
    b.run(0.1);
    EXPECT_NEAR(b.status().velocity_rad_s, 0.0, 0.01);
  }
}

TEST(Module, CancelWithdrawsAndARepetitionHasNoEffect) {
  ModuleBench b;
  ASSERT_TRUE(b.enable());
  ASSERT_TRUE(b.follow_here());
  const auto target = static_cast<std::uint8_t>((b.sync_counter + 10 - 1) % 240 + 1);
  b.select(can::SelectionAction::arm, false, 3, target, 0);
  b.tick();
  EXPECT_TRUE(b.status().selection_armed);
  b.select(can::SelectionAction::cancel, false, 4);
  b.tick();
  EXPECT_FALSE(b.status().selection_armed);
  b.select(can::SelectionAction::cancel, false, 4);
  b.run(0.1);
  EXPECT_EQ(b.status().law, Law::active);
  b.select(can::SelectionAction::now, false, 5);
  b.run(0.01);
  b.select(can::SelectionAction::now, true, 6);
  b.run(0.01);
  b.select(can::SelectionAction::now, false, 6);  // repetition of 6
  b.run(0.01);
  EXPECT_EQ(b.status().law, Law::active);
}

TEST(Module, AParameterWrittenInFaultLeavesWhatWasAcknowledged) {
  ModuleBench b;
  ASSERT_TRUE(b.enable());
  ASSERT_TRUE(b.follow_here());
  b.select(can::SelectionAction::now, false, 9);
  b.run(0.01);
  b.select(can::SelectionAction::now, true, 10);
  b.run(0.01);
  b.spoil = [](RawSensors& raw) { raw.fresh = static_cast<std::uint8_t>(raw.fresh & ~unsigned{kFreshEncoder}); };
  ASSERT_TRUE(b.run_until([&] { return b.status().state == DriveState::fault; }, 0.5));
  ASSERT_EQ(can::acknowledged_sequence(b.status().selection_acknowledged), 10);
  b.write(0x2100, 4, std::bit_cast<std::uint32_t>(0.9F), 4);
  ASSERT_EQ(b.module.objects().control_friction_feedforward, 0.9F);
  b.spoil = nullptr;
  b.run(0.01);
  b.command(0x00);
  b.run(0.01);
  b.command(0x80);
  b.run(0.01);
  ASSERT_EQ(b.status().state, DriveState::switch_on_disabled);
  EXPECT_EQ(can::acknowledged_sequence(b.status().selection_acknowledged), 10);
}

TEST(Module, SelectionIsRefusedUnlessTheJointIsUnderControl) {
  ModuleBench b;
  b.run(0.01);
  b.receive(can::nmt_frame(can::NmtCommand::start, b.config.node_id));
  b.run(0.01);
  b.select(can::SelectionAction::now, false, 2);
  b.tick();
  EXPECT_EQ(b.status().selection_acknowledged, can::acknowledgement_byte(0, can::SelectionState::refused));
  EXPECT_EQ(b.status().law, Law::off);
}

TEST(Module, PassivePhaseIsBoundedInTimeAndTravel) {
  auto p = test::hammer_joint();
  p.gravity_nm = 3.4;
  {
    ModuleBench b(p);
    ASSERT_TRUE(b.enable());
    b.config.passive.max_time = milliseconds(500);
    b.select(can::SelectionAction::now, false, 1);
    b.run(0.002);
    const Time since = b.status().selection_executed_at;
    const double from = b.joint.motor_q;
    ASSERT_TRUE(b.run_until([&] { return b.status().law == Law::active; }, 1.0));
    EXPECT_EQ(b.status().limit, LimitCode::passive_travel) << "3.4 Nm against 1.2 Nm of friction: it falls";
    EXPECT_NEAR(std::abs(b.joint.motor_q - from), 0.35, 0.01);
    b.run(0.5);
    EXPECT_NEAR(b.status().velocity_rad_s, 0.0, 0.02);
    EXPECT_LT(since, b.now);
  }
  ModuleBench b;  // no gravity: it stays where it is until the time is over
  ASSERT_TRUE(b.enable());
  b.select(can::SelectionAction::now, false, 1);
  b.run(0.002);
  const Time since = b.status().selection_executed_at;
  ASSERT_TRUE(b.run_until([&] { return b.status().law == Law::active; }, 1.0));
  EXPECT_EQ((b.now - b.config.tick - since), milliseconds(500));
  EXPECT_EQ(b.status().limit, LimitCode::passive_time);
}

TEST(Module, AJointThatABoardStoppedTakesItsReferenceAlongAndIsMetWhereItIs) {
  ModuleBench b;
  ASSERT_TRUE(b.enable());
  ASSERT_TRUE(b.follow_here());
  const double from = b.status().reference_position_rad;
  b.trajectory = RestToRest{from, from + 0.5, b.seconds_now() + 0.02, 0.6};
  b.run(0.33);
  b.select(can::SelectionAction::now, false, 1);
  b.tick();
  const double wall = b.joint.link_q + 0.01;
  b.each_tick = [&](const ModuleStatus&) { b.joint.external_nm = std::min(0.0, -4000.0 * (b.joint.link_q - wall)); };
  b.run(0.012);
  b.select(can::SelectionAction::now, true, 2);
  b.run(0.5);
  EXPECT_NEAR(b.status().reference_position_rad, b.joint.motor_q, 0.008 + 1e-4);
  EXPECT_TRUE(b.follow_here());
  b.run(1.0);
  EXPECT_NEAR(b.status().reference_position_rad, b.joint.motor_q, 5e-3);
}

// Presses the held joint with 12 Nm; the model torque that comes with the knots is 0.
double yields_by(float departure_nm) {
  auto c = test::module_config(test::hammer_joint());
  c.control.carried_departure_nm = departure_nm;
  ModuleBench b(test::hammer_joint(), c);
  EXPECT_TRUE(b.enable());
  EXPECT_TRUE(b.follow_here());
  b.run(0.5);
  const double here = b.joint.motor_q;
  b.joint.external_nm = 12.0;
  b.run(0.5);
  EXPECT_TRUE(b.status().following_knots);
  return b.joint.motor_q - here;
}

TEST(Module, YieldsToContactWithItsGainsWhenOnlyTheModelTorqueIsCarried) {
  EXPECT_LT(yields_by(std::numeric_limits<float>::infinity()), 1e-3)
      << "all of the load is carried: it stands like a rock";
  // (12 - 2 - static friction and position compensation) / K_P = 10 mrad at least, (12 - 2) / K_P = 23 at most.
  const double soft = yields_by(2.0F);
  EXPECT_GT(soft, 0.010);
  EXPECT_LT(soft, 0.024);
}

TEST(Module, ModeMinusOneIsPassiveForPlainClients) {
  ModuleBench b;
  ASSERT_TRUE(b.enable());
  b.set_mode(-1);
  b.run(0.005);
  EXPECT_EQ(b.module.objects().modes_of_operation_display, -1);
  b.set_mode(8);
  b.run(0.005);
  EXPECT_EQ(b.module.objects().modes_of_operation_display, 8);
  EXPECT_EQ(b.status().law, Law::active);
}

TEST(Module, LostEncoderIsAFaultWithBrakeWithinMilliseconds) {
  ModuleBench b;
  ASSERT_TRUE(b.enable());
  ASSERT_TRUE(b.follow_here());
  const Time lost = b.now;
  b.spoil = [](RawSensors& raw) { raw.fresh = static_cast<std::uint8_t>(raw.fresh & ~unsigned{kFreshEncoder}); };
  ASSERT_TRUE(b.run_until([&] { return !b.actuator.brake_release; }, 0.02));
  EXPECT_EQ(b.status().fault, Emergency::encoder);
  EXPECT_LE(b.status().fault_at - lost, milliseconds(5));
  ASSERT_TRUE(b.run_until([&] { return b.status().state == DriveState::fault; }, 0.2));
  EXPECT_FALSE(b.actuator.power_stage_enabled);
  EXPECT_EQ(b.module.objects().error_or_limit, static_cast<std::uint16_t>(Emergency::encoder));
  EXPECT_GE(b.count_sent(0x80U + b.config.node_id), 1);
  // Not while it is lost; then by the rising edge.
  b.command(0x80);
  b.run(0.01);
  EXPECT_EQ(b.status().state, DriveState::fault);
  b.spoil = nullptr;
  b.run(0.01);
  EXPECT_EQ(b.status().state, DriveState::fault) << "bit 7 is still set: no edge";
  b.command(0x00);
  b.run(0.01);
  b.command(0x80);
  b.run(0.01);
  EXPECT_EQ(b.status().state, DriveState::switch_on_disabled);
  EXPECT_EQ(b.status().fault, Emergency::none);
}

TEST(Module, EverySensorThatFallsSilentOrGoesWildIsAFaultNotMotion) {
  struct Case {
    const char* name;
    std::function<void(RawSensors&)> spoil;
    Emergency expected;
  };
  const auto silent = [](unsigned bit) {
    return [bit](RawSensors& raw) { raw.fresh = static_cast<std::uint8_t>(raw.fresh & ~bit); };
  };
  const std::vector<Case> cases{
      {"current", silent(kFreshCurrent), Emergency::current_sensor},
      {"temperature", silent(kFreshTemperature), Emergency::temperature_sensor},
      {"voltage", silent(kFreshBusVoltage), Emergency::under_voltage},
      {"hot winding", [](RawSensors& r) { r.winding_temperature_adc = 1500; }, Emergency::winding_over_temperature},
      {"hot stage", [](RawSensors& r) { r.drive_temperature_adc = 1000; }, Emergency::drive_over_temperature},
      {"voltage high", [](RawSensors& r) { r.bus_voltage_adc = 9000; }, Emergency::over_voltage},
      {"stage", [](RawSensors& r) { r.inputs |= kInputPowerStageFault; }, Emergency::power_stage},
      {"encoder jumps", [n = 0](RawSensors& r) mutable { r.encoder_count += (++n % 2) * 2'000'000; },
       Emergency::encoder_jump},
      {"encoder stuck far away", [](RawSensors& r) { r.encoder_count = 1'500'000'000; }, Emergency::encoder_jump},
  };
  for (const Case& c : cases) {
    ModuleBench b;
    ASSERT_TRUE(b.enable()) << c.name;
    ASSERT_TRUE(b.follow_here()) << c.name;
    const double here = b.joint.motor_q;
    b.spoil = c.spoil;
    b.run(1.0);
    EXPECT_EQ(b.status().fault, c.expected) << c.name;
    EXPECT_NEAR(b.joint.motor_q, here, 2e-3) << c.name;
    if (c.expected != Emergency::none) {
      EXPECT_EQ(b.status().state, DriveState::fault) << c.name;
      EXPECT_FALSE(b.actuator.power_stage_enabled) << c.name;
    }
  }
}

TEST(Module, WithoutItsTorqueSensorItGoesOnByTheModelTorqueAndSaysSo) {
  auto p = test::hammer_joint();
  p.gravity_nm = 4.0;
  ModuleBench b(p);
  b.model_torque_nm = [](const MotionState& s) { return 4.0 * std::cos(double{s.position_rad}); };
  ASSERT_TRUE(b.enable());
  ASSERT_TRUE(b.follow_here());
  b.run(0.2);
  const double here = b.joint.motor_q;
  const float torque = b.status().torque_command_nm;
  b.spoil = [](RawSensors& raw) { raw.fresh = static_cast<std::uint8_t>(raw.fresh & ~unsigned{kFreshTorque}); };
  float largest_step = 0.0F;
  float last = torque;
  b.each_tick = [&](const ModuleStatus& s) {
    largest_step = std::max(largest_step, std::abs(s.torque_command_nm - last));
    last = s.torque_command_nm;
  };
  b.run(1.0);
  EXPECT_EQ(b.status().fault, Emergency::none);
  EXPECT_TRUE(b.status().following_knots);
  EXPECT_EQ(b.status().limit, LimitCode::model_torque);
  EXPECT_EQ(b.module.objects().error_or_limit, static_cast<std::uint16_t>(LimitCode::model_torque));
  EXPECT_NEAR(b.joint.motor_q, here, 1e-3);
  EXPECT_LT(largest_step, 2.1F) << "no more than the torque slew in one tick";
  // Back: said no longer.
  b.spoil = nullptr;
  b.run(0.1);
  EXPECT_EQ(b.status().limit, LimitCode::none);
  // Lost with no model torque to go on by: stopped and faulted.
  b.spoil = [](RawSensors& raw) { raw.fresh = static_cast<std::uint8_t>(raw.fresh & ~unsigned{kFreshTorque}); };
  b.trajectory = nullptr;
  b.run(0.5);
  EXPECT_EQ(b.status().fault, Emergency::torque_sensor);
  EXPECT_NEAR(b.joint.motor_q, here, 3e-3);
}

TEST(Module, AConfigurationThatIsNotANumberNeverMoves) {
  const auto nan = std::numeric_limits<float>::quiet_NaN();
  const std::vector<std::function<void(ModuleConfig&)>> spoil{
      [&](ModuleConfig& c) { c.control.position_gain_nm_rad = nan; },
      [&](ModuleConfig& c) { c.friction.coulomb_nm = nan; },
      [&](ModuleConfig& c) { c.drive.torque_constant_negative_nm_a = 0.0F; },
      [&](ModuleConfig& c) { c.drive.gear_ratio = -1.0F; },
      [&](ModuleConfig& c) { c.passive.compensation_nm = c.friction.coulomb_nm; },
      [&](ModuleConfig& c) { c.limits.upper_rad = nan; },
      [&](ModuleConfig& c) { c.control.compensator.robust_gain[2] = nan; },
      [&](ModuleConfig& c) { c.limits.torque_nm = std::numeric_limits<float>::infinity(); },
  };
  for (const auto& s : spoil) {
    auto c = test::module_config(test::hammer_joint());
    s(c);
    ModuleBench b(test::hammer_joint(), c);
    EXPECT_FALSE(b.enable());
    EXPECT_EQ(b.status().fault, Emergency::configuration);
    EXPECT_FALSE(b.actuator.power_stage_enabled);
  }
}

TEST(Module, GainsWrittenOverTheBusAreCheckedAndInForceAtTheNextEnable) {
  ModuleBench b;
  b.run(0.01);
  b.receive(can::nmt_frame(can::NmtCommand::start, b.config.node_id));
  b.tick();
  b.write(0x2100, 2, std::bit_cast<std::uint32_t>(std::numeric_limits<float>::quiet_NaN()), 4);
  EXPECT_FLOAT_EQ(b.module.objects().control_position_gain_nm_rad, b.config.control.position_gain_nm_rad);
  b.write(0x2110, 1, std::bit_cast<std::uint32_t>(0.9F), 4);  // 0.9 f_s is above f_c: the module holds back by itself
  ASSERT_TRUE(b.enable());
  b.joint.external_nm = 3.0;
  b.run(0.2);
  b.select(can::SelectionAction::now, false, 1);
  b.run(0.02);
  EXPECT_LT(std::abs(b.status().passive_torque_nm), b.config.friction.coulomb_nm);
}

TEST(Module, LostHeartbeatStopsInAnOrderlyWay) {
  ModuleBench b;
  ASSERT_TRUE(b.enable());
  b.receive(can::heartbeat_frame(1, can::NmtState::operational));
  b.run(0.4);
  EXPECT_EQ(b.status().fault, Emergency::none);
  b.run(0.3);
  EXPECT_EQ(b.status().fault, Emergency::heartbeat_lost);
  b.run(0.3);
  EXPECT_EQ(b.status().state, DriveState::fault);
}

TEST(Module, LostSyncStopsThenFaults) {
  ModuleBench b;
  ASSERT_TRUE(b.enable());
  ASSERT_TRUE(b.follow_here());
  b.sync = false;
  b.run(0.03);
  EXPECT_EQ(b.status().limit, LimitCode::knots_lost);
  b.run(0.1);
  EXPECT_EQ(b.status().fault, Emergency::sync_lost);
}

TEST(Module, LeavingOperationalDisablesTheJointInOrder) {
  ModuleBench b;
  ASSERT_TRUE(b.enable());
  ASSERT_TRUE(b.follow_here());
  b.receive(can::nmt_frame(can::NmtCommand::enter_pre_operational, b.config.node_id));
  b.tick();
  EXPECT_NE(b.status().state, DriveState::operation_enabled);
  EXPECT_TRUE(b.actuator.power_stage_enabled) << "until the brake holds";
  b.run(0.3);
  EXPECT_FALSE(b.actuator.power_stage_enabled);
  EXPECT_EQ(b.status().fault, Emergency::none);
}

TEST(Module, HaltHoldsAndNothingStaleMovesItAfterwards) {
  ModuleBench b;
  ASSERT_TRUE(b.enable());
  ASSERT_TRUE(b.follow_here());
  const double from = b.status().reference_position_rad;
  const RestToRest move{from, from + 0.6, b.seconds_now() + 0.02, 0.6};
  b.trajectory = move;
  b.run(0.3);
  b.command(0x10F);
  b.run(0.5);
  const double stopped = b.joint.motor_q;
  EXPECT_NEAR(b.status().velocity_rad_s, 0.0, 0.01);
  EXPECT_LT(stopped, from + 0.5);
  b.command(0x0F);
  b.run(0.5);
  EXPECT_NEAR(b.joint.motor_q, stopped, 1e-3);
}

TEST(Module, TorqueModeGivesTheTorqueAskedFor) {
  ModuleBench b;
  ASSERT_TRUE(b.enable());
  b.set_mode(10);
  b.write(0x6071, 0, 125, 2);  // 0.125 * 16 Nm = 2 Nm, below the friction
  b.run(0.05);
  EXPECT_NEAR(b.status().torque_command_nm, 2.0, 1e-3);
  EXPECT_EQ(b.module.objects().modes_of_operation_display, 10);
}

TEST(Module, HomesOnItsSwitchAndRefusesKnotsBefore) {
  auto c = test::module_config(test::hammer_joint());
  c.sensing.encoder_absolute = false;
  c.homing = {.switch_position_rad = 0.25F, .fast_rad_s = 0.4F, .slow_rad_s = 0.02F, .timeout = milliseconds(20'000)};
  for (const double start : {0.4, -0.3, 0.102}) {  // before the switch, far beyond it at the limit, on it
    ModuleBench b(test::hammer_joint(), c);
    b.joint.place(start);
    const double edge = 0.1;  // true position of the switch's edge; closed below it, down to the limit switch
    b.spoil = [&](RawSensors& raw) {
      if (b.joint.motor_q < edge && b.joint.motor_q > -0.25) raw.inputs |= kInputHomeSwitch;
      if (b.joint.motor_q < -0.29) raw.inputs |= kInputNegativeLimit;
    };
    ASSERT_TRUE(b.enable());
    EXPECT_EQ(b.status().limit, LimitCode::not_homed);
    b.trajectory = [&](double) { return MotionState{b.status().position_rad, 0.0F, 0.0F}; };
    b.run(0.1);
    EXPECT_FALSE(b.status().following_knots);
    b.trajectory = nullptr;
    b.set_mode(6);
    b.run(0.01);
    b.command(0x1F);
    ASSERT_TRUE(b.run_until([&] { return (b.module.objects().statusword & kStatusFollowing) != 0; }, 15.0)) << start;
    b.run(0.2);
    EXPECT_NEAR(double{b.status().position_rad} - b.joint.motor_q, 0.25 - edge, 3e-4) << start;
    b.command(0x0F);
    b.set_mode(8);
    b.run(0.02);
    EXPECT_TRUE(b.follow_here());
  }
}

TEST(Module, HomingTimesOut) {
  auto c = test::module_config(test::hammer_joint());
  c.sensing.encoder_absolute = false;
  c.homing = {.switch_position_rad = 0.25F, .fast_rad_s = 0.05F, .slow_rad_s = 0.02F, .timeout = milliseconds(1'000)};
  ModuleBench b(test::hammer_joint(), c);
  b.mode = 6;
  ASSERT_TRUE(b.enable());
  b.command(0x1F);
  b.run(1.3);
  EXPECT_NE(b.module.objects().statusword & kStatusFollowingError, 0);
  EXPECT_EQ(b.module.objects().statusword & kStatusFollowing, 0);
  EXPECT_FALSE(b.status().homed);
  EXPECT_NEAR(b.status().velocity_rad_s, 0.0, 1e-2);
}

TEST(Module, RefusesKnotsBeyondItsLimits) {
  auto c = test::module_config(test::hammer_joint());
  c.limits.upper_rad = 0.05F;
  ModuleBench b(test::hammer_joint(), c);
  ASSERT_TRUE(b.enable());
  ASSERT_TRUE(b.follow_here());
  const RestToRest move{0.0, 0.3, b.seconds_now() + 0.02, 0.6};
  b.trajectory = move;
  b.run(0.8);
  EXPECT_LT(b.joint.motor_q, 0.06);
  EXPECT_GT(b.status().knots_rejected, 0U);
}

TEST(Module, TwoRunsAreBitIdentical) {
  const auto run = [] {
    ModuleBench b;
    EXPECT_TRUE(b.enable());
    EXPECT_TRUE(b.follow_here());
    const RestToRest move{0.0, 0.5, b.seconds_now() + 0.02, 0.5};
    b.trajectory = move;
    std::vector<std::int16_t> duty;
    b.each_tick = [&](const ModuleStatus&) { duty.push_back(b.actuator.current_duty); };
    b.run(0.7);
    return duty;
  };
  EXPECT_EQ(run(), run());
}

// Whatever number of the configuration is not a number: the joint is never led by it.
TEST(Module, NoNumberOfTheConfigurationThatIsNoneEverLeadsTheJoint) {
  const auto numbers = [](ModuleConfig& c) {
    return std::vector<float*>{&c.sensing.velocity_bandwidth_rad_s,
                               &c.sensing.torque_offset_nm,
                               &c.sensing.torque_full_scale_nm,
                               &c.sensing.torque_bandwidth_rad_s,
                               &c.sensing.current_full_scale_a,
                               &c.sensing.max_plausible_velocity_rad_s,
                               &c.friction.coulomb_nm,
                               &c.friction.static_nm,
                               &c.friction.stribeck_decay_s2_rad2,
                               &c.friction.viscous_nm_s_rad,
                               &c.control.compensator.integral_gain[2],
                               &c.control.compensator.integral_limit[2],
                               &c.control.compensator.robust_gain[2],
                               &c.control.compensator.robust_width[2],
                               &c.control.compensator.position_gain_nm,
                               &c.control.compensator.position_width_rad_s,
                               &c.control.inertia_kg_m2,
                               &c.control.lambda_1_s,
                               &c.control.position_gain_nm_rad,
                               &c.control.velocity_gain_nm_s_rad,
                               &c.control.friction_feedforward,
                               &c.control.carried_departure_nm,
                               &c.control.still_velocity_rad_s,
                               &c.control.moving_velocity_rad_s,
                               &c.control.reference_still_rad_s,
                               &c.passive.compensation_nm,
                               &c.passive.static_compensation_nm,
                               &c.passive.still_velocity_rad_s,
                               &c.passive.moving_velocity_rad_s,
                               &c.passive.torque_dead_band_nm,
                               &c.passive.torque_trend_nm,
                               &c.passive.trend_rate_1_s,
                               &c.passive.rest_trend_rate_1_s,
                               &c.passive.torque_filter_rad_s,
                               &c.passive.resume_torque_slew_nm_s,
                               &c.passive.guard_energy_j,
                               &c.passive.max_travel_rad,
                               &c.reference.stop_deceleration_rad_s2,
                               &c.reference.quick_stop_deceleration_rad_s2,
                               &c.reference.settle_rate_1_s,
                               &c.reference.resync_window_rad,
                               &c.reference.resync_velocity_rad_s,
                               &c.reference.offset_decay_1_s,
                               &c.drive.gear_ratio,
                               &c.drive.torque_constant_positive_nm_a,
                               &c.drive.torque_constant_negative_nm_a,
                               &c.drive.peak_current_a,
                               &c.drive.continuous_current_a,
                               &c.drive.thermal_time_constant_s,
                               &c.drive.max_winding_temperature_c,
                               &c.drive.max_drive_temperature_c,
                               &c.drive.temperature_derating_c,
                               &c.drive.min_bus_voltage_v,
                               &c.drive.max_bus_voltage_v,
                               &c.drive.rated_torque_nm,
                               &c.limits.lower_rad,
                               &c.limits.upper_rad,
                               &c.limits.velocity_rad_s,
                               &c.limits.acceleration_rad_s2,
                               &c.limits.torque_nm,
                               &c.limits.following_error_rad,
                               &c.homing.switch_position_rad,
                               &c.homing.fast_rad_s,
                               &c.homing.slow_rad_s,
                               &c.homing.max_travel_rad,
                               &c.homing.max_torque_nm,
                               &c.homing.index_position_rad};
  };
  ModuleConfig usual = test::module_config(test::hammer_joint());
  const std::size_t count = numbers(usual).size();
  for (std::size_t i = 0; i < count; ++i) {
    for (const float wrong : {std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity()}) {
      ModuleConfig c = usual;
      float& number = *numbers(c)[i];
      // These may be without bound.
      const bool unbounded = &number == &c.control.carried_departure_nm || &number == &c.drive.max_bus_voltage_v;
      if (unbounded && !std::isnan(wrong)) continue;
      number = wrong;
      ModuleBench b(test::hammer_joint(), c);
      bool led = false;
      b.each_tick = [&](const ModuleStatus& s) {
        led = led || b.actuator.power_stage_enabled;
        ASSERT_FALSE(std::isnan(s.torque_command_nm)) << "number " << i;
      };
      b.enable();
      EXPECT_FALSE(led) << "number " << i << " is " << wrong;
      EXPECT_EQ(b.status().state, DriveState::fault) << "number " << i;
    }
  }
}

}  // namespace
}  // namespace mrr::fw
