#include "common/robot/urdf_chain.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <numbers>
#include <sstream>
#include <vector>

#include "common/core/random.h"
#include "tests/unit/robot/sentence.h"

namespace mrr {
namespace {

using test::complaint;
using test::expect_one_sentence;
using testing::HasSubstr;

Eigen::Vector3d random_vector(Random& random, double size) {
  const double x = random.uniform(-size, size);
  const double y = random.uniform(-size, size);
  const double z = random.uniform(-size, size);
  return {x, y, z};
}

Eigen::Matrix3d rotation_rpy(const Eigen::Vector3d& rpy) {
  return (Eigen::AngleAxisd(rpy.z(), Eigen::Vector3d::UnitZ()) * Eigen::AngleAxisd(rpy.y(), Eigen::Vector3d::UnitY()) *
          Eigen::AngleAxisd(rpy.x(), Eigen::Vector3d::UnitX()))
      .toRotationMatrix();
}

/// A cloud of point masses: its mass, centre and inertia are sums over points, an oracle without parallel-axis formula.
struct Cloud {
  std::vector<double> mass_kg;
  std::vector<Eigen::Vector3d> at_m;

  static Cloud random(Random& random) {
    Cloud cloud;
    for (int i = 0; i < 6; ++i) {
      cloud.mass_kg.push_back(random.uniform(0.1, 2.0));
      cloud.at_m.push_back(random_vector(random, 0.3));
    }
    return cloud;
  }
  void add(const Cloud& other, const FrameOffset& pose) {
    for (std::size_t i = 0; i < other.at_m.size(); ++i) {
      mass_kg.push_back(other.mass_kg[i]);
      at_m.push_back(pose.translation_m + pose.rotation * other.at_m[i]);
    }
  }
  [[nodiscard]] LinkDescription body(const std::string& name) const {
    LinkDescription b;
    b.name = name;
    for (std::size_t i = 0; i < at_m.size(); ++i) {
      b.mass_kg += mass_kg[i];
      b.com_m += mass_kg[i] * at_m[i];
    }
    b.com_m /= b.mass_kg;
    for (std::size_t i = 0; i < at_m.size(); ++i) {
      const Eigen::Vector3d r = at_m[i] - b.com_m;
      b.inertia_kg_m2 += mass_kg[i] * (r.squaredNorm() * Eigen::Matrix3d::Identity() - r * r.transpose());
    }
    return b;
  }
};

void expect_same_body(const LinkDescription& a, const LinkDescription& b) {
  EXPECT_NEAR(a.mass_kg, b.mass_kg, 1e-12 * b.mass_kg);
  EXPECT_LT((a.com_m - b.com_m).norm(), 1e-12);
  EXPECT_LT((a.inertia_kg_m2 - b.inertia_kg_m2).norm(), 1e-12 * (1.0 + b.inertia_kg_m2.norm()));
}

TEST(MergeBodies, EqualsThePointMassesItStandsFor) {
  Random random(1);
  for (int trial = 0; trial < 500; ++trial) {
    const int count = 1 + trial % 5;
    std::vector<PlacedBody> bodies;
    Cloud all;
    for (int i = 0; i < count; ++i) {
      const Cloud cloud = Cloud::random(random);
      const FrameOffset pose{rotation_rpy(random_vector(random, 3.0)), random_vector(random, 1.0)};
      bodies.push_back({pose, cloud.body("part")});
      all.add(cloud, pose);
    }
    const LinkDescription merged = merge_bodies("whole", bodies);
    expect_same_body(merged, all.body("whole"));
    EXPECT_FALSE(impossible_body(merged).has_value());
  }
}

TEST(MergeBodies, OfNothingHasNoMass) { EXPECT_EQ(merge_bodies("empty", {}).mass_kg, 0.0); }

TEST(ImpossibleBody, FindsWhatNoBodyCanBe) {
  LinkDescription body{"b", 1.0, Eigen::Vector3d::Zero(), Eigen::Vector3d(0.25, 0.017, 0.25).asDiagonal()};
  EXPECT_FALSE(impossible_body(body).has_value()) << "the reference arm's link";
  body.inertia_kg_m2 = Eigen::Vector3d(0.5, 0.2, 0.3).asDiagonal();
  EXPECT_FALSE(impossible_body(body).has_value()) << "a flat plate, on the very edge";
  body.inertia_kg_m2 = Eigen::Vector3d(0.51, 0.2, 0.3).asDiagonal();
  EXPECT_TRUE(impossible_body(body).has_value());
  body.inertia_kg_m2 = Eigen::Vector3d(0.2, 0.2, 0.0).asDiagonal();
  EXPECT_TRUE(impossible_body(body).has_value()) << "a line";
  body.inertia_kg_m2 = Eigen::Vector3d(0.2, -0.2, 0.1).asDiagonal();
  EXPECT_TRUE(impossible_body(body).has_value());
  body.inertia_kg_m2 = Eigen::Matrix3d::Identity();
  for (double mass : {0.0, -1.0, 1e9, std::numeric_limits<double>::quiet_NaN()}) {
    body.mass_kg = mass;
    EXPECT_TRUE(impossible_body(body).has_value()) << mass;
  }
  body.mass_kg = 1.0;
  body.inertia_kg_m2(0, 0) = std::numeric_limits<double>::quiet_NaN();
  EXPECT_TRUE(impossible_body(body).has_value());
}

std::string triple(const Eigen::Vector3d& v) {
  std::ostringstream text;
  text.precision(17);
  text << v.x() << " " << v.y() << " " << v.z();
  return text.str();
}

/// An <inertial> whose own frame is turned by `rpy`, to see that the reader turns it back.
std::string inertial(const LinkDescription& body, const Eigen::Vector3d& rpy) {
  const Eigen::Matrix3d R = rotation_rpy(rpy);
  const Eigen::Matrix3d I = R.transpose() * body.inertia_kg_m2 * R;
  std::ostringstream text;
  text.precision(17);
  text << "<inertial><origin xyz='" << triple(body.com_m) << "' rpy='" << triple(rpy) << "'/><mass value='"
       << body.mass_kg << "'/><inertia ixx='" << I(0, 0) << "' ixy='" << I(0, 1) << "' ixz='" << I(0, 2) << "' iyy='"
       << I(1, 1) << "' iyz='" << I(1, 2) << "' izz='" << I(2, 2) << "'/></inertial>";
  return text.str();
}

TEST(UrdfChain, FixedJointsKeepMassCentreAndInertia) {
  Random random(2);
  const test::SpoiledRobot robot;
  for (int trial = 0; trial < 60; ++trial) {
    // base -fixed- pedestal -revolute- arm -fixed- part_0 -fixed- part_1 ..., part_3 hanging on the arm itself.
    std::ostringstream urdf;
    const Eigen::Vector3d pedestal_xyz = random_vector(random, 1.0);
    const Eigen::Vector3d pedestal_rpy = random_vector(random, 3.0);
    const Eigen::Vector3d joint_xyz = random_vector(random, 1.0);
    const Eigen::Vector3d joint_rpy = random_vector(random, 3.0);
    const Eigen::Vector3d axis = random_vector(random, 1.0);
    Cloud all;
    Cloud cloud = Cloud::random(random);
    all.add(cloud, {});
    urdf << "<robot name='r'><link name='base'/><link name='pedestal'/><joint name='p' type='fixed'><parent "
            "link='base'/>"
         << "<child link='pedestal'/><origin xyz='" << triple(pedestal_xyz) << "' rpy='" << triple(pedestal_rpy)
         << "'/></joint><joint name='j' type='revolute'><parent link='pedestal'/><child link='arm'/><origin xyz='"
         << triple(joint_xyz) << "' rpy='" << triple(joint_rpy) << "'/><axis xyz='" << triple(axis)
         << "'/><limit lower='-1' upper='1' velocity='1' effort='1'/></joint><link name='arm'>"
         << inertial(cloud.body("arm"), random_vector(random, 3.0)) << "</link>";
    FrameOffset pose;
    FrameOffset last;
    for (int i = 0; i < 4; ++i) {
      const Eigen::Vector3d xyz = random_vector(random, 0.5);
      const Eigen::Vector3d rpy = random_vector(random, 3.0);
      const bool on_arm = i == 3;
      last = compose(on_arm ? FrameOffset{} : pose, {rotation_rpy(rpy), xyz});
      if (!on_arm) pose = last;
      urdf << "<joint name='f" << i << "' type='fixed'><parent link='"
           << (i == 0 || on_arm ? "arm" : "part_" + std::to_string(i - 1)) << "'/><child link='part_" << i
           << "'/><origin xyz='" << triple(xyz) << "' rpy='" << triple(rpy) << "'/></joint><link name='part_" << i
           << "'>";
      if (i != 1) {  // a bare frame in between has no mass
        cloud = Cloud::random(random);
        all.add(cloud, last);
        urdf << inertial(cloud.body("part"), random_vector(random, 3.0));
      }
      urdf << "</link>";
    }
    urdf << "</robot>";
    robot.set_text("robot.urdf", urdf.str());

    const UrdfChain chain = read_urdf_chain(robot.directory() / "robot.urdf");
    ASSERT_EQ(chain.joints.size(), 1U);
    const JointDescription& joint = chain.joints.front();
    expect_same_body(joint.link, all.body("arm"));
    const FrameOffset offset =
        compose({rotation_rpy(pedestal_rpy), pedestal_xyz}, {rotation_rpy(joint_rpy), joint_xyz});
    EXPECT_LT((joint.offset.rotation - offset.rotation).norm(), 1e-12);
    EXPECT_LT((joint.offset.translation_m - offset.translation_m).norm(), 1e-12);
    EXPECT_LT((joint.axis - axis.normalized()).norm(), 1e-12);
    EXPECT_EQ(chain.links.at("pedestal").carrier, -1);
    EXPECT_EQ(chain.links.at("part_3").carrier, 0);
    EXPECT_LT((chain.links.at("part_3").pose.translation_m - last.translation_m).norm(), 1e-12);
    EXPECT_LT((chain.links.at("part_2").pose.rotation - pose.rotation).norm(), 1e-12);
  }
}

/// n revolute joints in a row.
std::string row_of_joints(int n) {
  std::ostringstream urdf;
  urdf << "<robot name='row'><link name='l0'/>";
  for (int i = 1; i <= n; ++i) {
    urdf << "<link name='l" << i
         << "'><inertial><mass value='1'/><inertia ixx='1' ixy='0' ixz='0' iyy='1' iyz='0' izz='1'/>"
         << "</inertial></link><joint name='j" << i << "' type='revolute'><parent link='l" << i - 1
         << "'/><child link='l" << i
         << "'/><axis xyz='0 0 2'/><limit lower='-1' upper='1' velocity='1' effort='1'/></joint>";
  }
  urdf << "</robot>";
  return urdf.str();
}

TEST(UrdfChain, SixteenJointsAreTheMost) {
  const test::SpoiledRobot robot;
  const auto read = [&](int n) {
    robot.set_text("robot.urdf", row_of_joints(n));
    return read_urdf_chain(robot.directory() / "robot.urdf");
  };
  EXPECT_EQ(read(1).joints.size(), 1U);
  const UrdfChain most = read(kMaxJoints);
  ASSERT_EQ(most.joints.size(), static_cast<std::size_t>(kMaxJoints));
  for (int i = 0; i < kMaxJoints; ++i)
    EXPECT_EQ(most.joints[static_cast<std::size_t>(i)].name, std::string("j").append(std::to_string(i + 1)));
  const std::string text = complaint([&] { return read(kMaxJoints + 1); });
  expect_one_sentence(text);
  EXPECT_THAT(text, HasSubstr("joint 'j17' is one too many"));
}

}  // namespace
}  // namespace mrr
