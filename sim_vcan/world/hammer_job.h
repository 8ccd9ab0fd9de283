// Room: sim_vcan/world. A hammering job from switched-off robot to verdict, in the world: what the robot believes
// beside what really happened. Host only, no I/O: results and recordings are handed back.
#pragma once

#include <functional>
#include <span>
#include <string>
#include <vector>

#include "sim_vcan/world/recorder.h"
#include "sim_vcan/world/swing_watch.h"
#include "sim_vcan/world/world.h"
#include "supervisor/strike/session.h"

namespace mrr::sim {

struct HammerJobOptions {
  sup::SessionOptions session;
  WorldOptions world;
  bool telemetry = false;
  Duration time_limit = milliseconds(300'000);  ///< simulated; a job that hangs is a defect and is reported as such
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

/// The first limit that was broken, one sentence without full stop; empty: no transmission above its repeated peak,
/// every planned joint passive before contact.
[[nodiscard]] std::string broken_limit(const RobotDescription& robot, std::span<const SwingTruth> swings);

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
