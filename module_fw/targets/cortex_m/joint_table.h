// Room: module_fw/targets/cortex_m. The configuration linked into the image: the hammer joint of the 3-joint reference
// arm. May touch module_fw/config.h. Figures as in robots/mrr3/robot.yaml, joint_3.
#pragma once

#include "module_fw/config.h"

namespace mrr::fw {

constexpr ModuleConfig make_joint_table() noexcept {
  ModuleConfig c;
  c.node_id = 4;
  c.selection_bit = 2;
  c.friction = {3.9F, 4.6F, 1111.0F, 2.0F};
  c.control.inertia_kg_m2 = 0.1714F;
  c.control.position_gain_nm_rad = 428.4F;
  c.control.velocity_gain_nm_s_rad = 17.14F;
  c.control.compensator = {true,
                           {10.0F, 300.0F, 300.0F, 0.0F},
                           {2.0F, 2.5F, 2.5F, 0.0F},
                           {0.5F, 0.8F, 0.8F, 40.0F},
                           {0.1F, 0.1F, 0.1F, 2.0F},
                           0.4F,
                           0.06F};
  c.passive.compensation_nm = 3.31F;
  c.passive.static_compensation_nm = 3.91F;
  c.drive.gear_ratio = 101.0F;
  c.drive.torque_constant_positive_nm_a = 0.19F;
  c.drive.torque_constant_negative_nm_a = 0.25F;
  c.drive.peak_current_a = 2.4F;
  c.drive.continuous_current_a = 1.2F;
  c.drive.rated_torque_nm = 16.0F;
  c.sensing.current_full_scale_a = 4.0F;
  c.limits.torque_nm = 45.0F;
  return c;
}

inline constexpr ModuleConfig kJointTable = make_joint_table();

}  // namespace mrr::fw
