// Room: supervisor/impact. One blow under every selection of passive joints at once: what a planner weighs.
// May touch common/ and supervisor/model. Allocates nothing, throws nothing.
#pragma once

#include <array>
#include <cstdint>

#include "supervisor/impact/external.h"

namespace mrr::sup {

/// A blow under one selection, per newton second on the face along the normal.
struct SelectionBlow {
  std::uint32_t passive = 0;      ///< bit i = joint i free; the others carry their extra inertia
  double mobility_per_kg = 0.0;   ///< n^T W n; the effective mass is one over it
  JointVector delta_qd_per_n_s;   ///< jump of joint speeds, (31)
  JointVector axis_nm_s_per_n_s;  ///< what the transmissions carry, signed
  /// P for an approach at `speed_m_s`, (36); infinite if nothing yields.
  [[nodiscard]] double impulse_n_s(double speed_m_s, double restitution, double nail_mass_kg) const noexcept;
};

/// H^-1 J^T n for every S from one factorisation: letting an active joint add its inertia k is the rank-one change
/// G - k/(1 + k G_ii) g_i g_i^T of G = H^-1. Joints become active one after the other down a binary tree, so no error
/// adds up over more than dof() steps, and a leaf costs O(n^2). All 2^n are exact; nothing is left out.
class SelectionSweep {
 public:
  /// `extra_inertia_kg_m2`: of each joint while active, >= 0. `usable()` is false if the input is not (as predict()).
  SelectionSweep(const Chain& chain, const ChainPose& pose, const Eigen::Vector3d& normal,
                 const std::array<double, kMaxJoints>& extra_inertia_kg_m2, RotorModel rotors = RotorModel::sym,
                 Formulation formulation = Formulation::corrected) noexcept;

  [[nodiscard]] bool usable() const noexcept { return usable_; }
  /// J^T n: joint speeds to the face's speed along the normal, m.
  [[nodiscard]] const JointVector& lever_m() const noexcept { return lever_; }

  /// Calls `visit(const SelectionBlow&)` for every selection that contains `fixed` and differs from it only by joints
  /// of `candidates`: 2^(number of candidates) times, most passive joints first.
  template <typename Visit>
  void for_each(std::uint32_t candidates, std::uint32_t fixed, Visit&& visit) const {
    candidates &= all() & ~fixed;
    SelectionBlow blow;
    Node root{inverse_, free_};
    for (int i = 0; i < dof_; ++i) {
      if (((candidates | fixed) >> i & 1U) == 0) activate(root, i, 0);
    }
    descend(root, 0, candidates, (fixed | candidates) & all(), blow, visit);
  }
  /// One selection alone.
  [[nodiscard]] SelectionBlow at(std::uint32_t passive) const noexcept;
  /// Joint `joint` held, the others free: its worst case.
  [[nodiscard]] SelectionBlow held(int joint) const noexcept;

 private:
  struct Node {
    JointMatrix inverse;  ///< H^-1 of the selection so far; columns of joints already decided are stale
    JointVector x;        ///< H^-1 J^T n
  };
  [[nodiscard]] std::uint32_t all() const noexcept { return (1U << dof_) - 1U; }
  /// Joint i becomes active; of the inverse only columns from `first` on are kept up.
  void activate(Node& node, int i, int first) const noexcept;
  void fill(const JointVector& x, std::uint32_t passive, SelectionBlow& blow) const noexcept;

  template <typename Visit>
  void descend(const Node& node, int i, std::uint32_t candidates, std::uint32_t passive, SelectionBlow& blow,
               Visit& visit) const {
    while (i < dof_ && (candidates >> i & 1U) == 0) ++i;
    if (i >= dof_) {
      fill(node.x, passive, blow);
      visit(static_cast<const SelectionBlow&>(blow));
      return;
    }
    descend(node, i + 1, candidates, passive, blow, visit);
    Node active = node;
    activate(active, i, i + 1);
    descend(active, i + 1, candidates, passive & ~(1U << i), blow, visit);
  }

  int dof_;
  bool usable_ = false;
  JointVector lever_;
  JointVector extra_;
  JointMatrix inverse_;  // all joints free
  JointVector free_;
  // Axis impulses are through_ + per_jump_ delta_qd.
  JointVector through_;
  JointMatrix per_jump_;
};

}  // namespace mrr::sup
