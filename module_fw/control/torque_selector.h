// Room: module_fw/control. Selection (23), (24): which law's torque is in force, and the change without a bump either
// way. May touch module_fw/control. Freestanding.
#pragma once

#include <cstdint>

#include "module_fw/control/scalar_math.h"
#include "module_fw/status.h"

namespace mrr::fw {

/// Active -> passive: from the last commanded torque to the passive torque of that instant in `blend_ticks` equal
/// steps, monotonic, no overshoot; the first step is in the tick of the switch, the last leaves exactly the passive
/// torque. Passive -> active: at most `slew` per tick towards the active torque until that is reached.
class TorqueSelector {
 public:
  TorqueSelector(std::int32_t blend_ticks, float slew_nm_per_tick) noexcept
      : blend_ticks_(blend_ticks < 1 ? 1 : blend_ticks), slew_nm_(slew_nm_per_tick) {}

  /// `passive_nm`: the passive torque of this instant, where the blend ends.
  void go_passive(float passive_nm) noexcept {
    law_ = Law::passive;
    catching_up_ = false;
    start_nm_ = output_nm_;
    target_nm_ = passive_nm;
    remaining_ = blend_ticks_;
  }
  void go_active() noexcept {
    law_ = Law::active;
    catching_up_ = true;
    remaining_ = 0;
  }
  void off() noexcept {
    law_ = Law::off;
    catching_up_ = false;
    remaining_ = 0;
    output_nm_ = 0.0F;
  }

  /// One tick: the torque to command. The trend of the passive law must rest while blending().
  float step(float active_nm, float passive_nm) noexcept {
    switch (law_) {
      case Law::off:
        output_nm_ = 0.0F;
        break;
      case Law::active:
        if (catching_up_) {
          const float missing = active_nm - output_nm_;
          catching_up_ = !(absolute(missing) <= slew_nm_);
          output_nm_ = catching_up_ ? output_nm_ + limit(missing, slew_nm_) : active_nm;
        } else {
          output_nm_ = active_nm;
        }
        break;
      case Law::passive:
        if (remaining_ > 0) {
          --remaining_;
          const float rest = static_cast<float>(remaining_) / static_cast<float>(blend_ticks_);
          output_nm_ = remaining_ == 0 ? target_nm_ : target_nm_ + (start_nm_ - target_nm_) * rest;
        } else {
          output_nm_ = passive_nm;
        }
        break;
    }
    return output_nm_;
  }

  /// What was really commanded, when something behind the selector limited it.
  void set_commanded(float torque_nm) noexcept { output_nm_ = torque_nm; }

  [[nodiscard]] Law law() const noexcept { return law_; }
  /// On the way from active to passive torque.
  [[nodiscard]] bool blending() const noexcept { return remaining_ > 0; }
  [[nodiscard]] bool catching_up() const noexcept { return catching_up_; }

 private:
  std::int32_t blend_ticks_;
  float slew_nm_;
  Law law_ = Law::off;
  bool catching_up_ = false;
  std::int32_t remaining_ = 0;
  float start_nm_ = 0.0F;
  float target_nm_ = 0.0F;
  float output_nm_ = 0.0F;
};

}  // namespace mrr::fw
