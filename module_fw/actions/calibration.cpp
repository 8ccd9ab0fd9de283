#include "module_fw/actions/calibration.h"

namespace mrr::fw {

namespace {

constexpr Duration kSettle = milliseconds(300);    // the drive's spring rings out
constexpr Duration kMeasure = milliseconds(1000);  // of the torque sensor: 0.07 Nm of noise average out
constexpr float kStill = 0.02F;                    // rad/s: the joint rests
constexpr float kSteady = 1.5F;                    // Nm from lowest to highest while measuring
constexpr Duration kRamp = milliseconds(200);      // of the pushing torque
constexpr Duration kPush = milliseconds(300);      // at full torque
constexpr float kRampRate = 1.0F / 0.2F;           // 1/s, as kRamp

}  // namespace

void Calibration::start(Mode mode, const Settings& settings, const Inputs& in) noexcept {
  settings_ = settings;
  mode_ = mode;
  state_ = ActionState::running;
  outcome_ = ActionState::done;
  wish_ = {};
  started_ = in.now;
  from_rad_ = in.position_rad;
  enter(Step::settle, in.now);
  if (mode == Mode::limit_recovery) {
    const bool above = is_above(in, settings_, 0.0F);
    const bool below = is_below(in, settings_, 0.0F);
    direction_ = above ? -1 : 1;
    if (above == below) finish(above ? ActionState::sensor : ActionState::nothing_to_do);
    enter(Step::move, in.now);
  }
  if (mode == Mode::brake_test) slip_rad_ = 0.0F;
}

void Calibration::update(const Inputs& in) noexcept {
  if (!running()) return;
  if (in.now - started_ > settings_.timeout) {
    // A reading that never came to rest is what there is to say.
    return finish(mode_ == Mode::torque_zero ? ActionState::sensor : ActionState::timed_out);
  }
  switch (mode_) {
    case Mode::torque_zero:
      return zero_torque(in);
    case Mode::brake_test:
      return test_brake(in);
    case Mode::limit_recovery:
      return recover(in);
    case Mode::identification:
    case Mode::passive:
    case Mode::none:
    case Mode::homing:
    case Mode::cyclic_position:
    case Mode::cyclic_torque:
      return finish(ActionState::nothing_to_do);
  }
}

// The joint rests: what the sensor shows beyond what the joint carries is its offset.
void Calibration::zero_torque(const Inputs& in) noexcept {
  if (!in.torque_nm.valid) return finish(ActionState::sensor);
  if (step_ == Step::settle) {
    const bool rests = in.reference_at_rest && absolute(in.velocity_rad_s) <= kStill;
    if (!rests) enter(Step::settle, in.now);
    if (in.now - step_since_ < kSettle) return;
    enter(Step::measure, in.now);
    sum_nm_ = 0.0F;
    samples_ = 0;
    lowest_nm_ = highest_nm_ = in.torque_nm.value;
  }
  sum_nm_ += in.torque_nm.value;
  ++samples_;
  if (in.torque_nm.value < lowest_nm_) lowest_nm_ = in.torque_nm.value;
  if (in.torque_nm.value > highest_nm_) highest_nm_ = in.torque_nm.value;
  if (!(highest_nm_ - lowest_nm_ <= kSteady) || !(absolute(in.velocity_rad_s) <= kStill))
    return enter(Step::settle, in.now);
  if (in.now - step_since_ < kMeasure) return;
  found_offset_nm_ = sum_nm_ / static_cast<float>(samples_) - settings_.torque_zero_load_nm;
  finish(absolute(found_offset_nm_) <= settings_.torque_zero_max_nm ? ActionState::done : ActionState::torque_cap);
}

// Brake on, push either way, back to the torque that held the joint, brake off. The joint is held all the while: by the
// brake, or, should that slip, by the torque.
void Calibration::test_brake(const Inputs& in) noexcept {
  const float elapsed_s = short_seconds((in.now - step_since_).ns);
  const float share = limit(elapsed_s * kRampRate, 0.0F, 1.0F);
  const float travel = absolute(in.position_rad - from_rad_);
  switch (step_) {
    case Step::settle:
      if (!(in.reference_at_rest && absolute(in.velocity_rad_s) <= kStill)) enter(Step::settle, in.now);
      if (in.now - step_since_ < kSettle) return;
      hold_nm_ = in.commanded_nm;
      enter(Step::engage, in.now);
      wish_ = {.brake = true, .push = true, .push_nm = hold_nm_};
      return;
    case Step::engage:
      if (!in.brake_engaged) return;
      from_rad_ = in.position_rad;
      enter(Step::push_up, in.now);
      return;
    case Step::push_up:
    case Step::push_down: {
      const float full = step_ == Step::push_up ? settings_.brake_test_torque_nm : -settings_.brake_test_torque_nm;
      const float from = step_ == Step::push_up ? hold_nm_ : settings_.brake_test_torque_nm;
      wish_.push_nm = from + share * (full - from);
      if (travel > slip_rad_) slip_rad_ = travel;
      const bool slipped = !(travel <= settings_.brake_test_travel_rad);
      if (slipped) outcome_ = ActionState::slipped;
      if (slipped || in.now - step_since_ >= kRamp + kPush) {
        enter(step_ == Step::push_up && !slipped ? Step::push_down : Step::relax, in.now);
      }
      return;
    }
    case Step::relax:
      // At once when it slips: every further degree is the arm's.
      wish_.push_nm = outcome_ == ActionState::slipped
                          ? hold_nm_
                          : hold_nm_ - (1.0F - share) * (settings_.brake_test_torque_nm + hold_nm_);
      if (in.now - step_since_ < kRamp) return;
      wish_.push_nm = hold_nm_;
      wish_.brake = false;
      enter(Step::release, in.now);
      return;
    case Step::release:
      if (in.brake_open) finish(outcome_);
      return;
    case Step::measure:
    case Step::move:
      return finish(ActionState::nothing_to_do);
  }
}

bool Calibration::is_above(const Inputs& in, const Settings& s, float margin_rad) noexcept {
  return in.upper_switch || (in.position_known && in.position_rad > s.upper_rad - margin_rad);
}

bool Calibration::is_below(const Inputs& in, const Settings& s, float margin_rad) noexcept {
  return in.lower_switch || (in.position_known && in.position_rad < s.lower_rad + margin_rad);
}

// Slowly back into the limits, and off the switch.
void Calibration::recover(const Inputs& in) noexcept {
  if (!(absolute(in.position_rad - from_rad_) <= settings_.recovery_travel_rad)) return finish(ActionState::travel_cap);
  if (!(absolute(in.commanded_nm - in.load_nm) <= settings_.recovery_torque_nm)) return finish(ActionState::torque_cap);
  const float margin = settings_.recovery_margin_rad;
  const bool outside = direction_ < 0 ? is_above(in, settings_, margin) : is_below(in, settings_, margin);
  if (!outside) return finish(ActionState::done);
  wish_.velocity_rad_s = static_cast<float>(direction_) * settings_.recovery_speed_rad_s;
}

}  // namespace mrr::fw
