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
  ProgressBar();
  ~ProgressBar();
  ProgressBar(const ProgressBar&) = delete;
  ProgressBar& operator=(const ProgressBar&) = delete;
  /// `done`: share, 0 .. 1.
  void update(const std::string& what, double done);
  void clear();

 private:
  bool terminal_;
  bool drawn_ = false;
};

}  // namespace mrr::cli
