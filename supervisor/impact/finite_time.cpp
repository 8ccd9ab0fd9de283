#include "supervisor/impact/finite_time.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "supervisor/impact/internal.h"

namespace mrr::sup {
namespace {

constexpr double kHalfSinePeak = 0.5 * std::numbers::pi;  // peak over mean
constexpr double kLongest_s = 0.4;
constexpr int kRounds = 3;  // the contact's length depends on the mass, the mass on the length

std::size_t at(int i) noexcept { return static_cast<std::size_t>(i); }
double sign(double x) noexcept { return x > 0.0 ? 1.0 : (x < 0.0 ? -1.0 : 0.0); }

/// Speed of the reference `t` after the planned contact, over that at contact; see ReferenceProfile.
double reference_speed(const ReferenceProfile& r, double t) noexcept {
  if (t < r.stop_s) {
    const double x = t / r.stop_s;
    return 1.0 - x * x * (3.0 - 2.0 * x);
  }
  const double x = std::min((t - r.stop_s) / r.return_s, 1.0);
  return -30.0 * (r.travel_s + 0.5 * r.stop_s) / r.return_s * x * x * (1.0 - x) * (1.0 - x);
}

}  // namespace

LumpedBlow lumped_blow(const ContactLaw& law, double mass_kg, double speed_m_s, double push_n,
                       double longest_s) noexcept {
  LumpedBlow blow;
  if (!(mass_kg > 0.0 && speed_m_s > 0.0) || !std::isfinite(push_n)) return blow;
  // The fastest that happens is the rubber against the mass, or against the nail's damping.
  const double h = std::min(0.04 * std::sqrt(mass_kg / law.face_stiffness_n_m), 1e-3);
  double x = 0.0;  // of the face past the head's first height
  double v = speed_m_s;
  double nail = 0.0;
  double t = 0.0;
  while (t < longest_s) {
    x += 0.5 * h * v;
    const double depth = x - nail;
    double force = 0.0;
    double u = 0.0;
    if (depth > 0.0) {
      const double elastic = law.face_stiffness_n_m * depth;
      force = std::max(0.0, elastic * (1.0 + law.face_damping_s_m * v));
      const double resistance = law.nail_resistance_n + law.nail_resistance_slope_n_m * nail;
      if (force > resistance && nail < law.nail_room_m) {
        const double share = elastic * law.face_damping_s_m / law.nail_damping_n_s_m;
        force = (elastic * (1.0 + law.face_damping_s_m * v) + share * resistance) / (1.0 + share);
        // Semi-implicit: the nail's own speed unloads the rubber within the step.
        u = std::max(0.0, force - resistance) / (law.nail_damping_n_s_m + h * law.face_stiffness_n_m);
      }
    }
    v -= h * (force - push_n) / mass_kg;
    x += 0.5 * h * v;
    nail = std::min(nail + h * u, law.nail_room_m);
    t += h;
    blow.impulse_n_s += h * force;
    blow.peak_force_n = std::max(blow.peak_force_n, force);
    if (x <= nail) break;
  }
  blow.contact_s = t;
  blow.penetration_m = nail;
  blow.speed_after_m_s = v;
  return blow;
}

Prediction finite_time_blow(const StrikeArm& arm, const PredictInput& in, bool corrected) noexcept {
  const Chain& chain = arm.chain;
  const int n = chain.dof();
  Prediction out;
  out.delta_qd = out.axis_impulse_nm_s = out.blow_impulse_nm_s = out.carried_before_nm = out.peak_torque_nm =
      JointVector::Zero(n);
  const ChainPose pose = chain.pose(in.q);
  const Jacobian J = chain.jacobian(pose);
  const JointVector lever = J.topRows<3>().transpose().lazyProduct(in.normal);
  const JointMatrix M = chain.mass_matrix(pose);
  const JointMatrix B = chain.reflected_inertia(pose, in.rotor_model);
  const JointVector h = chain.inverse_dynamics(pose, in.qd, JointVector::Zero(n));
  const double speed = -lever.dot(in.qd);

  // What acts on passive joints besides the blow, and how they accelerate as it begins.
  JointVector limp = JointVector::Zero(n);
  JointVector accel = JointVector::Zero(n);
  for (int i = 0; i < n; ++i) {
    if (in.joints[at(i)] != JointHold::free) continue;
    const JointDrive& d = arm.drive[at(i)];
    limp[i] = -h[i] - friction_torque_nm(d.friction, in.qd[i]) + d.compensation_nm * sign(in.qd[i]);
  }

  double T = std::isnan(in.contact_s) ? in.reference.stop_s : in.contact_s;
  LumpedBlow blow;
  JointMatrix H;
  JointVector push, x;
  for (int round = 0; round < kRounds; ++round) {
    // Joints that are held have left the equations: ones on the diagonal, nothing to the right.
    const double slowed = corrected ? reference_speed(in.reference, T) - 1.0 : 0.0;
    H = M + B;
    push = JointVector::Zero(n);
    const JointVector following = M * in.qd * slowed;
    for (int i = 0; i < n; ++i) {
      const JointDrive& d = arm.drive[at(i)];
      if (in.joints[at(i)] == JointHold::free) {
        if (corrected) push[i] = limp[i] * T;
        continue;
      }
      const double extra =
          controlled_extra_inertia(d.position_gain_nm_rad, d.velocity_gain_nm_s_rad, T, PulseShape::half_sine);
      H(i, i) += extra;
      if (!corrected) continue;
      const CompensatorDescription& c = d.compensator;
      // What the law carries or adds before it yields: the departure from the model's torque, and the bounded terms.
      double carried = std::min(d.carried_departure_nm, d.torque_limit_nm[lever[i] > 0.0 ? 1 : 0]);
      if (c.enabled) carried += c.position_gain_nm + c.robust_gain[1];
      push[i] = following[i] + (B(i, i) + extra) * in.qd[i] * slowed - sign(lever[i]) * carried * T;
    }
    for (int i = 0; i < n; ++i) {
      if (in.joints[at(i)] != JointHold::held) continue;
      H.row(i).setZero();
      H.col(i).setZero();
      H(i, i) = 1.0;
      push[i] = 0.0;
    }
    JointVector yielding = lever;
    for (int i = 0; i < n; ++i) {
      if (in.joints[at(i)] == JointHold::held) yielding[i] = 0.0;
    }
    const Eigen::PartialPivLU<JointMatrix> solver(H);
    x = solver.solve(yielding);
    JointVector drift = solver.solve(push);
    const double mobility = lever.dot(x);
    if (!(mobility > 1e-9) && std::isnan(in.restitution)) return out;
    out.effective_mass_kg = 1.0 / mobility;
    if (!(speed > 0.0)) {
      out.feasible = std::isfinite(mobility);
      return out;
    }
    if (std::isnan(in.restitution)) {
      blow = lumped_blow(in.contact, out.effective_mass_kg, speed, -lever.dot(drift) / (mobility * T), kLongest_s);
      if (std::isnan(in.contact_s)) T = std::clamp(blow.contact_s, 1e-4, kLongest_s);
    } else {
      const double compliance = mobility + 1.0 / in.nail_mass_kg;
      if (!(compliance > 1e-9)) return out;
      blow.impulse_n_s = std::max(0.0, ((1.0 + in.restitution) * speed - lever.dot(drift)) / compliance);
      blow.contact_s = T;
      blow.peak_force_n = kHalfSinePeak * blow.impulse_n_s / T;
    }
    out.delta_qd = blow.impulse_n_s * x + drift;
  }
  const double P = blow.impulse_n_s;
  if (!std::isfinite(P) || !out.delta_qd.allFinite()) {
    out.delta_qd.setZero();
    return out;
  }
  out.feasible = out.approaching = true;
  out.impulse_n_s = P;
  out.contact_s = blow.contact_s;
  out.peak_force_n = blow.peak_force_n;
  out.penetration_m = blow.penetration_m;
  out.speed_before_m_s = speed;
  out.speed_after_m_s = speed - lever.dot(out.delta_qd);

  if (corrected) {
    // Passive joints fall before the blow too; what they carry then is not the blow's.
    JointMatrix H0 = M + B;
    JointVector right = limp;
    for (int i = 0; i < n; ++i) {
      if (in.joints[at(i)] == JointHold::free) continue;
      H0.row(i).setZero();
      H0(i, i) = 1.0;
      right[i] = 0.0;
    }
    accel = H0.partialPivLu().solve(right);
  }
  out.carried_before_nm = -(M * accel + h);
  Vector6 external = Vector6::Zero();
  external.head<3>() = P * in.normal;
  const InternalImpulses internal = internal_impulses(chain, pose, out.delta_qd, external, in.formulation);
  out.wrench = internal.wrench;
  out.blow_impulse_nm_s = internal.axis_nm_s;
  out.axis_impulse_nm_s = internal.axis_nm_s - T * chain.gravity(pose);
  for (int i = 0; i < n; ++i) {
    const double before = out.carried_before_nm[i];
    const double peak = before + kHalfSinePeak * (out.axis_impulse_nm_s[i] / T - before);
    out.peak_torque_nm[i] = std::max(std::abs(before), std::abs(peak));
  }
  return out;
}

}  // namespace mrr::sup
