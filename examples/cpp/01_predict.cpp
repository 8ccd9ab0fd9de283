// Example 1: what a blow does to every joint. The reference arm, stretched out, swings its shoulder against a rigid
// board; once with both hammer joints free, once with the shoulder held.
//   01_predict robots/
#include <cstdio>

#include "supervisor/impact/prediction.h"

using namespace mrr;

int main(int argc, char** argv) {
  if (argc != 2) return std::puts("usage: 01_predict ROBOTS_FOLDER"), 2;
  const RobotDescription robot = load_robot(std::string(argv[1]) + "/mrr3");
  const sup::StrikeArm arm(robot);

  sup::PredictInput blow;
  blow.q = sup::JointVector::Zero(3);                             // rad
  blow.qd = (sup::JointVector(3) << 0.0, -0.62, 0.0).finished();  // rad/s
  blow.restitution = 1.0;
  blow.contact_s = 0.05;
  for (const sup::JointHold shoulder : {sup::JointHold::free, sup::JointHold::held}) {
    blow.joints[1] = shoulder;
    const std::string complaint = sup::validate_input(arm, blow, sup::PredictionModel::instant);
    if (!complaint.empty()) return std::puts(complaint.c_str()), 1;
    const sup::Prediction p = sup::predict(arm, blow, sup::PredictionModel::instant);
    std::printf("shoulder %-5s  impulse %.2f N s, joint 2 carries %.3f N m s, joint 3 %.3f N m s\n",
                shoulder == sup::JointHold::free ? "free" : "held", p.impulse_n_s, p.blow_impulse_nm_s[1],
                p.blow_impulse_nm_s[2]);
  }
  return 0;
}
