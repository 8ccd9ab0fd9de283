#include "supervisor/strike/contact_observer.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

namespace mrr::sup {
namespace {

constexpr double kLongestRiseS = 0.06;  // above the noise for longer without a blow: the baseline has moved

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
    drive_[static_cast<std::size_t>(i)] = robot.joints[static_cast<std::size_t>(i)].transmission;
  }
  reset(Eigen::Vector3d::UnitZ());
}

void ContactObserver::reset(const Eigen::Vector3d& normal) noexcept {
  normal_ = normal;
  has_last_ = false;
  residual_.setZero(chain_->dof());
  force_n_ = threshold_n_ = baseline_n_ = variance_n2_ = seen_s_ = rising_s_ = 0.0;
  low_samples_ = 0;
  history_.clear();
  skipped_ = 0;
  report_ = {};
}

ContactObserver::Instant ContactObserver::evaluate(Time now, const ContactSample& sample) const noexcept {
  Instant at;
  at.time = now;
  const int n = chain_->dof();
  at.flexion.resize(n);
  for (int i = 0; i < n; ++i) at.flexion[i] = flexion_rad(drive_[static_cast<std::size_t>(i)], sample.torque_nm[i]);
  at.q = sample.q - at.flexion;
  at.qd = sample.qd;
  if (has_last_) at.qd -= (at.flexion - last_.flexion) / (now - last_.time).seconds();
  const ChainPose pose = chain_->pose(at.q);
  at.M = chain_->mass_matrix(pose);
  at.bias_less_torque = chain_->bias(at.q, at.qd) - sample.torque_nm;
  at.J_n = chain_->jacobian(pose).topRows<3>().transpose().lazyProduct(normal_);
  at.face = pose.face.position_m;
  return at;
}

double ContactObserver::force_along_normal(const Instant& at, const JointVector& torque) const noexcept {
  const JointVector y = at.M.llt().solve(at.J_n);  // M^-1 J^T n
  const double mobility = at.J_n.dot(y);
  return mobility > 1e-9 ? y.dot(torque) / mobility : 0.0;
}

const ContactReport& ContactObserver::step(Time now, const ContactSample& sample) noexcept {
  const Eigen::Index n = chain_->dof();
  const bool usable = sample.q.size() == n && sample.qd.size() == n && sample.torque_nm.size() == n &&
                      sample.q.allFinite() && sample.qd.allFinite() && sample.torque_nm.allFinite() &&
                      (!has_last_ || now > last_.time);
  if (!usable) {
    ++skipped_;
    return report_;
  }
  if (has_last_ && !((now - last_.time).seconds() <= config_.max_gap_s)) {
    has_last_ = false;
    history_.clear();
    residual_.setZero();
  }
  const Instant at = evaluate(now, sample);
  if (!has_last_) {
    last_ = at;
    has_last_ = true;
    return report_;
  }

  // p' = tau_s + M' q' - h + J^T F over the interval; integral of M' q' = (change of M) (mean q').
  const double dt = (now - last_.time).seconds();
  const JointVector mean_qd = 0.5 * (at.qd + last_.qd);
  const JointMatrix change = at.M - last_.M;
  JointVector external = at.M.lazyProduct(at.qd);
  external -= last_.M.lazyProduct(last_.qd);
  external -= change.lazyProduct(mean_qd);
  external /= dt;
  external += 0.5 * (at.bias_less_torque + last_.bias_less_torque);
  residual_ += (1.0 - std::exp(-config_.residual_gain_1_s * dt)) * (external - residual_);

  Trace trace;
  trace.time = now;
  trace.dt_s = dt;
  trace.force_n = force_along_normal(at, external);
  trace.speed_m_s = -at.J_n.dot(at.qd);
  trace.face = at.face;
  trace.q = at.q;
  trace.qd = at.qd;
  if (history_.full()) {
    std::move(history_.begin() + 1, history_.end(), history_.begin());
    history_.truncate(kHistory - 1);
  }
  (void)history_.push_back(trace);
  last_ = at;

  const double excess = force_along_normal(at, residual_) - baseline_n_;
  force_n_ = excess;
  switch (report_.phase) {
    case ContactPhase::none:
      before_contact(excess, dt);
      break;
    case ContactPhase::touching:
      during_contact(trace, excess);
      break;
    case ContactPhase::over:
      break;
  }
  return report_;
}

void ContactObserver::before_contact(double excess, double dt) noexcept {
  threshold_n_ = std::max(config_.min_force_n, config_.sigmas * std::sqrt(variance_n2_));
  const bool settled = seen_s_ >= config_.settle_s;
  if (settled && excess > threshold_n_) {
    begin_contact();
    return;
  }
  seen_s_ += dt;
  rising_s_ = settled && excess > config_.release_share * threshold_n_ ? rising_s_ + dt : 0.0;
  if (rising_s_ > 0.0 && rising_s_ < kLongestRiseS) return;
  const double weight = dt / (dt + std::min(seen_s_, config_.baseline_time_s));
  baseline_n_ += weight * excess;
  variance_n2_ += weight * (excess * excess - variance_n2_);
}

void ContactObserver::begin_contact() noexcept {
  // Back to the first interval whose force stands out. history_[first - 1] ends where that interval begins.
  const double low = config_.release_share * threshold_n_;
  std::size_t first = history_.size() - 1;
  const auto over = [&](std::size_t k) { return history_[k].force_n - baseline_n_; };
  while (first > 1 && over(first - 1) > low) --first;

  // The instant within an interval: for a force that grows linearly from there, of which this and the next interval
  // show the means f1 and f2, the share x of the interval in contact solves x^2 = (f1/f2)(2x + 1).
  const auto share_in_contact = [&](std::size_t k) {
    if (k + 1 >= history_.size() || !(over(k + 1) > 0.0)) return 0.5;
    const double ratio = std::max(over(k), 0.0) / over(k + 1);
    return ratio + std::sqrt(ratio * ratio + ratio);
  };
  double share = share_in_contact(first);
  if (share > 1.0 && first > 1) share = share_in_contact(--first);
  share = std::clamp(share, 0.0, 1.0);

  const Trace& after = history_[first];
  const Trace& before = history_[first > 0 ? first - 1 : first];
  report_.phase = ContactPhase::touching;
  report_.start = after.time - seconds(share * after.dt_s);
  report_.face_start_m = share * before.face + (1.0 - share) * after.face;
  report_.q_start = share * before.q + (1.0 - share) * after.q;
  report_.qd_before = before.qd;
  report_.speed_before_m_s = before.speed_m_s;
  low_samples_ = 0;
  for (std::size_t k = first; k < history_.size(); ++k) during_contact(history_[k], force_n_);
}

void ContactObserver::during_contact(const Trace& trace, double excess) noexcept {
  const double force = trace.force_n - baseline_n_;
  const double low = config_.release_share * threshold_n_;
  if (force < low) {
    // Contact ended somewhere in the first low interval; its end is where the face left the head.
    if (low_samples_++ == 0) at_release_ = report_;
  } else {
    low_samples_ = 0;
  }
  report_.impulse_n_s += force * trace.dt_s;
  report_.peak_force_n = std::max(report_.peak_force_n, excess);
  report_.end = trace.time;
  report_.face_end_m = trace.face;
  report_.penetration_m = normal_.dot(report_.face_start_m - trace.face);
  report_.deepest_m = std::max(report_.deepest_m, report_.penetration_m);
  report_.qd_after = trace.qd;
  report_.speed_after_m_s = trace.speed_m_s;
  if (low_samples_ >= config_.release_samples) {
    report_ = at_release_;
    report_.phase = ContactPhase::over;
  } else if ((report_.end - report_.start).seconds() > config_.max_contact_s) {
    report_.phase = ContactPhase::over;
  }
}

}  // namespace mrr::sup
