// Test support: a module on a simulated joint, led by frames as a supervisor would send them. One virtual clock.
#pragma once

#include <functional>
#include <optional>
#include <utility>
#include <vector>

#include "can_protocol/client.h"
#include "can_protocol/pdo.h"
#include "can_protocol/selection.h"
#include "can_protocol/units.h"
#include "module_fw/module.h"
#include "tests/unit/module/joint_simulation.h"

namespace mrr::fw::test {

/// `Body`: the joint the module sits on; sample() gives its raw sensors, step(dt_s, command) advances it.
template <typename Body>
class BenchOf {
 public:
  BenchOf(const ModuleConfig& c, Body body) : config(c), joint(std::move(body)), module(config) {
    inbox_.reserve(256);
    sent.reserve(65536);
  }

  ModuleConfig config;
  Body joint;
  Module module;
  Time now;
  ActuatorCommand actuator;
  std::vector<can::Frame> sent;
  std::function<void(RawSensors&)> spoil;                     ///< changes the readings
  std::function<MotionState(double t_s)> trajectory;          ///< streamed as knots while set
  std::function<double(const MotionState&)> model_torque_nm;  ///< goes with the knots (60B2h); none: 0
  std::function<void(const ModuleStatus&)> each_tick;
  bool sync = true;
  int sync_every_ticks = 4;
  bool counter = true;
  std::uint8_t sync_counter = 0;
  std::uint16_t sequence = 0;
  std::uint16_t controlword = 0;
  std::int8_t mode = 8;
  int drop_knots = 0;  ///< this many of the next knots are lost

  [[nodiscard]] double seconds_now() const { return now.seconds(); }
  [[nodiscard]] double knot_period_s() const { return sync_every_ticks * config.tick.seconds(); }
  const ModuleStatus& status() const { return module.status(); }

  void receive(const can::Frame& frame) { inbox_.push_back({frame, now}); }

  /// One control tick: what a bus, a plant and a supervisor would do in it.
  void tick() {
    if (sync && ticks_ % sync_every_ticks == 0) {
      if (trajectory) {
        if (drop_knots > 0) {
          --drop_knots;
          ++sequence;
        } else {
          send_knot(trajectory(seconds_now() + knot_period_s()));
        }
      }
      sync_counter = static_cast<std::uint8_t>(sync_counter % 240U + 1U);
      receive(can::sync_frame(counter ? std::optional<std::uint8_t>(sync_counter) : std::nullopt));
    }
    RawSensors raw = joint.sample();
    if (spoil) spoil(raw);
    can::TransmitQueue tx;
    module.step(now, raw, inbox_, actuator, tx);
    inbox_.clear();
    for (const can::Frame& f : tx) {
      if (sent.size() < sent.capacity()) sent.push_back(f);
    }
    if (each_tick) each_tick(status());
    joint.step(config.tick.seconds(), actuator);
    now += config.tick;
    ++ticks_;
  }
  void run(double duration_s) {
    const auto n = static_cast<int>(std::lround(duration_s / config.tick.seconds()));
    for (int i = 0; i < n; ++i) tick();
  }
  /// Until `done` or the time is over.
  bool run_until(const std::function<bool()>& done, double timeout_s) {
    const auto n = static_cast<int>(std::lround(timeout_s / config.tick.seconds()));
    for (int i = 0; i < n && !done(); ++i) tick();
    return done();
  }

  void send_knot(const MotionState& s) {
    const auto id = config.node_id;
    receive(can::pack_rpdo2(id, {*can::urad_from_rad(static_cast<double>(s.position_rad)),
                                 *can::urad_s_from_rad_s(static_cast<double>(s.velocity_rad_s))}));
    const double torque_nm = model_torque_nm ? model_torque_nm(s) : 0.0;
    const auto rated_mnm = static_cast<std::uint32_t>(std::lround(config.drive.rated_torque_nm * 1e3F));
    receive(can::pack_rpdo3(id, {*can::mrad_s2_from_rad_s2(static_cast<double>(s.acceleration_rad_s2)),
                                 *can::permille_from_nm(torque_nm, rated_mnm), ++sequence}));
  }
  void command(std::uint16_t word) {
    controlword = word;
    receive(can::pack_rpdo1(config.node_id, {controlword, mode}));
  }
  void set_mode(std::int8_t value) {
    mode = value;
    command(controlword);
  }
  /// Expedited SDO download.
  void write(std::uint16_t index, std::uint8_t sub, std::uint32_t value, unsigned size) {
    can::Frame f;
    f.id = can::kSdoRequestCobId + config.node_id;
    f.length = 8;
    f.data[0] = static_cast<std::uint8_t>(0x23U | ((4U - size) << 2U));
    can::put<std::uint16_t>(f.data.data() + 1, index);
    f.data[3] = sub;
    can::put<std::uint32_t>(f.data.data() + 4, value);
    receive(f);
    tick();
  }
  void select(can::SelectionAction action, bool active, std::uint8_t seq, std::uint8_t at_counter = 0,
              std::uint16_t offset_us = 0) {
    const std::uint32_t mask = active ? 1U << config.selection_bit : 0U;
    receive(can::pack_rpdo4({mask, at_counter, offset_us, can::selection_byte(seq, action)}));
  }
  /// Boot, OPERATIONAL, SYNC counter on, drive enabled, brake released.
  bool enable() {
    run(0.01);
    write(0x1019, 0, 240, 1);
    receive(can::nmt_frame(can::NmtCommand::start, config.node_id));
    run(0.15);  // the loop locks to SYNC
    for (const std::uint16_t word : std::array<std::uint16_t, 3>{0x06, 0x07, 0x0F}) {
      command(word);
      run(0.01);
    }
    return run_until([&] { return status().brake_released && status().sync_locked; }, 1.0);
  }
  /// Streams a rest at the measured position until the module follows.
  bool follow_here() {
    const float here = status().position_rad;
    trajectory = [here](double) { return MotionState{here, 0.0F, 0.0F}; };
    return run_until([&] { return status().following_knots; }, 0.5);
  }
  [[nodiscard]] int count_sent(std::uint32_t id) const {
    return static_cast<int>(std::count_if(sent.begin(), sent.end(), [id](const can::Frame& f) { return f.id == id; }));
  }

 private:
  std::vector<can::ReceivedFrame> inbox_;
  std::int64_t ticks_ = 0;
};

/// On the joint simulation of these tests.
class ModuleBench : public BenchOf<Joint> {
 public:
  explicit ModuleBench(const JointParameters& parameters = hammer_joint(), std::optional<ModuleConfig> c = std::nullopt,
                       std::uint64_t seed = 1)
      : ModuleBench(parameters, c ? *c : module_config(parameters), seed, 0) {}

 private:
  ModuleBench(const JointParameters& parameters, const ModuleConfig& c, std::uint64_t seed, int)
      : BenchOf<Joint>(c, Joint(parameters, c, seed)) {}
};

}  // namespace mrr::fw::test
