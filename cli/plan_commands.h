// Room: cli. The commands that compute and move nothing: predict, plan, map.
// May touch the robot's description, supervisor/strike, supervisor/impact and the boards of sim_vcan.
#pragma once

#include <CLI/CLI.hpp>
#include <string>

#include "common/robot/robot.h"
#include "supervisor/impact/prediction.h"
#include "supervisor/strike/planner.h"

namespace mrr::cli {

void add_plan_command(CLI::App& app, int& status);
void add_predict_command(CLI::App& app, int& status);
void add_map_command(CLI::App& app, int& status);

/// Options of predict and plan that say what is struck, and from what they are made.
struct StrikeOptions {
  std::string robot = "robots/mrr3";
  double height_mm = -1.0;  ///< of the head above the board; < 0: as the task says
  double restitution = 1.0;
  double nail_mass_kg = 0.0;  ///< 0: rigid
  double contact_ms = 0.0;    ///< 0: as the task says
  double follow_mm = 5.0;
  double penetration_mm = 0.0;
  double speed_share = 1.0;
  std::string mode = "planned";
  std::string passive;  ///< names or numbers of joints, comma separated; empty: by the mode
  std::string measure = "load_ratio";
  std::string start;  ///< rad, comma separated; empty: where the robot rests
  std::uint64_t seed = 1;
};
void add_strike_options(CLI::App& command, StrikeOptions& options);
/// Throws std::invalid_argument naming the option, its value and the remedy.
[[nodiscard]] sup::PlanInput plan_input(const RobotDescription& robot, const StrikeOptions& options);

/// "0.1,0.2,-0.3": one number per joint. `option` is named in the complaint. Throws std::invalid_argument.
[[nodiscard]] sup::JointVector joint_values(const RobotDescription& robot, const std::string& option,
                                            const std::string& text);
/// "joint_2,3": bits of joints; "none" is 0. Throws std::invalid_argument.
[[nodiscard]] std::uint32_t joint_mask(const RobotDescription& robot, const std::string& option,
                                       const std::string& text);
/// What hammer and nail do on a board ("styrofoam", "hardwood" or a file), `height_m` above it.
[[nodiscard]] sup::ContactLaw contact_law(const RobotDescription& robot, const std::string& board, double height_m);

}  // namespace mrr::cli
