// Room: module_fw. What a joint's hardware gives and takes each control tick: raw, as ADCs and timers have it.
// Freestanding. The plant emulator fills and reads the same structs (over memory, or over a bus of its own).
#pragma once

#include <cstdint>

namespace mrr::fw {

/// Bits of RawSensors::inputs.
enum InputBit : std::uint8_t {
  kInputNegativeLimit = 1U << 0U,
  kInputPositiveLimit = 1U << 1U,
  kInputHomeSwitch = 1U << 2U,
  kInputIndexPulse = 1U << 3U,     ///< the encoder index was passed since the last sample
  kInputBrakeReleased = 1U << 4U,  ///< brake feedback contact
  kInputPowerStageFault = 1U << 5U,
};

/// Bits of RawSensors::fresh: which readings are new since the last sample. A reading without its bit must not be used.
enum FreshBit : std::uint8_t {
  kFreshEncoder = 1U << 0U,
  kFreshTorque = 1U << 1U,
  kFreshCurrent = 1U << 2U,
  kFreshTemperature = 1U << 3U,
  kFreshBusVoltage = 1U << 4U,
};

/// One sample of a joint's sensors. Scales are in the robot description (SensorsDescription).
struct RawSensors {
  std::int32_t encoder_count = 0;            ///< motor side, multi-turn, counts
  std::int16_t torque_adc = 0;               ///< joint torque sensor, full scale = 32767
  std::int16_t current_adc = 0;              ///< motor current (q axis), full scale = 32767
  std::int16_t winding_temperature_adc = 0;  ///< 0.1 degC per count
  std::int16_t drive_temperature_adc = 0;    ///< 0.1 degC per count
  std::uint16_t bus_voltage_adc = 0;         ///< 0.01 V per count
  std::uint8_t inputs = 0;                   ///< InputBit
  std::uint8_t fresh = 0;                    ///< FreshBit
};

/// What the module tells the power stage. The stage is a current-mode amplifier; its set point is a PWM duty.
struct ActuatorCommand {
  std::int16_t current_duty = 0;  ///< +-32767 = +- full-scale current (SensorsDescription::current_full_scale_a)
  bool power_stage_enabled = false;
  bool brake_release = false;
};

}  // namespace mrr::fw
