// Room: module_fw/drive. Joint torque -> current duty, within what current, heat and the sensors allow.
// May touch module_fw/config.h. Freestanding.
#pragma once

#include <cstdint>

#include "module_fw/config.h"
#include "module_fw/control/scalar_math.h"
#include "module_fw/sensing/sensing.h"

namespace mrr::fw {

/// I^2 t: load' = ((i / i_cont)^2 - load) / tau; 1 is what the winding stands for ever.
class ThermalModel {
 public:
  ThermalModel(const DriveConfig& config, float dt_s) noexcept;
  void set_peak_current(float peak_a) noexcept { peak_a_ = peak_a; }
  void update(float current_a) noexcept;
  [[nodiscard]] float load() const noexcept { return load_; }
  /// Largest current now: the peak while cool; from 80 % load it comes down linearly, to the continuous current at 100
  /// %.
  [[nodiscard]] float allowed_current_a() const noexcept;

 private:
  float peak_a_;
  float continuous_a_;
  float inverse_continuous_;
  float gain_;
  float load_ = 0.0F;
};

enum class DriveLimit : std::uint8_t { none, torque, current_peak, current_thermal };

class Drive {
 public:
  Drive(const DriveConfig& drive, const SensingConfig& sensing, const LimitsConfig& limits, float dt_s) noexcept;

  /// New limits; what the winding has stored stays.
  void configure(const DriveConfig& drive, const LimitsConfig& limits) noexcept;

  struct Output {
    std::int16_t duty = 0;
    float torque_nm = 0.0F;  ///< joint side, after the limits
    DriveLimit limit = DriveLimit::none;
    bool finite = true;  ///< false: the torque asked for was not a number; duty is 0
  };

  /// @param torque_nm  joint side
  /// @param current    measured; when not valid, the last command stands in for it in the thermal model
  /// @param winding    measured temperature, degC
  Output command(float torque_nm, const Reading& current, const Reading& winding, float max_torque_nm) noexcept;
  /// The power stage is off: the winding only cools.
  void idle() noexcept;

  [[nodiscard]] float thermal_load() const noexcept { return thermal_.load(); }
  /// Current that the last command asked for.
  [[nodiscard]] float commanded_current_a() const noexcept { return commanded_a_; }

 private:
  DriveConfig config_;
  ThermalModel thermal_;
  float amperes_per_nm_positive_;
  float amperes_per_nm_negative_;
  float counts_per_ampere_;
  float amperes_per_degree_;  ///< by which the current comes down near the highest winding temperature
  float torque_limit_nm_;
  float commanded_a_ = 0.0F;
};

}  // namespace mrr::fw
