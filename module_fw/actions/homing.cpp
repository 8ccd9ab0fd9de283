#include "module_fw/actions/homing.h"

#include <array>

#include "module_fw/control/scalar_math.h"

namespace mrr::fw {

namespace {

constexpr std::int32_t kHardTicks = 20;  // breaking loose takes a moment of more torque

}  // namespace

HomingConfig homing_by_method(HomingConfig config, std::int8_t method) noexcept {
  struct Search {
    HomingMark mark;
    int direction;
    bool leaving;
  };
  constexpr std::array<Search, 6> kEdges{{{HomingMark::limit_switch, -1, true},
                                          {HomingMark::limit_switch, 1, true},
                                          {HomingMark::home_switch, 1, true},
                                          {HomingMark::home_switch, 1, false},
                                          {HomingMark::home_switch, -1, true},
                                          {HomingMark::home_switch, -1, false}}};
  const bool to_index = method >= 1 && method <= 6;
  Search search{};
  if (to_index || (method >= 17 && method <= 22)) {
    search = kEdges[static_cast<std::size_t>(method - (to_index ? 1 : 17))];
  } else if (method == 33 || method == 34) {
    search = {HomingMark::index, method == 34 ? 1 : -1, false};
  } else {
    return config;
  }
  config.mark = search.mark;
  config.direction = search.direction;
  config.leaving = search.leaving;
  config.index = to_index || search.mark == HomingMark::index;
  return config;
}

void Homing::start(Time now, const Inputs& in) noexcept {
  from_rad_ = in.position_rad;
  hard_ticks_ = 0;
  started_ = now;
  seen_switch_ = false;
  if (config_.mark == HomingMark::index) {
    phase_ = Phase::index;
  } else if (on_mark(in)) {
    phase_ = config_.leaving ? Phase::leave : Phase::clear;
  } else {
    phase_ = Phase::search;
  }
}

float Homing::velocity_rad_s() const noexcept {
  const float direction = config_.direction < 0 ? -1.0F : 1.0F;
  switch (phase_) {
    case Phase::search:
      return direction * config_.fast_rad_s;
    case Phase::pass_over:
      return -direction * config_.fast_rad_s;
    case Phase::clear:
    case Phase::leave:
      return -direction * config_.slow_rad_s;
    case Phase::approach:
      return direction * config_.slow_rad_s;
    case Phase::index:  // on, the way the edge was met or left
      return (config_.leaving ? -direction : direction) * config_.slow_rad_s;
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
  const bool on = on_mark(in);
  const bool limit_ahead = limit_towards(config_.direction, in);
  const bool limit_behind = limit_towards(-config_.direction, in);
  switch (phase_) {
    case Phase::search:
      if (on) {
        phase_ = config_.leaving ? Phase::leave : Phase::clear;
      } else if (limit_ahead) {
        phase_ = Phase::pass_over;  // started beyond the switch: come back over it
      }
      break;
    case Phase::pass_over:
      seen_switch_ = seen_switch_ || on;
      if (seen_switch_ && !on) phase_ = Phase::approach;
      if (limit_behind) phase_ = Phase::failed;
      break;
    case Phase::clear:
      if (!on) phase_ = Phase::approach;
      if (limit_behind) phase_ = Phase::failed;
      break;
    case Phase::approach:
      if (on) {
        if (!config_.leaving) return at_edge();
        phase_ = Phase::leave;
      } else if (limit_ahead) {
        phase_ = Phase::failed;
      }
      break;
    case Phase::leave:
      // While it still brakes on the way in, an open contact is a bounce, or the switch's far end.
      if (!on && in.moving_rad_s * static_cast<float>(config_.direction) < 0.0F) return at_edge();
      if (limit_behind) phase_ = Phase::failed;
      break;
    case Phase::index:
      if (in.index_pulse) {
        phase_ = Phase::done;
        return true;
      }
      if (config_.leaving ? limit_behind : limit_ahead) phase_ = Phase::failed;
      break;
    case Phase::idle:
    case Phase::done:
    case Phase::failed:
      break;
  }
  return false;
}

}  // namespace mrr::fw
