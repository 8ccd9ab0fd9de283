// Room: sim_vcan/world. A hammering job from switched-off robot to verdict, in the world: what the robot believes
// beside what really happened. Host only, no I/O: results and recordings are handed back.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "sim_vcan/world/recorder.h"
#include "sim_vcan/world/world.h"
#include "supervisor/strike/session.h"

namespace mrr::sim {

struct HammerJobOptions {
  sup::SessionOptions session;
  WorldOptions world;
  bool telemetry = false;
  Duration time_limit = milliseconds(300'000);  ///< simulated; a job that hangs is a defect and is reported as such
};

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

struct HammerJobResult {
  sup::Verdict verdict = sup::Verdict::none;
  std::string reason;                    ///< one sentence
  std::vector<sup::SwingReport> swings;  ///< what the robot planned and saw
  std::vector<SwingTruth> truth;         ///< as many entries
  bool within_limits = true;   ///< no transmission above its repeated peak, every planned joint passive before contact
  std::string limit_note;      ///< which, if not
  double nail_height_m = 0.0;  ///< really
  bool really_flush = false;
  double simulated_s = 0.0;
  double bus_load = 0.0;             ///< measured on the simulated wire
  double bus_load_worst_case = 0.0;  ///< computed
  std::vector<sup::Event> events;

  /// Done, and within limits: the robot says flush, and it is.
  [[nodiscard]] bool success() const noexcept {
    return verdict == sup::Verdict::flush && really_flush && within_limits;
  }
};

/// Called now and then: simulated time, swings done, the nail's real height.
using Progress = std::function<void(double simulated_s, int swings, double nail_height_m)>;

/// Runs the job. `frames`, if given, gets every frame; `telemetry`, if given, a row per millisecond; `prepare`, if
/// given, may set hooks on the world before it runs (tests, fault schedules).
/// Throws DescriptionError if the descriptions do not fit each other.
[[nodiscard]] HammerJobResult run_hammer_job(const RobotDescription& robot, const PlantDescription& plant,
                                             const HammerJobOptions& options, CandumpWriter* frames = nullptr,
                                             Telemetry* telemetry = nullptr, const Progress& progress = {},
                                             const std::function<void(World&)>& prepare = {});

}  // namespace mrr::sim
