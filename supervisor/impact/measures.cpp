#include "supervisor/impact/measures.h"

#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <Eigen/QR>
#include <Eigen/SVD>
#include <algorithm>
#include <cmath>

#include "supervisor/impact/internal.h"

namespace mrr::sup {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
/// Mobility (1/kg) below which a direction counts as one the face cannot move in.
constexpr double kSmallestMobility = 1e-9;

}  // namespace

Eigen::Matrix3d linear_mobility(const Chain& chain, const ChainPose& pose, RotorModel rotors) noexcept {
  const Jacobian J_h = chain.jacobian(pose);
  const JointMatrix H = chain.mass_matrix(pose) + chain.reflected_inertia(pose, rotors);
  const Eigen::PartialPivLU<JointMatrix> solver(H);
  Eigen::Matrix3d W;
  for (int column = 0; column < 3; ++column) {
    const JointVector row = J_h.row(column).transpose();
    const JointVector x = solver.solve(row);
    W.col(column) = J_h.topRows<3>() * x;
  }
  return W;
}

double effective_mass_kg(const Eigen::Matrix3d& mobility, const Eigen::Vector3d& direction) noexcept {
  const Eigen::Vector3d u = direction.normalized();
  const double along = u.dot(mobility * u);
  return along > kSmallestMobility ? 1.0 / along : kInfinity;
}

ImpactEllipsoid dynamic_impact_ellipsoid(const Eigen::Matrix3d& mobility) noexcept {
  // RotorModel::lower makes W slightly asymmetric; its ellipsoid is that of the symmetric part.
  const Eigen::Matrix3d W = 0.5 * (mobility + mobility.transpose());
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(W);
  ImpactEllipsoid ellipsoid;
  ellipsoid.axes = eigen.eigenvectors();
  for (int i = 0; i < 3; ++i) {
    const double value = eigen.eigenvalues()[i];
    ellipsoid.semi_axes[i] = value > kSmallestMobility ? 1.0 / value : kInfinity;
  }
  return ellipsoid;
}

ImpactEllipsoid generalised_impact_ellipsoid(const Eigen::Matrix3d& mobility) noexcept {
  ImpactEllipsoid ellipsoid = dynamic_impact_ellipsoid(mobility);
  ellipsoid.semi_axes = ellipsoid.semi_axes.cwiseSqrt();
  return ellipsoid;
}

double normalised_impulse_n_s(const Eigen::Matrix3d& mobility, const Eigen::Vector3d& direction, double restitution,
                              double nail_mass_kg) noexcept {
  const Eigen::Vector3d u = direction.normalized();
  const double compliance = u.dot(mobility * u) + 1.0 / nail_mass_kg;
  return compliance > kSmallestMobility ? (1.0 + restitution) / compliance : kInfinity;
}

InternalImpactMeasure internal_impact_measure(const Chain& chain, const ChainPose& pose, double length_m,
                                              RotorModel rotors, Formulation formulation) noexcept {
  ImpulseMap L = impulse_map(chain, pose, rotors, formulation);
  L.bottomRows(3 * chain.dof()) /= length_m;
  L.rightCols<3>() *= length_m;
  // The triangular factor has the singular values of the tall matrix.
  const Eigen::HouseholderQR<ImpulseMap> qr(L);
  const Eigen::Matrix<double, 6, 6> R = qr.matrixQR().topRows<6>().triangularView<Eigen::Upper>();
  InternalImpactMeasure measure;
  measure.singular_values = Eigen::JacobiSVD<Eigen::Matrix<double, 6, 6>>(R).singularValues();
  measure.w_ii = measure.singular_values.prod();
  return measure;
}

double load_ratio(const ImpactPrediction& prediction, std::span<const double> limits_nm_s) noexcept {
  const auto n = static_cast<std::size_t>(prediction.axis_impulse_nm_s.size());
  if (!prediction.feasible || limits_nm_s.size() != n) return kInfinity;
  double worst = 0.0;
  for (std::size_t i = 0; i < n; ++i) {
    const double ratio = std::abs(prediction.axis_impulse_nm_s[static_cast<Eigen::Index>(i)]) / limits_nm_s[i];
    if (!(limits_nm_s[i] > 0.0 && ratio >= 0.0)) return kInfinity;
    worst = std::max(worst, ratio);
  }
  return worst;
}

double load_ratio_per_impulse(const ImpactPrediction& prediction, std::span<const double> limits_nm_s) noexcept {
  if (!(prediction.impulse_n_s > 0.0)) return kInfinity;
  return load_ratio(prediction, limits_nm_s) / prediction.impulse_n_s;
}

}  // namespace mrr::sup
