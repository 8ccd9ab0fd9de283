#include "supervisor/strike/estimate.h"

#include <algorithm>
#include <cmath>

#include "supervisor/impact/external.h"

namespace mrr::sup {

namespace {
constexpr double kLeastNoise_n = 1.0;  // of one force: what was quiet before a blow need not be so in it
constexpr double kSeenEnd_m = 1e-3;    // how well the observer alone knows where contact ended, one standard deviation
constexpr double kLeastSd_m = 2e-4;    // of a height: torsion, encoders and the face's tilt are not in the fit
constexpr double kLeastRubberShare = 0.03;  // it is never known better than this: one face is not the next blow's
constexpr double kLeastDampingSd_s_m = 0.1;
}  // namespace

StrikeEstimator::StrikeEstimator(double assumed_contact_s, const StrikeEstimateConfig& config) noexcept
    : config_(config), contact_s_(std::clamp(assumed_contact_s, config.min_contact_s, config.max_contact_s)) {}

SeenBlow StrikeEstimator::look(const StrikePlan& plan, const ContactReport& report) noexcept {
  SeenBlow seen{report, {plan.normal.dot(report.face_end_m), kSeenEnd_m}};
  const HeadFit fit = fit_head({report.leaving.begin(), report.leaving.end()},
                               std::max(report.force_noise_n, kLeastNoise_n), rubber_, seen.head.m);
  if (!fit.usable || !(fit.height_sd_m < kSeenEnd_m)) return seen;
  rubber_ = fit.rubber;
  rubber_.stiffness_share = std::max(rubber_.stiffness_share, kLeastRubberShare);
  rubber_.damping_sd_s_m = std::max(rubber_.damping_sd_s_m, kLeastDampingSd_s_m);
  seen.head = {fit.height_m, std::max(fit.height_sd_m, kLeastSd_m)};

  // The blow ends where the face has left for good, or for longer than a jitter; a second touch is not the blow.
  ContactReport& contact = seen.contact;
  contact.face_end_m += (fit.height_m - plan.normal.dot(contact.face_end_m)) * plan.normal;
  contact.penetration_m = plan.normal.dot(contact.face_start_m - contact.face_end_m);
  std::size_t off = 1;
  const auto above = [&](std::size_t k) { return report.leaving[k].height_m > fit.height_m; };
  while (off + 1 < report.leaving.size() && !(above(off) && above(off + 1))) ++off;
  if (off + 1 >= report.leaving.size()) return seen;  // it did not leave
  for (std::size_t k = off; k < report.leaving.size(); ++k) {
    const ContactPoint& point = report.leaving[k];
    contact.impulse_n_s -= point.force_n * point.counted_s;
    if (point.counted_s > 0.0) contact.end = std::min(contact.end, point.from);
  }
  return seen;
}

bool StrikeEstimator::learn(const StrikePlan& plan, const ContactReport& report) noexcept {
  const double P = report.impulse_n_s;
  const double t = (report.end - report.start).seconds();
  const double d = report.penetration_m;
  const double v = report.speed_before_m_s;
  if (report.phase != ContactPhase::over || !(P > 0.0 && t > 0.0 && v > 0.0) || !std::isfinite(P + d + v)) return false;
  const auto blend = [&](double old, double fresh) {
    const double weight = blows_ == 0 ? 0.0 : config_.memory;
    return weight * old + (1.0 - weight) * fresh;
  };

  const double moved = std::max(d, 0.0);
  const double infinity = std::numeric_limits<double>::infinity();
  double fresh_mass = infinity;
  if (moved > config_.least_penetration_m) fresh_mass = effective_nail_mass_kg(P, t, moved);  // (33), (34)
  // Blend mobilities 1/M*: infinite mass is then an ordinary value, 0.
  const double mobility = blend(1.0 / nail_mass_kg_, 1.0 / std::max(fresh_mass, config_.min_nail_mass_kg));
  nail_mass_kg_ = mobility * config_.max_nail_mass_kg > 1.0 ? 1.0 / mobility : infinity;

  // e from the impulse, with the mass this blow showed: (36) or (54) solved for e.
  // What the weight of limp joints pressed is no part of the rebound.
  const double e =
      restitution_from_impulse(std::max(P - plan.weight_force_n * t, 0.0), v, plan.effective_mass_kg, fresh_mass);
  if (std::isfinite(e)) restitution_ = blend(restitution_, std::clamp(e, 0.0, 1.0));
  contact_s_ = blend(contact_s_, std::clamp(t, config_.min_contact_s, config_.max_contact_s));

  if (moved > config_.least_penetration_m) {
    const double middle = depth_m_ + 0.5 * moved;
    const double resistance = P / t;
    s1_ += 1.0;
    sd_ += middle;
    sdd_ += middle * middle;
    sr_ += resistance;
    sdr_ += middle * resistance;
  }
  depth_m_ += moved;
  // The nail goes where the reference goes, give or take what the blow adds and the joints give way. One that did not
  // move says nothing of that: aiming deeper would only press against it. Nor does a blow of passive joints, which
  // follow no reference.
  if (moved > config_.least_penetration_m && plan.passive == 0) {
    const double offset = moved - plan.follow_through_m;
    offset_m_ = has_offset_ ? config_.memory * offset_m_ + (1.0 - config_.memory) * offset : offset;
    has_offset_ = true;
  }
  ++blows_;
  return true;
}

double StrikeEstimator::resistance_n(double depth_m) const noexcept {
  if (!(s1_ > 0.0)) return 0.0;
  const double spread = s1_ * sdd_ - sd_ * sd_;
  double slope = spread > 1e-8 * s1_ * s1_ ? (s1_ * sdr_ - sd_ * sr_) / spread : 0.0;
  slope = std::max(slope, 0.0);  // a nail does not get easier to drive; a fit that says so is noise
  return std::max((sr_ - slope * sd_) / s1_ + slope * depth_m, 0.0);
}

ContactLaw StrikeEstimator::contact_law(double room_m) const noexcept {
  ContactLaw law;
  law.nail_room_m = std::max(room_m, 0.0);
  if (blows_ > 0) {
    law.face_stiffness_n_m = rubber_.stiffness_n_m;
    law.face_damping_s_m = rubber_.damping_s_m;
  }
  return law;
}

double StrikeEstimator::follow_through_for(double wanted_m) const noexcept {
  if (!(wanted_m >= 0.0)) return 0.0;
  if (!has_offset_) return std::min(wanted_m, config_.first_follow_through_m);
  return std::clamp(wanted_m - offset_m_, 0.0, config_.max_follow_through_m);
}

}  // namespace mrr::sup
