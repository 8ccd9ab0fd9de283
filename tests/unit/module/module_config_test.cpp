// Configuration from a robot description.
#include "module_fw/targets/host/module_config.h"

#include <gtest/gtest.h>

#include "module_fw/module.h"

namespace mrr::fw {
namespace {

const RobotDescription& robot() {
  static const RobotDescription r = load_robot(std::filesystem::path(MRR_SOURCE_DIR) / "robots" / "mrr3");
  return r;
}

TEST(ModuleConfig, CarriesTheReferenceArmsFigures) {
  const ModuleConfig c = module_config(robot(), 2);
  EXPECT_EQ(c.node_id, 4);
  EXPECT_EQ(c.selection_bit, 2);
  EXPECT_NEAR(c.control.inertia_kg_m2, 0.1714F, 1e-4F);
  EXPECT_NEAR(c.control.position_gain_nm_rad, 2500.0F * 0.17138F, 0.1F);
  EXPECT_FLOAT_EQ(c.drive.gear_ratio, 101.0F);
  EXPECT_EQ(c.tick, milliseconds(1));
  EXPECT_EQ(c.knot_period, milliseconds(4));
  EXPECT_EQ(c.passive.blend, milliseconds(3));
  EXPECT_THROW(static_cast<void>(module_config(robot(), 3)), std::out_of_range);
}

TEST(ModuleConfig, IsUsableByTheModuleForEveryJointOfEveryRobot) {
  for (const char* name : {"mrr3", "arm7"}) {
    const auto folder = std::filesystem::path(MRR_SOURCE_DIR) / "robots" / name;
    const RobotDescription r = load_robot(folder);
    for (int i = 0; i < r.dof(); ++i) {
      Module m(module_config(r, i));
      ActuatorCommand a;
      can::TransmitQueue tx;
      m.step(Time{}, RawSensors{}, {}, a, tx);
      EXPECT_EQ(m.status().fault, can::Emergency::none) << name << " joint " << i;
    }
  }
}

TEST(ModuleConfig, HashChangesWithAnyFigure) {
  const ModuleConfig c = module_config(robot(), 1);
  EXPECT_EQ(c.configuration_hash, configuration_hash(c));
  ModuleConfig d = c;
  d.friction.viscous_nm_s_rad += 0.01F;
  EXPECT_NE(configuration_hash(d), c.configuration_hash);
  d = c;
  d.control.compensator.robust_width[3] *= 2.0F;
  EXPECT_NE(configuration_hash(d), c.configuration_hash);
  d = c;
  d.brake.engage = d.brake.engage + milliseconds(1);
  EXPECT_NE(configuration_hash(d), c.configuration_hash);
  EXPECT_NE(module_config(robot(), 1).configuration_hash, module_config(robot(), 2).configuration_hash);
}

}  // namespace
}  // namespace mrr::fw
