// Room: sim_vcan/world. What really happened in a swing, from the plant's side: for the one-clock world and for the
// emulator process alike. Host only, no I/O. Touches sim_vcan/plant and supervisor/impact's definitions.
#pragma once

#include <cstdint>
#include <vector>

#include "sim_vcan/plant/plant.h"

namespace mrr::sim {

/// One joint in one swing, as it really was.
struct JointBlow {
  bool passive = false;               ///< planned to be, at contact
  double switch_lead_s = 0.0;         ///< from "the commanded torque is the passive one" to contact; NaN: not passive
  double peak_torque_nm = 0.0;        ///< largest |transmission torque| while in contact
  double peak_torque_swing_nm = 0.0;  ///< ... during the whole swing
  double impulse_nm_s = 0.0;          ///< transmission torque integrated over the contact, less its value before
};

/// One swing as a force sensor under the board, a ruler and strain gauges would report it.
struct SwingTruth {
  bool hit = false;
  Time contact_start;
  double contact_s = 0.0;
  double impulse_n_s = 0.0;
  double peak_force_n = 0.0;
  double penetration_m = 0.0;
  double nail_height_m = 0.0;      ///< afterwards
  double speed_m_s = 0.0;          ///< at first touch, along -normal
  double effective_mass_kg = 0.0;  ///< M* = P t/d (33), (34); infinite when nothing moved
  double restitution = 0.0;        ///< (63) from face speeds
  std::vector<JointBlow> joints;
};

/// Watches the plant during a swing. Times are the plant's.
class SwingWatch {
 public:
  /// A swing may begin from now on.
  void begin(const Plant& plant);
  /// Once per step while the swing goes on.
  void observe(const PlantTruth& truth);
  /// The commanded torque of `joint` is wholly the passive one since `since`; the first time in a swing counts.
  void passive_since(std::size_t joint, Time since);
  [[nodiscard]] bool was_passive(std::size_t joint) const { return was_passive_[joint]; }
  /// The swing is over. `planned_passive`: bit per joint.
  [[nodiscard]] SwingTruth conclude(const Plant& plant, std::uint32_t planned_passive) const;

 private:
  std::uint64_t contacts_before_ = 0;
  double height_before_m_ = 0.0;
  std::vector<double> peak_swing_nm_;
  std::vector<Time> passive_since_;
  std::vector<bool> was_passive_;
};

}  // namespace mrr::sim
