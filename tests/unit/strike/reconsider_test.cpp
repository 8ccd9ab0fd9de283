// The selection with the lowest peaks over the contact, against trying each.
#include "supervisor/strike/reconsider.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <filesystem>

namespace mrr::sup {
namespace {

constexpr std::array<double, 3> kRated{47.0, 16.0, 16.0};
constexpr std::array<double, 3> kRepeated{110.0, 37.0, 37.0};
constexpr std::array<std::uint32_t, 4> kSelections{0U, 2U, 4U, 6U};

PredictInput blow() {
  PredictInput in;
  in.q = JointVector::Zero(3);
  in.q << 0.0, 0.05, -0.1;
  in.qd = JointVector::Zero(3);
  in.qd[1] = -0.62;
  in.joints.fill(JointHold::controlled);
  return in;
}

StrikeArm reference_arm() { return StrikeArm(load_robot(std::filesystem::path(MRR_SOURCE_DIR) / "robots" / "mrr3")); }

PredictInput with(std::uint32_t passive) {
  PredictInput in = blow();
  for (std::size_t i = 0; i < 3; ++i) {
    if ((passive >> i & 1U) != 0) in.joints[i] = JointHold::free;
  }
  return in;
}

TEST(Reconsider, TakesTheSelectionWithTheLowestPeaks) {
  const StrikeArm arm = reference_arm();
  double least = 1e9;
  std::uint32_t expected = 0;
  for (const std::uint32_t passive : kSelections) {
    const Reconsidered r = reconsider(arm, with(passive), PredictionModel::resolved, kRated, kRepeated);
    ASSERT_TRUE(r.feasible) << passive;
    EXPECT_EQ(r.passive, passive);
    EXPECT_NEAR(r.peak_ratio_per_n_s * r.prediction.impulse_n_s, r.peak_ratio, 1e-12);
    if (r.peak_ratio_per_n_s < least) {
      least = r.peak_ratio_per_n_s;
      expected = passive;
    }
  }
  const Reconsidered best = best_selection(arm, blow(), kSelections, 4, 0.0, kRated, kRepeated);
  ASSERT_TRUE(best.feasible);
  EXPECT_EQ(best.passive, expected);
  EXPECT_DOUBLE_EQ(best.peak_ratio_per_n_s, least);
  EXPECT_NE(expected, 0U);  // on this blow letting go helps
  // A tie as wide as everything goes to the fewest passive joints.
  EXPECT_EQ(best_selection(arm, blow(), kSelections, 4, 100.0, kRated, kRepeated).passive, 0U);
}

TEST(Reconsider, RefusesWhatTheGearsDoNotStandAndWhatIsNotThere) {
  const StrikeArm arm = reference_arm();
  EXPECT_FALSE(best_selection(arm, blow(), {}, 3, 0.02, kRated, kRepeated).feasible);
  constexpr std::array<double, 3> kNothing{0.1, 0.1, 0.1};
  EXPECT_FALSE(best_selection(arm, blow(), kSelections, 3, 0.02, kRated, kNothing).feasible);
  PredictInput unusable = blow();
  unusable.q[1] = std::nan("");
  EXPECT_FALSE(best_selection(arm, unusable, kSelections, 3, 0.02, kRated, kRepeated).feasible);
}

}  // namespace
}  // namespace mrr::sup
