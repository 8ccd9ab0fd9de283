// The impulse of a blow on every joint: ours beside Pinocchio and KDL on the same arms and states. Results are checked
// equal first.

#include <dlfcn.h>
#include <fmt/format.h>

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <string>
#include <vector>

#include "common/core/random.h"
#include "supervisor/impact/external.h"
#include "supervisor/impact/prediction.h"
#include "supervisor/impact/selection.h"
#include "supervisor/model/kdl_reference.h"
#include "tests/bench/contest.h"
#include "tests/bench/impact/peer.h"
#include "tests/unit/model/arms.h"

namespace {

using namespace mrr;  // NOLINT: a program of its own

constexpr std::size_t kStates = bench::kCallsPerRound;
constexpr double kTolerance = 1e-9;

struct Peer {
  PeerCreate create = nullptr;
  PeerPredict predict = nullptr;
};

Peer open_peer(const char* path) {
  void* library = dlopen(path, RTLD_NOW | RTLD_LOCAL);
  if (library == nullptr) {
    fmt::print("Pinocchio is not beside it: {}\n", dlerror());
    return {};
  }
  return {reinterpret_cast<PeerCreate>(dlsym(library, "peer_create")),
          reinterpret_cast<PeerPredict>(dlsym(library, "peer_predict"))};
}

struct Case {
  explicit Case(RobotDescription r) : robot(std::move(r)), chain(robot), kdl(robot) {
    Random random(1, static_cast<std::uint64_t>(robot.dof()));
    for (std::size_t k = 0; k < kStates; ++k) {
      sup::ImpactInput& in = input[k];
      in.q.resize(robot.dof());
      in.qd.resize(robot.dof());
      for (double& x : in.q) x = random.uniform(-1.5, 1.5);
      for (double& x : in.qd) x = random.uniform(-1.0, 1.0);
      in.normal = test::random_unit(random);
      in.rotor_model = sup::RotorModel::diag;
      if (-in.normal.dot(chain.jacobian(in.q).topRows<3>() * in.qd) < 0.0) in.qd *= -1.0;
    }
  }
  RobotDescription robot;
  sup::Chain chain;
  sup::KdlReference kdl;
  std::array<sup::ImpactInput, kStates> input;
};

/// The same by KDL: mass matrix, Jacobian, and Newton-Euler with the jump as acceleration; axis torques only.
double by_kdl(const Case& c, std::size_t k, sup::JointVector& axis) {
  const sup::ImpactInput& in = c.input[k];
  const int n = c.robot.dof();
  sup::JointMatrix H = c.kdl.mass_matrix(in.q);
  const sup::Jacobian J = c.kdl.jacobian(in.q);
  for (int i = 0; i < n; ++i) H(i, i) += c.chain.rotor_inertia_kg_m2(i);
  const sup::JointVector lever = J.topRows<3>().transpose().lazyProduct(in.normal);
  const sup::JointVector x = H.partialPivLu().solve(lever);
  const double P = -2.0 * lever.dot(in.qd) / lever.dot(x);
  const sup::JointVector still = sup::JointVector::Zero(n);
  axis = P * lever - (c.kdl.inverse_dynamics(in.q, still, P * x) - c.kdl.gravity(in.q));
  return P;
}

bool run(const std::string& name, RobotDescription robot, const Peer& peer, bool peers) {
  const Case c(std::move(robot));
  const int n = c.robot.dof();
  std::vector<bench::Contender> contenders;
  contenders.push_back({"ours", [&](std::size_t k) {
                          const sup::ImpactPrediction p = sup::predict(c.chain, c.input[k]);
                          return p.impulse_n_s + p.axis_impulse_nm_s[0] + p.wrench[0].force_n_s[0];
                        }});
  void* pinocchio = nullptr;
  std::array<double, kMaxJoints> axis{};
  std::array<double, 6 * kMaxJoints> wrench{};
  if (peers && peer.create != nullptr) {
    std::vector<PeerJoint> joints(static_cast<std::size_t>(n));
    for (std::size_t i = 0; i < joints.size(); ++i) {
      const JointDescription& from = c.robot.joints[i];
      PeerJoint& to = joints[i];
      Eigen::Map<Eigen::Matrix3d>(to.rotation) = from.offset.rotation;
      Eigen::Map<Eigen::Vector3d>(to.offset) = from.offset.translation_m;
      Eigen::Map<Eigen::Vector3d>(to.axis) = from.axis;
      Eigen::Map<Eigen::Vector3d>(to.com) = from.link.com_m;
      Eigen::Map<Eigen::Matrix3d>(to.inertia) = from.link.inertia_kg_m2;
      to.mass = from.link.mass_kg;
      to.rotor_inertia = from.reflected_inertia_kg_m2();
    }
    pinocchio = peer.create(joints.data(), n, c.robot.hammer.face.translation_m.data());
    contenders.push_back({"Pinocchio", [&](std::size_t k) {
                            const sup::ImpactInput& in = c.input[k];
                            return peer.predict(pinocchio, in.q.data(), in.qd.data(), in.normal.data(), 1.0,
                                                axis.data(), wrench.data());
                          }});
  }
  sup::JointVector kdl_axis(n);
  if (peers) contenders.push_back({"KDL (axes only)", [&](std::size_t k) { return by_kdl(c, k, kdl_axis); }});

  // Equal before fast.
  double worst = 0.0;
  for (std::size_t k = 0; k < kStates && peers; ++k) {
    const sup::ImpactPrediction p = sup::predict(c.chain, c.input[k]);
    const sup::ChainPose pose = c.chain.pose(c.input[k].q);
    const double size = std::max(1.0, p.axis_impulse_nm_s.cwiseAbs().maxCoeff());
    const auto differs = [&](double a, double b, double unit) { worst = std::max(worst, std::abs(a - b) / unit); };
    differs(by_kdl(c, k, kdl_axis), p.impulse_n_s, std::max(1.0, p.impulse_n_s));
    for (int i = 0; i < n; ++i) differs(kdl_axis[i], p.axis_impulse_nm_s[i], size);
    if (pinocchio == nullptr) continue;
    differs(contenders[1].work(k), p.impulse_n_s, std::max(1.0, p.impulse_n_s));
    for (int i = 0; i < n; ++i) {
      const auto at = static_cast<std::size_t>(i);
      differs(axis[at], p.axis_impulse_nm_s[i], size);
      const Eigen::Map<const Eigen::Vector3d> force(&wrench[6 * at]);
      const Eigen::Map<const Eigen::Vector3d> torque(&wrench[6 * at + 3]);
      const Eigen::Matrix3d& R = pose.link[at].rotation;
      differs((R * force - p.wrench[at].force_n_s).norm(), 0.0, std::max(1.0, p.impulse_n_s));
      differs((R * torque - p.wrench[at].torque_nm_s).norm(), 0.0, size);
    }
  }
  if (peers && !(worst <= kTolerance)) {
    fmt::print("{}: the contenders differ by {:.1e}, allowed {:.0e}\n", name, worst, kTolerance);
    return false;
  }
  bench::measure(contenders);
  bench::print(name, contenders);
  if (peers) fmt::print("{:<8} largest difference {:.1e}\n", name, worst);
  return true;
}

}  // namespace

int main(int argc, char** argv) {
  const Peer peer = open_peer(argc > 1 && argv[1][0] != '-' ? argv[1] : MRR_PEER_PINOCCHIO);
  const std::filesystem::path robots = std::filesystem::path(MRR_SOURCE_DIR) / "robots";
  fmt::print("Full prediction of one blow: external impulse, jump of speeds, wrench impulse of every joint.\n");
  bool good = run("mrr3", load_robot(robots / "mrr3"), peer, true);
  good = run("arm7", load_robot(robots / "arm7"), peer, true) && good;
  fmt::print("Growth with the number of joints (random chains):\n");
  for (int n = 1; n <= kMaxJoints; ++n) {
    Random random(9, static_cast<std::uint64_t>(n));
    good = run(fmt::format("n = {}", n), test::random_robot(random, n), peer, false) && good;
  }

  fmt::print("Every selection of the 3-joint arm, and the three models of one blow:\n");
  const Case c(load_robot(robots / "mrr3"));
  const sup::StrikeArm arm(c.robot);
  std::array<double, kMaxJoints> extra{};
  for (std::size_t i = 0; i < 3; ++i) {
    const ControlDescription& control = c.robot.joints[i].control;
    extra[i] = sup::controlled_extra_inertia(control.position_gain_nm_rad, control.velocity_gain_nm_s_rad, 0.05);
  }
  sup::PredictInput blow;
  blow.q = sup::JointVector::Zero(3);
  blow.qd = sup::JointVector::Zero(3);
  blow.qd[1] = -0.62;
  blow.joints.fill(sup::JointHold::controlled);
  blow.joints[1] = sup::JointHold::free;
  sup::PredictInput given = blow;
  given.restitution = 1.0;
  given.contact_s = 0.05;
  std::vector<bench::Contender> more;
  more.push_back({"every S", [&](std::size_t k) {
                    const sup::ImpactInput& in = c.input[k];
                    const sup::SelectionSweep sweep(c.chain, c.chain.pose(in.q), in.normal, extra);
                    double sum = 0.0;
                    sweep.for_each(7U, 0U, [&](const sup::SelectionBlow& s) { sum += s.axis_nm_s_per_n_s[1]; });
                    return sum;
                  }});
  more.push_back({"instant, e given",
                  [&](std::size_t) { return sup::predict(arm, given, sup::PredictionModel::instant).impulse_n_s; }});
  for (const auto model :
       {sup::PredictionModel::instant, sup::PredictionModel::finite_time, sup::PredictionModel::resolved}) {
    more.push_back(
        {sup::describe(model), [&, model](std::size_t) { return sup::predict(arm, blow, model).impulse_n_s; }});
  }
  bench::measure(more);
  for (const bench::Contender& m : more) bench::print("mrr3", {m});
  return good ? 0 : 1;
}
