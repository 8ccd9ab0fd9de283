#include "module_fw/actions/homing.h"

namespace mrr::fw {

void Homing::start(Time now, bool on_switch) noexcept {
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
  if (now - started_ > config_.timeout) {
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
