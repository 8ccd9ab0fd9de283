#include "supervisor/impact/finite_time.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "supervisor/impact/internal.h"
#include "supervisor/impact/swing_policy.h"

namespace mrr::sup {
namespace {

constexpr double kLeastMobility = 1e-9;                   // 1/kg: below it nothing yields
constexpr double kHalfSinePeak = 0.5 * std::numbers::pi;  // peak over mean
constexpr double kLongest_s = 0.4;
constexpr int kRounds = 3;  // the contact's length depends on the mass, the mass on the length
// The supervisor's rule for an arm that sinks with the nail.
constexpr double kStep_s = 1e-3;       // of the finite-time model
constexpr double kStill_rad_s = 0.01;  // Coulomb friction fades in below

std::size_t at(int i) noexcept { return static_cast<std::size_t>(i); }

/// Twist of a transmission under a torque, rad: only for the sag before contact, so the softest piece will do.
double sag_rad(const JointDrive& d, double torque) noexcept {
  return d.stiffness_nm_rad[0] > 0.0 ? torque / d.stiffness_nm_rad[0] : 0.0;
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

Prediction instant_blow(const StrikeArm& arm, const PredictInput& in) noexcept {
  const Chain& chain = arm.chain;
  const int n = chain.dof();
  Prediction out;
  out.delta_qd = out.axis_impulse_nm_s = out.blow_impulse_nm_s = out.carried_before_nm = out.peak_torque_nm =
      JointVector::Zero(n);
  const ChainPose pose = chain.pose(in.q);
  const Jacobian J = chain.jacobian(pose);
  const JointVector lever = J.topRows<3>().transpose().lazyProduct(in.normal);
  const JointMatrix inertia = chain.mass_matrix(pose) + chain.reflected_inertia(pose, in.rotor_model);
  const double speed = -lever.dot(in.qd);

  double T = std::isnan(in.contact_s) ? in.reference.stop_s : in.contact_s;
  LumpedBlow blow;
  JointVector x;
  for (int round = 0; round < (std::isnan(in.contact_s) ? kRounds : 1); ++round) {
    // Joints that are held leave the equations: ones on the diagonal, nothing to the right.
    JointMatrix H = inertia;
    JointVector yielding = lever;
    for (int i = 0; i < n; ++i) {
      const JointDrive& d = arm.drive[at(i)];
      if (in.joints[at(i)] == JointHold::controlled) {
        H(i, i) += controlled_extra_inertia(d.position_gain_nm_rad, d.velocity_gain_nm_s_rad, T, PulseShape::half_sine);
      } else if (in.joints[at(i)] == JointHold::held) {
        H.row(i).setZero();
        H.col(i).setZero();
        H(i, i) = 1.0;
        yielding[i] = 0.0;
      }
    }
    x = H.partialPivLu().solve(yielding);
    const double mobility = lever.dot(x);
    if (!std::isfinite(mobility)) return out;
    out.effective_mass_kg = mobility > kLeastMobility ? 1.0 / mobility : std::numeric_limits<double>::infinity();
    if (!(speed > 0.0)) {
      out.feasible = true;
      return out;
    }
    if (std::isnan(in.restitution)) {
      if (!(mobility > kLeastMobility)) return out;
      blow = lumped_blow(in.contact, out.effective_mass_kg, speed, 0.0, kLongest_s);
      if (std::isnan(in.contact_s)) T = std::clamp(blow.contact_s, 1e-4, kLongest_s);
    } else {
      const double compliance = mobility + 1.0 / in.nail_mass_kg;
      if (!(compliance > kLeastMobility)) return out;
      blow.impulse_n_s = (1.0 + in.restitution) * speed / compliance;
      blow.contact_s = T;
      blow.peak_force_n = kHalfSinePeak * blow.impulse_n_s / T;
    }
  }
  const double P = blow.impulse_n_s;
  out.delta_qd = P * x;
  out.feasible = out.approaching = std::isfinite(P) && out.delta_qd.allFinite();
  if (!out.feasible) {
    out.delta_qd.setZero();
    return out;
  }
  out.impulse_n_s = P;
  out.contact_s = blow.contact_s;
  out.peak_force_n = blow.peak_force_n;
  out.penetration_m = blow.penetration_m;
  out.speed_before_m_s = speed;
  out.speed_after_m_s = speed - lever.dot(out.delta_qd);
  const JointVector weight = chain.gravity(pose);
  out.carried_before_nm = -weight;
  Vector6 external = Vector6::Zero();
  external.head<3>() = P * in.normal;
  out.blow_impulse_nm_s = internal_impulses(chain, pose, out.delta_qd, external, in.formulation, out.wrench);
  out.axis_impulse_nm_s = out.blow_impulse_nm_s - T * weight;
  for (int i = 0; i < n; ++i) {
    const double peak = kHalfSinePeak * out.blow_impulse_nm_s[i] / T - weight[i];
    out.peak_torque_nm[i] = std::max(std::abs(weight[i]), std::abs(peak));
  }
  return out;
}

Prediction finite_time_blow(const StrikeArm& arm, const PredictInput& in) noexcept {
  const Chain& chain = arm.chain;
  const int n = chain.dof();
  Prediction out;
  out.delta_qd = out.axis_impulse_nm_s = out.blow_impulse_nm_s = out.carried_before_nm = out.peak_torque_nm =
      JointVector::Zero(n);
  const ChainPose pose = chain.pose(in.q);
  const JointVector lever = chain.jacobian(pose).topRows<3>().transpose().lazyProduct(in.normal);
  const JointMatrix M = chain.mass_matrix(pose);
  const JointMatrix inertia = M + chain.reflected_inertia(pose, in.rotor_model);
  const JointVector weight = chain.gravity(pose);
  const double planned_speed = -lever.dot(in.qd);

  // (M + B) q'' + K_D e' + K_P e = ..., implicit in speed and position: one inverse for all steps.
  JointMatrix A = inertia;
  std::array<bool, kMaxJoints> held{};
  for (int i = 0; i < n; ++i) {
    const JointDrive& d = arm.drive[at(i)];
    held[at(i)] = in.joints[at(i)] == JointHold::held;
    if (in.joints[at(i)] == JointHold::controlled) {
      A(i, i) += kStep_s * (d.velocity_gain_nm_s_rad + kStep_s * d.position_gain_nm_rad);
    } else if (in.joints[at(i)] == JointHold::free) {
      A(i, i) += kStep_s * d.friction.viscous_nm_s_rad;
    }
  }
  for (int i = 0; i < n; ++i) {
    if (!held[at(i)]) continue;
    A.row(i).setZero();
    A.col(i).setZero();
    A(i, i) = 1.0;
  }
  JointMatrix step = A.partialPivLu().inverse();
  const JointVector M_line = M * in.qd;  // what the links ask for per unit of s''
  if (!step.allFinite()) return out;
  const double mobility = lever.dot(inertia.partialPivLu().solve(lever));
  out.effective_mass_kg = mobility > kLeastMobility ? 1.0 / mobility : std::numeric_limits<double>::infinity();
  if (!(planned_speed > 0.0)) {
    out.feasible = std::isfinite(mobility);
    return out;
  }

  // The face hangs lower than its reference by what the transmissions give under the weight: it touches early.
  double sag_m = in.early_m;
  for (int i = 0; i < n; ++i) sag_m += lever[i] * sag_rad(arm.drive[at(i)], weight[i]);
  const double sag = std::clamp(sag_m - 2.0 * in.early_m, -0.01, 0.01);
  const double run_in = in.switch_lead_s;
  double t = -run_in - std::max(sag, 0.0) / planned_speed;
  t = std::max(t, -0.1);

  JointVector q = in.qd * t;  // from the planned pose
  JointVector v = in.qd;
  JointVector excess = JointVector::Zero(n);  // of the carried torque over the model's
  JointVector carried = weight;
  JointVector push(n);
  // Rigid transmissions know no overshoot: what they carry is seen through each joint's spring as one mode of its own,
  // the link on the motor: held by its loop where the joint is active, by its inertia where it is passive.
  std::array<double, kMaxJoints> seen{}, seen_rate{}, frequency2{}, fade_1_s{};
  const JointMatrix link_mobility = M.partialPivLu().inverse();
  for (int i = 0; i < n; ++i) {
    const JointDrive& d = arm.drive[at(i)];
    const double motor_yields = in.joints[at(i)] == JointHold::free ? 1.0 / d.rotor_inertia_kg_m2 : 0.0;
    const double yields = link_mobility(i, i) + motor_yields;
    frequency2[at(i)] = d.stiffness_nm_rad[0] * yields;
    fade_1_s[at(i)] = d.damping_nm_s_rad * yields;
    seen[at(i)] = weight[i];
  }
  std::array<double, kMaxJoints> sum{}, peak{};
  double nail = 0.0;  // driven in this blow
  double low_since = std::numeric_limits<double>::infinity();
  bool touched = false;
  double began = 0.0;
  JointVector begin_v = v;
  Prediction kept = out;
  const auto keep = [&](double now) {
    kept = out;
    kept.contact_s = now - began;
    kept.penetration_m = nail;
    kept.delta_qd = v - begin_v;
    kept.speed_after_m_s = -lever.dot(v);
    for (int i = 0; i < n; ++i) {
      kept.axis_impulse_nm_s[i] = -sum[at(i)];
      kept.peak_torque_nm[i] = peak[at(i)];
    }
  };
  // Passive joints are called back when their time is up, or when the arm sinks with the nail and needs the rest of the
  // way to stop: from then on they brake and hold.
  bool called_back = false;
  double call_back_s = in.passive_s - in.switch_lead_s;
  double deceleration = std::numeric_limits<double>::infinity();
  for (int i = 0; i < n; ++i) {
    if (in.joints[at(i)] != JointHold::free || std::abs(lever[i]) < kLeastLever_m) continue;
    deceleration = std::min(deceleration, std::abs(lever[i]) * arm.drive[at(i)].stop_deceleration_rad_s2);
  }
  bool over = false;
  for (; t < kLongest_s && !over; t += kStep_s) {
    // Just before contact as at contact.
    const ReferenceProfile::Point s = t < 0.0 ? ReferenceProfile::Point{t, 1.0, 0.0} : in.reference.at(t);
    const bool let_go = t >= -in.switch_lead_s;
    // Contact, in smaller steps of the nail alone: it has no mass.
    const double height = lever.dot(q) - sag;
    const double speed = -lever.dot(v);
    const double depth = -height - nail;
    if (!called_back && -height >= kRubberGives_m && speed > arm.sinking_share * planned_speed &&
        -height + speed * (1.5 * arm.knot_s + 0.5 * speed / deceleration) >= in.contact.nail_room_m) {
      call_back_s = std::min(call_back_s, t + arm.knot_s);
    }
    if (!called_back && t >= call_back_s) {
      called_back = true;
      for (int i = 0; i < n; ++i) {
        if (in.joints[at(i)] != JointHold::free) continue;
        A(i, i) += kStep_s * (arm.drive[at(i)].velocity_gain_nm_s_rad - arm.drive[at(i)].friction.viscous_nm_s_rad);
      }
      step = A.partialPivLu().inverse();
    }
    double force = 0.0;
    if (depth > 0.0) {
      const ContactLaw& law = in.contact;
      const double elastic = law.face_stiffness_n_m * depth;
      force = std::max(0.0, elastic * (1.0 + law.face_damping_s_m * speed));
      const double resistance = law.nail_resistance_n + law.nail_resistance_slope_n_m * nail;
      if (force > resistance && nail < law.nail_room_m) {
        const double share = elastic * law.face_damping_s_m / law.nail_damping_n_s_m;
        force = (elastic * (1.0 + law.face_damping_s_m * speed) + share * resistance) / (1.0 + share);
        const double u =
            std::max(0.0, force - resistance) / (law.nail_damping_n_s_m + kStep_s * law.face_stiffness_n_m);
        nail = std::min(nail + kStep_s * u, law.nail_room_m);
      }
    }
    for (int i = 0; i < n; ++i) {
      const JointDrive& d = arm.drive[at(i)];
      if (held[at(i)]) {
        push[i] = 0.0;
        continue;
      }
      double torque = 0.0;
      if (in.joints[at(i)] == JointHold::free && called_back) {
        torque = std::clamp(weight[i] - d.velocity_gain_nm_s_rad * v[i], -d.torque_limit_nm[1], d.torque_limit_nm[0]);
      } else if (in.joints[at(i)] == JointHold::free && let_go) {
        // What friction is left, fading in with the speed.
        const double left = d.friction.coulomb_nm - d.compensation_nm;
        torque = -left * std::clamp(v[i] / kStill_rad_s, -1.0, 1.0) - d.friction.viscous_nm_s_rad * v[i];
      } else {
        const double e = q[i] - in.qd[i] * s.s;
        const double e_v = v[i] - in.qd[i] * s.v;
        const double r = e_v + d.lambda_1_s * e;
        const CompensatorDescription& c = d.compensator;
        torque = weight[i] + s.a * (M_line[i] + d.rotor_inertia_kg_m2 * in.qd[i]) - d.velocity_gain_nm_s_rad * e_v -
                 d.position_gain_nm_rad * (e + kStep_s * e_v) +
                 std::clamp(excess[i], -d.carried_departure_nm, d.carried_departure_nm);
        if (c.enabled) {
          if (c.position_width_rad_s > 0.0) {
            torque -= c.position_gain_nm * std::clamp(r / c.position_width_rad_s, -1.0, 1.0);
          }
          if (c.robust_width[1] > 0.0) torque -= c.robust_gain[1] * std::clamp(r / c.robust_width[1], -1.0, 1.0);
        }
        torque = std::clamp(torque, -d.torque_limit_nm[1], d.torque_limit_nm[0]);
      }
      push[i] = torque - weight[i] + lever[i] * force;
    }
    const JointVector accel = step * push;
    carried.noalias() = M.lazyProduct(accel) + weight;
    carried -= lever * force;
    for (int i = 0; i < n; ++i) excess[i] = carried[i] - weight[i] - s.a * M_line[i];
    for (int i = 0; i < n; ++i) {
      // Implicit: any stiffness will do.
      const auto k = at(i);
      seen_rate[k] = (seen_rate[k] + kStep_s * frequency2[k] * (carried[i] - seen[k])) /
                     (1.0 + kStep_s * (fade_1_s[k] + kStep_s * frequency2[k]));
      seen[k] += kStep_s * seen_rate[k];
    }
    if (!touched && force > 0.0) {
      touched = true;
      began = t;
      begin_v = v;
      out.start_s = t;
      out.speed_before_m_s = speed;
      out.carried_before_nm = -carried;
    }
    v += kStep_s * accel;
    q += kStep_s * v;
    for (int i = 0; i < n; ++i) {
      if (held[at(i)]) {
        v[i] = in.qd[i] * s.v;
        q[i] = in.qd[i] * s.s;
      }
    }
    if (!touched) continue;
    out.impulse_n_s += kStep_s * force;
    out.peak_force_n = std::max(out.peak_force_n, force);
    for (int i = 0; i < n; ++i) {
      sum[at(i)] += kStep_s * carried[i];
      peak[at(i)] = std::max(peak[at(i)], std::abs(seen[at(i)]));
    }
    if (!(force < kBlowOverShare * out.peak_force_n)) {
      low_since = std::numeric_limits<double>::infinity();
    } else if (low_since > t) {
      low_since = t;
      keep(t + kStep_s);
    } else {
      over = t - low_since > kBlowOver_s;
    }
  }
  if (touched && !over) keep(t);
  const double mass = out.effective_mass_kg;
  out = kept;
  out.effective_mass_kg = mass;
  out.feasible = v.allFinite() && std::isfinite(out.impulse_n_s);
  out.approaching = touched;
  if (!out.feasible || !touched) return out;
  out.blow_impulse_nm_s = out.axis_impulse_nm_s + out.contact_s * weight;
  Vector6 external = Vector6::Zero();
  external.head<3>() = out.impulse_n_s * in.normal;
  internal_impulses(chain, pose, out.delta_qd, external, Formulation::corrected, out.wrench);
  return out;
}

}  // namespace mrr::sup
