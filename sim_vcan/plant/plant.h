// Room: sim_vcan/plant. The physics a robot has and an emulator must bring: arm, drives, hammer, nail, board, sensors.
// Stepped, no I/O, no clock, no heap in step(). Uses common/ and module_fw/joint_io.h; never supervisor/.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <span>

#include "common/core/containers.h"
#include "common/core/time.h"
#include "module_fw/joint_io.h"
#include "sim_vcan/plant/plant_description.h"

namespace mrr::sim {

/// Largest internal time step. Chosen so that the fastest spring (K3 or the bristles against a rotor, about 1100 rad/s)
/// is sampled some 60 times per period; docs/emulator.md shows the convergence.
inline constexpr Duration kPlantSubstep = microseconds(100);

/// Contacts separated by less than this are one contact, as a force sensor's trace is read.
inline constexpr Duration kContactMergeGap = milliseconds(5);

using PerJoint = std::array<double, kMaxJoints>;

/// Energy stored in the plant and work done since reset, joules. Invariant, up to integration error:
/// stored() - stored at reset = motor - friction - damping - brake - stops + contact + external.
struct EnergyTerms {
  double kinetic_j = 0.0;        ///< links and rotors
  double gravity_j = 0.0;        ///< zero at the base frame's origin
  double spring_j = 0.0;         ///< all transmissions
  double motor_work_j = 0.0;     ///< done by the motors
  double friction_work_j = 0.0;  ///< taken by friction, bristles included
  double damping_work_j = 0.0;   ///< taken by the damping of the transmissions
  double brake_work_j = 0.0;     ///< taken by the brakes
  double stop_work_j = 0.0;      ///< taken by the end stops
  double contact_work_j = 0.0;   ///< done on the robot by nail and board (negative: lost to them)
  double external_work_j = 0.0;  ///< done by set_external_torque()
  double nail_work_j = 0.0;      ///< part of the contact's that went into driving the nail

  [[nodiscard]] double stored_j() const noexcept { return kinetic_j + gravity_j + spring_j; }
  [[nodiscard]] double work_j() const noexcept {
    return motor_work_j - friction_work_j - damping_work_j - brake_work_j - stop_work_j + contact_work_j +
           external_work_j;
  }
};

/// Everything the plant knows, as of now. Arrays: joint 0 first, valid up to `dof`.
struct PlantTruth {
  Time now;
  int dof = 0;
  PerJoint link_position_rad{};
  PerJoint link_velocity_rad_s{};
  PerJoint motor_position_rad{};      ///< joint side: motor angle / gear ratio
  PerJoint motor_velocity_rad_s{};    ///< joint side
  PerJoint transmission_torque_nm{};  ///< tau_s: spring and damper, acts on the link in + direction
  PerJoint friction_torque_nm{};      ///< tau_f, opposes the motor
  PerJoint motor_torque_nm{};         ///< tau, joint side
  PerJoint current_a{};
  PerJoint winding_temperature_c{};
  PerJoint brake_torque_nm{};
  std::array<bool, kMaxJoints> brake_released{};
  Eigen::Vector3d face_position_m = Eigen::Vector3d::Zero();  ///< centre of the hammer face, base frame
  Eigen::Vector3d face_velocity_m_s = Eigen::Vector3d::Zero();
  double face_tilt_rad = 0.0;    ///< angle between the face's axis and the nail's
  double face_gap_m = 0.0;       ///< face above the nail's head, along the normal; negative: pressed in
  double face_lateral_m = 0.0;   ///< head's centre from the face's centre, across the normal
  double contact_force_n = 0.0;  ///< on the robot, along the normal: nail and board together
  double nail_force_n = 0.0;     ///< the nail's share
  bool contact = false;
  double nail_height_m = 0.0;      ///< head above the board
  double nail_velocity_m_s = 0.0;  ///< into the board, >= 0
  EnergyTerms energy;
};

/// One blow, as an external force sensor, a ruler and encoders would report it.
struct ContactRecord {
  Time start;
  Time end;                   ///< last instant with force; of an open contact: so far
  bool open = false;          ///< still touching, or within kContactMergeGap of it
  bool board_struck = false;  ///< the face touched the board itself
  double impulse_n_s = 0.0;   ///< integral of the force along the normal
  double peak_force_n = 0.0;
  double penetration_m = 0.0;       ///< by which the nail went deeper
  double speed_at_start_m_s = 0.0;  ///< of the face along -normal
  double speed_at_end_m_s = 0.0;
  double lateral_m = 0.0;                  ///< at the start
  double tilt_rad = 0.0;                   ///< at the start
  PerJoint peak_transmission_torque_nm{};  ///< largest |tau_s| during the contact
  PerJoint transmission_impulse_nm_s{};    ///< integral of tau_s - its value at the start
  PerJoint transmission_before_nm{};       ///< that value: tau_s as the contact began
  PerJoint link_velocity_before_rad_s{};
  PerJoint link_velocity_after_rad_s{};
  PerJoint motor_velocity_before_rad_s{};  ///< joint side
  PerJoint motor_velocity_after_rad_s{};

  [[nodiscard]] Duration duration() const noexcept { return end - start; }
};

inline constexpr std::size_t kMaxContactRecords = 64;
using ContactRecords = StaticVector<ContactRecord, kMaxContactRecords>;

/// The world of one robot. Same description, seed and calls: the same run, bit by bit, on one machine.
class Plant {
 public:
  /// `seed` draws what the descriptions only know roughly (PerturbationDescription); 0 takes them as they are.
  /// Throws DescriptionError if the descriptions do not fit each other.
  Plant(const RobotDescription& robot, const PlantDescription& description, std::uint64_t seed);
  ~Plant();
  Plant(Plant&&) noexcept;
  Plant& operator=(Plant&&) noexcept;

  /// At rest at these link positions (rad, size dof), brakes engaged, power stages off, the nail's head
  /// `nail_height_m` above the board (0 .. nail length; seeded error added). Time, energies and contacts start anew.
  void reset(std::span<const double> link_position_rad, double nail_height_m);

  /// Advances the physics by dt >= 0 in equal substeps of at most kPlantSubstep.
  void step(Duration dt) noexcept;

  /// Held until the next one. Precondition of all `joint`: 0 <= joint < dof.
  void set_actuator(int joint, const fw::ActuatorCommand& command) noexcept;

  /// Raw counts with noise, as of now. Two samples at one instant differ by their noise.
  fw::RawSensors sample(int joint) noexcept;

  /// A hand on the link: joint torque in addition to everything else, Nm, held until changed.
  void set_external_torque(int joint, double torque_nm) noexcept;

  [[nodiscard]] PlantTruth truth() const noexcept;
  [[nodiscard]] Time now() const noexcept;
  [[nodiscard]] int dof() const noexcept;

  /// Blows so far, oldest first; when full the last entry is overwritten and `contact_count()` goes on.
  [[nodiscard]] const ContactRecords& contacts() const noexcept;
  [[nodiscard]] std::uint64_t contact_count() const noexcept;

  /// The descriptions after the seed's perturbation: what is really simulated.
  [[nodiscard]] const RobotDescription& actual_robot() const noexcept;
  [[nodiscard]] const PlantDescription& actual_description() const noexcept;

 private:
  struct World;
  std::unique_ptr<World> world_;
};

}  // namespace mrr::sim
