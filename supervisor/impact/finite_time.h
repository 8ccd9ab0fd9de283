// Room: supervisor/impact. The instant model and its closed-form corrections for a contact that lasts. May touch
// common/, supervisor/model. Allocates nothing, throws nothing.
#pragma once

#include "supervisor/impact/prediction.h"

namespace mrr::sup {

/// Precondition: validate_input() has nothing against it; predict() sees to that. `corrected`: with what control,
/// gravity and friction do during the contact; without: the impulse of an instant.
[[nodiscard]] Prediction finite_time_blow(const StrikeArm& arm, const PredictInput& input, bool corrected) noexcept;

}  // namespace mrr::sup
