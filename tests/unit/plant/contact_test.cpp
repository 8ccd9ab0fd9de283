// Hammer, nail and board: what a force sensor and a ruler would find, and what must never happen.
#include <gtest/gtest.h>

#include "tests/unit/plant/hammering.h"

namespace mrr::sim::test {
namespace {

/// The reference arm lets its hammer fall: joint 2 free, the others braked. `turn_rad` sets it beside the nail.
Plant dropped(const PlantDescription& description, double height_m, double turn_rad = 0.0,
              double nail_height_m = 0.04) {
  RobotDescription robot = reference_arm();
  robot.task.nail_position_m.z() = 0.48 - 0.04;
  Plant plant(robot, description, 0);
  plant.reset(std::array{turn_rad, height_m / 0.76, 0.0}, nail_height_m);
  plant.set_actuator(1, {0, true, true});
  return plant;
}

PlantDescription hardwood() {
  PlantDescription description = default_plant(reference_arm());
  description.board.nail_resistance_n = 5000.0;
  return description;
}

TEST(Contact, FoamTakesTheNailAndTheRecordAddsUp) {
  Plant plant = dropped(default_plant(reference_arm()), 0.08);
  double impulse = 0.0;
  double peak = 0.0;
  double before = 0.04;
  for (int k = 0; k < 10000; ++k) {
    plant.step(microseconds(100));
    const PlantTruth truth = plant.truth();
    ASSERT_GE(truth.contact_force_n, 0.0);
    ASSERT_LE(truth.nail_height_m, before);  // a nail never comes out by itself
    before = truth.nail_height_m;
    impulse += 1e-4 * truth.contact_force_n;
    peak = std::max(peak, truth.contact_force_n);
  }
  ASSERT_GE(plant.contacts().size(), 1U);
  const ContactRecord& blow = plant.contacts()[0];
  EXPECT_GT(blow.penetration_m, 0.005);
  EXPECT_NEAR(plant.truth().nail_height_m, 0.04 - blow.penetration_m, 1e-9);
  EXPECT_NEAR(blow.peak_force_n, peak, 1e-9);
  double recorded = 0.0;
  for (const ContactRecord& record : plant.contacts()) recorded += record.impulse_n_s;
  EXPECT_NEAR(recorded, impulse, 1e-9);
  EXPECT_GT(blow.speed_at_start_m_s, 0.3);
  EXPECT_GT(plant.truth().energy.nail_work_j, 0.02);
  // What the robot lost to the nail is what the nail took, but for the rubber's own loss.
  EXPECT_LE(plant.truth().energy.nail_work_j, -plant.truth().energy.contact_work_j + 1e-6);
}

TEST(Contact, NailObeysItsResistance) {
  PlantDescription description = default_plant(reference_arm());
  Plant plant = dropped(description, 0.08);
  bool moved = false;
  for (int k = 0; k < 5000; ++k) {
    const double height = plant.truth().nail_height_m;
    plant.step(microseconds(100));
    const PlantTruth truth = plant.truth();
    if (!(truth.nail_height_m > 0.0)) break;  // flush: from here on the board carries it
    const double resistance = 3.8 + 113.0 * (0.04 - truth.nail_height_m);
    if (truth.nail_velocity_m_s > 0.0) {
      moved = true;
      EXPECT_NEAR(truth.nail_force_n, resistance + 11.6 * truth.nail_velocity_m_s, 0.02);
    } else {
      EXPECT_LE(truth.nail_force_n, resistance + 0.02);
      EXPECT_NEAR(truth.nail_height_m, height, 1e-4);
    }
  }
  EXPECT_TRUE(moved);
}

TEST(Contact, HardwoodDoesNotYield) {
  Plant plant = dropped(hardwood(), 0.08);
  plant.step(milliseconds(1000));
  ASSERT_GE(plant.contacts().size(), 1U);
  EXPECT_EQ(plant.truth().nail_height_m, 0.04);
  EXPECT_EQ(plant.contacts()[0].penetration_m, 0.0);
  EXPECT_LT(plant.contacts()[0].speed_at_end_m_s, 0.0);  // thrown back
  EXPECT_GT(-plant.contacts()[0].speed_at_end_m_s, 0.05 * plant.contacts()[0].speed_at_start_m_s);
}

// The joint carries the blow's impulse as J^T F says: for joint 1 held still, momentum about joint 2.
TEST(Contact, ImpulseIsTheChangeOfMomentum) {
  PlantDescription description = conservative_plant(reference_arm());
  description.board.nail_resistance_n = 5000.0;
  RobotDescription robot = reference_arm();
  robot.gravity_m_s2.setZero();
  Plant plant(robot, description, 0);
  plant.reset(std::array{0.0, 0.05, 0.0}, 0.04);
  for (int i = 0; i < 3; ++i) plant.set_actuator(i, {0, false, true});
  plant.set_external_torque(1, -8.0);
  plant.step(milliseconds(100));
  plant.set_external_torque(1, 0.0);
  // Angular momentum about joint 2's axis of links 2 and 3 and both rotors, from the matrices of the home pose.
  const auto momentum = [&] {
    const PlantTruth t = plant.truth();
    const double c3 = std::cos(t.link_position_rad[2]);
    const double m22 = 1.15925 - 2.0 * 0.38 * 0.35 * (1.0 - c3);
    const double m23 = 0.5055 - 0.38 * 0.35 * (1.0 - c3);
    return m22 * t.link_velocity_rad_s[1] + m23 * t.link_velocity_rad_s[2] + 0.1713768 * t.motor_velocity_rad_s[1] +
           101.0 * 0.168e-4 * t.motor_velocity_rad_s[2];
  };
  const double before = momentum();
  ASSERT_LT(before, -0.6);
  double moment = 0.0;  // integral of F times its arm about joint 2
  for (int k = 0; k < 6000; ++k) {
    plant.step(microseconds(100));
    const PlantTruth truth = plant.truth();
    moment += 1e-4 * truth.contact_force_n * 0.76;  // the nail stands still under the tip
  }
  ASSERT_EQ(plant.contacts().size(), 1U);
  EXPECT_GT(moment, 0.3);
  EXPECT_NEAR(momentum() - before, moment, 2e-3 * moment);
}

TEST(Contact, AMissIsAMiss) {
  // 15 mm beside the nail's axis: the 12 mm face passes it by and strikes the board.
  Plant plant = dropped(hardwood(), 0.08, 0.015 / 0.76);
  plant.step(milliseconds(1000));
  EXPECT_EQ(plant.truth().nail_height_m, 0.04);
  ASSERT_GE(plant.contacts().size(), 1U);
  EXPECT_TRUE(plant.contacts()[0].board_struck);
  EXPECT_GT(plant.contacts()[0].lateral_m, 0.014);
  EXPECT_LT(plant.truth().face_position_m.z(), 0.46);  // below the head, on the board

  Plant hit = dropped(hardwood(), 0.08, 0.010 / 0.76);
  hit.step(milliseconds(1000));
  ASSERT_GE(hit.contacts().size(), 1U);
  EXPECT_FALSE(hit.contacts()[0].board_struck);
  EXPECT_NEAR(hit.contacts()[0].lateral_m, 0.010, 5e-4);
}

TEST(Contact, AFlushNailPassesTheBlowToTheBoard) {
  RobotDescription robot = reference_arm();
  robot.task.nail_position_m.z() = 0.479;  // 1 mm proud
  PlantDescription description = default_plant(robot);
  Plant plant(robot, description, 0);
  plant.reset(std::array{0.0, 0.1, 0.0}, 0.001);
  plant.set_actuator(1, {0, true, true});
  plant.step(milliseconds(1000));
  EXPECT_EQ(plant.truth().nail_height_m, 0.0);
  ASSERT_GE(plant.contacts().size(), 1U);
  EXPECT_TRUE(plant.contacts()[0].board_struck);
  EXPECT_NEAR(plant.contacts()[0].penetration_m, 0.001, 1e-9);
  EXPECT_GT(plant.contacts()[0].peak_force_n, 15.0);  // more than the foam's resistance ever was
}

TEST(Contact, RecordsHoldTheSpeedsAndTorquesOfTheBlow) {
  Plant plant = dropped(hardwood(), 0.08);
  while (plant.contacts().empty() && plant.now() < Time{} + milliseconds(1000)) plant.step(microseconds(100));
  ASSERT_EQ(plant.contacts().size(), 1U);
  const ContactRecord start = plant.contacts()[0];
  EXPECT_TRUE(start.open);
  EXPECT_NEAR(start.link_velocity_before_rad_s[1] * 0.76, -start.speed_at_start_m_s, 0.02);
  double torque = 0.0;
  while (plant.contacts()[0].open) {
    plant.step(microseconds(100));
    if (plant.truth().contact) torque = std::max(torque, std::abs(plant.truth().transmission_torque_nm[1]));
  }
  const ContactRecord blow = plant.contacts()[0];
  EXPECT_EQ(blow.peak_transmission_torque_nm[1], torque);
  EXPECT_GT(blow.link_velocity_after_rad_s[1], blow.link_velocity_before_rad_s[1]);
  EXPECT_GT(blow.duration(), milliseconds(20));
  EXPECT_LT(blow.duration(), milliseconds(200));
  EXPECT_EQ(blow.start, start.start);
}

// A whole swing with everything in it: work in, work out, and what is stored.
TEST(Contact, EnergyBalanceOfAWholeSwing) {
  const RobotDescription robot = reference_arm();
  Plant plant(robot, default_plant(robot), 0);
  plant.reset(std::array{0.0, 0.5, 0.0}, 0.04);
  const double stored = plant.truth().energy.stored_j();
  double worst = 0.0;
  for (int k = 0; k < 1500; ++k) {
    const PlantTruth truth = plant.truth();
    const double wanted = k < 600 ? 0.5 - 0.55 * quintic(k / 600.0) : -0.05 + 0.55 * quintic((k - 600) / 600.0);
    const std::array<double, 3> target{0.0, wanted, 0.0};
    for (int i = 0; i < 3; ++i) {
      const auto j = static_cast<std::size_t>(i);
      const double torque = 500.0 * (target[j] - truth.motor_position_rad[j]) - 30.0 * truth.motor_velocity_rad_s[j];
      plant.set_actuator(i, torque_command(plant, i, torque));
    }
    plant.step(milliseconds(1));
    const EnergyTerms energy = plant.truth().energy;
    worst = std::max(worst, std::abs(energy.stored_j() - stored - energy.work_j()));
  }
  const EnergyTerms energy = plant.truth().energy;
  ASSERT_GE(plant.contacts().size(), 1U);
  ASSERT_GT(energy.nail_work_j, 0.02);
  ASSERT_GT(energy.friction_work_j, 3.0);
  EXPECT_LT(worst, 1e-3 * energy.friction_work_j);
}

}  // namespace
}  // namespace mrr::sim::test
