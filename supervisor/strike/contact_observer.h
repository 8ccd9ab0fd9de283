// Room: supervisor/strike. Sees the blow from the joints: force, impulse, penetration, jump of joint speeds.
// May touch common/ and supervisor/model. Stepped at the knot rate: allocates nothing, throws nothing.
#pragma once

#include <array>
#include <cstdint>
#include <limits>

#include "common/core/containers.h"
#include "common/core/time.h"
#include "common/robot/robot.h"
#include "supervisor/model/chain.h"

namespace mrr::sup {

struct ContactConfig {
  double residual_gain_1_s = 250.0;    ///< of the momentum observer, for the reported force
  double min_force_n = 4.0;            ///< never triggers below this
  double sigmas = 5.2;                 ///< threshold in standard deviations of the force before contact
  double release_share = 0.4;          ///< a force below this share of the threshold is low
  int release_samples = 2;             ///< contact is over when it was low for that many samples, off the head
  double face_stiffness_n_m = 8000.0;  ///< of the rubber, roughly: tells where the head is under a pressed face
  double baseline_time_s = 0.04;       ///< time constant of the baseline and its noise, before contact
  double settle_s = 0.02;              ///< no detection before this much was seen since reset()
  double max_gap_s = 0.03;             ///< longer without a sample: the observer starts anew
  double max_contact_s = 0.5;          ///< a contact is closed after this
  double min_contact_s = 0.015;        ///< what ends sooner was no blow but a jolt of the joints: forgotten
};

/// One sample, all joints at the same instant (SYNC).
struct ContactSample {
  JointVector q;          ///< motor side, joint units, rad
  JointVector qd;         ///< rad/s; carried for logs, the observer takes speeds from q
  JointVector torque_nm;  ///< what the transmission puts on the link (torque sensor), Nm
};

enum class ContactPhase : std::uint8_t { none, touching, over };

/// The face and the force on it at one sample.
struct ContactPoint {
  double height_m = 0.0;     ///< of the face's centre along +normal, link side, from the base frame's origin, when the
                             ///< force acted
  double leaving_m_s = 0.0;  ///< its speed along +normal
  double force_n = 0.0;      ///< on the robot along +normal, mean over the period around the sample
  Time from;                 ///< where that period begins
  double counted_s = 0.0;    ///< how much of it is in the report's impulse: all or nothing
};

/// The blow so far; final when `phase` is over.
struct ContactReport {
  ContactPhase phase = ContactPhase::none;
  Time start;
  Time end;                  ///< so far, while touching
  double impulse_n_s = 0.0;  ///< along +normal on the robot
  double peak_force_n = 0.0;
  double penetration_m = 0.0;     ///< along -normal: face where contact ended less where it began, link side
  double deepest_m = 0.0;         ///< deepest the face went past where contact began (>= penetration)
  double speed_before_m_s = 0.0;  ///< along -normal
  double speed_after_m_s = 0.0;   ///< along -normal, negative: it bounced
  Eigen::Vector3d face_start_m = Eigen::Vector3d::Zero();  ///< face centre where contact began, link side, base frame
  Eigen::Vector3d face_end_m = Eigen::Vector3d::Zero();    ///< ... and where it ended: where the head now is
  JointVector q_start;                                     ///< link side, at the start
  JointVector qd_before;                                   ///< rad/s, link side
  JointVector qd_after;
  double force_noise_n = 0.0;              ///< standard deviation of a single point's force, before contact
  StaticVector<ContactPoint, 32> leaving;  ///< the last points from the deepest on, oldest first; some off the head
};

/// Torsion of a harmonic drive under a torque, rad: piecewise linear K1, K2, K3, odd.
[[nodiscard]] double flexion_rad(const TransmissionDescription& drive, double torque_nm) noexcept;

/// Momentum observer on the link side, M q'' + h = tau_s + J_h^T F, in its form for samples: the momentum of the
/// interval before a sample against that of the interval after it, torque and bias in between. Positions only: q' would
/// have to be of the link, at that instant, unfiltered. Link side = motor side minus torsion. The force along the
/// normal is the dynamically consistent one, (J M^-1 r)/(J M^-1 J^T). Results lag half a period.
class ContactObserver {
 public:
  /// `chain` must outlive this; the drives' stiffness is copied.
  ContactObserver(const RobotDescription& robot, const Chain& chain, const ContactConfig& config = {});

  /// A new swing. `normal`: unit, from the board into the robot. Contact is believed only once the face is within
  /// `gate_m` of `head_m` (base frame) along it: what the joints feel before is their own motion.
  void reset(const Eigen::Vector3d& normal, const Eigen::Vector3d& head_m = Eigen::Vector3d::Zero(),
             double gate_m = std::numeric_limits<double>::infinity()) noexcept;
  /// One sample at `now`. A sample which is not finite, of the wrong size or not later than the last one is skipped and
  /// counted. A gap of more than 5 periods restarts the observer, not the report.
  const ContactReport& step(Time now, const ContactSample& sample) noexcept;

  [[nodiscard]] const ContactReport& report() const noexcept { return report_; }
  [[nodiscard]] double force_n() const noexcept { return force_n_; }  ///< filtered, less the baseline
  [[nodiscard]] double threshold_n() const noexcept { return threshold_n_; }
  [[nodiscard]] const JointVector& external_torque_nm() const noexcept { return residual_; }
  [[nodiscard]] std::uint32_t skipped() const noexcept { return skipped_; }

 private:
  static constexpr std::size_t kHistory = 12;
  struct Instant {
    Time time;
    JointVector q;  // link side
    JointVector torque;
    Eigen::Vector3d face = Eigen::Vector3d::Zero();
  };
  /// The end of an interval, and the mean force in it.
  struct Trace {
    Time time;
    double dt_s = 0.0;
    double force_n = 0.0;
    double speed_m_s = 0.0;
    Eigen::Vector3d face = Eigen::Vector3d::Zero();
    JointVector q;
    JointVector qd;
    ContactPoint point;  // in the middle of the interval
  };
  [[nodiscard]] double over(std::size_t k) const noexcept { return history_[k].force_n - baseline_n_; }
  [[nodiscard]] double share_in_contact(std::size_t edge, std::size_t inside) const noexcept;
  void before_contact(const Trace& trace, double excess_n) noexcept;
  [[nodiscard]] bool faded() const noexcept;
  void begin_contact() noexcept;
  void during_contact(const Trace& trace, double excess_n) noexcept;
  void end_contact() noexcept;
  void forget() noexcept;

  const Chain* chain_;
  ContactConfig config_;
  std::array<TransmissionDescription, kMaxJoints> drive_{};
  double force_age_s_ = 0.0;  // by the slowest torque sensor
  Eigen::Vector3d normal_ = Eigen::Vector3d::UnitZ();
  Eigen::Vector3d head_ = Eigen::Vector3d::Zero();
  double gate_m_ = std::numeric_limits<double>::infinity();
  Instant last_;
  Instant before_last_;
  int seen_ = 0;  // samples held: 0, 1, 2
  JointVector residual_;
  double force_n_ = 0.0;
  double threshold_n_ = 0.0;
  double baseline_n_ = 0.0;
  double variance_n2_ = 0.0;
  double noise_n2_ = 0.0;  // of one unfiltered force
  double under_m_ = 0.0;   // the head is no lower than this: deepest point, less what the rubber gave there
  double seen_s_ = 0.0;
  double rising_s_ = 0.0;  // how long the force has been above the noise without a contact
  int low_samples_ = 0;
  int samples_ = 0;                        // in contact
  StaticVector<Trace, kHistory> history_;  // newest last
  ContactReport at_release_;
  std::uint32_t skipped_ = 0;
  ContactReport report_;
};

}  // namespace mrr::sup
