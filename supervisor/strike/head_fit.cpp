#include "supervisor/strike/head_fit.h"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>

namespace mrr::sup {
namespace {

constexpr double kModelShare = 0.03;  // of a force: what the law of the rubber leaves unexplained
constexpr double kGuess_m = 5e-3;     // how far off the first guess may be, one standard deviation
constexpr double kPull = 4.0;         // standard deviations below zero: rubber does not pull
constexpr double kFar = 2.5;          // standard deviations: from here on a point counts for less
constexpr int kSteps = 20;
constexpr double kLeastShare = 1e-3;  // of a step
constexpr double kStill_m = 1e-6;

/// Head, ln k, c.
using Parameters = Eigen::Vector3d;

struct Cost {
  double value = 0.0;
  Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();  // J^T J
  Eigen::Vector3d slope = Eigen::Vector3d::Zero();   // J^T r
  int touching = 0;
  double counted = 0.0;  // sum of the weights of points
  double squares = 0.0;  // of their residuals, weighted
};

/// A sample taken a control tick late makes one wild force and the opposite on either side; the sign gives it away.
bool torn(std::span<const ContactPoint> points, std::size_t k, double noise_n) noexcept {
  const std::size_t last = std::min(k + 1, points.size() - 1);
  for (std::size_t i = k - std::min<std::size_t>(k, 1); i <= last; ++i) {
    if (points[i].force_n < -kPull * noise_n) return true;
  }
  return false;
}

Cost cost_of(const Parameters& p, const Parameters& believed, const Eigen::Vector3d& weight,
             std::span<const ContactPoint> points, double noise_n) noexcept {
  Cost cost;
  const Eigen::Vector3d off = (p - believed).cwiseProduct(weight);
  cost.value = off.squaredNorm();
  cost.normal.diagonal() = weight.cwiseAbs2();
  cost.slope = off.cwiseProduct(weight);
  const double k = std::exp(p[1]);
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (torn(points, i, noise_n)) continue;
    const ContactPoint& point = points[i];
    const double d = p[0] - point.height_m;
    const double factor = 1.0 - p[2] * point.leaving_m_s;
    const double force = d > 0.0 && factor > 0.0 ? k * d * factor : 0.0;
    const double sd = std::hypot(noise_n, kModelShare * point.force_n);
    const double r = (force - point.force_n) / sd;
    // Cauchy's loss: what is far off counts for less.
    const double far = r / kFar;
    const double weigh = 1.0 / (1.0 + far * far);
    cost.value += kFar * kFar * std::log1p(far * far);
    cost.counted += weigh;
    cost.squares += weigh * r * r;
    if (!(force > 0.0)) continue;
    ++cost.touching;
    const Eigen::Vector3d J = Eigen::Vector3d(k * factor, force, -k * d * point.leaving_m_s) / sd;
    cost.normal += weigh * J * J.transpose();
    cost.slope += weigh * r * J;
  }
  return cost;
}

/// Gauss and Newton's way down from `p`, with shorter steps where a whole one would lead up.
Cost descend(Parameters& p, const Parameters& believed, const Eigen::Vector3d& weight,
             std::span<const ContactPoint> points, double noise_n) noexcept {
  Cost cost = cost_of(p, believed, weight, points, noise_n);
  for (int step = 0; step < kSteps; ++step) {
    const Eigen::Vector3d move = cost.normal.llt().solve(-cost.slope);
    Cost next;
    double share = 1.0;
    for (; share > kLeastShare; share *= 0.5) {
      next = cost_of(p + share * move, believed, weight, points, noise_n);
      if (next.value < cost.value) break;
    }
    if (!(share > kLeastShare)) break;
    p += share * move;
    cost = next;
    if (std::abs(share * move[0]) < kStill_m) break;
  }
  return cost;
}

}  // namespace

HeadFit fit_head(std::span<const ContactPoint> leaving, double noise_n, const RubberBelief& believed,
                 double first_guess_m) noexcept {
  HeadFit fit;
  fit.rubber = believed;
  if (leaving.size() < 3 || !(noise_n > 0.0) || !std::isfinite(first_guess_m)) return fit;
  const Parameters prior(first_guess_m, std::log(believed.stiffness_n_m), believed.damping_s_m);
  const Eigen::Vector3d weight(1.0 / kGuess_m, 1.0 / believed.stiffness_share, 1.0 / believed.damping_sd_s_m);
  // From where the rubber would be pressed by as much as the force says, at the deepest point and at the first guess:
  // a wild point can hide the way from one of them.
  const ContactPoint& deepest = leaving.front();
  const double starts[] = {first_guess_m, deepest.height_m + std::max(deepest.force_n, 0.0) / believed.stiffness_n_m};
  Parameters p = prior;
  Cost cost;
  cost.value = std::numeric_limits<double>::infinity();
  for (const double start : starts) {
    Parameters q(start, prior[1], prior[2]);
    const Cost found = descend(q, prior, weight, leaving, noise_n);
    if (!(found.value < cost.value)) continue;
    cost = found;
    p = q;
  }
  if (!p.allFinite() || cost.touching == 0) return fit;
  // Points that fit worse than their noise says: the law is not quite the rubber's.
  const double excess = std::max(1.0, cost.squares / cost.counted);
  const Eigen::Matrix3d covariance = excess * cost.normal.inverse();
  fit.usable = covariance.allFinite();
  fit.height_m = p[0];
  fit.height_sd_m = std::sqrt(covariance(0, 0));
  fit.rubber.stiffness_n_m = std::exp(p[1]);
  fit.rubber.stiffness_share = std::min(std::sqrt(covariance(1, 1)), believed.stiffness_share);
  fit.rubber.damping_s_m = std::max(p[2], 0.0);
  fit.rubber.damping_sd_s_m = std::min(std::sqrt(covariance(2, 2)), believed.damping_sd_s_m);
  return fit;
}

}  // namespace mrr::sup
