#include "supervisor/strike/contact_observer.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <numbers>

namespace mrr::sup {
namespace {

constexpr double kStandsOut = 3.5;      // standard deviations: not noise, when a contact is known to follow
constexpr double kLongestRiseS = 0.06;  // above the noise for longer without a blow: the baseline has moved
constexpr std::size_t kBefore = 3;      // intervals before the first that stands out, with what it hid in the noise
constexpr double kOff_m = 1e-3;         // above where the head is thought to be: the face has left it
constexpr double kStillComing = 0.5;    // of the speed of approach: what was felt was a jolt of the joints
constexpr double kFaded = 0.25;         // of the least force, on average over the history: nothing presses any more
constexpr double kWild = 3.0;           // standard deviations: what is further off is no noise, and enters as this much

}  // namespace

double flexion_rad(const TransmissionDescription& drive, double torque_nm) noexcept {
  const auto& [k1, k2, k3] = drive.stiffness_nm_rad;
  const auto& [t1, t2] = drive.stiffness_break_nm;
  const double torque = std::abs(torque_nm);
  const double angle =
      std::min(torque, t1) / k1 + std::clamp(torque - t1, 0.0, t2 - t1) / k2 + std::max(torque - t2, 0.0) / k3;
  return std::copysign(angle, torque_nm);
}

ContactObserver::ContactObserver(const RobotDescription& robot, const Chain& chain, const ContactConfig& config)
    : chain_(&chain), config_(config) {
  for (int i = 0; i < chain.dof(); ++i) {
    const JointDescription& joint = robot.joints[static_cast<std::size_t>(i)];
    drive_[static_cast<std::size_t>(i)] = joint.transmission;
    // What a first-order sensor shows is this old.
    if (joint.sensors.torque_sensor && joint.sensors.torque_bandwidth_hz > 0.0) {
      force_age_s_ = std::max(force_age_s_, 1.0 / (2.0 * std::numbers::pi * joint.sensors.torque_bandwidth_hz));
    }
  }
  reset(Eigen::Vector3d::UnitZ());
}

void ContactObserver::reset(const Eigen::Vector3d& normal, const Eigen::Vector3d& head_m, double gate_m) noexcept {
  normal_ = normal;
  head_ = head_m;
  gate_m_ = gate_m;
  seen_ = 0;
  residual_.setZero(chain_->dof());
  force_n_ = threshold_n_ = baseline_n_ = variance_n2_ = noise_n2_ = seen_s_ = rising_s_ = 0.0;
  low_samples_ = 0;
  history_.clear();
  skipped_ = 0;
  report_ = {};
}

const ContactReport& ContactObserver::step(Time now, const ContactSample& sample) noexcept {
  const int n = chain_->dof();
  const bool usable = sample.q.size() == n && sample.torque_nm.size() == n && sample.q.allFinite() &&
                      sample.torque_nm.allFinite() && (seen_ == 0 || now > last_.time);
  if (!usable) {
    ++skipped_;
    return report_;
  }
  if (seen_ > 0 && !((now - last_.time).seconds() <= config_.max_gap_s)) {
    seen_ = 0;
    history_.clear();
    residual_.setZero();
  }
  Instant at;
  at.time = now;
  at.torque = sample.torque_nm;
  at.q = sample.q;
  for (int i = 0; i < n; ++i) at.q[i] -= flexion_rad(drive_[static_cast<std::size_t>(i)], at.torque[i]);
  at.face = chain_->face_pose(at.q).position_m;
  if (seen_ < 2) {
    before_last_ = last_;
    last_ = at;
    ++seen_;
    return report_;
  }

  // Around the middle one of three samples: from half a period before it to half a period after it.
  const double dt_before = (last_.time - before_last_.time).seconds();
  const double dt_after = (now - last_.time).seconds();
  const double dt = 0.5 * (dt_before + dt_after);
  const JointVector qd_before = (last_.q - before_last_.q) / dt_before;
  const JointVector qd_after = (at.q - last_.q) / dt_after;
  const JointVector qd = 0.5 * (qd_before + qd_after);
  const JointVector qdd = (qd_after - qd_before) / dt;
  const ChainPose pose = chain_->pose(last_.q);
  // Mean of the torque over the interval, if it goes linearly from sample to sample.
  JointVector external = -0.75 * last_.torque - 0.125 * (before_last_.torque + at.torque);
  external += chain_->inverse_dynamics(pose, qd, qdd);
  residual_ += (1.0 - std::exp(-config_.residual_gain_1_s * dt)) * (external - residual_);

  const JointVector J_n = chain_->jacobian(pose).topRows<3>().transpose().lazyProduct(normal_);
  const JointVector y = chain_->mass_matrix(pose).llt().solve(J_n);  // M^-1 J^T n
  const double mobility = J_n.dot(y);
  const auto along_normal = [&](const JointVector& torque) { return mobility > 1e-9 ? y.dot(torque) / mobility : 0.0; };
  Trace trace;
  trace.time = last_.time + (now - last_.time) / 2;
  trace.dt_s = dt;
  trace.force_n = along_normal(external);
  trace.speed_m_s = -J_n.dot(qd_after);
  trace.face = 0.5 * (last_.face + at.face);
  trace.q = 0.5 * (last_.q + at.q);
  trace.qd = qd_after;
  trace.point = {normal_.dot(last_.face) - force_age_s_ * J_n.dot(qd), J_n.dot(qd), trace.force_n,
                 trace.time - seconds(dt), dt};
  if (history_.full()) {
    std::move(history_.begin() + 1, history_.end(), history_.begin());
    history_.truncate(kHistory - 1);
  }
  (void)history_.push_back(trace);
  before_last_ = last_;
  last_ = at;

  const double excess = along_normal(residual_) - baseline_n_;
  force_n_ = excess;
  switch (report_.phase) {
    case ContactPhase::none:
      before_contact(trace, excess);
      break;
    case ContactPhase::touching:
      during_contact(trace, excess);
      break;
    case ContactPhase::over:
      break;
  }
  return report_;
}

void ContactObserver::before_contact(const Trace& trace, double excess) noexcept {
  const double dt = trace.dt_s;
  threshold_n_ = std::max(config_.min_force_n, config_.sigmas * std::sqrt(variance_n2_));
  const bool settled = seen_s_ >= config_.settle_s;
  const bool near = normal_.dot(last_.face - head_) <= gate_m_;
  if (settled && near && excess > threshold_n_) {
    begin_contact();
    return;
  }
  seen_s_ += dt;
  rising_s_ = settled && excess > config_.release_share * threshold_n_ ? rising_s_ + dt : 0.0;
  if (rising_s_ > 0.0 && rising_s_ < kLongestRiseS) return;
  // A sample taken a tick late makes a wild force and its opposite.
  const auto tamed = [&](double value, double variance_n2) {
    const double bound = kWild * std::max(std::sqrt(variance_n2), config_.min_force_n / config_.sigmas);
    return settled ? std::clamp(value, -bound, bound) : value;
  };
  const double weight = dt / (dt + std::min(seen_s_, config_.baseline_time_s));
  const double entered = tamed(excess, variance_n2_);
  const double single = tamed(trace.force_n - baseline_n_, noise_n2_);
  baseline_n_ += weight * entered;
  variance_n2_ += weight * (entered * entered - variance_n2_);
  noise_n2_ += weight * (single * single - noise_n2_);
}

/// How much of interval `edge` was spent in contact, 0..1 or more. For a force that grows linearly from (or falls
/// linearly to) an instant in it, the means of it and of its neighbour inside give x^2 = (f_edge/f_inside)(2x + 1).
double ContactObserver::share_in_contact(std::size_t edge, std::size_t inside) const noexcept {
  if (!(over(inside) > 0.0)) return 0.5;
  const double ratio = std::max(over(edge), 0.0) / over(inside);
  return ratio + std::sqrt(ratio * ratio + ratio);
}

void ContactObserver::begin_contact() noexcept {
  // Back to the first interval whose force stands out. history_[first - 1] ends where that interval begins.
  const double low = std::max(config_.release_share * threshold_n_, kStandsOut * std::sqrt(variance_n2_));
  std::size_t first = history_.size() - 1;
  while (first > 1 && over(first - 1) > low) --first;
  double share = first + 1 < history_.size() ? share_in_contact(first, first + 1) : 0.5;
  if (share > 1.0 && first > 1) {
    --first;
    share = share_in_contact(first, first + 1);
  }
  share = std::clamp(share, 0.0, 1.0);

  const Trace& after = history_[first];
  const Trace& before = history_[first > 0 ? first - 1 : first];
  report_.phase = ContactPhase::touching;
  report_.start = after.time - seconds(share * after.dt_s);
  report_.face_start_m = share * before.face + (1.0 - share) * after.face;
  report_.q_start = share * before.q + (1.0 - share) * after.q;
  report_.qd_before = before.qd;
  report_.speed_before_m_s = before.speed_m_s;
  report_.force_noise_n = std::sqrt(noise_n2_);
  low_samples_ = samples_ = 0;
  for (std::size_t k = first - std::min(first, kBefore); k < first; ++k) {
    report_.impulse_n_s += over(k) * history_[k].dt_s;
  }
  under_m_ = std::numeric_limits<double>::infinity();
  for (std::size_t k = first; k < history_.size(); ++k) during_contact(history_[k], force_n_);
}

/// Whether the force has been nothing much for as long as is remembered.
bool ContactObserver::faded() const noexcept {
  double sum = 0.0;
  for (std::size_t k = 0; k < history_.size(); ++k) sum += over(k);
  return samples_ >= static_cast<int>(kHistory) &&
         sum < kFaded * config_.min_force_n * static_cast<double>(history_.size());
}

void ContactObserver::during_contact(const Trace& trace, double excess) noexcept {
  ++samples_;
  const double force = trace.force_n - baseline_n_;
  ContactPoint point = trace.point;
  point.force_n = force;
  if (report_.leaving.empty() || point.height_m <= report_.leaving[0].height_m) {
    report_.leaving.clear();
    under_m_ = point.height_m + std::max(force, 0.0) / config_.face_stiffness_n_m;
  } else if (report_.leaving.full()) {
    // The deepest stays first: it tells a fresh depth from an old one.
    std::move(report_.leaving.begin() + 2, report_.leaving.end(), report_.leaving.begin() + 1);
    report_.leaving.truncate(report_.leaving.size() - 1);
  }
  (void)report_.leaving.push_back(point);
  // A nail does not follow the face back: with the face lower than the head, a low force is a long soft push.
  const bool off = force < config_.release_share * threshold_n_ && point.height_m >= under_m_ + kOff_m;
  if (off && low_samples_++ == 0) at_release_ = report_;
  if (!off) low_samples_ = 0;
  report_.impulse_n_s += force * trace.dt_s;
  report_.peak_force_n = std::max(report_.peak_force_n, excess);
  report_.end = trace.time;
  report_.face_end_m = trace.face;
  report_.penetration_m = normal_.dot(report_.face_start_m - trace.face);
  report_.deepest_m = std::max(report_.deepest_m, report_.penetration_m);
  report_.qd_after = trace.qd;
  report_.speed_after_m_s = trace.speed_m_s;
  if (low_samples_ >= config_.release_samples) {
    end_contact();
  } else if (faded() && trace.speed_m_s > kStillComing * report_.speed_before_m_s) {
    forget();  // nothing slowed the face down
  } else if (faded() || (report_.end - report_.start).seconds() > config_.max_contact_s) {
    report_.phase = ContactPhase::over;
  }
}

void ContactObserver::end_contact() noexcept {
  // The first low interval is the release_samples-th from the end; the contact ended in it or in the one before.
  const std::size_t samples = static_cast<std::size_t>(std::max(config_.release_samples, 1));
  const JointVector qd_after = history_[history_.size() - samples].qd;
  const double speed_after = history_[history_.size() - samples].speed_m_s;
  const auto leaving = report_.leaving;
  report_ = at_release_;
  report_.leaving = leaving;
  for (std::size_t k = leaving.size() - std::min(leaving.size(), samples); k < leaving.size(); ++k) {
    report_.leaving[k].counted_s = 0.0;
  }
  report_.phase = ContactPhase::over;
  if (history_.size() < samples + 2) return;
  std::size_t edge = history_.size() - samples;
  double share = share_in_contact(edge, edge - 1);
  if (!(over(edge) > 0.0) && edge >= 2) {
    const double earlier = share_in_contact(edge - 1, edge - 2);
    if (earlier < 1.0) {
      --edge;
      share = earlier;
    }
  }
  share = std::clamp(share, 0.0, 1.0);
  const Trace& before = history_[edge - 1];
  const Trace& after = history_[edge];
  report_.end = before.time + seconds(share * after.dt_s);
  report_.face_end_m = (1.0 - share) * before.face + share * after.face;
  report_.penetration_m = normal_.dot(report_.face_start_m - report_.face_end_m);
  report_.deepest_m = std::max(report_.deepest_m, report_.penetration_m);
  report_.qd_after = qd_after;
  report_.speed_after_m_s = speed_after;
  if ((report_.end - report_.start).seconds() < config_.min_contact_s) {
    forget();
  }
}

void ContactObserver::forget() noexcept {
  report_ = {};
  rising_s_ = 0.0;
}

}  // namespace mrr::sup
