// Room: supervisor/strike. Which joints go passive, by what the blow really does to them: selections predicted over the
// contact, ranked. May touch common/, supervisor/impact. Not for the cycle: allocates.
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <vector>

#include "supervisor/impact/prediction.h"

namespace mrr::sup {

/// One selection as predicted over the contact.
struct RankedSelection {
  std::uint32_t passive = 0;                             ///< bit i = joint i
  PredictionModel model = PredictionModel::finite_time;  ///< by which it was predicted
  double peak_ratio = 0.0;                               ///< largest peak torque over rated torque of any joint
  double peak_ratio_per_n_s = 0.0;                       ///< ... per newton second on the nail: smallest is best
  double impulse_n_s = 0.0;                              ///< on the nail
  double switch_lead_s = 0.0;                            ///< from the switch to the planned contact
  double passive_s = 0.0;                                ///< from the switch on
  int heaviest = 0;                                      ///< joint with the largest peak over rated
  double heaviest_nm = 0.0;                              ///< ... and that peak
  bool feasible = false;                                 ///< predicted, hits, and no joint above its repeated peak
};

/// What a selection may be compared by.
struct SelectionContest {
  const StrikeArm& arm;
  /// The blow with this selection: which joints, when they are let go and for how long. Nothing: not allowed.
  std::function<std::optional<PredictInput>(std::uint32_t passive)> blow;
  std::span<const double> rated_nm;     ///< one entry per joint
  std::span<const double> repeated_nm;  ///< one entry per joint
  std::uint32_t candidates = 0;         ///< joints that may be let go
  double tie = 0.02;                    ///< shares nearer than this are equal: fewer passive joints win
  int resolved_at_most = 8;             ///< selections predicted by the resolved model
  int enumerated_at_most = 10;          ///< candidates up to which every set is tried
};

/// One blow against what the gears stand.
[[nodiscard]] RankedSelection rank_selection(const SelectionContest& contest, const PredictInput& input,
                                             PredictionModel model);

/// Every allowed set of candidates, the best first. All are predicted by the resolved model if they are few enough,
/// else all by the finite-time model and the best of those by the resolved one; those come first. With more candidates
/// than are enumerated, sets are reached from `starts`, none and all by changing one joint at a time, the best first,
/// until all neighbours of the best are known. Within the tie of the best the one with fewest passive joints is first.
[[nodiscard]] std::vector<RankedSelection> rank_selections(const SelectionContest& contest,
                                                           std::span<const std::uint32_t> starts = {});

}  // namespace mrr::sup
