// Room: module_fw/faults. A torque that swings while the joint rests: the loop through the torque sensor is not as
// stable as it was laid out to be. May touch module_fw/config.h. Freestanding.
#pragma once

#include "module_fw/config.h"
#include "module_fw/control/scalar_math.h"

namespace mrr::fw {

/// Counts how often the torque goes from one side of its mean to the other, by more than noise and a drifting sensor
/// do.
class SwingWatch {
 public:
  SwingWatch(const FrictionConfig& friction, Duration tick) noexcept
      : band_nm_(kBand_nm + kFrictionShare * friction.static_nm),
        filter_(limit(tick.seconds_f() / kMean_s, 0.0F, 1.0F)),
        window_(static_cast<std::int32_t>(kWindow / tick)) {}

  /// One tick of a joint that rests. After motion it begins anew.
  void update(float torque_nm, Time now) noexcept {
    if (now - last_ > kPause) {
      ticks_ = turns_ = windows_ = 0;
      mean_nm_ = torque_nm;
    }
    last_ = now;
    mean_nm_ += filter_ * (torque_nm - mean_nm_);
    if ((torque_nm - mean_nm_) * side_ < -band_nm_) {
      side_ = -side_;
      ++turns_;
    }
    if (++ticks_ < window_) return;
    windows_ = turns_ >= kTurns ? windows_ + (windows_ < kWindows ? 1 : 0) : 0;
    ticks_ = turns_ = 0;
  }
  /// It does, for longer than what a stop leaves behind takes to ring out.
  [[nodiscard]] bool swings(Time now) const noexcept { return windows_ >= kWindows && now - last_ <= kPause; }

 private:
  static constexpr float kBand_nm = 1.0F;
  static constexpr float kFrictionShare = 0.05F;
  static constexpr float kMean_s = 0.1F;
  static constexpr Duration kWindow = milliseconds(500);
  static constexpr Duration kPause = milliseconds(50);  // without update(): it moved
  static constexpr std::int32_t kTurns = 8;             // 8 Hz: faster than a hand shakes the joint
  static constexpr std::int32_t kWindows = 3;

  float band_nm_;
  float filter_;
  std::int32_t window_;
  float mean_nm_ = 0.0F;
  float side_ = 1.0F;
  std::int32_t turns_ = 0;
  std::int32_t ticks_ = 0;
  std::int32_t windows_ = 0;  ///< in a row in which it did
  Time last_;
};

}  // namespace mrr::fw
