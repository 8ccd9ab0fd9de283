// Test support: a joint of the emulated robot as the body a module sits on; the robot's other joints are held by their
// brakes. May touch everything that tests may.
#pragma once

#include <array>
#include <cmath>
#include <functional>
#include <vector>

#include "common/robot/robot.h"
#include "module_fw/targets/host/module_config.h"
#include "sim_vcan/plant/plant.h"
#include "tests/unit/module/module_bench.h"

namespace mrr::fw::test {

/// Where a joint is tried, and what the plant is that the module does not know.
struct JointSetup {
  int joint = 0;
  std::vector<double> pose_rad{0.0, 0.5, 0.0};
  std::uint64_t seed = 0;                                                ///< of the plant; 0: the nominal one
  std::function<void(RobotDescription&)> module_robot;                   ///< changes what the module believes
  std::function<void(RobotDescription&, sim::PlantDescription&)> plant;  ///< changes what is true
  std::function<void(ModuleConfig&)> config;
};

inline RobotDescription hammer_robot() { return load_robot(std::filesystem::path(MRR_SOURCE_DIR) / "robots" / "mrr3"); }

class PlantJoint {
 public:
  PlantJoint(const JointSetup& setup, const RobotDescription& robot) : joint_(setup.joint), plant_(make(setup, robot)) {
    plant_.reset(setup.pose_rad, robot.task.nail_height_m);
    truth = plant_.truth();
  }
  RawSensors sample() { return plant_.sample(joint_); }
  void step(double dt_s, const ActuatorCommand& command) {
    plant_.set_actuator(joint_, command);
    plant_.set_external_torque(joint_, external_nm);
    plant_.step(seconds(dt_s));
    truth = plant_.truth();
  }
  [[nodiscard]] double motor_q() const { return truth.motor_position_rad[at()]; }
  [[nodiscard]] double motor_v() const { return truth.motor_velocity_rad_s[at()]; }
  [[nodiscard]] double link_q() const { return truth.link_position_rad[at()]; }
  [[nodiscard]] double motor_torque_nm() const { return truth.motor_torque_nm[at()]; }
  [[nodiscard]] const sim::Plant& plant() const { return plant_; }

  double external_nm = 0.0;  ///< a hand on the link
  sim::PlantTruth truth;     ///< as of now

 private:
  [[nodiscard]] std::size_t at() const { return static_cast<std::size_t>(joint_); }
  static sim::Plant make(const JointSetup& setup, RobotDescription robot) {
    sim::PlantDescription plant =
        sim::load_plant(robot, std::filesystem::path(MRR_SOURCE_DIR) / "robots" / "boards" / "styrofoam.yaml");
    if (setup.plant) setup.plant(robot, plant);
    return {robot, plant, setup.seed};
  }
  int joint_;
  sim::Plant plant_;
};

/// A module on a joint of the emulated robot, one clock.
class PlantBench : public BenchOf<PlantJoint> {
 public:
  explicit PlantBench(const JointSetup& setup, const RobotDescription& robot = hammer_robot())
      : BenchOf<PlantJoint>(configure(setup, robot), PlantJoint(setup, robot)) {
    sync_every_ticks = static_cast<int>(std::lround(config.knot_period.seconds() / config.tick.seconds()));
  }

 private:
  static ModuleConfig configure(const JointSetup& setup, RobotDescription robot) {
    if (setup.module_robot) setup.module_robot(robot);
    ModuleConfig c = fw::module_config(robot, setup.joint);
    if (setup.config) setup.config(c);
    return c;
  }
};

/// Up and down by 0.3 rad, 0.95 rad/s at the most, from rest.
inline void swing(PlantBench& b) {
  const double start = b.seconds_now();
  const double here = double{b.status().reference_position_rad};
  b.trajectory = [=](double t) {
    const double w = 3.2;
    const double x = w * (t - start);
    return MotionState{static_cast<float>(here + 0.15 * (1.0 - std::cos(x))),
                       static_cast<float>(0.15 * w * std::sin(x)), static_cast<float>(0.15 * w * w * std::cos(x))};
  };
}

}  // namespace mrr::fw::test
