// Room: cli. What a person reads in an 80-column terminal.
#pragma once

#include <string>

#include "sim_vcan/world/hammer_job.h"

namespace mrr::cli {

/// Pose, speed, loads free and held, limits, who goes passive and why.
std::string plan_text(const RobotDescription& robot, const sup::StrikePlan& plan);
/// Header of the table of swings, and one swing.
std::string swing_header();
std::string swing_text(const RobotDescription& robot, const sup::SwingReport& swing, const sim::SwingTruth& truth);
std::string verdict_text(const RobotDescription& robot, const sim::HammerJobResult& result, double realtime_factor);

/// A line that is redrawn on a terminal, and nothing at all in a pipe.
class ProgressBar {
 public:
  /// `from_mm`: the nail's height that counts as nothing done.
  explicit ProgressBar(double from_mm);
  ~ProgressBar();
  ProgressBar(const ProgressBar&) = delete;
  ProgressBar& operator=(const ProgressBar&) = delete;
  void update(double simulated_s, int swings, double nail_height_mm);
  void clear();

 private:
  double from_mm_;
  bool terminal_;
  bool drawn_ = false;
};

}  // namespace mrr::cli
