// Whole hammering jobs over many seeds, with learning and without: swings to flush, and how well the robot knows what
// really happened. Makes the tables of docs/strike.md.
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <vector>

#include "sim_vcan/world/hammer_job.h"

namespace {

using namespace mrr;  // NOLINT: a program of its own

struct Tally {
  int flush = 0;   // by the robot's verdict, and really
  int wrong = 0;   // said flush, and is not
  int broken = 0;  // a limit
  std::vector<double> swings;
  std::vector<double> height_mm;  // believed less true, after each swing that hit
  std::vector<double> impulse;    // felt over true, less 1
};

double quantile(std::vector<double> values, double share) {
  if (values.empty()) return std::nan("");
  std::sort(values.begin(), values.end());
  return values[static_cast<std::size_t>(std::lround(share * static_cast<double>(values.size() - 1)))];
}

std::vector<double> magnitudes(std::vector<double> values) {
  for (double& x : values) x = std::abs(x);
  return values;
}

double rms(const std::vector<double>& values) {
  double sum = 0.0;
  for (const double x : values) sum += x * x;
  return values.empty() ? std::nan("") : std::sqrt(sum / static_cast<double>(values.size()));
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{"Hammering jobs over seeds, learning and not."};
  int seeds = 20;
  std::string robot_name = "mrr3";
  std::vector<std::string> boards = {"styrofoam", "dense_foam", "hardwood"};
  bool each = false;
  app.add_option("--seeds", seeds, "1 to this")->capture_default_str();
  app.add_option("--robot", robot_name, "folder under robots/")->capture_default_str();
  app.add_option("--boards", boards, "names of files in robots/boards, or files")->capture_default_str();
  app.add_flag("--each", each, "a line per swing besides");
  CLI11_PARSE(app, argc, argv);

  const std::filesystem::path robots = std::filesystem::path(MRR_SOURCE_DIR) / "robots";
  const RobotDescription robot = load_robot(robots / robot_name);
  fmt::print(
      "| board, mode, plan | flush | swings to the verdict | height after a swing, mm rms / largest | within 1 mm | "
      "impulse felt, % median / 95th | within 10 % | said wrong | limit broken |\n"
      "| --- | --- | --- | --- | --- | --- | --- | --- | --- |\n");
  for (const std::string& board : boards) {
    std::filesystem::path file = robots / "boards" / fmt::format("{}.yaml", board);
    if (!std::filesystem::exists(file)) file = board;
    for (const sup::PassiveMode mode : {sup::PassiveMode::planned, sup::PassiveMode::never}) {
      for (const bool learn : {true, false}) {
        Tally tally;
        for (int seed = 1; seed <= seeds; ++seed) {
          sim::HammerJobOptions options;
          options.world.seed = options.session.seed = static_cast<std::uint64_t>(seed);
          options.world.max_boot_delay = milliseconds(100);
          options.session.mode = mode;
          options.session.learn = learn;
          const sim::PlantDescription plant = sim::load_plant(robot, file);
          const sim::HammerJobResult result = sim::run_hammer_job(robot, plant, options);
          const bool flush = result.verdict == sup::Verdict::flush;
          tally.flush += flush && result.really_flush ? 1 : 0;
          tally.wrong += flush != result.really_flush ? 1 : 0;
          tally.broken += result.within_limits ? 0 : 1;
          tally.swings.push_back(static_cast<double>(result.swings.size()));
          for (std::size_t k = 0; k < result.swings.size() && k < result.truth.size(); ++k) {
            const sup::SwingReport& saw = result.swings[k];
            const sim::SwingTruth& truth = result.truth[k];
            if (!truth.hit || saw.outcome.contact.phase != sup::ContactPhase::over) continue;
            tally.height_mm.push_back(1e3 * (saw.head_height_after_m - truth.nail_height_m));
            tally.impulse.push_back(saw.outcome.contact.impulse_n_s / truth.impulse_n_s - 1.0);
            if (each) {
              const Eigen::Vector3d& board_m = robot.task.nail_position_m;
              const sup::ContactReport& felt = saw.outcome.contact;
              const double left_m = (felt.face_end_m - board_m).dot(robot.task.normal) - truth.nail_height_m;
              const double met_m =
                  (felt.face_start_m - board_m).dot(robot.task.normal) - truth.nail_height_m - truth.penetration_m;
              fmt::print(
                  "{} {} {} seed {} swing {}: height {:.2f} mm, believed {:+.2f}, left at {:+.2f}, met at {:+.2f}; "
                  "impulse {:.3f} N s, felt {:+.1f} %; {:.0f} ms\n",
                  board, mode == sup::PassiveMode::never ? "never" : "planned", learn ? "learnt" : "fixed", seed, k + 1,
                  1e3 * truth.nail_height_m, tally.height_mm.back(), 1e3 * left_m, 1e3 * met_m, truth.impulse_n_s,
                  100.0 * tally.impulse.back(), 1e3 * truth.contact_s);
            }
          }
        }
        const auto within = [](const std::vector<double>& values, double bound) {
          const auto n = std::count_if(values.begin(), values.end(), [=](double x) { return std::abs(x) <= bound; });
          return fmt::format("{} of {}", n, values.size());
        };
        const std::vector<double> impulse = magnitudes(tally.impulse);
        fmt::print(
            "| {}, {}, {} | {} of {} | {:.0f} / {:.0f} / {:.0f} | {:.2f} / {:.2f} | {} | {:.1f} / {:.1f} | {} | {} | "
            "{} |\n",
            board, mode == sup::PassiveMode::never ? "never" : "planned", learn ? "learnt" : "fixed", tally.flush,
            seeds, quantile(tally.swings, 0.0), quantile(tally.swings, 0.5), quantile(tally.swings, 1.0),
            rms(tally.height_mm), quantile(magnitudes(tally.height_mm), 1.0), within(tally.height_mm, 1.0),
            100.0 * quantile(impulse, 0.5), 100.0 * quantile(impulse, 0.95), within(tally.impulse, 0.1), tally.wrong,
            tally.broken);
      }
    }
  }
  return 0;
}
