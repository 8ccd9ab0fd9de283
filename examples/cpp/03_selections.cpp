// Example 3: one blow under every selection of passive joints, from one factorisation.
//   03_selections robots/
#include <cmath>
#include <cstdio>

#include "supervisor/impact/selection.h"

using namespace mrr;

int main(int argc, char** argv) {
  if (argc != 2) return std::puts("usage: 03_selections ROBOTS_FOLDER"), 2;
  const RobotDescription robot = load_robot(std::string(argv[1]) + "/mrr3");
  const sup::Chain chain(robot);
  const double contact_s = 0.05;

  std::array<double, kMaxJoints> active_inertia{};  // what a joint under control adds to its rotor
  for (std::size_t i = 0; i < robot.joints.size(); ++i) {
    const ControlDescription& control = robot.joints[i].control;
    active_inertia[i] =
        sup::controlled_extra_inertia(control.position_gain_nm_rad, control.velocity_gain_nm_s_rad, contact_s);
  }
  const sup::JointVector q = (sup::JointVector(3) << 0.0, 0.05, -0.05).finished();
  const sup::SelectionSweep sweep(chain, chain.pose(q), Eigen::Vector3d::UnitZ(), active_inertia);
  const double speed_m_s = 0.47;
  std::puts("S (P passive)  impulse N s  joint 1, 2, 3 carry, N m s");
  sweep.for_each(0b111U, 0U, [&](const sup::SelectionBlow& blow) {
    const double P = blow.impulse_n_s(speed_m_s, 1.0, std::numeric_limits<double>::infinity());
    for (int i = 0; i < 3; ++i) std::putchar((blow.passive >> i & 1U) != 0 ? 'P' : 'A');
    std::printf("            %6.3f       %6.3f %6.3f %6.3f\n", P, std::abs(P * blow.axis_nm_s_per_n_s[0]),
                std::abs(P * blow.axis_nm_s_per_n_s[1]), std::abs(P * blow.axis_nm_s_per_n_s[2]));
  });
  return 0;
}
