// Room: supervisor/impact. How good a pose is for striking: impact measures of the reference and the planner's own.
// May touch common/ and supervisor/model. Allocates nothing, throws nothing.
#pragma once

#include <array>
#include <span>

#include "supervisor/impact/external.h"

namespace mrr::sup {

/// W = J H^-1 J^T of the face centre, linear part, 1/kg, base frame, H = M + B, all joints free.
[[nodiscard]] Eigen::Matrix3d linear_mobility(const Chain& chain, const ChainPose& pose,
                                              RotorModel rotors = RotorModel::sym) noexcept;

/// 1/(u^T W u), kg (Khatib, IJRR 14(1), 1995); u is normalised here. Infinite if the face cannot move along u.
[[nodiscard]] double effective_mass_kg(const Eigen::Matrix3d& mobility, const Eigen::Vector3d& direction) noexcept;

/// Axes are columns; semi-axes descend. Along an axis in which the face cannot move the semi-axis is infinite.
struct ImpactEllipsoid {
  Eigen::Matrix3d axes = Eigen::Matrix3d::Identity();
  Eigen::Vector3d semi_axes = Eigen::Vector3d::Zero();
};
/// Semi-axes 1/eig(W): impulse per unit of speed, N s/(m/s), without the factor 1+e. (Walker, IEEE T-RA 10(5), 1994.)
[[nodiscard]] ImpactEllipsoid dynamic_impact_ellipsoid(const Eigen::Matrix3d& mobility) noexcept;
/// Semi-axes 1/sqrt(eig(W)): impulse per root of the kinetic energy of the joints (Walker 1994).
[[nodiscard]] ImpactEllipsoid generalised_impact_ellipsoid(const Eigen::Matrix3d& mobility) noexcept;
/// Normalised impact geometry (Kim, Chung and Youm, ICRA 2000): P over directions for unit approach speed, (1+e)/(u^T W
/// u + 1/M*), N s/(m/s).
[[nodiscard]] double normalised_impulse_n_s(const Eigen::Matrix3d& mobility, const Eigen::Vector3d& direction,
                                            double restitution,
                                            double nail_mass_kg = std::numeric_limits<double>::infinity()) noexcept;

/// w_ii = product of the singular values of L, (55), by SVD. With `length_m` > 0 torques are divided by that length, so
/// that all entries are pure numbers; Chain::reach_m() is a good one. 1 m gives the reference's value.
struct InternalImpactMeasure {
  Vector6 singular_values = Vector6::Zero();  ///< descending
  double w_ii = 0.0;
};
[[nodiscard]] InternalImpactMeasure internal_impact_measure(const Chain& chain, const ChainPose& pose, double length_m,
                                                            RotorModel rotors = RotorModel::sym,
                                                            Formulation formulation = Formulation::corrected) noexcept;

/// max_i |tau_i| / limit_i, 1/1; `limits_nm_s` has one entry per joint. An infeasible prediction or a limit that is not
/// > 0 gives infinity.
[[nodiscard]] double load_ratio(const ImpactPrediction& prediction, std::span<const double> limits_nm_s) noexcept;
/// The planner's measure: load ratio per newton second of useful impulse, 1/(N s): smaller is better. Infinite without
/// an impulse.
[[nodiscard]] double load_ratio_per_impulse(const ImpactPrediction& prediction,
                                            std::span<const double> limits_nm_s) noexcept;

}  // namespace mrr::sup
