// Room: cli. What a program reads: docs/result.schema.json describes it. Made the same way whether the robot ran on one
// clock or as processes.
#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "sim_vcan/world/hammer_job.h"

namespace mrr::cli {

/// What was asked for, so that a result says what it is a result of.
struct RunLabel {
  std::string board;  ///< as given on the command line; "unknown" where only the plant knows
  std::uint64_t seed = 1;
  sup::PassiveMode mode = sup::PassiveMode::planned;
  sup::Formulation formulation = sup::Formulation::corrected;
  std::string processes;  ///< empty: one clock; else "lockstep" or "realtime"
};

/// A job that has ended: what the robot believes, and what really happened as far as somebody knows.
struct Outcome {
  std::string verdict;  ///< as sup::describe
  std::string reason;
  nlohmann::ordered_json plan;    ///< sup::plan_json of the first swing, or null
  nlohmann::ordered_json swings;  ///< list of sup::swing_json
  bool truth_known = true;        ///< false: a robot of metal, nobody to ask
  std::vector<sim::SwingTruth> truth;
  double nail_height_m = 0.0;  ///< really, or as the robot believes if nobody knows
  double simulated_s = 0.0;
  double wall_s = 0.0;
  double bus_load = 0.0;
  double bus_load_worst_case = 0.0;

  // Concluded by conclude().
  bool really_flush = false;
  bool within_limits = true;
  std::string limit_note;
  [[nodiscard]] bool success() const { return verdict == "flush" && really_flush && within_limits; }
};

[[nodiscard]] Outcome outcome_of(const RobotDescription& robot, const sim::HammerJobResult& result, double wall_s);
/// Judges limits and the nail.
void conclude(const RobotDescription& robot, Outcome& outcome);

/// Numbers that are not finite become null, and so does what nobody knows.
[[nodiscard]] nlohmann::ordered_json result_json(const RobotDescription& robot, const RunLabel& label,
                                                 const Outcome& outcome);

/// A swing of the plant's `swings` answer.
[[nodiscard]] sim::SwingTruth swing_truth(const nlohmann::ordered_json& swing);

}  // namespace mrr::cli
