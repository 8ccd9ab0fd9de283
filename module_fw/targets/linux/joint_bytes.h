// Room: module_fw/targets/linux. What is in the plant bus's blocks and answers of a joint (docs/plant_io.md):
// joint_io.h as bytes, for mrr_module and mrr_plant. Header only, no I/O.
#pragma once

#include <bit>

#include "can_protocol/codec.h"
#include "can_protocol/plant_io/plant_frames.h"
#include "module_fw/joint_io.h"
#include "module_fw/status.h"

namespace mrr::fw {

/// What a module tells the plant: what to do, and what it believes (recorded only).
struct JointAnswer {
  ActuatorCommand actuator;
  bool passive = false;         ///< the passive law is in force
  bool wholly_passive = false;  ///< and the blend has ended
  float reference_position_rad = 0.0F;
  float reference_velocity_rad_s = 0.0F;
  float joint_torque_nm = 0.0F;  ///< sensed
  float torque_command_nm = 0.0F;
};

inline JointAnswer joint_answer(const ActuatorCommand& actuator, const ModuleStatus& status,
                                bool wholly_passive) noexcept {
  return {actuator,
          status.law == Law::passive,
          wholly_passive,
          status.reference_position_rad,
          status.reference_velocity_rad_s,
          status.joint_torque_nm,
          status.torque_command_nm};
}

inline plant_io::Block encode(const RawSensors& s) noexcept {
  plant_io::Block b{};
  std::uint8_t* d = b.data();
  can::put<std::int32_t>(d, s.encoder_count);
  can::put<std::int16_t>(d + 4, s.torque_adc);
  can::put<std::int16_t>(d + 6, s.current_adc);
  can::put<std::int16_t>(d + 8, s.winding_temperature_adc);
  can::put<std::int16_t>(d + 10, s.drive_temperature_adc);
  can::put<std::uint16_t>(d + 12, s.bus_voltage_adc);
  d[14] = s.inputs;
  d[15] = s.fresh;
  return b;
}

inline RawSensors decode_sensors(const plant_io::Block& b) noexcept {
  const std::uint8_t* d = b.data();
  RawSensors s;
  s.encoder_count = can::get<std::int32_t>(d);
  s.torque_adc = can::get<std::int16_t>(d + 4);
  s.current_adc = can::get<std::int16_t>(d + 6);
  s.winding_temperature_adc = can::get<std::int16_t>(d + 8);
  s.drive_temperature_adc = can::get<std::int16_t>(d + 10);
  s.bus_voltage_adc = can::get<std::uint16_t>(d + 12);
  s.inputs = d[14];
  s.fresh = d[15];
  return s;
}

inline plant_io::AnswerPayload encode(const JointAnswer& a) noexcept {
  plant_io::AnswerPayload p{};
  std::uint8_t* d = p.data();
  d[0] = static_cast<std::uint8_t>((a.actuator.power_stage_enabled ? 1U : 0U) | (a.actuator.brake_release ? 2U : 0U) |
                                   (a.passive ? 4U : 0U) | (a.wholly_passive ? 8U : 0U));
  can::put<std::int16_t>(d + 2, a.actuator.current_duty);
  can::put<std::uint32_t>(d + 4, std::bit_cast<std::uint32_t>(a.reference_position_rad));
  can::put<std::uint32_t>(d + 8, std::bit_cast<std::uint32_t>(a.reference_velocity_rad_s));
  can::put<std::uint32_t>(d + 12, std::bit_cast<std::uint32_t>(a.joint_torque_nm));
  can::put<std::uint32_t>(d + 16, std::bit_cast<std::uint32_t>(a.torque_command_nm));
  return p;
}

inline JointAnswer decode_joint_answer(const plant_io::AnswerPayload& p) noexcept {
  const std::uint8_t* d = p.data();
  JointAnswer a;
  a.actuator.power_stage_enabled = (d[0] & 1U) != 0;
  a.actuator.brake_release = (d[0] & 2U) != 0;
  a.passive = (d[0] & 4U) != 0;
  a.wholly_passive = (d[0] & 8U) != 0;
  a.actuator.current_duty = can::get<std::int16_t>(d + 2);
  a.reference_position_rad = std::bit_cast<float>(can::get<std::uint32_t>(d + 4));
  a.reference_velocity_rad_s = std::bit_cast<float>(can::get<std::uint32_t>(d + 8));
  a.joint_torque_nm = std::bit_cast<float>(can::get<std::uint32_t>(d + 12));
  a.torque_command_nm = std::bit_cast<float>(can::get<std::uint32_t>(d + 16));
  return a;
}

}  // namespace mrr::fw
