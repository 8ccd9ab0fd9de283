// Every row of the table of faults, provoked on a joint of the emulated arm under gravity: found in time, the reaction
// that the table says, and what the bus is told. A row without a scenario fails.
#include <gtest/gtest.h>

#include <map>
#include <optional>

#include "can_protocol/faults.h"
#include "can_protocol/messages.h"
#include "tests/bench/module/plant_joint.h"

namespace mrr::fw {
namespace {

using can::Emergency;
using can::Fault;
using can::LimitCode;
using can::Reaction;
using test::JointSetup;
using test::PlantBench;

enum class Before : std::uint8_t { boot, enabled, following };

struct Scenario {
  Before before = Before::following;
  std::function<void(PlantBench&)> provoke;
  /// From the provocation to the report at the latest: the time of the table or of the object, and what the physics
  /// needs.
  double within_s = 0.0;
  std::function<void(ModuleConfig&)> config{};
  /// Takes the cause away, for the reset.
  std::function<void(PlantBench&)> heal = [](PlantBench& b) { b.spoil = nullptr; };
  bool resets = true;  ///< false: nothing a reset can cure
  /// How far the motor may move from the report until the joint is at rest under its brake.
  double travel_rad = 0.01;
};

void silence(PlantBench& b, unsigned bit) {
  b.spoil = [bit](RawSensors& raw) { raw.fresh = static_cast<std::uint8_t>(raw.fresh & ~bit); };
}
auto input(unsigned set, unsigned clear = 0) {
  return [=](PlantBench& b) {
    b.spoil = [=](RawSensors& raw) { raw.inputs = static_cast<std::uint8_t>((raw.inputs | set) & ~clear); };
  };
}
std::int16_t current_counts(const ModuleConfig& c, float amperes) {
  return static_cast<std::int16_t>(amperes / c.sensing.current_full_scale_a * 32767.0F);
}
std::int16_t torque_counts(const ModuleConfig& c, float nm) {
  return static_cast<std::int16_t>(nm / c.sensing.torque_full_scale_nm * 32767.0F);
}
void no_following_error(ModuleConfig& c) { c.limits.following_error_rad = 0.0F; }
/// So little torque that the arm falls.
void let_fall(PlantBench& b) { b.write(0x6072, 0, 100, 2); }

/// A torque target by RPDO2, and a tick.
void send_torque(PlantBench& b) {
  can::Frame f;
  f.id = 0x300U + b.config.node_id;
  f.length = 2;
  can::put<std::int16_t>(f.data.data(), 800);
  b.receive(f);
  b.tick();
}
/// 6071h by RPDO2 instead of position and velocity, mode 10 in force, and targets for 0.1 s.
void lead_by_torque(PlantBench& b) {
  b.write(0x1401, 1, 0x80000000U + 0x300U + b.config.node_id, 4);
  b.write(0x1601, 0, 0, 1);
  b.write(0x1601, 1, 0x60710010U, 4);
  b.write(0x1601, 0, 1, 1);
  b.write(0x1401, 1, 0x300U + b.config.node_id, 4);
  b.set_mode(10);
  for (int i = 0; i < 100; ++i) send_torque(b);
}

/// What a module finds in its memory when it starts.
class Memory final : public can::StoragePort {
 public:
  Result read(std::uint8_t slot, std::size_t offset, std::span<std::uint8_t> out) noexcept override {
    std::copy_n(bytes[slot].begin() + static_cast<long>(offset), out.size(), out.begin());
    return Result::done;
  }
  Result erase(std::uint8_t slot) noexcept override {
    bytes[slot].fill(0xFF);
    return Result::done;
  }
  Result write(std::uint8_t slot, std::size_t offset, std::span<const std::uint8_t> in) noexcept override {
    std::copy(in.begin(), in.end(), bytes[slot].begin() + static_cast<long>(offset));
    return Result::done;
  }
  Result flush(std::uint8_t) noexcept override { return Result::done; }
  std::array<std::array<std::uint8_t, 2 * can::kSlotBytes>, 2> bytes{};
};
/// Stores, and starts again with a slot that was changed meanwhile.
void start_with(PlantBench& b, Memory& memory, const std::function<void()>& meanwhile) {
  can::ParameterStore store;
  can::ObjectDictionary od = b.module.objects();
  store.load(memory, od, b.config.node_id);
  store.begin_write(&od, b.config.node_id);
  while (store.state() == can::StorageState::writing) store.tick();
  meanwhile();
  b.module.load_parameters(memory);
}

const std::map<Fault, Scenario>& scenarios() {
  static Memory memory;
  static const std::map<Fault, Scenario> all{
      {Fault::configuration,
       {.before = Before::boot,
        .provoke = [](PlantBench& b) { b.enable(); },
        .within_s = 0.01,
        .config = [](ModuleConfig& c) { c.drive.torque_constant_negative_nm_a = 0.0F; },
        .resets = false}},
      {Fault::stored_parameters,
       {.before = Before::boot,
        .provoke =
            [](PlantBench& b) {
              memory = {};
              start_with(b, memory, [] {
                memory.bytes[0][100] ^= 1;
                memory.bytes[1][0] = 1;
              });
            },
        .within_s = 0.001}},
      {Fault::storage,
       {.before = Before::boot,
        .provoke =
            [](PlantBench& b) {
              memory = {};
              start_with(b, memory, [] { memory.bytes[0][100] ^= 1; });
            },
        .within_s = 0.001,
        .heal =
            [](PlantBench& b) {
              b.write(0x1010, 1, 0x65766173, 4);
              b.run(0.3);
            }}},
      {Fault::not_a_number,
       {.before = Before::boot,
        .provoke = [](PlantBench&) {},
        .within_s = 0.002,
        // A gear so wrong that a position does not fit into a number.
        .config = [](ModuleConfig& c) { c.drive.gear_ratio = 1e-38F; },
        .resets = false}},
      {Fault::loop_overrun, {.provoke = [](PlantBench& b) { b.now += milliseconds(20); }, .within_s = 0.021}},
      {Fault::power_stage, {.provoke = input(kInputPowerStageFault), .within_s = 0.001}},
      {Fault::over_current,
       {.provoke =
            [](PlantBench& b) {
              b.spoil = [adc = current_counts(b.config, 1.4F * b.config.drive.peak_current_a)](RawSensors& raw) {
                raw.current_adc = adc;
              };
            },
        .within_s = 0.004}},
      {Fault::current_mismatch,
       {.provoke =
            [](PlantBench& b) {
              b.spoil = [more = current_counts(b.config, 0.3F * b.config.drive.peak_current_a)](RawSensors& raw) {
                raw.current_adc = static_cast<std::int16_t>(raw.current_adc + more);
              };
            },
        .within_s = 0.035}},
      {Fault::current_sensor, {.provoke = [](PlantBench& b) { silence(b, kFreshCurrent); }, .within_s = 0.012}},
      {Fault::thermal_overload,
       {.provoke =
            [](PlantBench& b) {
              // A stage that gives a little more than it is asked for.
              b.spoil = [more = current_counts(b.config, 0.2F * b.config.drive.peak_current_a)](RawSensors& raw) {
                raw.current_adc = static_cast<std::int16_t>(raw.current_adc + more);
              };
            },
        .within_s = 0.8,
        .config =
            [](ModuleConfig& c) {
              c.drive.continuous_current_a = 0.3F * c.drive.peak_current_a;
              c.drive.thermal_time_constant_s = 0.3F;
            },
        .travel_rad = 0.05}},
      {Fault::winding_over_temperature,
       {.provoke = [](PlantBench& b) { b.spoil = [](RawSensors& raw) { raw.winding_temperature_adc = 1250; }; },
        .within_s = 0.001,
        .travel_rad = 0.05}},
      {Fault::drive_over_temperature,
       {.provoke = [](PlantBench& b) { b.spoil = [](RawSensors& raw) { raw.drive_temperature_adc = 905; }; },
        .within_s = 0.001}},
      {Fault::temperature_sensor, {.provoke = [](PlantBench& b) { silence(b, kFreshTemperature); }, .within_s = 0.502}},
      {Fault::over_voltage,
       {.provoke = [](PlantBench& b) { b.spoil = [](RawSensors& raw) { raw.bus_voltage_adc = 9000; }; },
        .within_s = 0.004}},
      {Fault::under_voltage,
       {.provoke = [](PlantBench& b) { b.spoil = [](RawSensors& raw) { raw.bus_voltage_adc = 1500; }; },
        .within_s = 0.004,
        .config = [](ModuleConfig& c) { c.drive.min_bus_voltage_v = 20.0F; }}},
      {Fault::encoder_lost, {.provoke = [](PlantBench& b) { silence(b, kFreshEncoder); }, .within_s = 0.005}},
      {Fault::encoder_jump,
       {.provoke =
            [](PlantBench& b) {
              b.spoil = [n = 0](RawSensors& raw) mutable { raw.encoder_count += (++n % 2) * 200'000; };
            },
        .within_s = 0.014}},
      {Fault::encoder_stuck,
       {.provoke =
            [](PlantBench& b) {
              swing(b);
              b.run(0.5);
              b.spoil = [held = std::optional<std::int32_t>()](RawSensors& raw) mutable {
                if (!held) held = raw.encoder_count;
                raw.encoder_count = *held;
              };
            },
        .within_s = 0.506,
        .travel_rad = 0.06}},
      {Fault::torque_sensor_lost,
       {.before = Before::enabled, .provoke = [](PlantBench& b) { silence(b, kFreshTorque); }, .within_s = 0.007}},
      {Fault::torque_sensor_range,
       {.before = Before::enabled,
        .provoke = [](PlantBench& b) { b.spoil = [](RawSensors& raw) { raw.torque_adc = 32767; }; },
        .within_s = 0.007}},
      {Fault::torque_sensor_stuck,
       {.before = Before::enabled,
        .provoke =
            [](PlantBench& b) {
              b.spoil = [held = std::optional<std::int16_t>()](RawSensors& raw) mutable {
                if (!held) held = raw.torque_adc;
                raw.torque_adc = *held;
              };
              b.run(0.05);
              b.joint.external_nm = -22.0;
            },
        .within_s = 0.3,
        .travel_rad = 0.1}},
      {Fault::torque_sensor_drift,
       {.before = Before::enabled,
        .provoke =
            [](PlantBench& b) {
              b.spoil = [offset = torque_counts(b.config, 30.0F)](RawSensors& raw) {
                raw.torque_adc = static_cast<std::int16_t>(raw.torque_adc + offset);
              };
            },
        .within_s = 0.8,
        .travel_rad = 0.1}},
      {Fault::over_speed,
       {.before = Before::enabled,
        .provoke =
            [](PlantBench& b) {
              b.set_mode(10);
              b.write(0x6071, 0, 1600, 2);  // 25.6 Nm: far above gravity and friction
            },
        .within_s = 0.3,
        .config = [](ModuleConfig& c) { c.limits.velocity_rad_s = 0.4F; },
        .travel_rad = 0.1}},
      {Fault::following_error, {.provoke = let_fall, .within_s = 0.6, .travel_rad = 0.6}},
      {Fault::position_limit,
       {.provoke =
            [](PlantBench& b) {
              b.write(0x607D, 1, static_cast<std::uint32_t>(b.module.objects().position_actual_urad - 20'000), 4);
              b.command(0x07);
              b.run(0.3);
              b.command(0x0F);
              b.run(0.3);
              let_fall(b);
            },
        .within_s = 1.2,
        .config = no_following_error,
        .travel_rad = 1.0}},
      {Fault::limit_switch,
       {.provoke =
            [](PlantBench& b) {
              swing(b);
              b.run(0.5);
              input(kInputPositiveLimit)(b);
            },
        .within_s = 0.502,
        .travel_rad = 0.1}},
      {Fault::limit_switches,
       {.provoke = input(std::uint8_t{kInputPositiveLimit} | std::uint8_t{kInputNegativeLimit}), .within_s = 0.022}},
      {Fault::torque_not_confirmed,
       {.before = Before::boot,
        .provoke =
            [](PlantBench& b) {
              b.spoil = [adc = current_counts(b.config, 0.1F * b.config.sensing.current_full_scale_a)](
                            RawSensors& raw) { raw.current_adc = static_cast<std::int16_t>(raw.current_adc + adc); };
              b.enable();
            },
        .within_s = 0.72}},
      {Fault::brake_not_released,
       {.before = Before::boot,
        .provoke =
            [](PlantBench& b) {
              input(0, kInputBrakeReleased)(b);
              b.enable();
            },
        .within_s = 0.32}},
      {Fault::brake_not_engaged,
       {.provoke =
            [](PlantBench& b) {
              input(kInputBrakeReleased)(b);
              b.command(0x07);
            },
        .within_s = 0.13}},
      {Fault::brake_closed, {.provoke = input(0, kInputBrakeReleased), .within_s = 0.022}},
      {Fault::homing_failed,
       {.before = Before::enabled,
        .provoke =
            [](PlantBench& b) {
              b.set_mode(6);
              b.run(0.01);
              b.command(0x1F);
            },
        .within_s = 0.22,
        .config = [](ModuleConfig& c) { c.homing.timeout = milliseconds(200); },
        .heal = [](PlantBench& b) { b.set_mode(8); },
        .travel_rad = 0.1}},
      {Fault::knots_lost,
       {.provoke = [](PlantBench& b) { b.trajectory = nullptr; },
        .within_s = 0.015,
        .heal = [](PlantBench& b) { b.follow_here(); }}},
      {Fault::torque_target_lost,
       {.before = Before::enabled,
        .provoke = lead_by_torque,
        .within_s = 0.12 + 0.105,
        .heal =
            [](PlantBench& b) {
              send_torque(b);
              b.run(0.02);
            },
        .travel_rad = 0.3}},
      {Fault::heartbeat_lost,
       {.provoke = [](PlantBench& b) { b.receive(can::heartbeat_frame(1, can::NmtState::operational)); },
        .within_s = 0.503,
        .heal = [](PlantBench& b) { b.receive(can::heartbeat_frame(1, can::NmtState::operational)); }}},
      {Fault::sync_lost,
       {.provoke = [](PlantBench& b) { b.sync = false; },
        .within_s = 0.056,
        .heal = [](PlantBench& b) { b.sync = true; }}},
      {Fault::bus_off,
       {.provoke = [](PlantBench& b) { b.module.bus_off(b.now); },
        .within_s = 0.001,
        .heal = [](PlantBench& b) { b.module.bus_recovered(b.now); }}},
  };
  return all;
}

/// OPERATIONAL, with the SYNC counter this bench sends: nothing but the fault is to be seen.
void start_node(PlantBench& b) {
  b.write(0x1019, 0, 240, 1);
  b.receive(can::nmt_frame(can::NmtCommand::start, b.config.node_id));
  b.run(0.02);
}

class FaultTable : public testing::TestWithParam<std::size_t> {};

TEST_P(FaultTable, IsFoundInTimeReactedToAndTold) {
  const auto fault = static_cast<Fault>(GetParam());
  const can::FaultRow& row = can::row_of(fault);
  const auto found = scenarios().find(fault);
  ASSERT_NE(found, scenarios().end()) << "the row " << row.name << " has no scenario";
  const Scenario& s = found->second;

  JointSetup setup;
  setup.joint = 1;
  setup.config = s.config;
  PlantBench b(setup);
  if (s.before != Before::boot) {
    ASSERT_TRUE(b.enable());
  }
  if (s.before == Before::following) {
    ASSERT_TRUE(b.follow_here());
  }
  if (s.before != Before::boot) {
    b.run(0.3);
    ASSERT_EQ(b.status().fault, Emergency::none) << can::name_of_code(static_cast<std::uint16_t>(b.status().fault));
  }

  // What happens from the provocation on, tick by tick.
  const auto code = static_cast<std::uint16_t>(row.code);
  const double provoked_s = b.seconds_now();
  std::optional<double> reported_s;
  double motor_at_report = 0.0;
  double furthest = 0.0;
  bool stage_cut_at_once = false;
  bool brake_at_once = false;
  bool torque_outlived_brake = true;  // the stage was on until the brake held
  bool was_led = false;
  b.each_tick = [&](const ModuleStatus&) {
    const bool told = static_cast<std::uint16_t>(b.module.objects().error_history[0]) == code ||
                      static_cast<std::uint16_t>(b.module.objects().error_history[1]) == code;
    if (told && !reported_s) {
      reported_s = (b.now - Time{}).seconds();
      motor_at_report = b.joint.motor_q();
      stage_cut_at_once = !b.actuator.power_stage_enabled;
      brake_at_once = !b.actuator.brake_release;
    }
    if (reported_s) furthest = std::max(furthest, std::abs(b.joint.motor_q() - motor_at_report));
    if (reported_s && was_led && !b.actuator.power_stage_enabled && b.joint.truth.brake_released[1])
      torque_outlived_brake = false;
    was_led = b.actuator.power_stage_enabled;
  };
  s.provoke(b);
  b.run_until([&] { return reported_s.has_value(); }, s.within_s + 1.0);
  ASSERT_TRUE(reported_s) << row.name << " was not found; fault now: "
                          << can::name_of_code(static_cast<std::uint16_t>(b.status().fault)) << ", limit "
                          << can::name_of_code(static_cast<std::uint16_t>(b.status().limit));
  EXPECT_LE(*reported_s - provoked_s, s.within_s + 1e-9) << row.name;

  // The bus: EMCY with this code, 603Fh, status word, TPDO2.
  b.run(0.02);
  const auto emergency_id = can::kEmergencyCobId + b.config.node_id;
  EXPECT_TRUE(std::any_of(b.sent.begin(), b.sent.end(),
                          [&](const can::Frame& f) {
                            const auto m = can::parse_emergency(f);
                            return f.id == emergency_id && m && m->code == code;
                          }) ||
              s.before == Before::boot)
      << "no EMCY";
  const can::ObjectDictionary& od = b.module.objects();
  EXPECT_EQ(od.error_code, code);
  const auto told_by_tpdo2 = [&] {
    for (auto f = b.sent.rbegin(); f != b.sent.rend(); ++f) {
      if (f->id == 0x280U + b.config.node_id) return can::unpack_tpdo2(*f)->error_or_limit;
    }
    return std::uint16_t{0xFFFF};
  };
  if (row.reaction >= Reaction::stop) {
    EXPECT_EQ(b.status().cause, fault) << can::name_of_code(od.first_fault_cause);
    EXPECT_EQ(od.error_or_limit, code);
    EXPECT_NE(od.statusword & kStatusFault, 0);
    EXPECT_EQ(od.first_fault_cause, code);
    EXPECT_NEAR(od.first_fault_time_ms * 1e-3, *reported_s, 2e-3);
    if (s.before != Before::boot) {
      EXPECT_EQ(od.first_fault_mode, b.mode);
      EXPECT_NEAR(od.first_fault_position_urad * 1e-6, motor_at_report, 0.02);
      if (fault != Fault::sync_lost) {
        EXPECT_EQ(told_by_tpdo2(), code);
      }
    }
    if (row.reaction == Reaction::torque_off && s.before != Before::boot) {
      EXPECT_TRUE(stage_cut_at_once && brake_at_once);
    }
    if (row.reaction == Reaction::brake) {
      EXPECT_TRUE(brake_at_once);
    }
    if (fault == Fault::brake_not_engaged) {
      b.run(1.0);
      EXPECT_TRUE(b.actuator.power_stage_enabled) << "the joint would fall";
      EXPECT_EQ(b.status().state, DriveState::fault_reaction_active);
      s.heal(b);
    }
    ASSERT_TRUE(b.run_until([&] { return b.status().state == DriveState::fault; }, 1.5));
    b.run(0.1);
    EXPECT_FALSE(b.actuator.power_stage_enabled);
    EXPECT_FALSE(b.actuator.brake_release);
    if (row.reaction != Reaction::torque_off && s.before != Before::boot) {
      EXPECT_TRUE(torque_outlived_brake) << "torque went before the brake held";
    }
    EXPECT_LT(furthest, s.travel_rad);
    EXPECT_EQ(b.module.objects().first_fault_cause, code) << "the first one stays";
    if (!s.resets) return;
    s.heal(b);
    if (s.before == Before::boot) start_node(b);
    b.run(0.02);
    b.command(0x00);
    b.run(0.02);
    b.command(0x80);
    b.run(0.02);
    EXPECT_EQ(b.status().state, DriveState::switch_on_disabled);
    EXPECT_EQ(od.error_or_limit, 0);
    EXPECT_EQ(od.first_fault_cause, 0);
    EXPECT_EQ(od.error_register, 0);
    return;
  }
  // No fault: the drive stays enabled, says so and takes it back when it is over.
  EXPECT_EQ(b.status().fault, Emergency::none);
  EXPECT_NE(od.statusword & kStatusWarning, 0);
  EXPECT_LT(od.error_or_limit, 0x1000);
  if (row.reaction == Reaction::hold) {
    EXPECT_EQ(b.status().state, DriveState::operation_enabled);
    EXPECT_NE(od.statusword & kStatusInternalLimit, 0);
    b.run(0.5);
    EXPECT_NEAR(b.status().velocity_rad_s, 0.0, 0.02);
    EXPECT_TRUE(b.actuator.power_stage_enabled && b.actuator.brake_release);
    EXPECT_LT(furthest, s.travel_rad);
  }
  s.heal(b);
  if (s.before == Before::boot) start_node(b);
  b.run(0.05);
  EXPECT_EQ(b.module.objects().error_register, 0);
  EXPECT_EQ(b.module.objects().statusword & kStatusWarning, 0);
}

PlantBench following_joint() {
  JointSetup setup;
  setup.joint = 1;
  return PlantBench(setup);
}

TEST(Faults, TheFirstIsKeptWithAPictureAndLaterOnesAreCounted) {
  PlantBench b = following_joint();
  ASSERT_TRUE(b.enable());
  ASSERT_TRUE(b.follow_here());
  swing(b);
  b.run(0.5);
  const double q = double{b.status().position_rad};
  const double v = double{b.status().velocity_rad_s};
  b.spoil = [](RawSensors& raw) { raw.bus_voltage_adc = 9000; };
  b.run(0.005);
  const can::ObjectDictionary& od = b.module.objects();
  EXPECT_NEAR(od.first_fault_position_urad * 1e-6, q, 0.01);
  EXPECT_NEAR(od.first_fault_velocity_urad_s * 1e-6, v, 0.1);
  EXPECT_NE(od.first_fault_torque_permille, 0);
  EXPECT_NE(od.first_fault_current_permille, 0);
  EXPECT_EQ(od.first_fault_mode, 8);
  EXPECT_EQ(od.first_fault_statusword & 0x6F, 0x27) << "it was enabled then";
  EXPECT_EQ(od.later_faults, 0);
  b.spoil = [](RawSensors& raw) {
    raw.bus_voltage_adc = 9000;
    raw.drive_temperature_adc = 1200;
    raw.fresh = static_cast<std::uint8_t>(raw.fresh & ~unsigned{kFreshEncoder});
  };
  b.run(0.5);
  EXPECT_EQ(b.module.objects().first_fault_cause, static_cast<int>(Emergency::over_voltage));
  EXPECT_EQ(b.module.objects().later_faults, 2);
  EXPECT_EQ(b.module.objects().error_code, static_cast<int>(Emergency::encoder)) << "603Fh: the last one";
}

TEST(Faults, AHarderReactionTakesOverFromOneThatIsUnderWay) {
  PlantBench b = following_joint();
  ASSERT_TRUE(b.enable());
  ASSERT_TRUE(b.follow_here());
  swing(b);
  b.run(0.5);
  b.spoil = [](RawSensors& raw) { raw.bus_voltage_adc = 9000; };
  b.run(0.006);
  ASSERT_TRUE(b.actuator.power_stage_enabled && b.actuator.brake_release) << "a controlled stop";
  b.spoil = [](RawSensors& raw) {
    raw.bus_voltage_adc = 9000;
    raw.inputs |= kInputPowerStageFault;
  };
  b.tick();
  EXPECT_FALSE(b.actuator.power_stage_enabled);
  EXPECT_FALSE(b.actuator.brake_release);
}

TEST(Faults, ALimitThatIsActiveIsNotAFault) {
  PlantBench b = following_joint();
  ASSERT_TRUE(b.enable());
  ASSERT_TRUE(b.follow_here());
  b.run(0.3);
  // 8 degC below the highest winding temperature: the current comes down before it would trip.
  const double hot = double{b.config.drive.max_winding_temperature_c} - 1.0;
  b.spoil = [=](RawSensors& raw) { raw.winding_temperature_adc = static_cast<std::int16_t>(10.0 * hot); };
  b.run(0.01);
  const can::ObjectDictionary& od = b.module.objects();
  EXPECT_EQ(od.error_or_limit, static_cast<int>(LimitCode::thermal));
  EXPECT_NE(od.statusword & kStatusInternalLimit, 0);
  EXPECT_EQ(od.statusword & (kStatusFault | kStatusWarning), 0);
  EXPECT_EQ(od.error_register, 0);
}

// A weight that the joint can hold for a while but not for ever: I^2 t takes current away before it trips.
TEST(Faults, TheCurrentComesDownBeforeTheWindingsThermalLoadTrips) {
  JointSetup setup;
  setup.joint = 1;
  setup.config = [](ModuleConfig& c) {
    c.drive.continuous_current_a = 0.35F * c.drive.peak_current_a;
    c.drive.thermal_time_constant_s = 0.5F;
    c.limits.following_error_rad = 0.0F;
  };
  PlantBench b(setup);
  ASSERT_TRUE(b.enable());
  ASSERT_TRUE(b.follow_here());
  b.run(0.3);
  ASSERT_LT(b.status().thermal_load, 0.8F);
  b.joint.external_nm = -25.0;
  float worst = 0.0F;
  float most_a = 0.0F;
  std::optional<double> derated_s;
  b.each_tick = [&](const ModuleStatus& s) {
    worst = std::max(worst, s.thermal_load);
    if (s.limit == LimitCode::thermal && !derated_s) derated_s = b.seconds_now();
    most_a = std::max(most_a, std::abs(s.current_a));
    if (s.thermal_load > 0.999F) {
      EXPECT_LT(std::abs(s.current_a), 1.1F * b.config.drive.continuous_current_a);
    }
  };
  const double began = b.seconds_now();
  b.run(1.5);
  ASSERT_TRUE(derated_s) << "limit code 7 was not shown";
  EXPECT_GT(*derated_s - began, 0.02) << "not before it is warm";
  EXPECT_GT(most_a, 1.2F * b.config.drive.continuous_current_a);
  EXPECT_GT(worst, 0.8F);
  EXPECT_LT(worst, can::row_of(Fault::thermal_overload).threshold);
  EXPECT_EQ(b.status().fault, Emergency::none) << "it gives way, without a fault";
}

struct Silence {
  const char* name;
  std::uint8_t sub;  ///< of 2131h
  Fault fault;
  std::function<void(PlantBench&)> provoke;
};

TEST(Faults, WhatASilentSourceLeadsToIsConfiguredPerSource) {
  const std::vector<Silence> sources{
      {"knots", 1, Fault::knots_lost, [](PlantBench& b) { b.trajectory = nullptr; }},
      {"heartbeat", 3, Fault::heartbeat_lost,
       [](PlantBench& b) { b.receive(can::heartbeat_frame(1, can::NmtState::operational)); }},
      {"bus", 5, Fault::bus_off, [](PlantBench& b) { b.module.bus_off(b.now); }},
  };
  for (const Silence& source : sources) {
    for (const Reaction reaction : {Reaction::report, Reaction::hold, Reaction::stop, Reaction::damp}) {
      if (reaction == Reaction::report && source.sub == 1) continue;
      PlantBench b = following_joint();
      b.run(0.01);
      b.write(0x2131, source.sub, static_cast<std::uint32_t>(reaction), 1);
      ASSERT_TRUE(b.enable());
      ASSERT_TRUE(b.follow_here());
      swing(b);
      b.run(0.5);
      source.provoke(b);
      b.run(0.8);
      const can::ObjectDictionary& od = b.module.objects();
      EXPECT_EQ(od.error_code, static_cast<int>(can::row_of(source.fault).code)) << source.name;
      switch (reaction) {
        case Reaction::report:
          EXPECT_TRUE(b.status().following_knots) << source.name;
          EXPECT_NE(od.statusword & kStatusWarning, 0);
          break;
        case Reaction::hold:
          EXPECT_EQ(b.status().state, DriveState::operation_enabled) << source.name;
          EXPECT_NEAR(b.status().velocity_rad_s, 0.0, 0.01) << source.name;
          EXPECT_FALSE(b.status().following_knots) << source.name;
          break;
        default:
          EXPECT_EQ(b.status().state, DriveState::fault) << source.name;
          EXPECT_FALSE(b.actuator.power_stage_enabled) << source.name;
      }
    }
  }
}

TEST(Faults, InTorqueModeASilentSourceHasReactionsOfItsOwn) {
  const std::vector<Silence> sources{
      {"torque targets", 0, Fault::torque_target_lost, [](PlantBench&) {}},
      {"heartbeat", 1, Fault::heartbeat_lost,
       [](PlantBench& b) { b.receive(can::heartbeat_frame(1, can::NmtState::operational)); }},
      {"bus", 2, Fault::bus_off, [](PlantBench& b) { b.module.bus_off(b.now); }},
  };
  for (const Silence& source : sources) {
    for (const Reaction reaction : {Reaction::report, Reaction::hold, Reaction::stop, Reaction::damp}) {
      const bool targets = source.sub == 0;
      if (targets && reaction == Reaction::report) continue;
      PlantBench b = following_joint();
      b.run(0.01);
      const auto number = static_cast<std::uint32_t>(reaction);
      if (targets) {
        b.write(0x2131, 2, number, 1);
      } else {
        // What holds in mode 8 is something else.
        b.write(0x2131, source.sub == 1 ? 3 : 5, reaction == Reaction::stop ? 0 : 3, 1);
        b.write(0x2132, source.sub, number, 1);
      }
      ASSERT_TRUE(b.enable());
      lead_by_torque(b);
      ASSERT_EQ(b.status().mode, Mode::cyclic_torque);
      source.provoke(b);
      for (int i = 0; i < 800; ++i) targets ? b.tick() : send_torque(b);
      SCOPED_TRACE(std::string(source.name) + ", reaction " + std::to_string(number));
      const can::ObjectDictionary& od = b.module.objects();
      EXPECT_EQ(od.error_code, static_cast<int>(can::row_of(source.fault).code));
      EXPECT_EQ(b.status().state, reaction >= Reaction::stop ? DriveState::fault : DriveState::operation_enabled);
      EXPECT_EQ(b.status().cause, reaction >= Reaction::stop ? source.fault : Fault::none);
      if (reaction == Reaction::report) {
        EXPECT_EQ(b.status().authority, Authority::motion) << "the targets still lead";
      }
      if (reaction == Reaction::hold) {
        EXPECT_EQ(b.status().limit, LimitCode::watchdog);
        EXPECT_NEAR(b.status().velocity_rad_s, 0.0, 0.01);
      }
    }
  }
}

TEST(Faults, ATorqueTargetThatComesBackDoesNotEndTheHoldOfALostHeartbeat) {
  for (const bool heartbeat_too : {false, true}) {
    PlantBench b = following_joint();
    b.run(0.01);
    b.write(0x2131, 2, static_cast<std::uint32_t>(Reaction::hold), 1);
    b.write(0x2132, 1, static_cast<std::uint32_t>(Reaction::hold), 1);
    ASSERT_TRUE(b.enable());
    lead_by_torque(b);
    if (heartbeat_too) b.receive(can::heartbeat_frame(1, can::NmtState::operational));
    b.run(0.8);
    ASSERT_EQ(b.status().limit, LimitCode::watchdog);
    for (int i = 0; i < 300; ++i) send_torque(b);
    EXPECT_EQ(b.status().authority == Authority::motion, !heartbeat_too);
    EXPECT_EQ(b.status().limit == LimitCode::watchdog, heartbeat_too);
  }
}

TEST(Faults, KnotsThatWereLostBeforeDoNotEndAPassivePhase) {
  PlantBench b = following_joint();
  b.run(0.01);
  b.write(0x2133, 1, static_cast<std::uint32_t>(Reaction::stop), 1);
  ASSERT_TRUE(b.enable());
  ASSERT_TRUE(b.follow_here());
  b.trajectory = nullptr;
  b.run(0.1);
  ASSERT_EQ(b.module.objects().error_code, static_cast<int>(Emergency::knots_lost));
  b.select(can::SelectionAction::now, false, 1);
  b.run(0.02);
  EXPECT_EQ(b.status().law, Law::passive);
  EXPECT_EQ(b.status().fault, Emergency::none);
}

TEST(Faults, WhilePassiveASilentSourceHasReactionsOfItsOwn) {
  const std::vector<Silence> sources{
      {"knots", 1, Fault::knots_lost, [](PlantBench& b) { b.trajectory = nullptr; }},
      {"heartbeat", 2, Fault::heartbeat_lost, [](PlantBench&) {}},  // seen once, at the start
      {"SYNC", 3, Fault::sync_lost, [](PlantBench& b) { b.sync = false; }},
      {"bus", 4, Fault::bus_off, [](PlantBench& b) { b.module.bus_off(b.now); }},
  };
  constexpr std::array<std::uint8_t, 4> kActive{1, 3, 4, 5};  // the same source in 2131h
  for (const Silence& source : sources) {
    for (const Reaction reaction : {Reaction::report, Reaction::hold, Reaction::stop, Reaction::damp}) {
      JointSetup setup;
      setup.joint = 2;
      setup.pose_rad = {0.0, 0.5, -1.5};
      setup.config = [](ModuleConfig& c) {
        c.passive.max_time = milliseconds(1500);
        c.passive.max_travel_rad = 3.0F;
      };
      PlantBench b(setup);
      b.run(0.01);
      if (source.sub == 1) b.write(0x2130, 4, 100, 2);
      b.write(0x2133, source.sub, static_cast<std::uint32_t>(reaction), 1);
      // Once it is active again it shall hold, whatever was lost.
      b.write(0x2131, kActive[source.sub - 1U], 2, 1);
      ASSERT_TRUE(b.enable());
      ASSERT_TRUE(b.follow_here());
      if (source.sub == 2) b.receive(can::heartbeat_frame(1, can::NmtState::operational));
      b.select(can::SelectionAction::now, false, 1);
      b.run(0.2);
      SCOPED_TRACE(std::string(source.name) + ", reaction " + std::to_string(static_cast<int>(reaction)));
      ASSERT_EQ(b.status().law, Law::passive);
      ASSERT_EQ(b.module.objects().error_code, 0) << "nothing is silent yet";
      source.provoke(b);
      b.run(0.6);
      EXPECT_EQ(b.module.objects().error_code, static_cast<int>(can::row_of(source.fault).code));
      if (reaction == Reaction::report) {
        EXPECT_EQ(b.status().law, Law::passive) << "the phase is carried through";
        EXPECT_NE(b.module.objects().statusword & kStatusWarning, 0);
        b.run(1.5);
        EXPECT_EQ(b.status().law, Law::active);
      }
      EXPECT_EQ(b.status().state, reaction >= Reaction::stop ? DriveState::fault : DriveState::operation_enabled);
      EXPECT_EQ(b.status().cause, reaction >= Reaction::stop ? source.fault : Fault::none);
      if (reaction <= Reaction::hold) {
        EXPECT_EQ(b.status().law, Law::active);
        EXPECT_NEAR(b.status().velocity_rad_s, 0.0, 0.01);
      }
    }
  }
}

TEST(Faults, WhatAPassivePhaseWasCarriedThroughStopsTheJointAfterIt) {
  PlantBench b = following_joint();
  ASSERT_TRUE(b.enable());
  ASSERT_TRUE(b.follow_here());
  b.select(can::SelectionAction::now, false, 1);
  b.run(0.01);
  b.module.bus_off(b.now);
  b.run(0.05);
  ASSERT_EQ(b.status().law, Law::passive);
  ASSERT_EQ(b.status().fault, Emergency::none);
  b.run(1.5);
  EXPECT_EQ(b.status().state, DriveState::fault);
  EXPECT_EQ(b.status().cause, Fault::bus_off) << "the first fault is kept though it was told before";
  EXPECT_EQ(b.module.objects().first_fault_cause, static_cast<int>(Emergency::bus_off_recovered));
}

INSTANTIATE_TEST_SUITE_P(Rows, FaultTable, testing::Range(std::size_t{0}, can::kFaultCount),
                         [](const auto& row) { return std::string(can::kFaults[row.param].name); });

}  // namespace
}  // namespace mrr::fw
