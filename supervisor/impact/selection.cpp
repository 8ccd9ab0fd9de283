#include "supervisor/impact/selection.h"

#include <Eigen/LU>
#include <cmath>
#include <limits>

#include "supervisor/impact/internal.h"

namespace mrr::sup {
namespace {

constexpr double kSmallestMobility = 1e-9;  // 1/kg; as in predict()

}  // namespace

double SelectionBlow::impulse_n_s(double speed_m_s, double restitution, double nail_mass_kg) const noexcept {
  const double compliance = mobility_per_kg + 1.0 / nail_mass_kg;
  if (!(compliance > kSmallestMobility)) return std::numeric_limits<double>::infinity();
  return speed_m_s > 0.0 ? (1.0 + restitution) * speed_m_s / compliance : 0.0;
}

SelectionSweep::SelectionSweep(const Chain& chain, const ChainPose& pose, const Eigen::Vector3d& normal,
                               const std::array<double, kMaxJoints>& extra_inertia_kg_m2, RotorModel rotors,
                               Formulation formulation) noexcept
    : dof_(chain.dof()), extra_(chain.dof()) {
  bool sound = normal.allFinite();
  for (int i = 0; i < dof_; ++i) {
    extra_[i] = extra_inertia_kg_m2[static_cast<std::size_t>(i)];
    sound = sound && extra_[i] >= 0.0 && std::isfinite(extra_[i]);
  }
  const JointMatrix M = chain.mass_matrix(pose);
  lever_ = chain.jacobian(pose).topRows<3>().transpose() * normal;
  inverse_ = (M + chain.reflected_inertia(pose, rotors)).partialPivLu().inverse();
  free_.noalias() = inverse_.lazyProduct(lever_);
  if (formulation == Formulation::corrected) {
    through_ = lever_;
    per_jump_ = -M;
  } else {
    Vector6 external = Vector6::Zero();
    external.head<3>() = normal;
    JointWrenches unused;
    through_ = internal_impulses(chain, pose, JointVector::Zero(dof_), external, formulation, unused);
    per_jump_.resize(dof_, dof_);
    for (int i = 0; i < dof_; ++i) {
      per_jump_.col(i) =
          internal_impulses(chain, pose, JointVector::Unit(dof_, i), Vector6::Zero(), formulation, unused);
    }
  }
  usable_ = sound && inverse_.allFinite() && free_.allFinite();
}

void SelectionSweep::activate(Node& node, int i, int first) const noexcept {
  const double share = extra_[i] / (1.0 + extra_[i] * node.inverse(i, i));
  const double jump = share * node.x[i];
  node.x.noalias() -= jump * node.inverse.col(i);
  for (int j = first; j < dof_; ++j) {
    if (j == i) continue;
    const double factor = share * node.inverse(i, j);
    for (int row = 0; row < dof_; ++row) node.inverse(row, j) -= factor * node.inverse(row, i);
  }
  if (first <= i) node.inverse.col(i) /= 1.0 + extra_[i] * node.inverse(i, i);
}

void SelectionSweep::fill(const JointVector& x, std::uint32_t passive, SelectionBlow& blow) const noexcept {
  blow.passive = passive;
  blow.mobility_per_kg = lever_.dot(x);
  blow.delta_qd_per_n_s = x;
  blow.axis_nm_s_per_n_s = through_;
  blow.axis_nm_s_per_n_s.noalias() += per_jump_.lazyProduct(x);
}

SelectionBlow SelectionSweep::at(std::uint32_t passive) const noexcept {
  SelectionBlow blow;
  for_each(0, passive & all(), [&](const SelectionBlow& only) { blow = only; });
  return blow;
}

SelectionBlow SelectionSweep::held(int joint) const noexcept {
  SelectionBlow blow;
  JointVector x = free_;
  x.noalias() -= (free_[joint] / inverse_(joint, joint)) * inverse_.col(joint);
  x[joint] = 0.0;
  fill(x, all() & ~(1U << joint), blow);
  return blow;
}

}  // namespace mrr::sup
