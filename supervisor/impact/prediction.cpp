#include "supervisor/impact/prediction.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>

#include "supervisor/impact/finite_time.h"
#include "supervisor/impact/resolved.h"

namespace mrr::sup {
namespace {

constexpr double kUnitTolerance = 1e-6;
constexpr double kReturnShare = 0.4;  // of the limits, as the supervisor goes back

std::size_t at(int i) noexcept { return static_cast<std::size_t>(i); }

/// Whether `x` is a number within [low, high] (which may be infinite).
bool within(double x, double low, double high) noexcept { return x >= low && x <= high; }

bool finite(const std::array<double, 4>& v) noexcept {
  return std::all_of(v.begin(), v.end(), [](double x) { return std::isfinite(x) && x >= 0.0; });
}

/// What is wrong, in terms a sentence can be made of; null: nothing. Allocates nothing.
struct Complaint {
  const char* field = nullptr;
  double value = 0.0;
  const char* allowed = nullptr;
  int joint = -1;
};

Complaint first_complaint(const StrikeArm& arm, const PredictInput& in, PredictionModel model) noexcept {
  constexpr double kInf = std::numeric_limits<double>::infinity();
  const int n = arm.chain.dof();
  const auto size = [](const JointVector& v) { return static_cast<double>(v.size()); };
  if (in.q.size() != n) return {"q", size(in.q), "needs one entry, rad, per joint of the arm"};
  if (in.qd.size() != n) return {"qd", size(in.qd), "needs one entry, rad/s, per joint of the arm"};
  for (int i = 0; i < n; ++i) {
    if (!std::isfinite(in.q[i])) return {"q", in.q[i], "rad must be finite", i};
    if (!(std::abs(in.qd[i]) <= 1e3)) return {"qd", in.qd[i], "rad/s must lie within +-1000", i};
  }
  const double length = in.normal.norm();
  if (!(std::abs(length - 1.0) <= kUnitTolerance)) return {"normal", length, "long must have length 1"};
  const ContactLaw& law = in.contact;
  if (!within(law.face_stiffness_n_m, 1.0, 1e7))
    return {"contact.face_stiffness_n_m", law.face_stiffness_n_m, "N/m must lie between 1 and 1e7"};
  if (!within(law.face_damping_s_m, 0.0, 1e3))
    return {"contact.face_damping_s_m", law.face_damping_s_m, "s/m must lie between 0 and 1000"};
  if (!within(law.nail_resistance_n, 0.0, kInf))
    return {"contact.nail_resistance_n", law.nail_resistance_n, "N must be 0 or more; infinite is a nail that stands"};
  if (!within(law.nail_resistance_slope_n_m, 0.0, 1e9))
    return {"contact.nail_resistance_slope_n_m", law.nail_resistance_slope_n_m, "N/m must lie between 0 and 1e9"};
  if (!within(law.nail_damping_n_s_m, 1e-3, 1e9))
    return {"contact.nail_damping_n_s_m", law.nail_damping_n_s_m, "N s/m must lie between 1e-3 and 1e9"};
  if (!within(law.nail_room_m, 0.0, kInf)) return {"contact.nail_room_m", law.nail_room_m, "m must be 0 or more"};
  // NaN means: from the contact law.
  if (!std::isnan(in.restitution) && !within(in.restitution, 0.0, 1.0))
    return {"restitution", in.restitution, "must lie between 0 and 1"};
  if (!(in.nail_mass_kg > 0.0))
    return {"nail_mass_kg", in.nail_mass_kg, "kg must be above 0; infinite is a rigid board"};
  if (!std::isnan(in.contact_s) && !within(in.contact_s, 1e-4, 1.0))
    return {"contact_s", in.contact_s, "s must lie between 1e-4 and 1"};
  for (int i = 0; i < n; ++i) {
    const JointDrive& d = arm.drive[at(i)];
    if (!within(d.position_gain_nm_rad, 0.0, 1e6))
      return {"position_gain_nm_rad", d.position_gain_nm_rad, "Nm/rad must lie between 0 and 1e6", i};
    if (!within(d.velocity_gain_nm_s_rad, 0.0, 1e5))
      return {"velocity_gain_nm_s_rad", d.velocity_gain_nm_s_rad, "Nm s/rad must lie between 0 and 1e5", i};
    const FrictionDescription& f = d.friction;
    if (!(within(f.coulomb_nm, 0.0, 1e4) && within(f.static_nm, f.coulomb_nm, 1e4) &&
          within(f.viscous_nm_s_rad, 0.0, 1e5) && within(f.stribeck_decay_s2_rad2, 0.0, 1e9)))
      return {"friction.static_nm", f.static_nm, "Nm: friction must be finite, 0 <= Coulomb <= static", i};
  }
  if (model == PredictionModel::instant) return {};
  if (!within(in.switch_lead_s, 0.0, 0.5)) return {"switch_lead_s", in.switch_lead_s, "s must lie between 0 and 0.5"};
  if (!within(in.passive_s, 1e-3, 10.0)) return {"passive_s", in.passive_s, "s must lie between 0.001 and 10"};
  static_assert(kMostRobots == 32);
  if (!(in.robots >= 1 && in.robots <= kMostRobots))
    return {"robots", static_cast<double>(in.robots), "must lie between 1 and 32"};
  if (!within(in.early_m, -0.05, 0.05)) return {"early_m", in.early_m, "m must lie within +-0.05"};
  const ReferenceProfile& r = in.reference;
  if (!within(r.travel_s, 1e-3, 100.0)) return {"reference.travel_s", r.travel_s, "s must lie between 0.001 and 100"};
  if (!within(r.approach_s, 1e-3, 100.0))
    return {"reference.approach_s", r.approach_s, "s must lie between 0.001 and 100"};
  if (!within(r.stop_s, 1e-3, 10.0)) return {"reference.stop_s", r.stop_s, "s must lie between 0.001 and 10"};
  if (!within(r.return_s, 1e-2, 100.0)) return {"reference.return_s", r.return_s, "s must lie between 0.01 and 100"};
  for (int i = 0; i < n; ++i) {
    const JointDrive& d = arm.drive[at(i)];
    if (!within(d.rotor_inertia_kg_m2, 1e-6, 1e4))
      return {"rotor_inertia_kg_m2", d.rotor_inertia_kg_m2,
              "kg m^2 must lie between 1e-6 and 1e4 to resolve a blow in time", i};
    if (!(d.carried_departure_nm >= 0.0))
      return {"carried_departure_nm", d.carried_departure_nm, "Nm must be 0 or more", i};
    const auto& k = d.stiffness_nm_rad;
    if (!(within(k[0], 1.0, 1e7) && within(k[1], 1.0, 1e7) && within(k[2], 1.0, 1e7) &&
          within(d.stiffness_break_nm[0], 0.0, d.stiffness_break_nm[1]) && std::isfinite(d.stiffness_break_nm[1])))
      return {"stiffness_nm_rad", k[0], "Nm/rad: stiffnesses must lie between 1 and 1e7, their breaks in order", i};
    if (!(d.torque_limit_nm[0] > 0.0 && d.torque_limit_nm[1] > 0.0))
      return {"torque_limit_nm", d.torque_limit_nm[0], "Nm must be above 0 either way", i};
    if (!(d.presliding_rad > 1e-6 && d.blend_s > 0.0 && d.still_velocity_rad_s > 0.0 && d.damping_nm_s_rad >= 0.0 &&
          d.sensed_trend_nm > 0.0 && d.stop_deceleration_rad_s2 > 0.0 && d.return_speed_rad_s > 0.0 &&
          d.return_acceleration_rad_s2 > 0.0 && d.current_bandwidth_hz > 0.0 && d.sensor_bandwidth_hz > 0.0))
      return {"presliding_rad", d.presliding_rad, "rad and the other times and rates of a drive must be above 0", i};
    const CompensatorDescription& c = d.compensator;
    if (!(finite(c.integral_gain) && finite(c.integral_limit) && finite(c.robust_gain) && finite(c.robust_width) &&
          std::isfinite(c.position_gain_nm) && std::isfinite(d.lambda_1_s)))
      return {"compensator", c.position_gain_nm, "must be finite", i};
  }
  return {};
}

}  // namespace

ReferenceProfile::Point ReferenceProfile::at(double t) const noexcept {
  if (t < 0.0) {
    const double T = approach_s;
    if (t <= -T) return {-travel_s, 0.0, 0.0};
    const double x = 1.0 + t / T;
    const double L = travel_s / T;  // quintic from (-L, 0, 0) to (0, 1, 0), in units of T
    const double c3 = 10.0 * L - 4.0;
    const double c4 = -15.0 * L + 7.0;
    const double c5 = 6.0 * L - 3.0;
    return {T * (-L + x * x * x * (c3 + x * (c4 + x * c5))), x * x * (3.0 * c3 + x * (4.0 * c4 + x * 5.0 * c5)),
            x * (6.0 * c3 + x * (12.0 * c4 + x * 20.0 * c5)) / T};
  }
  if (t < stop_s) {
    const double x = t / stop_s;
    return {stop_s * x * (1.0 - x * x * (1.0 - 0.5 * x)), 1.0 - x * x * (3.0 - 2.0 * x), -6.0 * x * (1.0 - x) / stop_s};
  }
  const double way = -travel_s - 0.5 * stop_s;
  const double x = std::min((t - stop_s) / return_s, 1.0);
  const double u = 1.0 - x;
  return {0.5 * stop_s + way * x * x * x * (10.0 - x * (15.0 - 6.0 * x)), 30.0 * way * x * x * u * u / return_s,
          60.0 * way * x * u * (1.0 - 2.0 * x) / (return_s * return_s)};
}

const char* describe(PredictionModel model) noexcept {
  switch (model) {
    case PredictionModel::instant:
      return "instant";
    case PredictionModel::finite_time:
      return "finite time";
    case PredictionModel::resolved:
      return "resolved";
  }
  return "?";
}

StrikeArm::StrikeArm(const RobotDescription& robot)
    : chain(robot),
      tick_s(1.0 / robot.bus.loop_rate_hz),
      knot_s(1.0 / robot.bus.knot_rate_hz),
      lead_s(robot.task.switch_lead_s),
      face_radius_m(robot.hammer.face_radius_m) {
  for (std::size_t i = 0; i < robot.joints.size(); ++i) {
    const JointDescription& j = robot.joints[i];
    JointDrive& d = drive[i];
    d.rotor_inertia_kg_m2 = j.reflected_inertia_kg_m2();
    d.position_gain_nm_rad = j.control.position_gain_nm_rad;
    d.velocity_gain_nm_s_rad = j.control.velocity_gain_nm_s_rad;
    d.lambda_1_s = j.control.lambda_1_s;
    d.carried_departure_nm = j.control.carried_departure_nm;
    d.friction_feedforward = j.control.friction_feedforward;
    const double gear = j.transmission.gear_ratio;
    if (j.sensors.encoder_counts_per_turn > 0 && gear > 0.0) {
      // The encoder tells motion from rest above two and a half counts per tick.
      const double count_rad = 2.0 * std::numbers::pi / (j.sensors.encoder_counts_per_turn * gear);
      d.still_velocity_rad_s = std::max(2.5 * count_rad / tick_s, 5e-3);
    }
    if (j.control.friction_by_reference) d.still_velocity_rad_s = 20.0;
    d.compensator = j.control.compensator;
    d.friction = j.friction;
    d.compensation_nm = std::min(j.control.passive_compensation * j.friction.static_nm, 0.89 * j.friction.coulomb_nm);
    if (j.friction.coulomb_nm > 0.0) {
      d.static_compensation_nm = d.compensation_nm * j.friction.static_nm / j.friction.coulomb_nm;
    }
    d.sensed_dead_band_nm = std::max(1.0, 6.0 * j.sensors.torque_noise_nm + 0.5);
    d.sensed_trend_nm = 1.5 * d.sensed_dead_band_nm;
    d.blend_s = j.control.passive_blend_s;
    d.resume_slew_nm_s = j.control.resume_torque_slew_nm_s;
    d.stop_deceleration_rad_s2 = j.stop_deceleration_rad_s2();
    const double vmax =
        gear > 0.0 ? std::min(j.limits.velocity_rad_s, j.motor.max_velocity_rad_s / gear) : j.limits.velocity_rad_s;
    d.return_speed_rad_s = kReturnShare * vmax;
    d.return_acceleration_rad_s2 = kReturnShare * j.limits.acceleration_rad_s2;
    const double peak = gear * j.motor.peak_current_a;
    d.torque_limit_nm = {std::min(j.limits.torque_nm, peak * j.motor.torque_constant_positive_nm_a),
                         std::min(j.limits.torque_nm, peak * j.motor.torque_constant_negative_nm_a)};
    d.stiffness_nm_rad = j.transmission.stiffness_nm_rad;
    d.stiffness_break_nm = j.transmission.stiffness_break_nm;
    d.torque_sensor = j.sensors.torque_sensor;
    if (j.sensors.torque_bandwidth_hz > 0.0) d.sensor_bandwidth_hz = j.sensors.torque_bandwidth_hz;
  }
}

std::string validate_input(const StrikeArm& arm, const PredictInput& input, PredictionModel model) {
  const Complaint c = first_complaint(arm, input, model);
  if (c.field == nullptr) return {};
  if (c.joint >= 0)
    return fmt::format("prediction: {} of joint {} is {:g}: {}", c.field, c.joint + 1, c.value, c.allowed);
  return fmt::format("prediction: {} is {:g}: {}", c.field, c.value, c.allowed);
}

Prediction predict(const StrikeArm& arm, const PredictInput& input, PredictionModel model) noexcept {
  Prediction out;
  if (first_complaint(arm, input, model).field != nullptr) {
    out.delta_qd = out.axis_impulse_nm_s = out.blow_impulse_nm_s = out.carried_before_nm = out.peak_torque_nm =
        JointVector::Zero(arm.chain.dof());
  } else if (model == PredictionModel::resolved) {
    return resolve_blow(arm, input);
  } else {
    out = model == PredictionModel::finite_time ? finite_time_blow(arm, input) : instant_blow(arm, input);
  }
  out.as_one_robot();
  return out;
}

}  // namespace mrr::sup
