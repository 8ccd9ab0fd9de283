// Room: cli. What a person reads in an 80-column terminal, from the result that programs read.
#pragma once

#include <nlohmann/json.hpp>
#include <string>

#include "common/robot/robot.h"

namespace mrr::cli {

/// Pose, speed, loads free and held, limits, who goes passive and why. `plan`: of docs/result.schema.json.
[[nodiscard]] std::string plan_text(const nlohmann::ordered_json& plan);
/// Header of the table of swings, and one swing. `truth_known`: somebody could be asked what really happened.
[[nodiscard]] std::string swing_header(bool truth_known);
[[nodiscard]] std::string swing_text(const nlohmann::ordered_json& swing);
[[nodiscard]] std::string verdict_text(const RobotDescription& robot, const nlohmann::ordered_json& result);

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
  [[nodiscard]] bool terminal() const noexcept { return terminal_; }

 private:
  bool terminal_;
  bool drawn_ = false;
};

}  // namespace mrr::cli
