// Example 4: where in its workspace an arm strikes hardest: effective mass over the plane of base and nail.
//   04_map robots/
#include <cstdio>

#include "supervisor/strike/measure_map.h"

using namespace mrr;

int main(int argc, char** argv) {
  if (argc != 2) return std::puts("usage: 04_map ROBOTS_FOLDER"), 2;
  const RobotDescription robot = load_robot(std::string(argv[1]) + "/mrr3");
  sup::MapInput input;
  input.measure = sup::Measure::effective_mass;
  input.columns = 24;
  input.rows = 10;
  const sup::MeasureMap map = sup::measure_map(robot, sup::Chain(robot), input);
  std::printf("%s, %s\n", sup::info(map.measure).name, sup::info(map.measure).unit);
  for (int row = map.rows - 1; row >= 0; --row) {
    for (int column = 0; column < map.columns; ++column) {
      const sup::MapCell& cell = map.cell(row, column);
      cell.q.size() == 0 ? std::printf("   .") : std::printf(" %3.0f", cell.value);
    }
    std::printf("   %.2f m\n", map.z_m(row));
  }
  return 0;
}
