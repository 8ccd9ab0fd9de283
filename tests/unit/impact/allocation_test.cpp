// Nothing of the model or of a prediction touches the heap.
#include "tests/unit/model/allocation_count.h"

#include <gtest/gtest.h>

#include "supervisor/impact/external.h"
#include "supervisor/impact/internal.h"
#include "supervisor/impact/limits.h"
#include "supervisor/impact/measures.h"
#include "tests/unit/model/arms.h"

namespace mrr::sup {
namespace {

template <typename Function>
long allocations_of(Function function) {
  const long before = test::allocations.load();
  function();
  return test::allocations.load() - before;
}

class Heap : public testing::TestWithParam<int> {
 protected:
  void SetUp() override {
    if (!test::kCountsAllocations) GTEST_SKIP() << "the address sanitizer owns malloc";
  }
};

TEST(HeapCounter, SeesAllocations) {
  if (!test::kCountsAllocations) GTEST_SKIP() << "the address sanitizer owns malloc";
  double* volatile kept = nullptr;
  EXPECT_GE(allocations_of([&] { kept = new double(1.0); }), 1);
  delete kept;
  Eigen::VectorXd vector;
  EXPECT_GE(allocations_of([&] { vector.resize(100); }), 1);
}

TEST_P(Heap, IsNotTouched) {
  Random random(static_cast<std::uint64_t>(GetParam()));
  const int n = GetParam();
  const Chain chain(test::random_robot(random, n));
  const JointVector q = test::random_vector(random, n, -3.0, 3.0);
  const JointVector qd = test::random_vector(random, n, -1.0, 1.0);
  const JointVector qdd = test::random_vector(random, n, -9.0, 9.0);
  const std::array<FrictionDescription, kMaxJoints> friction{};
  double sink = 0.0;
  EXPECT_EQ(allocations_of([&] {
              const ChainPose pose = chain.pose(q);
              sink += chain.face_pose(q).position_m.x() + chain.jacobian(q).sum() + chain.mass_matrix(q).sum() +
                      chain.reflected_inertia(q).sum() + chain.gravity(q).sum() + chain.bias(q, qd).sum() +
                      chain.inverse_dynamics(q, qd, qdd).sum() + chain.com_jacobian(pose, n - 1).sum();
            }),
            0)
      << "model";
  EXPECT_EQ(allocations_of([&] {
              ImpactInput input;
              input.q = q;
              input.qd = qd;
              for (const RotorModel rotors : {RotorModel::diag, RotorModel::lower, RotorModel::sym}) {
                input.rotor_model = rotors;
                sink += predict(chain, input).impulse_n_s;
                input.qd = -input.qd;
                input.joints[0] = {.hold = JointHold::controlled, .extra_inertia_kg_m2 = 1.0};
                input.joints[static_cast<std::size_t>(n / 2)].hold = JointHold::held;
                sink += predict(chain, input).impulse_n_s;
              }
              sink += finite_time_correction_nm_s(chain, friction, q, qd, qdd, 0.05).sum();
            }),
            0)
      << "prediction";
  EXPECT_EQ(allocations_of([&] {
              const ChainPose pose = chain.pose(q);
              const Eigen::Matrix3d W = linear_mobility(chain, pose);
              sink += dynamic_impact_ellipsoid(W).semi_axes[2] + generalised_impact_ellipsoid(W).semi_axes[2] +
                      internal_impact_measure(chain, pose, chain.reach_m()).w_ii +
                      impulse_map(chain, pose, RotorModel::sym).sum();
            }),
            0)
      << "measures";
  EXPECT_FALSE(std::isnan(sink));
}

INSTANTIATE_TEST_SUITE_P(Dof, Heap, testing::Values(1, 2, 3, 7, kMaxJoints));

}  // namespace
}  // namespace mrr::sup
