// Room: supervisor/strike. Where a nail's head is after a blow, and how soft the hammer's face is: from forces and
// heights while the face leaves. May touch the contact observer. Allocates nothing, throws nothing.
#pragma once

#include <span>

#include "supervisor/strike/contact_observer.h"

namespace mrr::sup {

/// Rubber of the hammer's face, F = k d (1 + c d'), and how well it is known (one standard deviation).
struct RubberBelief {
  double stiffness_n_m = 8000.0;  ///< k
  double stiffness_share = 0.2;   ///< standard deviation of ln k
  double damping_s_m = 1.8;       ///< c
  double damping_sd_s_m = 0.8;    ///< standard deviation of c
};

struct HeadFit {
  bool usable = false;
  double height_m = 0.0;     ///< of the head, as ContactPoint has it
  double height_sd_m = 0.0;  ///< one standard deviation
  RubberBelief rubber;       ///< what was believed and what this blow said, together
};

/// The head at rest under the face that leaves it: least squares of the forces against F = max(0, k d (1 + c d')),
/// d = head - face, over `leaving`, from the deepest point on; k and c are found too, near what is believed of them.
/// `noise_n`: standard deviation of one force, > 0. Not usable with fewer than three points or none in contact.
[[nodiscard]] HeadFit fit_head(std::span<const ContactPoint> leaving, double noise_n, const RubberBelief& believed,
                               double first_guess_m) noexcept;

}  // namespace mrr::sup
