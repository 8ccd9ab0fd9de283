// Room: supervisor/impact. The impulse of a blow: what the hammer face gets, what every joint gets, by selection of
// joints. May touch common/ and supervisor/model. Functions here allocate nothing and throw nothing.
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <span>

#include "supervisor/model/chain.h"

namespace mrr::sup {

/// What a joint does while the contact lasts.
enum class JointHold : std::uint8_t {
  free,        ///< passive: the link drags only its rotor along; (30)
  held,        ///< active, worst case: the axis is a constraint, delta q'_i = 0
  controlled,  ///< active, between: `extra_inertia_kg_m2` on top of the rotor
};

struct JointState {
  JointHold hold = JointHold::free;
  double extra_inertia_kg_m2 = 0.0;  ///< joint side, >= 0; controlled joints only, see controlled_extra_inertia()
};

/// `as_printed` evaluates the reference with the sign slip of its (52); it changes internal impulses and nothing else.
/// (Its Table 5 was made with RotorModel::lower.)
enum class Formulation : std::uint8_t { corrected, as_printed };

/// Shape of the contact force over time.
enum class PulseShape : std::uint8_t { square, half_sine };

struct ImpactInput {
  JointVector q;                                                  ///< rad
  JointVector qd;                                                 ///< just before contact, rad/s
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();              ///< unit, from the surface into the robot, base frame
  double restitution = 1.0;                                       ///< e, 0..1
  double nail_mass_kg = std::numeric_limits<double>::infinity();  ///< M*, > 0; infinite: rigid board
  std::array<JointState, kMaxJoints> joints{};                    ///< default: all free
  RotorModel rotor_model = RotorModel::sym;
  Formulation formulation = Formulation::corrected;
};

/// An impulse of force and torque between two neighbouring links. Unset until computed: a prediction holds sixteen.
struct WrenchImpulse {
  Eigen::Vector3d force_n_s;
  Eigen::Vector3d torque_nm_s;
  [[nodiscard]] static WrenchImpulse none() noexcept { return {Eigen::Vector3d::Zero(), Eigen::Vector3d::Zero()}; }
};

struct ImpactPrediction {
  /// False: a joint selection that cannot yield along the normal struck against a rigid board (the impulse would be
  /// infinite; for example all joints held), or input that is not usable (NaN, sizes, ranges). The other fields are
  /// then zero.
  bool feasible = false;
  bool approaching = false;           ///< n.v < 0; if not, nothing is struck: zero impulse, feasible
  double impulse_n_s = 0.0;           ///< P >= 0, on the robot along +normal, (36)
  double speed_before_m_s = 0.0;      ///< -n.v: approach speed of the face centre, positive when closing in
  double speed_after_m_s = 0.0;       ///< the same just after the impact
  double effective_mass_kg = 0.0;     ///< 1/(n^T W n) for this selection; may be infinite
  double nail_speed_after_m_s = 0.0;  ///< P/M*, along -normal
  JointVector delta_qd;               ///< jump of joint speed, rad/s, (31)
  JointVector axis_impulse_nm_s;      ///< axis component of the joint impulse: what each transmission carries, signed
  /// Full wrench impulse of link i on link i-1, at the centre of joint i, base frame.
  /// Entries beyond the chain's dof are unset.
  std::array<WrenchImpulse, kMaxJoints> wrench;
};

/// Predicts one blow; (27)-(36) and (37)-(53). `axis_impulse_nm_s` = J^T n P - M delta q', which is (B delta q')_i for
/// a free joint,
/// ((B + extra) delta q')_i for a controlled one and what the constraint carries for a held one.
[[nodiscard]] ImpactPrediction predict(const Chain& chain, const ImpactInput& input) noexcept;

/// First order: what a PD joint looks like over a contact of `contact_s`, as inertia on top of its rotor, kg m^2.
/// Square pulse: K_D t/2 + K_P t^2/6; half-sine: K_D t/2 + K_P t^2 (1/4 - 1/pi^2). Holds until the current saturates.
[[nodiscard]] double controlled_extra_inertia(double position_gain_nm_rad, double velocity_gain_nm_s_rad,
                                              double contact_s, PulseShape shape = PulseShape::square) noexcept;

/// Impulse of a sampled force by the trapezoidal rule, N s. `sample_s` apart; fewer than two samples give 0.
[[nodiscard]] double impulse_of_samples_n_s(std::span<const double> force_n, double sample_s) noexcept;

/// M* = P t_s / d, kg; (33),(34). Infinite if nothing moved (penetration 0), NaN if an input is not positive and
/// finite.
[[nodiscard]] double effective_nail_mass_kg(double impulse_n_s, double contact_s, double penetration_m) noexcept;

/// e from a measured impulse: (36) or (54) solved for e. Speeds and masses > 0, M* may be infinite. May come out below
/// 0 or above 1.
[[nodiscard]] double restitution_from_impulse(double impulse_n_s, double approach_speed_m_s, double effective_mass_kg,
                                              double nail_mass_kg = std::numeric_limits<double>::infinity()) noexcept;

/// e from speeds along the normal, (63): -(relative speed after)/(relative speed before), the nail at rest before.
/// All along +normal (m/s): face before (< 0), face after, nail after. NaN if the face was not approaching.
[[nodiscard]] double restitution_from_speeds(double face_before_m_s, double face_after_m_s,
                                             double nail_after_m_s = 0.0) noexcept;

/// Friction of (5), joint side, Nm, 0 at rest: [f_c + (f_s - f_c) exp(-f_tau q'^2)] sgn(q') + b q'.
[[nodiscard]] double friction_torque_nm(const FrictionDescription& friction, double qd_rad_s) noexcept;

/// Finite-time correction, Nm s per joint: integral (h + tau_f) dt over the contact, which the impulse of an instant
/// leaves out. q is kept; q' goes linearly from `qd_before` to `qd_after` (friction changes sign on the way); Simpson
/// for h, midpoints for tau_f. `friction` has dof() entries.
[[nodiscard]] JointVector finite_time_correction_nm_s(const Chain& chain,
                                                      const std::array<FrictionDescription, kMaxJoints>& friction,
                                                      const JointVector& q, const JointVector& qd_before,
                                                      const JointVector& qd_after, double contact_s) noexcept;

}  // namespace mrr::sup
