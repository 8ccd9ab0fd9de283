#include "cli/reference.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "supervisor/impact/external.h"
#include "supervisor/impact/limits.h"
#include "supervisor/model/chain.h"

namespace mrr::cli {

namespace {

using Json = nlohmann::ordered_json;

// The reference's home swing, and the rounded speed its Table 5 was made with.
constexpr double kHomeSpeed_rad_s = 0.6109;
constexpr double kTable5Speed_rad_s = 0.62;
constexpr double kMassTolerance = 0.01;

sup::ImpactPrediction home_swing(const RobotDescription& robot, double speed_rad_s) {
  sup::ImpactInput input;
  input.q = sup::JointVector::Zero(robot.dof());
  input.qd = sup::JointVector::Zero(robot.dof());
  input.qd[1] = -speed_rad_s;
  input.rotor_model = sup::RotorModel::lower;
  input.formulation = sup::Formulation::as_printed;
  return sup::predict(sup::Chain(robot), input);
}

Json number(double value) { return std::isfinite(value) ? Json(value) : Json(nullptr); }

std::string cell(double value, int digits) {
  return std::isfinite(value) ? fmt::format("{:.{}f}", value, digits) : "-";
}

}  // namespace

std::vector<ReproducedFigure> reproduce_tables(const RobotDescription& robot) {
  std::vector<ReproducedFigure> figures;
  const auto add = [&](std::string table, std::string quantity, double published, double computed, int digits,
                       std::string note = "") {
    ReproducedFigure figure{std::move(table), std::move(quantity), published, computed, digits, std::move(note), false};
    figure.reproduced = fmt::format("{:.{}f}", computed, digits) == fmt::format("{:.{}f}", published, digits);
    figures.push_back(figure);
  };
  struct Drive {
    const char* name;
    double gear_ratio;
    std::array<double, 3> rpm;
  };
  for (const Drive& drive : {Drive{"SHD17", 101.0, {5.94, 8.51, 19.8}}, Drive{"SHD25", 133.0, {4.51, 6.46, 15.0}}}) {
    add("Table 4", fmt::format("{} safest link rpm", drive.name), drive.rpm[0],
        sup::link_rpm(sup::kSafestMotorRpm, drive.gear_ratio), 2);
    add("Table 4", fmt::format("{} average link rpm", drive.name), drive.rpm[1],
        sup::link_rpm(sup::kAverageMotorRpm, drive.gear_ratio), 2);
    add("Table 4", fmt::format("{} largest link rpm", drive.name), drive.rpm[2],
        sup::link_rpm(sup::kMaxMotorRpm, drive.gear_ratio), 1);
  }

  const sup::ImpactPrediction blow = home_swing(robot, kTable5Speed_rad_s);
  add("Table 5", "external impulse, N s", 2.06, blow.impulse_n_s, 2);
  add("Table 5", "speed change of joint 2, rad/s", 0.98, std::abs(blow.delta_qd[1]), 2);
  add("Table 5", "speed change of joint 3, rad/s", 0.72, std::abs(blow.delta_qd[2]), 2,
      "the printed figure contradicts the reference's own (27)");
  add("Table 5", "internal impulse of joint 2, N m s", 0.84, std::abs(blow.axis_impulse_nm_s[1]), 2);
  add("Table 5", "internal impulse of joint 3, N m s", 0.72, std::abs(blow.axis_impulse_nm_s[2]), 2);

  struct Foam {
    const char* name;
    double penetration_mm, contact_ms, impulse_n_s, mass_kg;
  };
  for (const Foam& swing :
       {Foam{"Table 6", 22, 150, 1.02, 7.02}, Foam{"Table 6", 4, 85, 0.53, 11.2}, Foam{"Table 6", 3, 90, 0.49, 14.6},
        Foam{"Table 6", 11, 120, 1.05, 11.5}, Foam{"Table 7", 20, 140, 0.95, 6.7}, Foam{"Table 7", 13, 130, 1.08, 10.9},
        Foam{"Table 7", 5, 90, 0.67, 12.1}, Foam{"Table 7", 2, 90, 0.76, 34.1}}) {
    add(swing.name, fmt::format("effective mass of the nail, {:g} mm, kg", swing.penetration_mm), swing.mass_kg,
        sup::effective_nail_mass_kg(swing.impulse_n_s, swing.contact_ms * 1e-3, swing.penetration_mm * 1e-3), 1,
        "from rounded entries of the table: within 1 %");
    figures.back().reproduced = std::abs(figures.back().computed / swing.mass_kg - 1.0) <= kMassTolerance;
  }

  // The reference prints these as bars of its figure 26; theory gives them to three digits.
  const sup::ImpactPrediction home = home_swing(robot, kHomeSpeed_rad_s);
  const std::array<double, 8> impulses{1.79, 1.3, 1.29, 1.34, 1.41, 1.28, 1.42, 1.26};
  const std::array<double, 8> restitutions{0.764, 0.281, 0.271, 0.321, 0.390, 0.261, 0.399, 0.242};
  for (std::size_t i = 0; i < impulses.size(); ++i) {
    add("Table 8", fmt::format("restitution from {:.2f} N s", impulses[i]), restitutions[i],
        sup::restitution_from_impulse(impulses[i], home.speed_before_m_s, home.effective_mass_kg), 3);
  }
  return figures;
}

std::string tables_text(const std::vector<ReproducedFigure>& figures) {
  std::string text =
      "The reference's tables, from its equations as printed\n"
      "  table    quantity                               published  computed\n";
  for (const ReproducedFigure& figure : figures) {
    text += fmt::format("  {:<8} {:<38} {:>9.{}f} {:>9.{}f}  {}\n", figure.table, figure.quantity, figure.published,
                        figure.digits, figure.computed, figure.digits, figure.reproduced ? "" : "differs");
    if (!figure.reproduced && !figure.note.empty()) text += fmt::format("           ({})\n", figure.note);
  }
  return text;
}

Json tables_json(const std::vector<ReproducedFigure>& figures) {
  Json rows = Json::array();
  for (const ReproducedFigure& figure : figures) {
    rows.push_back({{"table", figure.table},
                    {"quantity", figure.quantity},
                    {"published", number(figure.published)},
                    {"computed", number(figure.computed)},
                    {"reproduced", figure.reproduced},
                    {"note", figure.note}});
  }
  return rows;
}

std::string experiment_text(const std::vector<sim::SimulatedSeries>& series) {
  std::string text;
  for (const sim::SimulatedSeries& board : series) {
    text += fmt::format("{}: simulated / measured by the reference\n", board.board);
    if (board.single_swings) {
      text += "  swing  past head   contact ms     impulse N s   penetration mm      M* kg\n";
      for (const sim::SimulatedSwing& s : board.swings) {
        const sim::PublishedSwing& p = s.swing.published;
        text +=
            fmt::format("  {:<6} {:>6.2f} mm  {:>5.0f} / {:<5} {:>6.2f} / {:<6} {:>6.1f} / {:<5} {:>6} / {:<5} {}\n",
                        s.swing.name, s.swing.past_head_m * 1e3, s.contact_ms, cell(p.contact_ms, 0), s.impulse_n_s,
                        cell(p.impulse_n_s, 2), s.penetration_mm, cell(p.penetration_mm, 0),
                        cell(s.effective_mass_kg, 1), cell(p.effective_mass_kg, 1), s.within ? "" : "off");
      }
      text += fmt::format(
          "  within {:.0f} % on duration, {:.0f} % on impulse, {:.0f} % or {:.1f} mm on penetration: {}\n",
          sim::kContactTolerance * 100, sim::kImpulseTolerance * 100, sim::kPenetrationTolerance * 100,
          sim::kPenetrationTolerance_mm,
          std::all_of(board.swings.begin(), board.swings.end(), [](const auto& s) { return s.within; }) ? "all"
                                                                                                        : "NOT all");
    } else {
      text += fmt::format("  measured: {:.0f} to {:.0f} ms, {:.2f} to {:.2f} N s\n", board.contact_low_ms,
                          board.contact_high_ms, board.impulse_low_n_s, board.impulse_high_n_s);
      for (const sim::SimulatedSwing& s : board.swings) {
        text += fmt::format("  {:>5.2f} mm past the head: {:>5.0f} ms  {:>6.2f} N s  {}\n", s.swing.past_head_m * 1e3,
                            s.contact_ms, s.impulse_n_s, s.within ? "" : "off");
      }
    }
  }
  return text;
}

Json experiment_json(const std::vector<sim::SimulatedSeries>& series) {
  Json boards = Json::array();
  for (const sim::SimulatedSeries& board : series) {
    Json swings = Json::array();
    for (const sim::SimulatedSwing& s : board.swings) {
      const sim::PublishedSwing& p = s.swing.published;
      swings.push_back({{"name", s.swing.name},
                        {"past_head_mm", s.swing.past_head_m * 1e3},
                        {"nail_height_mm", s.swing.nail_height_m * 1e3},
                        {"hit", s.hit},
                        {"within", s.within},
                        {"contact_ms", number(s.contact_ms)},
                        {"impulse_n_s", number(s.impulse_n_s)},
                        {"penetration_mm", number(s.penetration_mm)},
                        {"effective_mass_kg", number(s.effective_mass_kg)},
                        {"speed_m_s", number(s.speed_m_s)},
                        {"switch_lead_ms", number(s.switch_lead_ms)},
                        {"published",
                         {{"contact_ms", number(p.contact_ms)},
                          {"impulse_n_s", number(p.impulse_n_s)},
                          {"penetration_mm", number(p.penetration_mm)},
                          {"effective_mass_kg", number(p.effective_mass_kg)}}}});
    }
    Json entry = {{"board", board.board}, {"swings", swings}};
    if (!board.single_swings) {
      entry["measured_contact_ms"] = {board.contact_low_ms, board.contact_high_ms};
      entry["measured_impulse_n_s"] = {board.impulse_low_n_s, board.impulse_high_n_s};
    }
    boards.push_back(entry);
  }
  return boards;
}

bool experiment_reproduced(const std::vector<sim::SimulatedSeries>& series) {
  for (const sim::SimulatedSeries& board : series) {
    for (const sim::SimulatedSwing& swing : board.swings) {
      if (!swing.within) return false;
    }
  }
  return true;
}

}  // namespace mrr::cli
