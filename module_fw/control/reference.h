// Room: module_fw/control. What the active law follows: knots from the bus, or by itself a stop, a hold, a slow search.
// May touch module_fw/config.h, common/core. Freestanding.
#pragma once

#include <cstdint>

#include "common/core/time.h"
#include "module_fw/config.h"
#include "module_fw/control/active_law.h"

namespace mrr::fw {

/// One set-point knot: the joint shall be there, so fast, so accelerated, at the SYNC after the one it came with.
struct Knot {
  MotionState state;
  std::uint16_t sequence = 0;
};

/// The motion `by_s` seconds on (or back), its acceleration constant.
[[nodiscard]] MotionState carried_on(const MotionState& s, float by_s) noexcept;

/// What became of a knot.
enum class KnotVerdict : std::uint8_t {
  accepted,
  resynchronised,  ///< accepted, and it ended a hold
  ignored_far,     ///< holding: not within the window around the held reference or the joint
  ignored_moving,  ///< not at rest yet after a stop
  stale,           ///< its sequence did not advance
  out_of_limits,   ///< position, velocity or acceleration beyond the joint's limits
  jump,            ///< no joint within its limits gets there in one period
};

/// The reference trajectory of one joint. Between knots: quintic Hermite in (q, q', q''), so a quintic trajectory is
/// reproduced exactly.
class Reference {
 public:
  Reference(const ReferenceConfig& config, const LimitsConfig& limits, float dt_s) noexcept;

  /// q_d := q, q_d' := q'; from there the reference comes to rest at a bounded rate and holds.
  void start_at(float position_rad, float velocity_rad_s, float deceleration_rad_s2) noexcept;
  /// Knots lead no longer: comes to rest at a bounded rate and holds.
  void stop(float deceleration_rad_s2) noexcept;
  /// Moves at a constant velocity, reached with a bounded acceleration (homing).
  void move_at(float velocity_rad_s, float acceleration_rad_s2) noexcept;
  /// While stopping or holding: never further than `distance_rad` from where the joint is. A joint that is held back
  /// (an arm that came to rest on a board) takes its reference along rather than press ever harder against it.
  void keep_near(float position_rad, float distance_rad) noexcept;
  /// The position scale changed (homing): the reference is the same place under another number.
  void shift(float by_rad) noexcept;

  /// A knot arrived with the SYNC at `sync`; the next SYNC is due `period` later.
  /// `position_rad` is where the joint is: a knot near it ends a hold too, for a joint that is kept off its reference
  /// (the board stopped it) can only be met there.
  KnotVerdict offer(const Knot& knot, Time sync, Duration period, float position_rad) noexcept;

  /// While the reference comes to rest it is not faster than the joint (by more than a margin): a joint that something
  /// stopped is not pressed against it. The law carries the sensed load, so what the reference runs on, the joint
  /// pushes.
  void not_faster_than(float joint_velocity_rad_s) noexcept;

  /// One tick: where the joint shall be now. Continues the last knot at its acceleration once its period is over.
  const MotionState& step(Time now) noexcept;

  [[nodiscard]] const MotionState& state() const noexcept { return state_; }
  /// Knots lead, as opposed to a hold.
  [[nodiscard]] bool following() const noexcept { return lead_ == Lead::knots; }
  /// Holding at rest.
  [[nodiscard]] bool at_rest() const noexcept { return lead_ == Lead::stop && state_.velocity_rad_s == 0.0F; }
  /// Time since the SYNC that brought the last accepted knot; meaningful while following().
  [[nodiscard]] Duration since_knot(Time now) const noexcept { return now - segment_start_; }
  [[nodiscard]] bool continuing() const noexcept { return continuing_; }

 private:
  enum class Lead : std::uint8_t { stop, velocity, knots };

  [[nodiscard]] bool within_limits(const MotionState& s) const noexcept;
  /// Trajectory of the segment at x seconds after its start, without the fading offset.
  [[nodiscard]] MotionState segment_at(float x_s) const noexcept;
  void begin_segment(const MotionState& from, const MotionState& to, Time start, float period_s) noexcept;
  void fade_offset() noexcept;

  ReferenceConfig config_;
  LimitsConfig limits_;
  float dt_s_;
  float offset_factor_;  ///< exp(-omega dt)

  Lead lead_ = Lead::stop;
  MotionState state_;
  float deceleration_rad_s2_ = 0.0F;
  float wanted_velocity_rad_s_ = 0.0F;

  // Segment: p(s) = from + c1 s + ... + c5 s^5, s = x / T.
  MotionState from_;
  MotionState to_;
  Time segment_start_;
  float period_s_ = 1.0F;
  float inverse_period_ = 1.0F;
  float c1_ = 0.0F, c2_ = 0.0F, c3_ = 0.0F, c4_ = 0.0F, c5_ = 0.0F;
  std::uint16_t sequence_ = 0;  ///< of the last accepted knot
  bool has_sequence_ = false;
  bool continuing_ = false;

  // Difference between the held reference and the knots at resynchronisation, fading (critically damped).
  float offset_rad_ = 0.0F;
  float offset_velocity_rad_s_ = 0.0F;
};

}  // namespace mrr::fw
