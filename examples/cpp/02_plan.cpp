// Example 2: plan a blow on the task's nail, and say why so.
//   02_plan robots/
#include <cstdio>

#include "supervisor/strike/planner.h"

using namespace mrr;

int main(int argc, char** argv) {
  if (argc != 2) return std::puts("usage: 02_plan ROBOTS_FOLDER"), 2;
  const RobotDescription robot = load_robot(std::string(argv[1]) + "/mrr3");
  const sup::Chain chain(robot);

  sup::PlanInput input;
  input.normal = robot.task.normal;
  input.head_position_m = robot.task.nail_position_m + robot.task.nail_height_m * robot.task.normal;
  input.board_distance_m = robot.task.nail_height_m;
  input.contact_duration_s = robot.task.assumed_contact_s;
  input.start = sup::JointVector::Zero(robot.dof());
  input.start[1] = 0.5;
  const std::string complaint = sup::validate_input(robot, input);
  if (!complaint.empty()) return std::puts(complaint.c_str()), 1;
  try {
    const sup::StrikePlan plan = sup::plan(robot, chain, input);
    std::puts(sup::report(robot, plan).c_str());
    // The swing is a trajectory that can be looked at anywhere.
    sup::JointMotion motion;
    plan.strike.sample(plan.contact_time, motion);
    std::printf("at contact joint 2 is at %.4f rad, %.4f rad/s\n", motion.q[1], motion.qd[1]);
  } catch (const PlanError& error) {
    return std::puts(error.what()), 1;
  }
  return 0;
}
