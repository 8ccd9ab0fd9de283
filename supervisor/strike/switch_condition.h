// Room: supervisor/strike. Watches the swing on its way in and says when the joints go passive, or that they must not.
// May touch common/core, supervisor/model and the plan. Stepped: allocates nothing, throws nothing.
#pragma once

#include <cstdint>

#include "supervisor/strike/planner.h"

namespace mrr::sup {

enum class SwitchVerdict : std::uint8_t { wait, switch_now, cancel };
enum class SwitchCause : std::uint8_t {
  none,          ///< condition met, or still far away
  momentum_low,  ///< slower than (1 - delta) of the plan
  lateral_miss,  ///< the face would meet the head too far off its centre
  tilted,
  passed,      ///< the head was passed and the condition never held
  not_finite,  ///< measurement unusable: decides nothing
};

struct SwitchConfig {
  double momentum_slack = 0.15;  ///< delta
  double lead_s = 0.012;         ///< from the switch to contact: TaskDescription::switch_lead_s
  double gap_margin_m = 0.0005;  ///< added to v t_lead
  double max_lateral_m = 0.006;  ///< at contact; half the face is a good value
  double max_tilt_rad = 0.14;
};
[[nodiscard]] SwitchConfig switch_config(const RobotDescription& robot) noexcept;

struct SwitchState {
  SwitchVerdict verdict = SwitchVerdict::wait;
  SwitchCause cause = SwitchCause::none;
  double gap_m = 0.0;              ///< d.(p_head - p_face), d = -normal
  double speed_m_s = 0.0;          ///< of the face along d
  double time_to_contact_s = 0.0;  ///< gap/speed; infinite if not closing in
  double momentum_ratio = 0.0;     ///< q_f'^T M(q) q' / q_f'^T M(q_f) q_f'
  double lateral_m = 0.0;          ///< predicted at contact
  double tilt_rad = 0.0;
};

/// One swing. Latched: after switch_now or cancel the verdict stays. Corrects the reference's (61), (62): see
/// docs/strike.md.
class SwitchCondition {
 public:
  SwitchCondition(const Chain& chain, const StrikePlan& plan, const SwitchConfig& config) noexcept;
  /// Measured q, q'. `chain` must outlive this.
  const SwitchState& step(const JointVector& q, const JointVector& qd) noexcept;
  [[nodiscard]] const SwitchState& state() const noexcept { return state_; }

 private:
  const Chain* chain_;
  SwitchConfig config_;
  JointVector qd_impact_;
  Eigen::Vector3d head_;
  Eigen::Vector3d direction_;
  double momentum_at_impact_;
  SwitchState state_;
};

}  // namespace mrr::sup
