// Room: supervisor/impact. The matrices of the reference, (48)-(53), written out: a second way to the internal
// impulses, for tests. May touch common/ and supervisor/model. Allocates; not for the cycle.
#pragma once

#include <Eigen/Core>

#include "supervisor/impact/external.h"

namespace mrr::sup {

/// A, B, D, L of (48)-(53) with every vector in the base frame (R_{i+1}^i = I there), all joints free.
/// Rows: forces of links 1..n, then torques; columns of B, D, L: (force; torque) on the face.
struct DenseImpulseModel {
  Eigen::MatrixXd A, B, D, L;
};
[[nodiscard]] DenseImpulseModel dense_impulse_model(const Chain& chain, const JointVector& q, RotorModel rotors,
                                                    Formulation formulation = Formulation::corrected);

}  // namespace mrr::sup
