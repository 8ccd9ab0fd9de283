// Room: supervisor/strike. What one blow teaches for the next: restitution, effective mass, resistance, how deep to
// aim. May touch supervisor/impact and the contact observer. Allocates nothing, throws nothing.
#pragma once

#include <limits>

#include "supervisor/strike/contact_observer.h"
#include "supervisor/strike/head_fit.h"
#include "supervisor/strike/planner.h"

namespace mrr::sup {

struct StrikeEstimateConfig {
  double least_penetration_m = 2e-4;  ///< less counts as nothing moved: M* is infinite
  double max_nail_mass_kg = 500.0;    ///< above it, infinite
  double min_nail_mass_kg = 1.0;
  double memory = 0.5;  ///< weight of the old estimate against a new blow, 0..1
  double min_contact_s = 0.02;
  double max_contact_s = 0.2;
  double max_follow_through_m = 0.04;
  double first_follow_through_m = 0.006;  ///< until a nail has moved: how it answers is not known yet
};

/// A length and its standard deviation, m.
struct Height {
  double m = 0.0;
  double sd_m = 0.0;
};

struct SeenBlow {
  ContactReport contact;  ///< end, impulse, face_end_m and penetration as seen now
  Height head;            ///< afterwards, along the plan's normal from the base frame's origin
};

/// Learns from blow to blow. Starts with what the task assumes and stays within sane bounds whatever it is fed.
class StrikeEstimator {
 public:
  explicit StrikeEstimator(double assumed_contact_s, const StrikeEstimateConfig& config = {}) noexcept;

  /// Enters a finished blow. `follow_through_m`: how far past the head the reference went. False, and nothing learnt,
  /// if the report is not over or not finite.
  bool learn(const StrikePlan& plan, const ContactReport& report) noexcept;

  /// A finished blow once more, with all of it at hand: where it left the head by fit_head(), or by the observer if too
  /// little was seen of it, and when it ended by that. Learns the rubber of the face.
  [[nodiscard]] SeenBlow look(const StrikePlan& plan, const ContactReport& report) noexcept;

  [[nodiscard]] double restitution() const noexcept { return restitution_; }    ///< 0..1
  [[nodiscard]] double nail_mass_kg() const noexcept { return nail_mass_kg_; }  ///< M*, may be infinite
  [[nodiscard]] double contact_duration_s() const noexcept { return contact_s_; }
  [[nodiscard]] double resistance_n(double depth_m) const noexcept;   ///< R(d) = R0 + R1 d, fitted, >= 0
  [[nodiscard]] double depth_m() const noexcept { return depth_m_; }  ///< driven so far
  [[nodiscard]] int blows() const noexcept { return blows_; }
  [[nodiscard]] const RubberBelief& rubber() const noexcept { return rubber_; }
  /// What the next blow is predicted against: the rubber as it was found, on a nail that stands. One that gives way
  /// lets drives press for long, and newton seconds that are pressed are not struck: selections compared so lean on the
  /// nail.
  [[nodiscard]] ContactLaw contact_law(double room_m) const noexcept;
  /// How far past the head the reference should go for the nail to move by `wanted_m` in the next blow.
  [[nodiscard]] double follow_through_for(double wanted_m) const noexcept;

 private:
  StrikeEstimateConfig config_;
  RubberBelief rubber_;
  double restitution_ = 1.0;
  double nail_mass_kg_ = std::numeric_limits<double>::infinity();
  double contact_s_;
  double depth_m_ = 0.0;
  int blows_ = 0;
  // Sums of the line fit R over d.
  double s1_ = 0.0, sd_ = 0.0, sdd_ = 0.0, sr_ = 0.0, sdr_ = 0.0;
  // penetration = follow-through + offset
  double offset_m_ = 0.0;
  bool has_offset_ = false;
};

}  // namespace mrr::sup
