#include "sim_vcan/world/recorder.h"

#include <fmt/format.h>

#include <array>
#include <iterator>
#include <ostream>

namespace mrr::sim {

Telemetry::Telemetry(const RobotDescription& robot) : dof_(robot.dof()) {
  columns_ = {"time [s]",      "swing [1]",  "activity [1]", "contact_force [N]", "nail_height [mm]",
              "face_gap [mm]", "face_x [m]", "face_y [m]",   "face_z [m]",        "estimated_force [N]"};
  for (const JointDescription& joint : robot.joints) {
    for (const char* quantity : {"reference [rad]", "position [rad]", "link_position [rad]",
                                 "reference_velocity [rad/s]", "motor_velocity [rad/s]", "transmission_torque [Nm]",
                                 "sensed_torque [Nm]", "commanded_torque [Nm]", "current [A]", "passive [1]"}) {
      columns_.push_back(fmt::format("{}_{}", joint.name, quantity));
    }
  }
}

void Telemetry::sample(const World& world, int swing) {
  const sup::Supervisor& supervisor = world.supervisor();
  std::array<JointTelemetry, kMaxJoints> joints;
  for (int i = 0; i < dof_; ++i) {
    const fw::ModuleStatus& status = world.module(i).status();
    joints[static_cast<std::size_t>(i)] = {
        static_cast<double>(status.reference_position_rad), static_cast<double>(status.reference_velocity_rad_s),
        static_cast<double>(status.joint_torque_nm), static_cast<double>(status.torque_command_nm),
        status.law == fw::Law::passive};
  }
  append({world.now(), swing, static_cast<int>(supervisor.activity()), supervisor.observer().force_n()},
         world.plant().truth(), {joints.data(), static_cast<std::size_t>(dof_)});
}

void Telemetry::append(const RobotTelemetry& robot, const PlantTruth& truth, std::span<const JointTelemetry> joints) {
  values_.insert(values_.end(),
                 {robot.now.seconds(), static_cast<double>(robot.swing), static_cast<double>(robot.activity),
                  truth.contact_force_n, truth.nail_height_m * 1e3, truth.face_gap_m * 1e3, truth.face_position_m.x(),
                  truth.face_position_m.y(), truth.face_position_m.z(), robot.estimated_force_n});
  for (std::size_t k = 0; k < joints.size(); ++k) {
    const JointTelemetry& joint = joints[k];
    values_.insert(values_.end(),
                   {joint.reference_rad, truth.motor_position_rad[k], truth.link_position_rad[k],
                    joint.reference_velocity_rad_s, truth.motor_velocity_rad_s[k], truth.transmission_torque_nm[k],
                    joint.sensed_torque_nm, joint.commanded_torque_nm, truth.current_a[k], joint.passive ? 1.0 : 0.0});
  }
}

void Telemetry::write_csv(std::ostream& out) const {
  fmt::memory_buffer line;
  for (std::size_t c = 0; c < columns_.size(); ++c)
    fmt::format_to(std::back_inserter(line), "{}{}", c == 0 ? "" : ",", columns_[c]);
  line.push_back('\n');
  out.write(line.data(), static_cast<std::streamsize>(line.size()));
  for (std::size_t r = 0; r < rows(); ++r) {
    line.clear();
    for (std::size_t c = 0; c < columns_.size(); ++c) {
      fmt::format_to(std::back_inserter(line), "{}{:.9g}", c == 0 ? "" : ",", values_[r * columns_.size() + c]);
    }
    line.push_back('\n');
    out.write(line.data(), static_cast<std::streamsize>(line.size()));
  }
}

}  // namespace mrr::sim
