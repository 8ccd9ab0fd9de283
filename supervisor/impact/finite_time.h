// Room: supervisor/impact. The instant model, and the finite-time one: constant pose, rigid transmissions, loops and
// friction over the contact. May touch common/, supervisor/model. Allocates nothing, throws nothing.
#pragma once

#include "supervisor/impact/prediction.h"

namespace mrr::sup {

/// Precondition of both: validate_input() has nothing against it; predict() sees to that.
[[nodiscard]] Prediction instant_blow(const StrikeArm& arm, const PredictInput& input) noexcept;
[[nodiscard]] Prediction finite_time_blow(const StrikeArm& arm, const PredictInput& input) noexcept;

}  // namespace mrr::sup
