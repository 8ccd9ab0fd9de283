#include "module_fw/actions/brake_sequence.h"

#include "can_protocol/faults.h"

namespace mrr::fw {

namespace {

// The stage's answer must agree for this many ticks in a row: one agreeing sample may be chance.
constexpr std::uint8_t kTicksToConfirm = 5;
// The contact of a real brake bounces; so long beyond its dwell it must have switched.
constexpr Duration kReleaseGrace = can::row_of(can::Fault::brake_not_released).time;
constexpr Duration kEngageGrace = can::row_of(can::Fault::brake_not_engaged).time;
// A joint that does not come to rest gets its brake all the same.
constexpr Duration kStopTimeout = milliseconds(1000);

}  // namespace

BrakeSequence::Trouble BrakeSequence::update(Time now, const Inputs& in) noexcept {
  if (in.cut) {
    enter(Phase::off, now);
    return Trouble::none;
  }
  const Duration elapsed = now - since_;
  switch (phase_) {
    case Phase::off:
      if (in.wanted) {
        confirmed_ticks_ = 0;
        enter(Phase::confirming, now);
      }
      break;
    case Phase::confirming:
      if (!in.wanted) {
        enter(Phase::off, now);  // the brake never opened
        break;
      }
      confirmed_ticks_ = in.torque_confirmed ? static_cast<std::uint8_t>(confirmed_ticks_ + 1U) : std::uint8_t{0};
      if (confirmed_ticks_ >= kTicksToConfirm) {
        enter(Phase::releasing, now);
      } else if (elapsed > config_.torque_confirm_timeout) {
        return Trouble::torque_not_confirmed;
      }
      break;
    case Phase::releasing:
      if (!in.wanted) {
        enter(Phase::engaging, now);
      } else if (elapsed >= config_.release && in.feedback_released) {
        enter(Phase::open, now);
      } else if (elapsed > config_.release + kReleaseGrace) {
        return Trouble::not_released;
      }
      break;
    case Phase::open:
      if (!in.wanted) {
        enter(in.at_rest ? Phase::engaging : Phase::stopping, now);
      } else if (in.test) {
        enter(Phase::testing, now);
      }
      break;
    case Phase::testing:
      if (!in.wanted) {
        enter(Phase::engaging, now);
      } else if (!in.test) {
        enter(Phase::releasing, now);
      } else if (in.feedback_released && elapsed > config_.engage + kEngageGrace) {
        return Trouble::not_engaged;
      }
      break;
    case Phase::stopping:
      if (in.wanted) {
        enter(Phase::open, now);
      } else if (in.at_rest || elapsed > kStopTimeout) {
        enter(Phase::engaging, now);
      }
      break;
    case Phase::engaging:
      if (in.wanted) {
        confirmed_ticks_ = 0;
        enter(Phase::confirming, now);
      } else if (elapsed >= config_.engage && !in.feedback_released) {
        enter(Phase::off, now);
      } else if (elapsed > config_.engage + kEngageGrace) {
        return Trouble::not_engaged;
      }
      break;
  }
  return Trouble::none;
}

}  // namespace mrr::fw
