#include "module_fw/faults/sensor_watch.h"

namespace mrr::fw {

namespace {

using can::Fault;

constexpr std::uint16_t kPerJump = 4;      // a jump counts so much, a good tick takes one away
constexpr std::uint16_t kPushedTimes = 4;  // pushing is believed after so many times the frozen time
constexpr float kPushShare = 1.5F;         // of the static friction: more must move the motor
constexpr float kPushMargin = 1.0F;        // N m
constexpr float kDriftTime = 0.1F;         // s: filter of the disagreement
constexpr float kDriftShare = 0.2F;        // of the torques: what torque constant and sensor gain may be wrong by
constexpr float kFullScale = 32767.0F;

float threshold(Fault fault) noexcept { return can::row_of(fault).threshold; }

}  // namespace

SensorWatch::SensorWatch(const ModuleConfig& c) noexcept
    : nm_per_a_positive_(c.drive.gear_ratio * c.drive.torque_constant_positive_nm_a),
      nm_per_a_negative_(c.drive.gear_ratio * c.drive.torque_constant_negative_nm_a),
      radians_s_per_count_(
          2.0F * kPi /
          (static_cast<float>(c.sensing.encoder_counts_per_turn) * c.drive.gear_ratio * c.tick.seconds_f())),
      torque_end_(static_cast<std::int16_t>(threshold(Fault::torque_sensor_range) * kFullScale)),
      drift_nm_(threshold(Fault::torque_sensor_drift) * c.sensing.torque_full_scale_nm),
      drift_filter_(limit(c.tick.seconds_f() / kDriftTime, 0.0F, 1.0F)),
      torque_sensor_(c.sensing.torque_sensor),
      stuck_limit_ticks_(static_cast<std::uint16_t>(can::row_of(Fault::encoder_stuck).time / c.tick)),
      at_end_(can::row_of(Fault::torque_sensor_range).time, c.tick),
      frozen_(can::row_of(Fault::torque_sensor_stuck).time, c.tick),
      drifting_(can::row_of(Fault::torque_sensor_drift).time, c.tick) {
  if (stuck_limit_ticks_ < 3) stuck_limit_ticks_ = 3;
  configure(c);
}

void SensorWatch::configure(const ModuleConfig& c) noexcept {
  over_current_a_ = threshold(Fault::over_current) * c.drive.peak_current_a;
  mismatch_a_ = threshold(Fault::current_mismatch) * c.drive.peak_current_a;
  static_nm_ = c.friction.static_nm;
  viscous_nm_s_rad_ = c.friction.viscous_nm_s_rad;
  // What the rotor's acceleration may take at most, besides friction and drift.
  explained_at_rest_nm_ = static_nm_ + drift_nm_ + c.control.inertia_kg_m2 * c.limits.acceleration_rad_s2;
}

void SensorWatch::reset() noexcept {
  torque_trouble_ = Fault::none;
  torque_at_end_ = false;
  frozen_ticks_ = pushed_ticks_ = jumps_ = 0;
  disagreement_nm_ = 0.0F;
}

void SensorWatch::update(const RawSensors& raw, const Sensing& sensing, const Inputs& in,
                         FaultMonitor& faults) noexcept {
  const float amperes = sensing.current_a().valid ? sensing.current_a().value : in.commanded_a;
  motor_torque_nm_ = amperes * (amperes >= 0.0F ? nm_per_a_positive_ : nm_per_a_negative_);
  watch_encoder(raw, sensing, in, faults);
  watch_current(sensing, in, faults);
  if (torque_sensor_) watch_torque(raw, sensing, in);
}

void SensorWatch::watch_encoder(const RawSensors& raw, const Sensing& sensing, const Inputs& in,
                                FaultMonitor& faults) noexcept {
  if (sensing.implausible_counts() != implausible_) {
    implausible_ = sensing.implausible_counts();
    jumps_ = static_cast<std::uint16_t>(jumps_ + kPerJump);
  } else if (jumps_ > 0) {
    --jumps_;
  }
  constexpr auto kJumps = static_cast<std::uint16_t>(can::row_of(Fault::encoder_jump).threshold);
  if (jumps_ >= kJumps) {
    jumps_ = kJumps;
    faults.find(Fault::encoder_jump);
  }
  // Only jumping counts come: that is what is wrong, not their absence.
  if (!sensing.position_valid()) faults.check(Fault::encoder_lost, jumps_ == 0);

  if ((raw.fresh & kFreshEncoder) == 0) return;
  const auto step = static_cast<std::int32_t>(static_cast<std::uint32_t>(raw.encoder_count) -
                                              static_cast<std::uint32_t>(last_count_));
  last_count_ = raw.encoder_count;
  if (step != 0 || !in.free) {
    last_step_rad_s_ = in.free ? absolute(static_cast<float>(step)) * radians_s_per_count_ : 0.0F;
    frozen_ticks_ = pushed_ticks_ = 0;
    return;
  }
  if (frozen_ticks_ < 0xFFFFU) ++frozen_ticks_;
  const Reading& sensed = sensing.joint_torque_nm();
  const float load_nm = sensed.valid ? sensed.value : in.model_nm;
  const bool pushed =
      (sensed.valid || in.model_known) && absolute(motor_torque_nm_ - load_nm) > kPushShare * static_nm_ + kPushMargin;
  pushed_ticks_ = pushed ? static_cast<std::uint16_t>(pushed_ticks_ + 1U) : std::uint16_t{0};
  if ((frozen_ticks_ >= stuck_limit_ticks_ && last_step_rad_s_ > threshold(Fault::encoder_stuck)) ||
      pushed_ticks_ >= kPushedTimes * stuck_limit_ticks_) {
    pushed_ticks_ = 0;
    faults.find(Fault::encoder_stuck);
  }
}

void SensorWatch::watch_current(const Sensing& sensing, const Inputs& in, FaultMonitor& faults) noexcept {
  const Reading& current = sensing.current_a();
  faults.check(Fault::over_current, current.valid && !(absolute(current.value) <= over_current_a_));
  faults.check(Fault::current_mismatch,
               in.free && current.valid && !(absolute(current.value - in.commanded_a) <= mismatch_a_));
}

// What becomes of a finding is the module's choice, as a joint that is led goes on by the model torque.
void SensorWatch::watch_torque(const RawSensors& raw, const Sensing& sensing, const Inputs& in) noexcept {
  if ((raw.fresh & kFreshTorque) == 0) return;
  const bool end = raw.torque_adc >= torque_end_ || raw.torque_adc <= -torque_end_;
  torque_at_end_ = end;
  const bool out_of_range = at_end_.update(end);
  if (out_of_range) {
    if (torque_trouble_ == Fault::none) torque_trouble_ = Fault::torque_sensor_range;
  } else if (torque_trouble_ == Fault::torque_sensor_range && !end) {
    torque_trouble_ = Fault::none;
  }

  const bool same = raw.torque_adc == last_torque_ && in.free && !end;
  last_torque_ = raw.torque_adc;
  if (!same) torque_froze_at_nm_ = motor_torque_nm_;
  if (frozen_.update(same)) {
    const float hidden_nm = threshold(Fault::torque_sensor_stuck) + 2.0F * static_nm_;
    if (absolute(motor_torque_nm_ - torque_froze_at_nm_) > hidden_nm && torque_trouble_ == Fault::none)
      torque_trouble_ = Fault::torque_sensor_stuck;
  }

  if (in.free) {
    disagreement_nm_ += drift_filter_ * (motor_torque_nm_ - sensing.joint_torque_nm().value - disagreement_nm_);
    effort_nm_ += drift_filter_ * (absolute(motor_torque_nm_) - effort_nm_);
  } else {
    disagreement_nm_ = effort_nm_ = 0.0F;
  }
  const float explained_nm =
      explained_at_rest_nm_ + viscous_nm_s_rad_ * absolute(sensing.velocity_rad_s()) + kDriftShare * effort_nm_;
  const bool drifts = drifting_.update(!(absolute(disagreement_nm_) <= explained_nm));
  if (drifts && torque_trouble_ == Fault::none) torque_trouble_ = Fault::torque_sensor_drift;
}

}  // namespace mrr::fw
