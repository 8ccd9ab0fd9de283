#include "supervisor/strike/measure_map.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "common/robot/errors.h"
#include "supervisor/impact/limits.h"
#include "supervisor/impact/measures.h"
#include "supervisor/impact/selection.h"

namespace mrr::sup {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

/// Largest load over its rated limit per newton second, under the selection that makes it least.
double lightest_load(const RobotDescription& robot, const Chain& chain, const ChainPose& pose,
                     const MeasureSetting& setting) {
  std::array<double, kMaxJoints> extra{};
  std::array<double, kMaxJoints> rated{};
  for (std::size_t i = 0; i < robot.joints.size(); ++i) {
    const JointDescription& joint = robot.joints[i];
    extra[i] = controlled_extra_inertia(joint.control.position_gain_nm_rad, joint.control.velocity_gain_nm_s_rad,
                                        setting.contact_s);
    rated[i] = impulse_limits(joint.transmission, setting.contact_s).rated_nm_s;
  }
  const SelectionSweep sweep(chain, pose, setting.normal, extra);
  if (!sweep.usable()) return kInfinity;
  double least = kInfinity;
  sweep.for_each((1U << chain.dof()) - 1U, 0, [&](const SelectionBlow& blow) {
    if (!std::isfinite(blow.impulse_n_s(1.0, setting.restitution, setting.nail_mass_kg))) return;
    double worst = 0.0;
    for (int i = 0; i < chain.dof(); ++i) {
      worst = std::max(worst, std::abs(blow.axis_nm_s_per_n_s[i]) / rated[static_cast<std::size_t>(i)]);
    }
    least = std::min(least, worst);
  });
  return least;
}

double mean_semi_axis(const ImpactEllipsoid& ellipsoid) { return std::cbrt(ellipsoid.semi_axes.prod()); }

}  // namespace

const MeasureInfo& info(Measure measure) noexcept { return kMeasures[static_cast<std::size_t>(measure)]; }

std::optional<Measure> measure_named(std::string_view name) noexcept {
  for (const MeasureInfo& one : kMeasures) {
    if (name == one.name) return one.measure;
  }
  return std::nullopt;
}

double measure_at(const RobotDescription& robot, const Chain& chain, const JointVector& q, Measure measure,
                  const MeasureSetting& setting) {
  const ChainPose pose = chain.pose(q);
  switch (measure) {
    case Measure::load_ratio:
      return lightest_load(robot, chain, pose, setting);
    case Measure::effective_mass:
      return effective_mass_kg(linear_mobility(chain, pose), setting.normal);
    case Measure::internal_impact:
      return internal_impact_measure(chain, pose, chain.reach_m()).w_ii;
    case Measure::dynamic_ellipsoid:
      return mean_semi_axis(dynamic_impact_ellipsoid(linear_mobility(chain, pose)));
    case Measure::generalised_ellipsoid:
      return mean_semi_axis(generalised_impact_ellipsoid(linear_mobility(chain, pose)));
    case Measure::impact_geometry:
      return normalised_impulse_n_s(linear_mobility(chain, pose), setting.normal, setting.restitution,
                                    setting.nail_mass_kg);
  }
  return kInfinity;
}

std::string validate_input(const RobotDescription& robot, const MapInput& in) {
  const struct {
    const char* name;
    double value, low, high;
    const char* unit;
  } ranges[] = {{"columns", 1.0 * in.columns, 2, 512, ""},
                {"rows", 1.0 * in.rows, 2, 512, ""},
                {"max_tilt_rad", in.max_tilt_rad, 0.0, std::numbers::pi, " rad"},
                {"setting.restitution", in.setting.restitution, 0.0, 1.0, ""},
                {"setting.nail_mass_kg", in.setting.nail_mass_kg, 1e-6, kInfinity, " kg"},
                {"setting.contact_s", in.setting.contact_s, 1e-4, 1.0, " s"},
                {"low_m", in.low_m, -100.0, in.high_m, " m"},
                {"high_m", in.high_m, in.low_m, 100.0, " m"},
                {"bottom_m", in.bottom_m, -100.0, in.top_m, " m"},
                {"top_m", in.top_m, in.bottom_m, 100.0, " m"}};
  for (const auto& [name, value, low, high, unit] : ranges) {
    if (value >= low && value <= high) continue;
    return fmt::format("map: {} is {:.6g}{}, allowed {:.6g} to {:.6g}{}", name, value, unit, low, high, unit);
  }
  const double length = in.setting.normal.norm();
  if (!(std::abs(length - 1.0) <= 1e-6)) return fmt::format("map: normal has length {:.6g}, must be 1", length);
  if (robot.joints.empty()) return "map: the robot has no joints";
  return {};
}

MeasureMap measure_map(const RobotDescription& robot, const Chain& chain, const MapInput& in) {
  const std::string complaint = validate_input(robot, in);
  if (!complaint.empty()) throw PlanError(complaint);
  MeasureMap map;
  map.measure = in.measure;
  map.columns = in.columns;
  map.rows = in.rows;
  const Eigen::Vector3d up = robot.gravity_m_s2.norm() > 1e-3 ? Eigen::Vector3d(-robot.gravity_m_s2.normalized())
                                                              : Eigen::Vector3d(Eigen::Vector3d::UnitZ());
  // The plane holds the first joint's place, the vertical and the nail.
  const Eigen::Vector3d base = chain.pose(JointVector::Zero(chain.dof())).link[0].position_m;
  Eigen::Vector3d along = robot.task.nail_position_m - base;
  along -= up * up.dot(along);
  map.along = along.norm() > 1e-6 ? Eigen::Vector3d(along.normalized()) : up.unitOrthogonal();
  map.origin_m = base - up * up.dot(base);
  const double reach = 1.02 * chain.reach_m();
  const double shoulder = up.dot(base);
  const bool own_window = in.high_m > in.low_m;
  const bool own_height = in.top_m > in.bottom_m;
  map.low_m = own_window ? in.low_m : -reach;
  map.high_m = own_window ? in.high_m : reach;
  map.bottom_m = own_height ? in.bottom_m : shoulder - reach;
  map.top_m = own_height ? in.top_m : shoulder + reach;
  map.max_tilt_rad = in.max_tilt_rad > 0.0 ? in.max_tilt_rad
                     : chain.dof() < 5     ? std::numbers::pi
                                           : robot.hammer.max_tilt_rad;

  FaceTarget target;
  target.normal = in.setting.normal;
  target.max_tilt_rad = map.max_tilt_rad;
  IkOptions options;
  options.seed = in.seed;
  options.starts = chain.dof() > 5 ? 12 : 32;  // many cells, each a look at neighbours' poses too
  options.max_solutions = 12;
  options.null_space_steps = 2;
  const bool most = info(in.measure).most_is_best;
  JointVector near = JointVector::Zero(chain.dof());
  map.cells.resize(static_cast<std::size_t>(map.columns * map.rows));
  for (int row = 0; row < map.rows; ++row) {
    for (int column = 0; column < map.columns; ++column) {
      MapCell& cell = map.cells[map.index(row, column)];
      target.position_m = map.origin_m + map.along * map.x_m(column) + up * map.z_m(row);
      if ((target.position_m - base).norm() > chain.reach_m()) continue;
      for (const FaceSolution& s : solve_face_on_point(robot, chain, target, near, options).solutions) {
        const double value = measure_at(robot, chain, s.q, in.measure, in.setting);
        const bool first = cell.q.size() == 0;
        if (std::isnan(value) || !(first || (most ? value > cell.value : value < cell.value))) continue;
        cell.value = value;
        cell.q = s.q;
      }
      if (cell.q.size() > 0) near = cell.q;
    }
  }
  return map;
}

}  // namespace mrr::sup
