// Room: supervisor/strike. The hammering session: swing after swing until the nail is flush, nothing moves any more, or
// a limit says so. An explicit state machine around the supervisor's cycle. Plans between swings: not for the cycle.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "common/robot/robot.h"
#include "supervisor/strike/estimate.h"
#include "supervisor/strike/planner.h"
#include "supervisor/supervisor.h"

namespace mrr::sup {

struct SessionOptions {
  int max_swings = 0;  ///< 0: as the task says
  PassiveMode mode = PassiveMode::planned;
  Formulation formulation = Formulation::corrected;
  StrikeMeasure measure = StrikeMeasure::load_ratio;
  std::uint64_t seed = 1;
  bool learn = true;             ///< false: every blow is planned as the first one, only the head's height is followed
  double largest_step_m = 0.02;  ///< no blow is asked to drive the nail further than this
  Duration bring_up_timeout = milliseconds(8000);
};

enum class SessionState : std::uint8_t { bring_up, planning, planned, swinging, learning, done };
[[nodiscard]] const char* describe(SessionState state) noexcept;

enum class Verdict : std::uint8_t {
  none,
  flush,          ///< the head is level with the board
  nothing_moves,  ///< blow after blow, the nail stays where it is
  swings_used_up,
  nothing_hit,   ///< a swing met nothing
  plan_refused,  ///< no blow within limits; see reason
  swing_aborted,
  not_ready,  ///< bring-up did not end; see reason
  joint_fault,
};
[[nodiscard]] const char* describe(Verdict verdict) noexcept;

/// One swing: what was planned and what the robot itself saw.
struct SwingReport {
  int number = 0;  ///< from 1
  StrikePlan plan;
  SwingOutcome outcome;
  double head_height_before_m = 0.0;  ///< estimate used by the plan
  double head_height_after_m = 0.0;   ///< estimate afterwards
  double head_sd_after_m = 0.0;       ///< its standard deviation
  double restitution = 0.0;           ///< assumed by the plan
  double nail_mass_kg = 0.0;          ///< assumed by the plan
  double speed_factor = 1.0;          ///< PlanInput::speed_factor of the plan
};

class HammerSession {
 public:
  /// All must outlive the session.
  HammerSession(const RobotDescription& robot, RobotPort& port, const SessionOptions& options);

  /// Call after each step of the supervisor. Returns true when the session is over.
  bool step(Time now);

  [[nodiscard]] SessionState state() const noexcept { return state_; }
  [[nodiscard]] Verdict verdict() const noexcept { return verdict_; }
  /// One sentence for the user.
  [[nodiscard]] const std::string& reason() const noexcept { return reason_; }
  [[nodiscard]] const std::vector<SwingReport>& swings() const noexcept { return swings_; }
  /// The plan in force, once there is one.
  [[nodiscard]] const StrikePlan* plan() const noexcept { return plan_ ? &*plan_ : nullptr; }
  [[nodiscard]] double head_height_m() const noexcept { return head_height_m_; }
  [[nodiscard]] const StrikeEstimator& estimator() const noexcept { return estimator_; }

 private:
  void finish(Verdict verdict, std::string reason);
  void plan_next();
  [[nodiscard]] bool plan_faster();
  void execute();
  void learn();
  [[nodiscard]] PlanInput next_request() const;
  [[nodiscard]] double next_speed_factor(const SwingReport& swing, double moved_m) const;
  [[nodiscard]] std::string bring_up_report(bool refused_only = false) const;

  const RobotDescription& robot_;
  RobotPort& port_;
  Chain chain_;
  SessionOptions options_;
  StrikeEstimator estimator_;
  SessionState state_ = SessionState::bring_up;
  Verdict verdict_ = Verdict::none;
  std::string reason_;
  std::optional<StrikePlan> plan_;
  std::vector<SwingReport> swings_;
  double head_height_m_;
  double head_sd_m_;           // of it, one standard deviation
  double speed_factor_ = 1.0;  // PlanInput::speed_factor of the next blow
  int still_in_a_row_ = 0;
  int misses_in_a_row_ = 0;
  bool started_ = false;
  Time started_at_;
};

}  // namespace mrr::sup
