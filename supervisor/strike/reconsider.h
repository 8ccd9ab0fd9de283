// Room: supervisor/strike. Which joints go passive, by what the blow really does to them: selections that a planner has
// shortlisted by the impulse of an instant, weighed again over the contact. May touch common/, supervisor/impact.
// Allocates nothing, throws nothing.
#pragma once

#include <cstdint>
#include <span>

#include "supervisor/impact/prediction.h"

namespace mrr::sup {

/// One selection as predicted over the contact.
struct Reconsidered {
  std::uint32_t passive = 0;        ///< bit i = joint i
  double peak_ratio = 0.0;          ///< largest peak torque over rated torque of any joint
  double peak_ratio_per_n_s = 0.0;  ///< ... per newton second on the nail: smallest is best
  bool feasible = false;            ///< predicted, hits, and no joint above its repeated peak
  Prediction prediction;
};

/// Peaks of one blow against what the gears stand. `rated_nm`, `repeated_nm`: one entry per joint.
[[nodiscard]] Reconsidered reconsider(const StrikeArm& arm, const PredictInput& input, PredictionModel model,
                                      std::span<const double> rated_nm, std::span<const double> repeated_nm) noexcept;

/// Weighs `selections` (each a mask of passive joints) with the blow of `input`, all by the finite-time model, then the
/// `resolved_at_most` best of those by the resolved one. Returns the best; within `tie` of it the one with fewer
/// passive joints. An empty or wholly infeasible list gives `feasible == false`. Joints that `input` holds stay held.
[[nodiscard]] Reconsidered best_selection(const StrikeArm& arm, const PredictInput& input,
                                          std::span<const std::uint32_t> selections, int resolved_at_most, double tie,
                                          std::span<const double> rated_nm,
                                          std::span<const double> repeated_nm) noexcept;

}  // namespace mrr::sup
