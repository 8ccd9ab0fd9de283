// Room: tests/unit/plant. The reference's hammering experiment with ideal joint controllers: what the emulator is
// judged by. Uses sim_vcan/plant only; the firmware has no part in it.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>

#include "tests/unit/plant/reference_arm.h"

namespace mrr::sim::test {

/// Rest to rest quintic, unit travel in unit time: position, and its derivative.
inline double quintic(double s) { return s <= 0.0 ? 0.0 : s >= 1.0 ? 1.0 : s * s * s * (10.0 + s * (-15.0 + 6.0 * s)); }
inline double quintic_bend(double s) { return s <= 0.0 || s >= 1.0 ? 0.0 : 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s); }
inline double quintic_rate(double s) { return s <= 0.0 || s >= 1.0 ? 0.0 : 30.0 * s * s * (1.0 - s) * (1.0 - s); }

struct Swing {
  double travel_rad = 0.594;    ///< of joint 2, from the back-swing to the end of its reference
  double time_s = 0.57;         ///< of the way in; the way back follows at once and takes as long
  double past_head_m = 0.0;     ///< how far below the head, at the arm's tip, the reference ends
  double head_height_m = 0.04;  ///< above the board, before the blow
};

struct ExperimentController {
  std::array<double, 3> stiffness_nm_rad{2000.0, 414.0, 414.0};
  std::array<double, 3> damping_nm_s_rad{50.0, 55.7, 55.7};
  double passive_gap_m = 0.004;            ///< joint 3 lets go at this gap on the way in
  double inertia_feedforward_kg_m2 = 0.0;  ///< times joint 2's reference acceleration
  double coulomb_feedforward = 0.0;        ///< share of joint 2's identified Coulomb friction fed forward
  bool torque_sensor = false;              ///< joint 2 is relieved of what its torque sensor reads, instead of gravity
};

struct SwingResult {
  ContactRecord blow;
  std::size_t contacts = 0;
};

/// One swing in the home pose. The nail's head is at the height of the stretched-out arm whatever its depth: the
/// board is lifted for each swing, as only the reference depth is free. Joint 1 is held, joint 2 follows its
/// reference by PD on its motor plus gravity, joint 3 is held until the gap and then left alone, without current.
inline SwingResult run_swing(RobotDescription robot, const PlantDescription& description, const Swing& swing,
                             const ExperimentController& control, std::uint64_t seed = 0) {
  robot.task.nail_position_m.z() = 0.48 - swing.head_height_m;
  Plant plant(robot, description, seed);
  const double end = -swing.past_head_m / 0.76;  // reference of joint 2 at its lowest
  const std::array<double, 3> start{0.0, end + swing.travel_rad, 0.0};
  plant.reset(start, swing.head_height_m);

  constexpr double kTick = 1e-3;
  const double settle = 0.2;  // brakes open, the arm settles in its controllers
  bool passive = false;
  const int ticks = static_cast<int>((settle + 2.0 * swing.time_s + 0.1) / kTick);
  for (int k = 0; k < ticks; ++k) {
    const double t = k * kTick - settle;
    const double way_in = t / swing.time_s;
    const double way_back = way_in - 1.0;
    const double share = quintic(way_in) - quintic(way_back);
    const double rate = (quintic_rate(way_in) - quintic_rate(way_back)) / swing.time_s;
    const double bend = (quintic_bend(way_in) - quintic_bend(way_back)) / (swing.time_s * swing.time_s);
    const std::array<double, 3> wanted{0.0, start[1] - swing.travel_rad * share, 0.0};
    const std::array<double, 3> wanted_rate{0.0, -swing.travel_rad * rate, 0.0};

    const PlantTruth truth = plant.truth();
    if (t > 0.0 && truth.face_gap_m <= control.passive_gap_m) passive = true;
    const double q2 = truth.motor_position_rad[1];
    const double q3 = truth.motor_position_rad[2];
    const double gravity3 = 9.81 * 1.0 * 0.35 * std::cos(q2 + q3);
    const double gravity2 = 9.81 * (3.5 * 0.19 + 1.0 * 0.38) * std::cos(q2) + gravity3;
    const std::array<double, 3> gravity{0.0, gravity2, gravity3};
    for (int i = 0; i < 3; ++i) {
      const auto j = static_cast<std::size_t>(i);
      double torque = gravity[j] - control.stiffness_nm_rad[j] * (truth.motor_position_rad[j] - wanted[j]) -
                      control.damping_nm_s_rad[j] * (truth.motor_velocity_rad_s[j] - wanted_rate[j]);
      if (i == 1 && control.torque_sensor) {
        const double full_scale = robot.joints[1].sensors.torque_full_scale_nm;
        torque += full_scale * static_cast<double>(plant.sample(1).torque_adc) / 32767.0 - gravity[1];
      }
      if (i == 1) {
        torque -= control.inertia_feedforward_kg_m2 * swing.travel_rad * bend;
        torque += control.coulomb_feedforward * robot.joints[1].friction.coulomb_nm * std::tanh(wanted_rate[1] / 0.02);
      }
      if (i == 2 && passive) torque = 0.0;
      plant.set_actuator(i, torque_command(plant, i, torque));
    }
    plant.step(milliseconds(1));
    if (way_in > 1.0 && !plant.contacts().empty() && !plant.contacts().back().open) break;  // seen all of the blow
  }
  SwingResult result;
  result.contacts = plant.contacts().size();
  if (result.contacts > 0) result.blow = plant.contacts()[0];
  return result;
}

/// What the reference measured (Tables 6, 7): penetration mm, duration ms, impulse N s.
struct MeasuredSwing {
  const char* name;
  double penetration_mm;
  double duration_ms;
  double impulse_n_s;
  double head_height_mm;  ///< before the blow
  double past_head_mm;    ///< reference depth: the one free parameter per swing
};

}  // namespace mrr::sim::test
