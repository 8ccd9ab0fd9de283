#include "supervisor/strike/switch_condition.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace mrr::sup {

SwitchConfig switch_config(const RobotDescription& robot) noexcept {
  SwitchConfig config;
  config.lead_s = robot.task.switch_lead_s;
  config.max_lateral_m = 0.5 * robot.hammer.face_radius_m;
  config.max_tilt_rad = robot.hammer.max_tilt_rad;
  return config;
}

SwitchCondition::SwitchCondition(const Chain& chain, const StrikePlan& plan, const SwitchConfig& config) noexcept
    : chain_(&chain),
      config_(config),
      qd_impact_(plan.qd_impact),
      head_(plan.head_position_m),
      direction_(-plan.normal),
      momentum_at_impact_(plan.qd_impact.dot(chain.mass_matrix(plan.q_impact).lazyProduct(plan.qd_impact).eval())) {}

const SwitchState& SwitchCondition::step(const JointVector& q, const JointVector& qd) noexcept {
  if (state_.verdict != SwitchVerdict::wait) return state_;
  const Eigen::Index n = chain_->dof();
  if (q.size() != n || qd.size() != n || !q.allFinite() || !qd.allFinite()) {
    state_.cause = SwitchCause::not_finite;
    return state_;
  }
  const ChainPose pose = chain_->pose(q);
  const Jacobian J_h = chain_->jacobian(pose);
  const Eigen::Vector3d v = J_h.topRows<3>().lazyProduct(qd);
  const Eigen::Vector3d off = head_ - pose.face.position_m;
  SwitchState s;
  s.gap_m = direction_.dot(off);
  s.speed_m_s = direction_.dot(v);
  s.time_to_contact_s = s.speed_m_s > 0.0 ? s.gap_m / s.speed_m_s : std::numeric_limits<double>::infinity();
  s.momentum_ratio = qd_impact_.dot(chain_->mass_matrix(pose).lazyProduct(qd).eval()) / momentum_at_impact_;
  s.tilt_rad = std::acos(std::clamp(pose.face.rotation.col(2).dot(direction_), -1.0, 1.0));
  // Where the face will be when the gap is closed, seen along the nail.
  Eigen::Vector3d miss = off - direction_ * s.gap_m;
  if (std::isfinite(s.time_to_contact_s)) miss -= (v - direction_ * s.speed_m_s) * s.time_to_contact_s;
  s.lateral_m = miss.norm();

  const bool in_window = s.gap_m >= 0.0 && s.gap_m <= s.speed_m_s * config_.lead_s + config_.gap_margin_m;
  if (s.gap_m < 0.0) {
    s.verdict = SwitchVerdict::cancel;
    s.cause = state_.cause == SwitchCause::momentum_low ? SwitchCause::momentum_low : SwitchCause::passed;
  } else if (in_window) {
    if (!(s.lateral_m <= config_.max_lateral_m)) {
      s.verdict = SwitchVerdict::cancel;
      s.cause = SwitchCause::lateral_miss;
    } else if (!(s.tilt_rad <= config_.max_tilt_rad)) {
      s.verdict = SwitchVerdict::cancel;
      s.cause = SwitchCause::tilted;
    } else if (s.momentum_ratio >= 1.0 - config_.momentum_slack) {
      s.verdict = SwitchVerdict::switch_now;
    } else {
      s.cause = SwitchCause::momentum_low;  // it may still come up to speed before the head
    }
  }
  state_ = s;
  return state_;
}

}  // namespace mrr::sup
