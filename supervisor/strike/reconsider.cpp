#include "supervisor/strike/reconsider.h"

#include <algorithm>
#include <array>
#include <bit>

namespace mrr::sup {
namespace {

constexpr std::size_t kMostKept = 8;

PredictInput with(const PredictInput& input, std::uint32_t passive, int dof) noexcept {
  PredictInput in = input;
  for (int i = 0; i < dof; ++i) {
    JointHold& hold = in.joints[static_cast<std::size_t>(i)];
    if (hold != JointHold::held) hold = (passive >> i & 1U) != 0 ? JointHold::free : JointHold::controlled;
  }
  return in;
}

}  // namespace

Reconsidered reconsider(const StrikeArm& arm, const PredictInput& input, PredictionModel model,
                        std::span<const double> rated_nm, std::span<const double> repeated_nm) noexcept {
  Reconsidered out;
  const int n = arm.chain.dof();
  out.prediction = predict(arm, input, model);
  for (int i = 0; i < n; ++i) {
    if (input.joints[static_cast<std::size_t>(i)] == JointHold::free) out.passive |= 1U << i;
  }
  out.feasible = out.prediction.feasible && out.prediction.approaching && out.prediction.impulse_n_s > 0.0;
  if (!out.feasible) return out;
  for (int i = 0; i < n; ++i) {
    const double peak = out.prediction.peak_torque_nm[i];
    out.peak_ratio = std::max(out.peak_ratio, peak / rated_nm[static_cast<std::size_t>(i)]);
    if (!(peak <= repeated_nm[static_cast<std::size_t>(i)])) out.feasible = false;
  }
  out.peak_ratio_per_n_s = out.peak_ratio / out.prediction.impulse_n_s;
  return out;
}

Reconsidered best_selection(const StrikeArm& arm, const PredictInput& input, std::span<const std::uint32_t> selections,
                            int resolved_at_most, double tie, std::span<const double> rated_nm,
                            std::span<const double> repeated_nm) noexcept {
  struct Rough {
    std::uint32_t passive = 0;
    double ratio = 0.0;
  };
  std::array<Rough, kMostKept> kept{};
  std::size_t count = 0;
  const std::size_t most = std::min(kMostKept, static_cast<std::size_t>(std::max(resolved_at_most, 1)));
  for (const std::uint32_t passive : selections) {
    const Reconsidered r =
        reconsider(arm, with(input, passive, arm.chain.dof()), PredictionModel::finite_time, rated_nm, repeated_nm);
    if (!r.feasible) continue;
    // Insertion into a short sorted list.
    std::size_t k = count < most ? count++ : most;
    while (k > 0 && kept[k - 1].ratio > r.peak_ratio_per_n_s) {
      if (k < most) kept[k] = kept[k - 1];
      --k;
    }
    if (k < most) kept[k] = {passive, r.peak_ratio_per_n_s};
  }
  Reconsidered best;
  std::array<Reconsidered, kMostKept> close;
  for (std::size_t k = 0; k < count; ++k) {
    close[k] = reconsider(arm, with(input, kept[k].passive, arm.chain.dof()), PredictionModel::resolved, rated_nm,
                          repeated_nm);
    if (close[k].feasible && (!best.feasible || close[k].peak_ratio_per_n_s < best.peak_ratio_per_n_s)) best = close[k];
  }
  const double within = (1.0 + tie) * best.peak_ratio_per_n_s;
  for (std::size_t k = 0; k < count; ++k) {
    const bool fewer = std::popcount(close[k].passive) < std::popcount(best.passive);
    if (close[k].feasible && close[k].peak_ratio_per_n_s <= within && fewer) best = close[k];
  }
  return best;
}

}  // namespace mrr::sup
