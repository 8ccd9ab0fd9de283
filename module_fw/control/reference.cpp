#include "module_fw/control/reference.h"

namespace mrr::fw {

namespace {

// Below this a decaying velocity is at rest: a tenth of a microradian per millisecond tick.
constexpr float kRestVelocity = 1e-4F;
// Tracking lags a stopping reference by less than this, rad/s.
constexpr float kVelocityMargin = 0.15F;
constexpr float kRestOffset = 1e-7F;
// Position counts on the wire are microradians: two of them are rounding, not a jump.
constexpr float kWireRounding = 3e-6F;

}  // namespace

MotionState carried_on(const MotionState& s, float by_s) noexcept {
  return {s.position_rad + by_s * (s.velocity_rad_s + 0.5F * by_s * s.acceleration_rad_s2),
          s.velocity_rad_s + by_s * s.acceleration_rad_s2, s.acceleration_rad_s2};
}

Reference::Reference(const ReferenceConfig& config, const LimitsConfig& limits, float dt_s) noexcept
    : config_(config), limits_(limits), dt_s_(dt_s), offset_factor_(exp_negative(config.offset_decay_1_s * dt_s)) {}

void Reference::start_at(float position_rad, float velocity_rad_s, float deceleration_rad_s2) noexcept {
  state_ = {position_rad, velocity_rad_s, 0.0F};
  stop(deceleration_rad_s2);
}

void Reference::stop(float deceleration_rad_s2) noexcept {
  lead_ = Lead::stop;
  continuing_ = false;
  deceleration_rad_s2_ = deceleration_rad_s2;
  wanted_velocity_rad_s_ = 0.0F;
  offset_rad_ = 0.0F;
  offset_velocity_rad_s_ = 0.0F;
}

void Reference::move_at(float velocity_rad_s, float acceleration_rad_s2) noexcept {
  stop(acceleration_rad_s2);
  lead_ = Lead::velocity;
  wanted_velocity_rad_s_ = velocity_rad_s;
}

void Reference::keep_near(float position_rad, float distance_rad) noexcept {
  if (lead_ != Lead::stop) return;
  state_.position_rad = limit(state_.position_rad, position_rad - distance_rad, position_rad + distance_rad);
}

void Reference::not_faster_than(float joint_velocity_rad_s) noexcept {
  if (lead_ != Lead::stop || state_.velocity_rad_s == 0.0F) return;
  const float direction = sign(state_.velocity_rad_s);
  const float allowed =
      limit(direction * joint_velocity_rad_s + kVelocityMargin, 0.0F, direction * state_.velocity_rad_s);
  state_.velocity_rad_s = direction * allowed;
}

void Reference::shift(float by_rad) noexcept {
  state_.position_rad += by_rad;
  from_.position_rad += by_rad;
  to_.position_rad += by_rad;
}

bool Reference::within_limits(const MotionState& s) const noexcept {
  // A twentieth over velocity and acceleration is rounding and interpolation; the planner keeps the limits themselves.
  const float v_max = 1.05F * limits_.velocity_rad_s;
  const float a_max = 1.05F * limits_.acceleration_rad_s2;
  if (!(absolute(s.velocity_rad_s) <= v_max && absolute(s.acceleration_rad_s2) <= a_max)) return false;
  // Where the joint could still stop must be within its range. A joint that stands beyond it may be led back.
  const float stop = s.position_rad + 0.5F * s.velocity_rad_s * absolute(s.velocity_rad_s) / a_max;
  const float slack = 1e-4F;
  const float lower = state_.position_rad < limits_.lower_rad ? state_.position_rad : limits_.lower_rad;
  const float upper = state_.position_rad > limits_.upper_rad ? state_.position_rad : limits_.upper_rad;
  return s.position_rad >= lower - slack && s.position_rad <= upper + slack && stop >= lower - slack &&
         stop <= upper + slack;
}

KnotVerdict Reference::offer(const Knot& knot, Time sync, Duration period, float position_rad) noexcept {
  if (!within_limits(knot.state)) return KnotVerdict::out_of_limits;
  const float T = short_seconds(period.ns);
  if (lead_ != Lead::knots) {
    if (!at_rest()) return KnotVerdict::ignored_moving;
    // A sender that repeats itself is not alive.
    if (has_sequence_ && knot.sequence == sequence_) return KnotVerdict::stale;
    const float away = state_.position_rad - knot.state.position_rad;
    const bool near = absolute(away) <= config_.resync_window_rad ||
                      absolute(position_rad - knot.state.position_rad) <= config_.resync_window_rad;
    if (!(near && absolute(knot.state.velocity_rad_s) <= config_.resync_velocity_rad_s)) {
      return KnotVerdict::ignored_far;
    }
    // One knot does not tell where it came from: it came with its own acceleration. What is then left between the held
    // reference and that segment fades, so that nothing jumps.
    MotionState from =
        carried_on({knot.state.position_rad, knot.state.velocity_rad_s, knot.state.acceleration_rad_s2}, -T);
    offset_rad_ = state_.position_rad - from.position_rad;
    offset_velocity_rad_s_ = -from.velocity_rad_s;
    lead_ = Lead::knots;
    sequence_ = knot.sequence;
    has_sequence_ = true;
    begin_segment(from, knot.state, sync, T);
    return KnotVerdict::resynchronised;
  }
  const auto advance = static_cast<std::int16_t>(static_cast<std::uint16_t>(knot.sequence - sequence_));
  if (advance <= 0) return KnotVerdict::stale;
  // The last segment ends at its knot. If knots went missing meanwhile, its continuation is where we are.
  const float x = short_seconds((sync - segment_start_).ns);
  const bool late = x > 1.5F * period_s_;
  const MotionState from = late ? segment_at(x) : to_;
  const float mean_velocity = 0.5F * (from.velocity_rad_s + knot.state.velocity_rad_s);
  const float bend = knot.state.position_rad - from.position_rad - T * mean_velocity;
  // |bend| <= a T^2 / 4 for any motion with |q''| <= a; twice that, and more after a gap, is still no jump.
  const float reach = limits_.acceleration_rad_s2 * T * (late ? 4.0F : 1.0F);
  if (!(absolute(bend) <= 0.5F * reach * T + kWireRounding &&
        absolute(knot.state.velocity_rad_s - from.velocity_rad_s) <= 2.0F * reach)) {
    return KnotVerdict::jump;
  }
  sequence_ = knot.sequence;
  begin_segment(from, knot.state, sync, T);
  return KnotVerdict::accepted;
}

void Reference::begin_segment(const MotionState& from, const MotionState& to, Time start, float period_s) noexcept {
  from_ = from;
  to_ = to;
  segment_start_ = start;
  if (period_s != period_s_) {
    period_s_ = period_s;
    inverse_period_ = 1.0F / period_s;
  }
  const float T = period_s;
  const float v0 = from.velocity_rad_s * T;
  const float v1 = to.velocity_rad_s * T;
  const float a0 = from.acceleration_rad_s2 * T * T;
  const float a1 = to.acceleration_rad_s2 * T * T;
  const float d = to.position_rad - from.position_rad;
  c1_ = v0;
  c2_ = 0.5F * a0;
  c3_ = 10.0F * d - 6.0F * v0 - 4.0F * v1 - 1.5F * a0 + 0.5F * a1;
  c4_ = -15.0F * d + 8.0F * v0 + 7.0F * v1 + 1.5F * a0 - a1;
  c5_ = 6.0F * d - 3.0F * (v0 + v1) - 0.5F * (a0 - a1);
}

MotionState Reference::segment_at(float x_s) const noexcept {
  if (x_s >= period_s_) return carried_on(to_, x_s - period_s_);
  const float s = x_s > 0.0F ? x_s * inverse_period_ : 0.0F;
  const float p = s * (c1_ + s * (c2_ + s * (c3_ + s * (c4_ + s * c5_))));
  const float v = c1_ + s * (2.0F * c2_ + s * (3.0F * c3_ + s * (4.0F * c4_ + s * 5.0F * c5_)));
  const float a = 2.0F * c2_ + s * (6.0F * c3_ + s * (12.0F * c4_ + s * 20.0F * c5_));
  return {from_.position_rad + p, v * inverse_period_, a * inverse_period_ * inverse_period_};
}

void Reference::fade_offset() noexcept {
  const float w = config_.offset_decay_1_s;
  const float c = (offset_velocity_rad_s_ + w * offset_rad_) * dt_s_;
  offset_rad_ = (offset_rad_ + c) * offset_factor_;
  offset_velocity_rad_s_ = (offset_velocity_rad_s_ - w * c) * offset_factor_;
  if (absolute(offset_rad_) < kRestOffset && absolute(offset_velocity_rad_s_) < kRestVelocity * 0.1F) {
    offset_rad_ = 0.0F;
    offset_velocity_rad_s_ = 0.0F;
  }
}

const MotionState& Reference::step(Time now) noexcept {
  if (lead_ == Lead::knots) {
    const float x = short_seconds((now - segment_start_).ns);
    continuing_ = x > 1.25F * period_s_;
    state_ = segment_at(x);
    if (offset_rad_ != 0.0F || offset_velocity_rad_s_ != 0.0F) {
      const float w = config_.offset_decay_1_s;
      state_.position_rad += offset_rad_;
      state_.velocity_rad_s += offset_velocity_rad_s_;
      state_.acceleration_rad_s2 -= w * (2.0F * offset_velocity_rad_s_ + w * offset_rad_);
      fade_offset();
    }
    return state_;
  }
  // Towards the wanted velocity: bounded acceleration, exponential at the end so that the torque does not step there.
  const float missing = wanted_velocity_rad_s_ - state_.velocity_rad_s;
  const float a = limit(config_.settle_rate_1_s * missing, deceleration_rad_s2_);
  if (absolute(missing) < kRestVelocity) {
    state_.position_rad += wanted_velocity_rad_s_ * dt_s_;
    state_.velocity_rad_s = wanted_velocity_rad_s_;
    state_.acceleration_rad_s2 = 0.0F;
    return state_;
  }
  state_.position_rad += dt_s_ * (state_.velocity_rad_s + 0.5F * a * dt_s_);
  state_.velocity_rad_s += a * dt_s_;
  state_.acceleration_rad_s2 = a;
  return state_;
}

}  // namespace mrr::fw
