// Room: supervisor/strike. Impact measures at a pose and over the workspace, each with its unit and source.
// May touch common/, supervisor/model, supervisor/impact and inverse kinematics. Maps allocate; deterministic.
#pragma once

#include <array>
#include <limits>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "supervisor/impact/external.h"
#include "supervisor/strike/inverse_kinematics.h"

namespace mrr::sup {

enum class Measure : std::uint8_t {
  load_ratio,
  effective_mass,
  internal_impact,
  dynamic_ellipsoid,
  generalised_ellipsoid,
  impact_geometry,
};

struct MeasureInfo {
  Measure measure;
  const char* name;  ///< as on the command line
  const char* unit;
  const char* meaning;  ///< one line
  const char* source;
  bool most_is_best;
};
inline constexpr std::array<MeasureInfo, 6> kMeasures{{
    {Measure::load_ratio, "load_ratio", "1/(N s)",
     "largest predicted axis impulse over its rated limit, per N s of useful impulse, under the lightest selection",
     "this product's own: docs/theory.md, section 4", false},
    {Measure::effective_mass, "effective_mass", "kg", "1/(n^T W n) along the strike, all joints free",
     "Khatib, Int. J. Robotics Research 14(1), 1995", true},
    {Measure::internal_impact, "internal_impact", "1",
     "w_ii: product of the singular values of L, torques over the arm's reach", "the reference's (55)", true},
    {Measure::dynamic_ellipsoid, "dynamic_ellipsoid", "kg",
     "geometric mean of the semi-axes 1/eig(W): impulse per unit of speed, whatever the direction",
     "Walker, IEEE Trans. Robotics and Automation 10(5), 1994: dynamic impact ellipsoid", true},
    {Measure::generalised_ellipsoid, "generalised_ellipsoid", "kg^(1/2)",
     "geometric mean of the semi-axes 1/sqrt(eig(W)): impulse per root of the joints' energy",
     "Walker 1994: generalised impact ellipsoid", true},
    {Measure::impact_geometry, "impact_geometry", "N s/(m/s)",
     "impulse along the strike per unit of approach speed, (1+e)/(n^T W n + 1/M*)",
     "Kim, Chung and Youm, ICRA 2000: normalised impact geometry; with the reference's (36)", true},
}};
[[nodiscard]] const MeasureInfo& info(Measure measure) noexcept;
/// nullopt: there is none of that name.
[[nodiscard]] std::optional<Measure> measure_named(std::string_view name) noexcept;

/// What some measures depend on besides the pose.
struct MeasureSetting {
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();              ///< unit, from the board into the robot, base frame
  double restitution = 1.0;                                       ///< e, 0..1
  double nail_mass_kg = std::numeric_limits<double>::infinity();  ///< M*, > 0
  double contact_s = 0.05;                                        ///< t_s, > 0: of limits and of active joints
};

/// The measure at a pose, in its unit. Infinite where the face cannot move (along n, or at all for the ellipsoids).
[[nodiscard]] double measure_at(const RobotDescription& robot, const Chain& chain, const JointVector& q,
                                Measure measure, const MeasureSetting& setting);

/// A grid of places for the face in the vertical plane through the base and the nail.
struct MapInput {
  Measure measure = Measure::load_ratio;
  MeasureSetting setting;
  int columns = 64;  ///< 2..512
  int rows = 28;     ///< 2..512
  double max_tilt_rad =
      0.0;  ///< of the face against the strike; 0: the hammer's, or any for arms of less than 5 joints
  /// The window, m: along the plane (from the base's axis towards the nail) and up. low = high: the arm's reach.
  double low_m = 0.0, high_m = 0.0, bottom_m = 0.0, top_m = 0.0;
  std::uint64_t seed = 1;
};
/// Empty if usable; else one sentence naming the field, its value and what is allowed.
[[nodiscard]] std::string validate_input(const RobotDescription& robot, const MapInput& input);

struct MapCell {
  double value = std::numeric_limits<double>::quiet_NaN();  ///< NaN: out of reach; of the best pose there
  JointVector q;                                            ///< that pose, empty if out of reach
};

struct MeasureMap {
  Measure measure = Measure::load_ratio;
  int columns = 0;
  int rows = 0;
  double low_m = 0.0, high_m = 0.0, bottom_m = 0.0, top_m = 0.0;
  Eigen::Vector3d along = Eigen::Vector3d::UnitX();    ///< horizontal direction of the plane, base frame
  Eigen::Vector3d origin_m = Eigen::Vector3d::Zero();  ///< of the plane's coordinates, base frame
  double max_tilt_rad = 0.0;
  std::vector<MapCell> cells;  ///< row by row from the bottom
  [[nodiscard]] std::size_t index(int row, int column) const {
    return static_cast<std::size_t>(row) * static_cast<std::size_t>(columns) + static_cast<std::size_t>(column);
  }
  [[nodiscard]] const MapCell& cell(int row, int column) const { return cells[index(row, column)]; }
  [[nodiscard]] double x_m(int column) const { return low_m + (high_m - low_m) * (column + 0.5) / columns; }
  [[nodiscard]] double z_m(int row) const { return bottom_m + (top_m - bottom_m) * (row + 0.5) / rows; }
};

/// Throws PlanError with the sentence of validate_input().
[[nodiscard]] MeasureMap measure_map(const RobotDescription& robot, const Chain& chain, const MapInput& input);

}  // namespace mrr::sup
