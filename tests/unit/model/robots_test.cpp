// The example robots as they are loaded from their files.
#include <gtest/gtest.h>

#include "supervisor/model/kdl_reference.h"
#include "tests/unit/model/arms.h"

namespace mrr::sup {
namespace {

class Robots : public testing::TestWithParam<const char*> {};

TEST_P(Robots, ModelAgreesWithKdl) {
  const RobotDescription robot = load_robot(std::string(MRR_SOURCE_DIR "/robots/") + GetParam());
  EXPECT_LT(model_self_check(robot), 1e-11);
}

INSTANTIATE_TEST_SUITE_P(Examples, Robots, testing::Values("mrr3", "arm7"),
                         [](const auto& which) { return which.param; });

TEST(Mrr3, IsTheReferenceArm) {
  const Chain ours(load_robot(MRR_SOURCE_DIR "/robots/mrr3"));
  const Chain reference(test::reference_arm().robot);
  Random random(1);
  for (int k = 0; k < 20; ++k) {
    const JointVector q = test::random_vector(random, 3, -3.0, 3.0);
    const JointVector qd = test::random_vector(random, 3, -2.0, 2.0);
    EXPECT_LT((ours.mass_matrix(q) - reference.mass_matrix(q)).cwiseAbs().maxCoeff(), 1e-12);
    EXPECT_LT((ours.bias(q, qd) - reference.bias(q, qd)).cwiseAbs().maxCoeff(), 1e-12);
    EXPECT_LT((ours.reflected_inertia(q) - reference.reflected_inertia(q)).cwiseAbs().maxCoeff(), 1e-12);
    EXPECT_LT((ours.face_pose(q).position_m - reference.face_pose(q).position_m).norm(), 1e-12);
  }
}

}  // namespace
}  // namespace mrr::sup
