#include "supervisor/model/kdl_reference.h"

#include <algorithm>
#include <cmath>
#include <kdl/chain.hpp>
#include <kdl/chaindynparam.hpp>
#include <kdl/chainfksolverpos_recursive.hpp>
#include <kdl/chainidsolver_recursive_newton_euler.hpp>
#include <kdl/chainjnttojacsolver.hpp>
#include <limits>
#include <stdexcept>

#include "common/core/random.h"

namespace mrr::sup {
namespace {

KDL::Vector to_kdl(const Eigen::Vector3d& v) { return {v.x(), v.y(), v.z()}; }

KDL::Frame to_kdl(const FrameOffset& offset) {
  const Eigen::Matrix3d& R = offset.rotation;
  return {KDL::Rotation(R(0, 0), R(0, 1), R(0, 2), R(1, 0), R(1, 1), R(1, 2), R(2, 0), R(2, 1), R(2, 2)),
          to_kdl(offset.translation_m)};
}

KDL::JntArray to_kdl(const JointVector& v) {
  KDL::JntArray array(static_cast<unsigned>(v.size()));
  for (unsigned i = 0; i < array.rows(); ++i) array(i) = v[static_cast<Eigen::Index>(i)];
  return array;
}

JointVector from_kdl(const KDL::JntArray& array) {
  JointVector v(static_cast<Eigen::Index>(array.rows()));
  for (unsigned i = 0; i < array.rows(); ++i) v[static_cast<Eigen::Index>(i)] = array(i);
  return v;
}

/// KDL's solvers tell failures by their return value; E_DEGRADED is positive and no failure.
void check(int status) {
  if (status < 0) throw std::runtime_error("KDL solver failed with code " + std::to_string(status));
}

KDL::Chain make_chain(const RobotDescription& robot) {
  KDL::Chain chain;
  for (const JointDescription& joint : robot.joints) {
    const KDL::Frame to_joint = to_kdl(joint.offset);
    const LinkDescription& link = joint.link;
    const Eigen::Matrix3d& I = link.inertia_kg_m2;
    const KDL::RigidBodyInertia inertia(link.mass_kg, to_kdl(link.com_m),
                                        KDL::RotationalInertia(I(0, 0), I(1, 1), I(2, 2), I(0, 1), I(0, 2), I(1, 2)));
    chain.addSegment(KDL::Segment(
        link.name, KDL::Joint(joint.name, to_joint.p, to_joint.M * to_kdl(joint.axis), KDL::Joint::RotAxis), to_joint,
        inertia));
  }
  chain.addSegment(KDL::Segment("face", KDL::Joint("face", KDL::Joint::Fixed), to_kdl(robot.hammer.face)));
  return chain;
}

}  // namespace

// The solvers keep references to the chain, so it is declared first and never moved.
struct KdlReference::Impl {
  explicit Impl(const RobotDescription& robot)
      : chain(make_chain(robot)),
        dynamics(chain, to_kdl(robot.gravity_m_s2)),
        position(chain),
        jacobian(chain),
        newton_euler(chain, to_kdl(robot.gravity_m_s2)) {}
  KDL::Chain chain;
  KDL::ChainDynParam dynamics;
  KDL::ChainFkSolverPos_recursive position;
  KDL::ChainJntToJacSolver jacobian;
  KDL::ChainIdSolver_RNE newton_euler;
};

KdlReference::KdlReference(const RobotDescription& robot) : impl_(std::make_unique<Impl>(robot)) {}
KdlReference::~KdlReference() = default;

Pose KdlReference::face_pose(const JointVector& q) const {
  KDL::Frame frame;
  check(impl_->position.JntToCart(to_kdl(q), frame));
  Pose pose;
  for (int row = 0; row < 3; ++row) {
    pose.position_m[row] = frame.p(row);
    for (int column = 0; column < 3; ++column) pose.rotation(row, column) = frame.M(row, column);
  }
  return pose;
}

Jacobian KdlReference::jacobian(const JointVector& q) const {
  KDL::Jacobian jacobian(static_cast<unsigned>(q.size()));
  check(impl_->jacobian.JntToJac(to_kdl(q), jacobian));
  return jacobian.data;
}

JointMatrix KdlReference::mass_matrix(const JointVector& q) const {
  KDL::JntSpaceInertiaMatrix mass(static_cast<unsigned>(q.size()));
  check(impl_->dynamics.JntToMass(to_kdl(q), mass));
  return mass.data;
}

JointVector KdlReference::gravity(const JointVector& q) const {
  KDL::JntArray torque(static_cast<unsigned>(q.size()));
  check(impl_->dynamics.JntToGravity(to_kdl(q), torque));
  return from_kdl(torque);
}

JointVector KdlReference::coriolis(const JointVector& q, const JointVector& qd) const {
  KDL::JntArray torque(static_cast<unsigned>(q.size()));
  check(impl_->dynamics.JntToCoriolis(to_kdl(q), to_kdl(qd), torque));
  return from_kdl(torque);
}

JointVector KdlReference::inverse_dynamics(const JointVector& q, const JointVector& qd, const JointVector& qdd) const {
  KDL::JntArray torque(static_cast<unsigned>(q.size()));
  const KDL::Wrenches no_load(impl_->chain.getNrOfSegments(), KDL::Wrench::Zero());
  check(impl_->newton_euler.CartToJnt(to_kdl(q), to_kdl(qd), to_kdl(qdd), no_load, torque));
  return from_kdl(torque);
}

double model_self_check(const RobotDescription& robot) {
  const Chain chain(robot);
  const KdlReference kdl(robot);
  double worst = 0.0;
  const auto compare = [&worst](const auto& ours, const auto& theirs) {
    const double difference = (ours - theirs).cwiseAbs().maxCoeff() / std::max(1.0, theirs.cwiseAbs().maxCoeff());
    // Infinity if not finite: NaN must not look healthy.
    if (!(difference <= worst))
      worst = std::isfinite(difference) ? difference : std::numeric_limits<double>::infinity();
  };
  constexpr int kStates = 5;
  Random random(1);
  JointVector q = JointVector::Zero(chain.dof());
  JointVector qd = JointVector::Zero(chain.dof());
  JointVector qdd = JointVector::Zero(chain.dof());
  for (int state = 0; state < kStates; ++state) {  // the first one is the home pose
    const Pose face = chain.face_pose(q);
    const Pose kdl_face = kdl.face_pose(q);
    compare(face.position_m, kdl_face.position_m);
    compare(face.rotation, kdl_face.rotation);
    compare(chain.jacobian(q), kdl.jacobian(q));
    compare(chain.mass_matrix(q), kdl.mass_matrix(q));
    compare(chain.gravity(q), kdl.gravity(q));
    compare(JointVector(chain.bias(q, qd) - chain.gravity(q)), kdl.coriolis(q, qd));
    compare(chain.inverse_dynamics(q, qd, qdd), kdl.inverse_dynamics(q, qd, qdd));
    for (int i = 0; i < chain.dof(); ++i) {
      q[i] = random.uniform(-3.0, 3.0);
      qd[i] = random.uniform(-2.0, 2.0);
      qdd[i] = random.uniform(-10.0, 10.0);
    }
  }
  return worst;
}

}  // namespace mrr::sup
