#include <fcntl.h>
#include <fmt/format.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <numbers>
#include <stdexcept>
#include <vector>

#include "cli/app.h"
#include "cli/exit_status.h"
#include "cli/files.h"
#include "cli/plan_commands.h"
#include "cli/text.h"
#include "common/robot/places.h"
#include "supervisor/report_json.h"
#include "supervisor/strike/measure_map.h"

extern char** environ;

namespace mrr::cli {

namespace {

using Json = nlohmann::ordered_json;
namespace fs = std::filesystem;

struct MapArguments {
  std::string robot = "robots/mrr3";
  std::string measure = "load_ratio";
  std::string picture;
  double restitution = 1.0;
  double nail_mass_kg = 0.0;
  double contact_ms = 0.0;
  double tilt_deg = 0.0;
  int columns = 0;
  int rows = 0;
  std::uint64_t seed = 1;
  bool json = false;
};

std::vector<std::string> measure_names() {
  std::vector<std::string> names;
  for (const sup::MeasureInfo& one : sup::kMeasures) names.emplace_back(one.name);
  return names;
}

/// Values from a twentieth to nineteen twentieths of all: singular poses at the rim do not wash out the rest.
struct Scale {
  double low = 0.0;
  double high = 0.0;
  double least = 0.0;
  double most = 0.0;
  std::size_t reached = 0;
};
Scale scale_of(const sup::MeasureMap& map) {
  std::vector<double> values;
  Scale scale;
  for (const sup::MapCell& cell : map.cells) {
    if (!cell.q.size()) continue;
    ++scale.reached;
    if (std::isfinite(cell.value)) values.push_back(cell.value);
  }
  if (values.empty()) return scale;
  std::sort(values.begin(), values.end());
  scale.least = values.front();
  scale.most = values.back();
  scale.low = values[values.size() / 20];
  scale.high = values[values.size() - 1 - values.size() / 20];
  return scale;
}

Json map_json(const RobotDescription& robot, const sup::MeasureMap& map) {
  const sup::MeasureInfo& info = sup::info(map.measure);
  const auto vector = [](const Eigen::Vector3d& v) { return Json{v.x(), v.y(), v.z()}; };
  Json rows = Json::array();
  for (int row = 0; row < map.rows; ++row) {
    Json values = Json::array();
    for (int column = 0; column < map.columns; ++column) {
      values.push_back(sup::number(map.cell(row, column).value));
    }
    rows.push_back(values);
  }
  Json along = Json::array();
  Json up = Json::array();
  for (int column = 0; column < map.columns; ++column) along.push_back(map.x_m(column));
  for (int row = 0; row < map.rows; ++row) up.push_back(map.z_m(row));
  const Scale scale = scale_of(map);
  Eigen::Vector3d nail = robot.task.nail_position_m + robot.task.nail_height_m * robot.task.normal - map.origin_m;
  const double nail_x = nail.dot(map.along);
  nail -= nail_x * map.along;
  return {
      {"schema_version", 1},
      {"robot", robot.name},
      {"measure", info.name},
      {"unit", info.unit},
      {"meaning", info.meaning},
      {"source", info.source},
      {"most_is_best", info.most_is_best},
      {"max_tilt_rad", map.max_tilt_rad},
      {"direction", vector(map.along)},
      {"origin_m", vector(map.origin_m)},
      {"nail_m", {nail_x, (robot.gravity_m_s2.norm() > 1e-3 ? -nail.dot(robot.gravity_m_s2.normalized()) : nail.z())}},
      {"scale", {scale.low, scale.high}},
      {"along_m", along},
      {"up_m", up},
      {"values", rows}};
}

std::string map_text(const RobotDescription& robot, const sup::MeasureMap& map) {
  constexpr std::string_view kRamp = ".:-=+*#%@";
  const sup::MeasureInfo& info = sup::info(map.measure);
  const Scale scale = scale_of(map);
  std::string text = wrapped(fmt::format("{} of {}, {}: {}. {} is best. Source: {}.", info.name, robot.name, info.unit,
                                         info.meaning, info.most_is_best ? "Most" : "Least", info.source),
                             2);
  text +=
      wrapped(fmt::format("Plane through base and nail, up against gravity; the face may tilt by {:.0f} deg; best pose "
                          "of each place.",
                          map.max_tilt_rad * 180.0 / std::numbers::pi),
              2);
  if (scale.reached == 0) return text + "Nothing in this window is within reach.\n";
  const Eigen::Vector3d nail = robot.task.nail_position_m + robot.task.nail_height_m * robot.task.normal - map.origin_m;
  const double nail_along = nail.dot(map.along);
  const double nail_up = robot.gravity_m_s2.norm() > 1e-3 ? -nail.dot(robot.gravity_m_s2.normalized()) : nail.z();
  text += "\n  up m\n";
  const auto blank = [&](int row) {
    const auto first = map.cells.begin() + row * map.columns;
    return std::none_of(first, first + map.columns, [](const sup::MapCell& cell) { return cell.q.size() > 0; });
  };
  int top = map.rows - 1;
  int bottom = 0;
  while (top > bottom && blank(top)) --top;
  while (bottom < top && blank(bottom)) ++bottom;
  for (int row = top; row >= bottom; --row) {
    std::string line;
    for (int column = 0; column < map.columns; ++column) {
      const double half_x = 0.5 * (map.high_m - map.low_m) / map.columns;
      const double half_z = 0.5 * (map.top_m - map.bottom_m) / map.rows;
      const sup::MapCell& cell = map.cell(row, column);
      if (std::abs(map.x_m(column) - nail_along) <= half_x && std::abs(map.z_m(row) - nail_up) <= half_z) {
        line += 'N';
      } else if (cell.q.size() == 0) {
        line += ' ';
      } else {
        const double share = scale.high > scale.low ? (cell.value - scale.low) / (scale.high - scale.low) : 0.0;
        line += kRamp[static_cast<std::size_t>(std::clamp(share, 0.0, 1.0) * (static_cast<double>(kRamp.size()) - 1.0) +
                                               0.5)];
      }
    }
    line.erase(line.find_last_not_of(' ') + 1);
    text += row % 4 == 0 ? fmt::format("{:>6.2f} |{}\n", map.z_m(row), line) : fmt::format("       |{}\n", line);
  }
  text += fmt::format("       +{}\n", std::string(static_cast<std::size_t>(map.columns), '-'));
  const std::string left = fmt::format("{:.2f}", map.x_m(0));
  const std::string right = fmt::format("{:.2f} m along", map.x_m(map.columns - 1));
  text += fmt::format("        {}{:>{}}\n", left, right, std::max(0, map.columns - static_cast<int>(left.size())));
  text +=
      wrapped(fmt::format("{} {:.4g} or less ... {} {:.4g} {} or more; all: {:.4g} to {:.4g}; N the nail; blank: out "
                          "of reach",
                          kRamp.front(), scale.low, kRamp.back(), scale.high, info.unit, scale.least, scale.most),
              2);
  return text;
}

/// tools/map.py draws the file; throws std::runtime_error if it fails.
void draw(const Json& json, const std::string& picture) {
  const std::string suffix = fs::path(picture).extension().string();
  if (suffix != ".png" && suffix != ".svg") {
    throw std::invalid_argument(fmt::format("--picture {}: a picture's name ends in .png or .svg", picture));
  }
  std::string name = (fs::temp_directory_path() / "mrr-map-XXXXXX").string();
  const int handle = mkstemp(name.data());
  if (handle < 0)
    throw std::runtime_error("a temporary file could not be made in " + fs::temp_directory_path().string());
  close(handle);
  write_whole(name, [&](std::ostream& file) { file << json.dump() << '\n'; });
  const std::string tool = (data_root() / "tools" / "map.py").string();
  const char* const words[] = {"/usr/bin/python3", tool.c_str(), name.c_str(), picture.c_str(), nullptr};
  pid_t child = 0;
  int result = 0;
  const bool drawn = posix_spawn(&child, words[0], nullptr, nullptr, const_cast<char* const*>(words), environ) == 0 &&
                     waitpid(child, &result, 0) == child && WIFEXITED(result) && WEXITSTATUS(result) == 0;
  fs::remove(name);
  if (!drawn)
    throw std::invalid_argument(fmt::format("--picture {}: could not be drawn; the reason is above", picture));
}

int run_map(const MapArguments& a) {
  const RobotDescription robot = load_robot(find_robot(a.robot));
  sup::MapInput in;
  in.measure = *sup::measure_named(a.measure);
  in.setting.normal = robot.task.normal;
  in.setting.restitution = a.restitution;
  if (a.nail_mass_kg > 0.0) in.setting.nail_mass_kg = a.nail_mass_kg;
  in.setting.contact_s = a.contact_ms > 0.0 ? 1e-3 * a.contact_ms : robot.task.assumed_contact_s;
  in.max_tilt_rad = a.tilt_deg * std::numbers::pi / 180.0;
  const bool fine = !a.picture.empty();  // a picture shows more than a terminal
  in.columns = a.columns > 0 ? a.columns : fine ? 120 : 70;
  in.rows = a.rows > 0 ? a.rows : fine ? 100 : 30;
  in.seed = a.seed;
  const sup::MeasureMap map = sup::measure_map(robot, sup::Chain(robot), in);
  const Json json = map_json(robot, map);
  if (!a.picture.empty()) draw(json, a.picture);
  if (a.json) {
    fmt::print("{}\n", json.dump());
  } else if (a.picture.empty()) {
    fmt::print("{}", map_text(robot, map));
  } else {
    fmt::print("{}\n", a.picture);
  }
  return scale_of(map).reached > 0 ? kExitDone : kExitNotDone;
}

}  // namespace

void add_map_command(CLI::App& app, int& status) {
  auto a = std::make_shared<MapArguments>();
  CLI::App* command =
      app.add_subcommand("map", "Show an impact measure over the workspace, in the terminal or as a picture");
  command
      ->add_option("--measure", a->measure,
                   "load_ratio, effective_mass, internal_impact, dynamic_ellipsoid, "
                   "generalised_ellipsoid, impact_geometry")
      ->type_name("NAME")
      ->check(CLI::IsMember(measure_names()))
      ->capture_default_str();
  command->add_option("--robot", a->robot, "Folder with robot.urdf and robot.yaml")
      ->type_name("DIR")
      ->capture_default_str();
  command->add_option("--picture", a->picture, "Draw into this .png or .svg file instead")->type_name("FILE");
  command->add_option("--columns", a->columns, "Places along the plane")->check(CLI::Range(2, 512));
  command->add_option("--rows", a->rows, "Places upwards")->check(CLI::Range(2, 512));
  command
      ->add_option("--tilt", a->tilt_deg,
                   "Largest tilt of the face, deg (default: the hammer's; any for arms of less than "
                   "5 joints)")
      ->check(between(0.1, 180.0));
  command->add_option("--restitution", a->restitution, "e of the blow, 0 to 1")
      ->capture_default_str()
      ->check(between(0.0, 1.0));
  command->add_option("--nail-mass", a->nail_mass_kg, "M* of the nail, kg (default: infinite, it stands)")
      ->check(between(1e-3, 1e9));
  command->add_option("--contact", a->contact_ms, "Duration of the contact, ms (default: the task's)")
      ->check(between(0.1, 1000.0));
  command->add_option("--seed", a->seed, "Of the searches for poses")
      ->check(whole_number())
      ->type_name("N")
      ->capture_default_str();
  command->add_flag("--json", a->json, "Print one JSON object and nothing else");
  command->callback([a, &status] { status = run_map(*a); });
}

}  // namespace mrr::cli
