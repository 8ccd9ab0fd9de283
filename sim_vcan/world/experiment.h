// Room: sim_vcan/world. The reference's hammering experiment, repeated with the whole robot: its trajectories, its
// gains, joint 2 active and joint 3 passive, published figures beside simulated ones. Host only, no I/O after loading.
#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "common/robot/robot.h"
#include "sim_vcan/plant/plant_description.h"

namespace mrr::sim {

/// What the reference published of one swing; NaN where it did not.
struct PublishedSwing {
  double penetration_mm = 0.0;
  double contact_ms = 0.0;
  double impulse_n_s = 0.0;
  double effective_mass_kg = 0.0;
};

struct ExperimentSwing {
  std::string name;            ///< e.g. "1-2": test, swing
  double nail_height_m = 0.0;  ///< before the blow
  double past_head_m = 0.0;    ///< reference depth past the head at the tip: free per swing
  PublishedSwing published;    ///< of a single swing
};

/// One board of the experiment.
struct ExperimentSeries {
  std::string board;
  double travel_rad = 0.0;  ///< of the swinging joint, rest to rest
  double time_s = 0.0;      ///< of the way in; the way back follows at once
  std::vector<ExperimentSwing> swings;
  /// Ranges over all published swings; for series whose swings cannot be told apart.
  double contact_low_ms = 0.0, contact_high_ms = 0.0;
  double impulse_low_n_s = 0.0, impulse_high_n_s = 0.0;
};

struct Experiment {
  std::string swinging_joint;  ///< active through the blow
  std::string passive_joint;   ///< passive from the gap on, without compensation
  double position_gain_nm_rad = 0.0;
  double velocity_gain_nm_s_rad = 0.0;
  double friction_feedforward = 0.0;
  double passive_gap_m = 0.0;
  std::vector<ExperimentSeries> series;
};

/// Reads `robot.source`/experiment.yaml. Throws DescriptionError; a robot without such a file has no experiment.
[[nodiscard]] Experiment load_experiment(const RobotDescription& robot);

struct SimulatedSwing {
  ExperimentSwing swing;
  bool hit = false;
  double penetration_mm = 0.0;
  double contact_ms = 0.0;
  double impulse_n_s = 0.0;
  double effective_mass_kg = 0.0;
  double speed_m_s = 0.0;  ///< at first touch
  double switch_lead_ms = 0.0;
  /// As asked of the emulator: 15 % on duration, 25 % on impulse, 10 % or 0.5 mm on penetration.
  bool within = false;
};

struct SimulatedSeries {
  std::string board;
  std::vector<SimulatedSwing> swings;
  bool single_swings = true;  ///< compared swing by swing; else against the ranges
  double contact_low_ms = 0.0, contact_high_ms = 0.0;
  double impulse_low_n_s = 0.0, impulse_high_n_s = 0.0;
};

/// Largest deviations of a single swing that count as reproduced.
inline constexpr double kContactTolerance = 0.15;
inline constexpr double kImpulseTolerance = 0.25;
inline constexpr double kPenetrationTolerance = 0.10;
inline constexpr double kPenetrationTolerance_mm = 0.5;

/// Runs every swing in a world of its own, modules, supervisor and wire included.
/// `board` gives the plant for a board's name. `progress`: swings done, of how many.
[[nodiscard]] std::vector<SimulatedSeries> run_experiment(
    const RobotDescription& robot, const Experiment& experiment,
    const std::function<PlantDescription(const RobotDescription&, const std::string&)>& board, std::uint64_t seed,
    const std::function<void(int done, int of)>& progress = {});

}  // namespace mrr::sim
