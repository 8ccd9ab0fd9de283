#include "supervisor/impact/external.h"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <cmath>
#include <numbers>

#include "supervisor/impact/internal.h"

namespace mrr::sup {
namespace {

/// Below this mobility (1/kg) against a rigid board nothing yields: the impulse would be without bound.
constexpr double kSmallestMobility = 1e-9;
constexpr double kUnitTolerance = 1e-6;
constexpr double kSmallestPivot = 1e-12;  // of its diagonal entry

bool usable(const Chain& chain, const ImpactInput& input) noexcept {
  const int n = chain.dof();
  if (input.q.size() != n || input.qd.size() != n || !input.q.allFinite() || !input.qd.allFinite()) return false;
  if (!(std::abs(input.normal.norm() - 1.0) <= kUnitTolerance)) return false;
  if (!(input.restitution >= 0.0 && input.restitution <= 1.0)) return false;
  if (!(input.nail_mass_kg > 0.0)) return false;
  for (int i = 0; i < n; ++i) {
    const JointState& joint = input.joints[static_cast<std::size_t>(i)];
    if (joint.hold == JointHold::controlled &&
        !(joint.extra_inertia_kg_m2 >= 0.0 && std::isfinite(joint.extra_inertia_kg_m2))) {
      return false;
    }
  }
  return true;
}

/// x := H^-1 x by L D L^T of the lower triangle of H, which is lost. False, x lost and H as it was, unless H is clearly
/// positive definite. For a few joints this is several times faster than a pivoting LU.
bool solve_in_place(JointMatrix& H, JointVector& x) noexcept {
  const int n = static_cast<int>(x.size());
  const JointVector diagonal = H.diagonal();
  for (int j = 0; j < n; ++j) {
    const double d = H(j, j);
    if (!(d > kSmallestPivot * diagonal[j])) {
      H.triangularView<Eigen::StrictlyLower>() = H.transpose();
      H.diagonal() = diagonal;
      return false;
    }
    const double inverse = 1.0 / d;
    for (int i = j + 1; i < n; ++i) {
      const double factor = H(i, j) * inverse;
      for (int k = i; k < n; ++k) H(k, i) -= factor * H(k, j);
      x[i] -= factor * x[j];
      H(i, j) = factor;
    }
    x[j] *= inverse;
  }
  for (int i = n - 1; i > 0; --i) {
    for (int k = 0; k < i; ++k) x[k] -= H(i, k) * x[i];
  }
  return true;
}

/// x = H^-1 J_h^T n over the joints that are not held; zero for the held ones.
JointVector speed_per_impulse(const Chain& chain, const ChainPose& pose, const PoseTerms& terms,
                              const ImpactInput& input, const JointVector& lever) noexcept {
  JointMatrix H = chain.mass_matrix(pose, terms);
  chain.add_reflected_inertia(pose, input.rotor_model, H);
  JointVector right(chain.dof());
  JointVector x(chain.dof());
  for (int i = 0; i < chain.dof(); ++i) {
    const JointState& joint = input.joints[static_cast<std::size_t>(i)];
    const bool held = joint.hold == JointHold::held;
    right[i] = x[i] = held ? 0.0 : lever[i];
    if (held) {
      H.row(i).setZero();
      H.col(i).setZero();
      H(i, i) = 1.0;
    } else if (joint.hold == JointHold::controlled) {
      H(i, i) += joint.extra_inertia_kg_m2;
    }
  }
  // Symmetric but for the reference's one-sided rotors.
  if (input.rotor_model == RotorModel::lower || !solve_in_place(H, x)) x = H.partialPivLu().solve(right);
  return x;
}

}  // namespace

ImpactPrediction predict(const Chain& chain, const ImpactInput& input) noexcept {
  const int n = chain.dof();
  ImpactPrediction out;
  out.delta_qd.setZero(n);
  out.axis_impulse_nm_s.setZero(n);
  for (int i = 0; i < n; ++i) out.wrench[static_cast<std::size_t>(i)] = WrenchImpulse::none();
  if (!usable(chain, input)) return out;

  const ChainPose pose = chain.pose(input.q);
  const PoseTerms terms = chain.terms(pose);
  JointVector lever(n);  // J_h^T n
  for (int i = 0; i < n; ++i) lever[i] = terms.face.col(i).head<3>().dot(input.normal);
  const JointVector x = speed_per_impulse(chain, pose, terms, input, lever);
  const double mobility = lever.dot(x);  // n^T W n
  const double compliance = mobility + 1.0 / input.nail_mass_kg;
  const double speed = -lever.dot(input.qd);
  const bool approaching = speed > 0.0;
  if (!std::isfinite(speed) || !std::isfinite(mobility)) return out;
  if (approaching && !(compliance > kSmallestMobility)) return out;

  out.feasible = true;
  out.approaching = approaching;
  out.speed_before_m_s = out.speed_after_m_s = speed;
  out.effective_mass_kg = mobility > kSmallestMobility ? 1.0 / mobility : std::numeric_limits<double>::infinity();
  if (!approaching) return out;

  const double P = (1.0 + input.restitution) * speed / compliance;
  out.impulse_n_s = P;
  out.delta_qd = P * x;
  out.speed_after_m_s = speed - P * mobility;
  out.nail_speed_after_m_s = P / input.nail_mass_kg;
  Vector6 external = Vector6::Zero();
  external.head<3>() = P * input.normal;
  out.axis_impulse_nm_s = internal_impulses(chain, pose, terms, out.delta_qd, external, input.formulation, out.wrench);
  return out;
}

double controlled_extra_inertia(double position_gain_nm_rad, double velocity_gain_nm_s_rad, double contact_s,
                                PulseShape shape) noexcept {
  // Integrals of the speed jump and of the displacement it makes, per unit of jump.
  constexpr double kSquare = 1.0 / 6.0;
  constexpr double kHalfSine = 0.25 - 1.0 / (std::numbers::pi * std::numbers::pi);
  const double position_share = shape == PulseShape::square ? kSquare : kHalfSine;
  return velocity_gain_nm_s_rad * contact_s / 2.0 + position_gain_nm_rad * contact_s * contact_s * position_share;
}

double impulse_of_samples_n_s(std::span<const double> force_n, double sample_s) noexcept {
  double sum = 0.0;
  for (std::size_t k = 1; k < force_n.size(); ++k) sum += 0.5 * (force_n[k - 1] + force_n[k]);
  return sum * sample_s;
}

double effective_nail_mass_kg(double impulse_n_s, double contact_s, double penetration_m) noexcept {
  if (!(impulse_n_s > 0.0 && contact_s > 0.0 && penetration_m >= 0.0) || !std::isfinite(impulse_n_s) ||
      !std::isfinite(contact_s) || !std::isfinite(penetration_m)) {
    return std::numeric_limits<double>::quiet_NaN();
  }
  return impulse_n_s * contact_s / penetration_m;
}

double restitution_from_impulse(double impulse_n_s, double approach_speed_m_s, double effective_mass_kg,
                                double nail_mass_kg) noexcept {
  if (!(approach_speed_m_s > 0.0 && effective_mass_kg > 0.0 && nail_mass_kg > 0.0)) {
    return std::numeric_limits<double>::quiet_NaN();
  }
  return impulse_n_s * (1.0 / effective_mass_kg + 1.0 / nail_mass_kg) / approach_speed_m_s - 1.0;
}

double restitution_from_speeds(double face_before_m_s, double face_after_m_s, double nail_after_m_s) noexcept {
  if (!(face_before_m_s < 0.0)) return std::numeric_limits<double>::quiet_NaN();
  return -(face_after_m_s - nail_after_m_s) / face_before_m_s;
}

double friction_torque_nm(const FrictionDescription& friction, double qd_rad_s) noexcept {
  const double sign = qd_rad_s > 0.0 ? 1.0 : (qd_rad_s < 0.0 ? -1.0 : 0.0);
  const double decay = std::exp(-friction.stribeck_decay_s2_rad2 * qd_rad_s * qd_rad_s);
  return (friction.coulomb_nm + (friction.static_nm - friction.coulomb_nm) * decay) * sign +
         friction.viscous_nm_s_rad * qd_rad_s;
}

JointVector finite_time_correction_nm_s(const Chain& chain, const std::array<FrictionDescription, kMaxJoints>& friction,
                                        const JointVector& q, const JointVector& qd_before, const JointVector& qd_after,
                                        double contact_s) noexcept {
  // h is quadratic in q', q' linear in time: Simpson is exact.
  const JointVector qd_middle = 0.5 * (qd_before + qd_after);
  JointVector impulse =
      (contact_s / 6.0) * (chain.bias(q, qd_before) + 4.0 * chain.bias(q, qd_middle) + chain.bias(q, qd_after));
  constexpr int kSlices = 64;
  for (int i = 0; i < chain.dof(); ++i) {
    double sum = 0.0;
    for (int slice = 0; slice < kSlices; ++slice) {
      const double share = (slice + 0.5) / kSlices;
      sum += friction_torque_nm(friction[static_cast<std::size_t>(i)],
                                qd_before[i] + share * (qd_after[i] - qd_before[i]));
    }
    impulse[i] += contact_s * sum / kSlices;
  }
  return impulse;
}

}  // namespace mrr::sup
