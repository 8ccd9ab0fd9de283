// Room: supervisor/impact. The resolved model: a blow integrated in time. May touch common/, supervisor/model.
// Allocates nothing, throws nothing. Shares no code with the emulator, which it is measured against.
#pragma once

#include "supervisor/impact/prediction.h"

namespace mrr::sup {

/// Precondition: validate_input() has nothing against it; predict() sees to that.
[[nodiscard]] Prediction resolve_blow(const StrikeArm& arm, const PredictInput& input) noexcept;

}  // namespace mrr::sup
