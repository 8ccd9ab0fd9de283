#include <fmt/format.h>

#include <charconv>
#include <cmath>
#include <limits>
#include <memory>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <vector>

#include "cli/app.h"
#include "cli/exit_status.h"
#include "cli/plan_commands.h"
#include "cli/text.h"
#include "common/robot/places.h"
#include "sim_vcan/plant/plant_description.h"
#include "supervisor/report_json.h"

namespace mrr::cli {

namespace {

std::vector<std::string> parts_of(const std::string& text) {
  std::vector<std::string> parts(1);
  for (const char c : text) {
    if (c == ',') {
      parts.emplace_back();
    } else if (c != ' ') {
      parts.back() += c;
    }
  }
  return parts;
}

std::string names(const RobotDescription& robot) {
  std::string text;
  for (const JointDescription& joint : robot.joints) text += (text.empty() ? "" : ", ") + joint.name;
  return text;
}

sup::StrikeMeasure strike_measure(const std::string& name) {
  if (name == "internal_impact") return sup::StrikeMeasure::internal_impact;
  return name == "effective_mass" ? sup::StrikeMeasure::effective_mass : sup::StrikeMeasure::load_ratio;
}

sup::PassiveMode passive_mode(const std::string& name) {
  if (name == "never") return sup::PassiveMode::never;
  return name == "always" ? sup::PassiveMode::always : sup::PassiveMode::planned;
}

int run_plan(const StrikeOptions& options, bool json) {
  const RobotDescription robot = load_robot(find_robot(options.robot));
  const sup::PlanInput input = plan_input(robot, options);
  const sup::StrikePlan plan = sup::plan(robot, sup::Chain(robot), input);
  if (json) {
    const nlohmann::ordered_json all = {
        {"schema_version", 1}, {"robot", robot.name}, {"plan", sup::plan_json(robot, plan)}};
    fmt::print("{}\n", all.dump(2));
    return kExitDone;
  }
  fmt::print("{}",
             wrapped(fmt::format("Plan for {}: nail's head at ({:.4f}, {:.4f}, {:.4f}) m, {:.1f} mm above the board",
                                 robot.name, input.head_position_m.x(), input.head_position_m.y(),
                                 input.head_position_m.z(), 1e3 * input.board_distance_m),
                     2));
  const std::string text = sup::report(robot, plan);
  for (std::size_t at = 0; at < text.size();) {
    const std::size_t end = text.find('\n', at);
    const std::string line = text.substr(at, end - at);
    fmt::print("{}", line.size() <= kWidth ? line + "\n" : wrapped(line, at == 0 ? 2 : 13));
    at = end + 1;
  }
  return kExitDone;
}

}  // namespace

sup::JointVector joint_values(const RobotDescription& robot, const std::string& option, const std::string& text) {
  const std::vector<std::string> parts = parts_of(text);
  if (static_cast<int>(parts.size()) != robot.dof()) {
    throw std::invalid_argument(
        fmt::format("{} {}: {} value{}, but {} has {} joints; give one number per joint, comma separated", option, text,
                    parts.size(), parts.size() == 1 ? "" : "s", robot.name, robot.dof()));
  }
  sup::JointVector values(robot.dof());
  for (std::size_t i = 0; i < parts.size(); ++i) {
    double value = 0.0;
    const auto [end, error] = std::from_chars(parts[i].data(), parts[i].data() + parts[i].size(), value);
    if (error != std::errc() || end != parts[i].data() + parts[i].size() || !std::isfinite(value)) {
      throw std::invalid_argument(fmt::format("{} {}: '{}' is not a number", option, text, parts[i]));
    }
    values[static_cast<Eigen::Index>(i)] = value;
  }
  return values;
}

std::uint32_t joint_mask(const RobotDescription& robot, const std::string& option, const std::string& text) {
  if (text == "none") return 0;
  std::uint32_t mask = 0;
  for (const std::string& part : parts_of(text)) {
    int found = -1;
    for (int i = 0; i < robot.dof(); ++i) {
      if (part == robot.joints[static_cast<std::size_t>(i)].name || part == std::to_string(i + 1)) found = i;
    }
    if (found < 0) {
      throw std::invalid_argument(fmt::format("{} {}: there is no joint '{}'; the joints are {}, or give none", option,
                                              text, part, names(robot)));
    }
    mask |= 1U << found;
  }
  return mask;
}

sup::ContactLaw contact_law(const RobotDescription& robot, const std::string& board, double height_m) {
  const sim::PlantDescription plant = sim::load_plant(robot, find_board(board));
  sup::ContactLaw law;
  law.face_stiffness_n_m = plant.face.stiffness_n_m;
  law.face_damping_s_m = plant.face.damping_s_m;
  law.nail_resistance_n =
      plant.board.nail_resistance_n + plant.board.nail_resistance_slope_n_m * (plant.board.nail_length_m - height_m);
  law.nail_resistance_slope_n_m = plant.board.nail_resistance_slope_n_m;
  law.nail_damping_n_s_m = plant.board.nail_damping_n_s_m;
  law.nail_room_m = height_m;
  return law;
}

void add_strike_options(CLI::App& command, StrikeOptions& o) {
  command.add_option("--robot", o.robot, "Folder with robot.urdf and robot.yaml")
      ->type_name("DIR")
      ->capture_default_str();
  command.add_option("--height", o.height_mm, "Nail's head above the board, mm (default: the task's)")
      ->check(between(0.0, 1000.0));
  command.add_option("--restitution", o.restitution, "e of the blow, 0 to 1")
      ->capture_default_str()
      ->check(between(0.0, 1.0));
  command.add_option("--nail-mass", o.nail_mass_kg, "M* of the nail, kg (default: infinite, it stands)")
      ->check(between(1e-3, 1e9));
  command.add_option("--contact", o.contact_ms, "Duration of the contact, ms (default: the task's)")
      ->check(between(0.1, 1000.0));
  command.add_option("--follow-through", o.follow_mm, "How far past the head the reference goes, mm")
      ->capture_default_str()
      ->check(between(0.0, 200.0));
  command
      .add_option("--penetration", o.penetration_mm,
                  "Strike no harder than drives the nail this far, mm; needs --nail-mass (default: as hard as allowed)")
      ->check(between(0.01, 200.0));
  command.add_option("--speed", o.speed_share, "Share of the speed that the limits allow")
      ->capture_default_str()
      ->check(between(0.001, 1.0));
  command.add_option("--mode", o.mode, "Passive switching: planned, never, or always all joints")
      ->check(CLI::IsMember({"planned", "never", "always"}))
      ->capture_default_str();
  command
      .add_option("--passive", o.passive, "These joints passive and no other: names or numbers, comma separated; none")
      ->type_name("JOINT,...");
  command.add_option("--measure", o.measure, "What ranks poses: load_ratio, internal_impact, effective_mass")
      ->check(CLI::IsMember({"load_ratio", "internal_impact", "effective_mass"}))
      ->capture_default_str();
  command.add_option("--start", o.start, "Present pose, rad, comma separated (default: where the robot rests)")
      ->type_name("RAD,...");
  command.add_option("--seed", o.seed, "Of the searches for poses")
      ->check(whole_number())
      ->type_name("N")
      ->capture_default_str();
}

sup::PlanInput plan_input(const RobotDescription& robot, const StrikeOptions& o) {
  const TaskDescription& task = robot.task;
  sup::PlanInput input;
  const double height_m = o.height_mm < 0.0 ? task.nail_height_m : 1e-3 * o.height_mm;
  input.normal = task.normal;
  input.head_position_m = task.nail_position_m + height_m * task.normal;
  input.board_distance_m = height_m;
  input.restitution = o.restitution;
  if (o.nail_mass_kg > 0.0) input.nail_mass_kg = o.nail_mass_kg;
  input.contact_duration_s = o.contact_ms > 0.0 ? 1e-3 * o.contact_ms : task.assumed_contact_s;
  input.follow_through_m = 1e-3 * o.follow_mm;
  input.wanted_penetration_m = 1e-3 * o.penetration_mm;
  if (o.penetration_mm > 0.0 && !(o.nail_mass_kg > 0.0)) {
    throw std::invalid_argument(fmt::format(
        "--penetration {:g} mm: how hard that is depends on the nail; give its effective mass with --nail-mass, kg",
        o.penetration_mm));
  }
  input.speed_share = o.speed_share;
  input.mode = passive_mode(o.mode);
  if (!o.passive.empty()) input.passive = joint_mask(robot, "--passive", o.passive);
  input.measure = strike_measure(o.measure);
  input.seed = o.seed;
  input.start = sup::JointVector::Zero(robot.dof());
  for (int i = 0; i < robot.dof(); ++i) input.start[i] = robot.joints[static_cast<std::size_t>(i)].park_rad;
  if (!o.start.empty()) input.start = joint_values(robot, "--start", o.start);
  return input;
}

void add_plan_command(CLI::App& app, int& status) {
  struct Arguments {
    StrikeOptions strike;
    bool json = false;
  };
  auto arguments = std::make_shared<Arguments>();
  CLI::App* command = app.add_subcommand("plan", "Plan a blow on the task's nail and say why so; moves nothing");
  add_strike_options(*command, arguments->strike);
  command->add_flag("--json", arguments->json, "Print one JSON object and nothing else");
  command->callback([arguments, &status] { status = run_plan(arguments->strike, arguments->json); });
}

}  // namespace mrr::cli
