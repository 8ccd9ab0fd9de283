// Room: module_fw/actions. Torque zero, brake test, limit recovery: each a state machine stepped once a tick, with a
// timeout and caps on travel and torque. They say what they want of the joint; the module gives it.
// May touch module_fw/config.h and sensing's Reading. Freestanding.
#pragma once

#include <cstdint>

#include "common/core/time.h"
#include "module_fw/sensing/sensing.h"
#include "module_fw/status.h"

namespace mrr::fw {

/// As 2180h:01 shows it.
enum class ActionState : std::uint8_t {
  none,
  running,
  done,
  timed_out,
  travel_cap,
  torque_cap,
  interrupted,
  sensor,
  slipped,
  nothing_to_do,
};

class Calibration {
 public:
  /// From the objects 2180h and the configuration, when an action starts.
  struct Settings {
    Duration timeout = milliseconds(10'000);
    float torque_zero_max_nm = 0.0F;
    float torque_zero_load_nm = 0.0F;
    float brake_test_torque_nm = 0.0F;
    float brake_test_travel_rad = 0.0F;
    float recovery_speed_rad_s = 0.0F;
    float recovery_margin_rad = 0.0F;
    float recovery_travel_rad = 0.0F;
    float recovery_torque_nm = 0.0F;
    float lower_rad = 0.0F;
    float upper_rad = 0.0F;
  };
  struct Inputs {
    Time now;
    float position_rad = 0.0F;
    float velocity_rad_s = 0.0F;
    bool position_known = false;  ///< homed: position limits mean something
    Reading torque_nm;            ///< the sensor, offset taken off
    float load_nm = 0.0F;         ///< what the joint carries
    float commanded_nm = 0.0F;    ///< what the drive was asked for
    bool reference_at_rest = false;
    bool lower_switch = false;
    bool upper_switch = false;
    bool brake_engaged = false;  ///< dwell over, contact closed, power stage on
    bool brake_open = false;
  };
  struct Wish {
    float velocity_rad_s = 0.0F;  ///< of the reference; 0: hold
    bool brake = false;           ///< engaged, with the power stage on
    bool push = false;            ///< give push_nm instead of the control law
    float push_nm = 0.0F;
  };

  /// `mode`: torque_zero, brake_test or limit_recovery.
  void start(Mode mode, const Settings& settings, const Inputs& in) noexcept;
  /// Something of higher priority took the joint, or the client withdrew the start bit.
  void interrupt() noexcept {
    if (running()) finish(ActionState::interrupted);
  }
  /// One tick while running.
  void update(const Inputs& in) noexcept;

  [[nodiscard]] bool running() const noexcept { return state_ == ActionState::running; }
  [[nodiscard]] ActionState state() const noexcept { return state_; }
  [[nodiscard]] Mode mode() const noexcept { return mode_; }
  [[nodiscard]] const Wish& wish() const noexcept { return wish_; }
  /// Torque zero, done: by how much the sensor reads too high. Nm.
  [[nodiscard]] float found_offset_nm() const noexcept { return found_offset_nm_; }
  /// Brake test: largest travel under torque. rad.
  [[nodiscard]] float slip_rad() const noexcept { return slip_rad_; }

 private:
  enum class Step : std::uint8_t { settle, measure, engage, push_up, push_down, relax, release, move };

  void zero_torque(const Inputs& in) noexcept;
  void test_brake(const Inputs& in) noexcept;
  void recover(const Inputs& in) noexcept;
  void enter(Step step, Time now) noexcept {
    step_ = step;
    step_since_ = now;
  }
  void finish(ActionState state) noexcept {
    state_ = state;
    wish_ = {};
  }
  /// Beyond the limit, or nearer to it than the margin, or on its switch.
  [[nodiscard]] static bool is_above(const Inputs& in, const Settings& s, float margin_rad) noexcept;
  [[nodiscard]] static bool is_below(const Inputs& in, const Settings& s, float margin_rad) noexcept;

  Settings settings_;
  ActionState state_ = ActionState::none;
  Mode mode_ = Mode::none;
  Step step_ = Step::settle;
  Wish wish_;
  Time started_;
  Time step_since_;
  float from_rad_ = 0.0F;
  float hold_nm_ = 0.0F;
  float slip_rad_ = 0.0F;
  float found_offset_nm_ = 0.0F;
  float sum_nm_ = 0.0F;
  float lowest_nm_ = 0.0F;
  float highest_nm_ = 0.0F;
  std::int32_t samples_ = 0;
  int direction_ = 0;                        ///< of limit recovery
  ActionState outcome_ = ActionState::done;  ///< of the brake test, once the brake is open again
};

}  // namespace mrr::fw
