#include "supervisor/strike/null_space.h"

#include <Eigen/QR>
#include <nlopt.hpp>
#include <vector>

namespace mrr::sup {
namespace {

constexpr double kWall = 1e6;  // cost where there is no solution; finite, for the simplex to compare
constexpr double kFirstStepRad = 0.3;
constexpr double kFurthestRad = 3.0;

}  // namespace

JointMatrix NullSpaceSearch::freedom(const JointVector& q) const {
  const ChainPose pose = chain_.pose(q);
  const Jacobian J = chain_.jacobian(pose);
  const int n = chain_.dof();
  // Rows that may not move: the face's centre, and its axis if there are joints enough to keep it.
  Eigen::MatrixXd kept(n, n < 5 ? 3 : 5);
  kept.leftCols<3>() = J.topRows<3>().transpose();
  if (n >= 5) kept.rightCols<2>() = J.bottomRows<3>().transpose() * pose.face.rotation.leftCols<2>();
  const Eigen::ColPivHouseholderQR<Eigen::MatrixXd> qr(kept);
  const Eigen::MatrixXd Q = qr.householderQ();
  return Q.rightCols(n - qr.rank());
}

std::optional<FaceSolution> NullSpaceSearch::improve(const FaceSolution& from,
                                                     const std::function<double(const FaceSolution&)>& cost,
                                                     int evaluations) const {
  const JointMatrix basis = freedom(from.q);
  const auto dimensions = static_cast<unsigned>(basis.cols());
  if (dimensions == 0) return std::nullopt;
  std::optional<FaceSolution> best;
  double least = cost(from);
  std::function<double(const std::vector<double>&)> cost_at = [&](const std::vector<double>& x) {
    JointVector q = from.q;
    for (unsigned k = 0; k < dimensions; ++k) q += x[k] * basis.col(k);
    const auto solution = solve_near(robot_, chain_, target_, q);
    if (!solution) return kWall;
    const double value = cost(*solution);
    if (value < least) {
      least = value;
      best = solution;
    }
    return value < kWall ? value : kWall;  // NaN too
  };
  nlopt::opt search(nlopt::LN_SBPLX, dimensions);
  search.set_min_objective(
      [](const std::vector<double>& x, std::vector<double>&, void* f) {
        return (*static_cast<std::function<double(const std::vector<double>&)>*>(f))(x);
      },
      &cost_at);
  search.set_lower_bounds(-kFurthestRad);
  search.set_upper_bounds(kFurthestRad);
  search.set_initial_step(kFirstStepRad);
  search.set_maxeval(evaluations);
  search.set_xtol_abs(2e-3);
  search.set_ftol_abs(2e-3);
  std::vector<double> x(dimensions, 0.0);
  double value = 0.0;
  try {
    search.optimize(x, value);
  } catch (const nlopt::roundoff_limited&) {  // as good as it gets; `best` has it
  }
  return best;
}

}  // namespace mrr::sup
