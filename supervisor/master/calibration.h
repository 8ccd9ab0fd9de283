// Room: supervisor/master. One calibration of one joint: settings over SDO, the module's own action, its results back.
// May touch common/core, can_protocol and NodeProxy. Stepped: allocates nothing, throws nothing.
#pragma once

#include <array>
#include <cstdint>

#include "common/core/time.h"
#include "supervisor/master/node_proxy.h"

namespace mrr::sup {

enum class CalibrationKind : std::uint8_t {
  friction,     ///< identification: friction of either direction, torque constants if a torque sensor is there
  torque_zero,  ///< what the torque sensor reads too high
  brake,        ///< whether the brake holds
};
inline constexpr std::array kCalibrationKinds{CalibrationKind::friction, CalibrationKind::torque_zero,
                                              CalibrationKind::brake};
/// As clients name it.
[[nodiscard]] const char* describe(CalibrationKind kind) noexcept;

struct CalibrationSettings {
  CalibrationKind kind = CalibrationKind::friction;
  float travel_rad = 0.3F;   ///< friction: to either side of where the joint stands
  float speed_rad_s = 1.0F;  ///< friction: of the fastest pass
  float load_nm = 0.0F;      ///< torque zero: what the transmission gives the link, by the model
  float torque_nm = 0.0F;    ///< brake: pushes with it; 0: the module's own choice
};

/// How far one has come, and what it found.
struct CalibrationReport {
  CalibrationSettings settings;
  int joint = -1;             ///< -1: there was none yet
  std::uint32_t command = 0;  ///< its number
  ActionState state = ActionState::none;
  std::uint8_t progress_percent = 0;
  bool has_result = false;        ///< what follows was read from the module
  std::uint8_t module_state = 0;  ///< 2170h:01 (friction), 2180h:01: why it failed
  /// Friction, of motion in the positive and in the negative direction: f_c, f_s in Nm, f_tau in s^2/rad^2, b in
  /// Nm s/rad, joint side.
  std::array<std::array<float, 4>, 2> friction{};
  std::array<float, 2> torque_constant_nm_a{};  ///< motor side, for positive and negative torque
  float residual_nm = 0.0F;                     ///< of the fit, rms
  std::uint32_t points = 0;                     ///< of the fit
  float offset_nm = 0.0F;                       ///< torque zero: what is subtracted from the sensor from now on
  float slip_rad = 0.0F;                        ///< brake: largest travel
};
/// Why the module says that it failed, in words; empty if it does not.
[[nodiscard]] const char* why_failed(const CalibrationReport& report) noexcept;

class CalibrationRun {
 public:
  void start(int joint, std::uint32_t command, const CalibrationSettings& settings, Time now) noexcept;
  /// The joint stops; the results of a brake or friction run are no use then.
  void stop(NodeProxy& node) noexcept;
  /// Every step while running, after the node's own.
  void step(Time now, NodeProxy& node) noexcept;

  [[nodiscard]] bool running() const noexcept { return report_.state == ActionState::running; }
  [[nodiscard]] const CalibrationReport& report() const noexcept { return report_; }

 private:
  enum class Phase : std::uint8_t { settings, action, results };
  void finish() noexcept;
  void take(can::ObjectId object, const can::Value& value) noexcept;

  CalibrationReport report_;
  Phase phase_ = Phase::settings;
  int request_ = 0;
  int retries_ = 0;
  bool asked_ = false;
  Time last_poll_;
};

}  // namespace mrr::sup
