// Room: supervisor/impact. What the supervisor does about a blow while it lasts: one set of figures for the cycle that
// does it and for the models that foresee it. May touch common/core only.
#pragma once

#include "common/core/time.h"

namespace mrr::sup {

/// A hammer face gives way by this much before a nail must move.
inline constexpr double kRubberGives_m = 0.006;
/// A face still faster than this share of the planned impact speed sinks: what is struck does not stop the arm.
inline constexpr double kStillFast = 0.8;
/// A joint with a shorter lever does not move the face along the nail.
inline constexpr double kLeastLever_m = 0.05;
/// A switch that is due this soon anyway is not pulled.
inline constexpr Duration kPullMargin = milliseconds(5);

}  // namespace mrr::sup
