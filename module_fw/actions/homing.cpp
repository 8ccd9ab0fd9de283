#include "module_fw/actions/homing.h"

#include "module_fw/control/scalar_math.h"

namespace mrr::fw {

namespace {

constexpr std::int32_t kHardTicks = 20;  // breaking loose takes a moment of more torque

}  // namespace

HomingConfig homing_by_method(HomingConfig config, std::int8_t method) noexcept {
  const bool index = method == 4 || method == 6;
  const bool positive = method == 4 || method == 20;
  if (!index && !positive && method != 22) return config;
  config.direction = positive ? 1 : -1;
  config.index = index;
  return config;
}

void Homing::start(Time now, bool on_switch, float position_rad) noexcept {
  from_rad_ = position_rad;
  hard_ticks_ = 0;
  started_ = now;
  seen_switch_ = false;
  phase_ = on_switch ? Phase::clear : Phase::search;
}

float Homing::velocity_rad_s() const noexcept {
  const float direction = config_.direction < 0 ? -1.0F : 1.0F;
  switch (phase_) {
    case Phase::search:
      return direction * config_.fast_rad_s;
    case Phase::pass_over:
      return -direction * config_.fast_rad_s;
    case Phase::clear:
      return -direction * config_.slow_rad_s;
    case Phase::approach:
    case Phase::index:
      return direction * config_.slow_rad_s;
    case Phase::idle:
    case Phase::done:
    case Phase::failed:
      break;
  }
  return 0.0F;
}

bool Homing::update(Time now, const Inputs& in) noexcept {
  if (!running()) return false;
  const bool too_far =
      config_.max_travel_rad > 0.0F && !(absolute(in.position_rad - from_rad_) <= config_.max_travel_rad);
  const bool hard = config_.max_torque_nm > 0.0F && !(absolute(in.effort_nm) <= config_.max_torque_nm);
  hard_ticks_ = hard ? hard_ticks_ + 1 : 0;
  if (now - started_ > config_.timeout || too_far || hard_ticks_ > kHardTicks) {
    phase_ = Phase::failed;
    return false;
  }
  const bool limit_ahead = config_.direction < 0 ? in.negative_limit : in.positive_limit;
  const bool limit_behind = config_.direction < 0 ? in.positive_limit : in.negative_limit;
  switch (phase_) {
    case Phase::search:
      if (in.home_switch) {
        phase_ = Phase::clear;
      } else if (limit_ahead) {
        phase_ = Phase::pass_over;  // started beyond the switch: come back over it
      }
      break;
    case Phase::pass_over:
      seen_switch_ = seen_switch_ || in.home_switch;
      if (seen_switch_ && !in.home_switch) phase_ = Phase::approach;
      if (limit_behind) phase_ = Phase::failed;
      break;
    case Phase::clear:
      if (!in.home_switch) phase_ = Phase::approach;
      if (limit_behind) phase_ = Phase::failed;
      break;
    case Phase::approach:
      if (in.home_switch) {
        phase_ = config_.index ? Phase::index : Phase::done;
        return !config_.index;
      }
      if (limit_ahead) phase_ = Phase::failed;
      break;
    case Phase::index:
      if (in.index_pulse) {
        phase_ = Phase::done;
        return true;
      }
      if (limit_ahead) phase_ = Phase::failed;
      break;
    case Phase::idle:
    case Phase::done:
    case Phase::failed:
      break;
  }
  return false;
}

}  // namespace mrr::fw
