// What must hold for a blow of any arm of 1 to 16 joints: against a solve with six coordinates per link and against the
// reference's matrices, under every selection, turned and mirrored, and at the edges of what can be computed.
#include <gtest/gtest.h>
#include <rapidcheck.h>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <cmath>
#include <cstdlib>
#include <limits>

#include "supervisor/impact/dense_oracle.h"
#include "supervisor/impact/external.h"
#include "supervisor/impact/measures.h"
#include "supervisor/impact/selection.h"
#include "supervisor/strike/measure_map.h"
#include "tests/unit/model/arms.h"

namespace mrr::sup {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
/// The same cases every time, unless the caller asks for others.
const int kSeeded = setenv("RC_PARAMS", "seed=20250711 max_success=150", 0);

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

/// An arm about to strike, with joints free or controlled, and held if wanted.
struct Blow {
  RobotDescription robot;
  ImpactInput input;
  int dof() const { return robot.dof(); }
  JointHold hold(int i) const { return input.joints[static_cast<std::size_t>(i)].hold; }
};

Blow blow_of(std::uint64_t seed, int n, bool may_hold) {
  Random random(seed);
  Blow blow{test::random_robot(random, n), {}};
  ImpactInput& in = blow.input;
  in.q = test::random_vector(random, n, -3.0, 3.0);
  in.qd = test::random_vector(random, n, -1.0, 1.0);
  in.normal = test::random_unit(random);
  in.restitution = random.uniform();
  in.nail_mass_kg = random.below(2) == 0 ? kInfinity : random.uniform(0.5, 30.0);
  for (std::size_t i = 0; i < static_cast<std::size_t>(n); ++i) {
    const auto draw = random.below(3);
    if (draw == 1) in.joints[i] = {JointHold::controlled, random.uniform(0.0, 3.0)};
    if (draw == 2 && may_hold && i > 0) in.joints[i].hold = JointHold::held;
  }
  const Chain chain(blow.robot);
  if (in.normal.dot((chain.jacobian(in.q) * in.qd).head<3>()) > 0.0) in.qd = -in.qd;
  return blow;
}

/// Evenly in [low, high): RapidCheck's own ranges begin small.
template <typename T>
rc::Gen<T> whole_range(T low, T high) {
  return rc::gen::resize(rc::kNominalSize, rc::gen::inRange<T>(low, high));
}

/// 1 to 16 joints, any seed; shrinks to few joints.
rc::Gen<Blow> blows(bool may_hold) {
  return rc::gen::map(
      rc::gen::pair(whole_range<std::uint64_t>(0, 1U << 30), whole_range(1, 17)),
      [may_hold](const std::pair<std::uint64_t, int>& p) { return blow_of(p.first, p.second, may_hold); });
}

void expect(bool passed) {
  ASSERT_EQ(kSeeded, 0);
  EXPECT_TRUE(passed) << "see the counterexample above";
}

bool near(double a, double b, double tolerance) { return std::abs(a - b) <= tolerance; }
bool near(const JointVector& a, const JointVector& b, double tolerance) {
  return a.size() == b.size() && (a - b).cwiseAbs().maxCoeff() <= tolerance;
}

bool near(const WrenchImpulse& a, const WrenchImpulse& b, double tolerance) {
  return (a.force_n_s - b.force_n_s).norm() <= tolerance && (a.torque_nm_s - b.torque_nm_s).norm() <= tolerance;
}

/// The blow in maximal coordinates: every link has six speeds, every joint a wrench that keeps it together. One dense
/// system of 13 n + 1 equations that knows no Jacobian and no mass matrix.
ImpactPrediction maximal(const Blow& blow) {
  const Chain chain(blow.robot);
  const ImpactInput& in = blow.input;
  const ChainPose pose = chain.pose(in.q);
  const int n = blow.dof();
  const int twists = 0, wrenches = 6 * n, rates = 12 * n, impulse = 13 * n, size = 13 * n + 1;
  Eigen::MatrixXd A = Eigen::MatrixXd::Zero(size, size);
  Eigen::VectorXd b = Eigen::VectorXd::Zero(size);
  const auto cross = [](const Eigen::Vector3d& v) {
    Eigen::Matrix3d S;
    S << 0.0, -v.z(), v.y(), v.z(), 0.0, -v.x(), -v.y(), v.x(), 0.0;
    return S;
  };
  const JointMatrix B = chain.reflected_inertia(in.q, in.rotor_model);
  for (int i = 0; i < n; ++i) {
    const auto k = static_cast<std::size_t>(i);
    const Eigen::Matrix3d& R = pose.link[k].rotation;
    const Eigen::Vector3d& c = pose.com_m[k];
    const Eigen::Vector3d& o = pose.link[k].position_m;
    // Linear and angular momentum of link i; wrench i acts from link i on link i-1 at joint i.
    A.block<3, 3>(6 * i, twists + 6 * i) = blow.robot.joints[k].link.mass_kg * Eigen::Matrix3d::Identity();
    A.block<3, 3>(6 * i + 3, twists + 6 * i + 3) = R * blow.robot.joints[k].link.inertia_kg_m2 * R.transpose();
    A.block<3, 3>(6 * i, wrenches + 6 * i).setIdentity();
    A.block<3, 3>(6 * i + 3, wrenches + 6 * i + 3).setIdentity();
    A.block<3, 3>(6 * i + 3, wrenches + 6 * i) = cross(o - c);
    if (i + 1 < n) {
      A.block<3, 3>(6 * i, wrenches + 6 * (i + 1)) = -Eigen::Matrix3d::Identity();
      A.block<3, 3>(6 * i + 3, wrenches + 6 * (i + 1) + 3) = -Eigen::Matrix3d::Identity();
      A.block<3, 3>(6 * i + 3, wrenches + 6 * (i + 1)) = -cross(pose.link[k + 1].position_m - c);
    } else {
      A.block<3, 1>(6 * i, impulse) = -in.normal;
      A.block<3, 1>(6 * i + 3, impulse) = -(pose.face.position_m - c).cross(in.normal);
    }
    // At joint i both links move alike but for the joint's own rate.
    const int row = 6 * n + 6 * i;
    A.block<3, 3>(row, twists + 6 * i).setIdentity();
    A.block<3, 3>(row, twists + 6 * i + 3) = -cross(o - c);
    A.block<3, 3>(row + 3, twists + 6 * i + 3).setIdentity();
    A.block<3, 1>(row + 3, rates + i) = -pose.axis[k];
    if (i > 0) {
      A.block<3, 3>(row, twists + 6 * (i - 1)) = -Eigen::Matrix3d::Identity();
      A.block<3, 3>(row, twists + 6 * (i - 1) + 3) = cross(o - pose.com_m[k - 1]);
      A.block<3, 3>(row + 3, twists + 6 * (i - 1) + 3) = -Eigen::Matrix3d::Identity();
    }
    // About its axis the joint carries what its rotor takes, or it does not turn.
    const JointState& joint = in.joints[k];
    if (joint.hold == JointHold::held) {
      A(12 * n + i, rates + i) = 1.0;
    } else {
      A.block<1, 3>(12 * n + i, wrenches + 6 * i + 3) = pose.axis[k].transpose();
      for (int j = 0; j < n; ++j) A(12 * n + i, rates + j) -= B(i, j);
      if (joint.hold == JointHold::controlled) A(12 * n + i, rates + i) -= joint.extra_inertia_kg_m2;
    }
  }
  // Face against nail: the approach speed is reversed by e.
  const Eigen::Vector3d arm = pose.face.position_m - pose.com_m[static_cast<std::size_t>(n - 1)];
  A.block<1, 3>(13 * n, twists + 6 * (n - 1)) = in.normal.transpose();
  A.block<1, 3>(13 * n, twists + 6 * (n - 1) + 3) = arm.cross(in.normal).transpose();
  A(13 * n, impulse) = 1.0 / in.nail_mass_kg;
  b[13 * n] = -(1.0 + in.restitution) * in.normal.dot((chain.jacobian(in.q) * in.qd).head<3>());
  const Eigen::VectorXd x = A.fullPivLu().solve(b);
  ImpactPrediction out;
  out.impulse_n_s = x[impulse];
  out.delta_qd = x.segment(rates, n);
  out.axis_impulse_nm_s.resize(n);
  for (int i = 0; i < n; ++i) {
    WrenchImpulse& wrench = out.wrench[static_cast<std::size_t>(i)];
    wrench = {x.segment<3>(wrenches + 6 * i), x.segment<3>(wrenches + 6 * i + 3)};
    out.axis_impulse_nm_s[i] = pose.axis[static_cast<std::size_t>(i)].dot(wrench.torque_nm_s);
  }
  return out;
}

/// Poses in which the arm can hardly yield make any two ways of solving differ.
bool well_conditioned(const ImpactPrediction& p) { return p.feasible && p.effective_mass_kg < 1e4; }

TEST(AnyArm, AgreesWithASolveInMaximalCoordinates) {
  expect(rc::check("six coordinates per link", [] {
    const Blow blow = *blows(true);
    const ImpactPrediction got = predict(Chain(blow.robot), blow.input);
    RC_PRE(well_conditioned(got));
    const ImpactPrediction other = maximal(blow);
    const double scale = 1e-7 * std::max(1.0, got.impulse_n_s);
    RC_ASSERT(near(other.impulse_n_s, got.impulse_n_s, scale));
    RC_ASSERT(near(other.delta_qd, got.delta_qd, 10.0 * scale));
    RC_ASSERT(near(other.axis_impulse_nm_s, got.axis_impulse_nm_s, 10.0 * scale));
    for (std::size_t i = 0; i < static_cast<std::size_t>(blow.dof()); ++i) {
      RC_ASSERT(near(other.wrench[i], got.wrench[i], 10.0 * scale));
    }
  }));
}

TEST(AnyArm, GivesTheWrenchesOfTheReferencesMatricesWithEitherSign) {
  expect(rc::check("dense form", [] {
    Blow blow = *blows(false);
    blow.input.joints = {};  // as the reference has it
    blow.input.rotor_model = *rc::gen::element(RotorModel::diag, RotorModel::lower, RotorModel::sym);
    blow.input.formulation = *rc::gen::element(Formulation::corrected, Formulation::as_printed);
    const Chain chain(blow.robot);
    const ImpactPrediction got = predict(chain, blow.input);
    RC_PRE(well_conditioned(got) && got.approaching);
    const int n = blow.dof();
    const Eigen::VectorXd dense =
        dense_impulse_model(chain, blow.input.q, blow.input.rotor_model, blow.input.formulation).L.leftCols<3>() *
        (got.impulse_n_s * blow.input.normal);
    const double scale = 1e-8 * std::max({1.0, got.impulse_n_s, dense.cwiseAbs().maxCoeff()});
    for (int i = 0; i < n; ++i) {
      const WrenchImpulse other{dense.segment<3>(3 * i), dense.segment<3>(3 * (n + i))};
      RC_ASSERT(near(other, got.wrench[static_cast<std::size_t>(i)], scale));
    }
  }));
}

TEST(AnyArm, AnImpulseAlongOneLineMovesTheFaceAlongAnotherAsMuchAsTheOtherWayRound) {
  expect(rc::check("reciprocity", [] {
    const Blow blow = *blows(true);
    const Chain chain(blow.robot);
    Random random(*whole_range<std::uint64_t>(0, 1U << 30));
    const Eigen::Matrix<double, 3, Eigen::Dynamic> J = chain.jacobian(blow.input.q).topRows<3>();
    const std::array<Eigen::Vector3d, 2> line{test::random_unit(random), test::random_unit(random)};
    std::array<double, 2> across{};
    for (std::size_t k = 0; k < 2; ++k) {
      ImpactInput in = blow.input;
      in.normal = line[k];
      if (in.normal.dot(J * in.qd) > 0.0) in.qd = -in.qd;
      const ImpactPrediction p = predict(chain, in);
      RC_PRE(well_conditioned(p) && p.impulse_n_s > 0.0);
      across[k] = line[1 - k].dot(J * p.delta_qd) / p.impulse_n_s;
    }
    RC_ASSERT(near(across[0], across[1], 1e-9 * std::max(1.0, std::abs(across[0]))));
  }));
}

TEST(AnyArm, BalancesMomentumAndEnergyAndFreeJointsCarryTheirRotors) {
  expect(rc::check("invariants", [] {
    const Blow blow = *blows(false);
    const Chain chain(blow.robot);
    const ImpactPrediction got = predict(chain, blow.input);
    RC_PRE(well_conditioned(got) && got.approaching);
    JointMatrix B = chain.reflected_inertia(blow.input.q);
    for (int i = 0; i < blow.dof(); ++i) {
      if (blow.hold(i) == JointHold::controlled) {
        B(i, i) += blow.input.joints[static_cast<std::size_t>(i)].extra_inertia_kg_m2;
      }
    }
    const JointMatrix M = chain.mass_matrix(blow.input.q);
    const JointVector lever = chain.jacobian(blow.input.q).topRows<3>().transpose() * blow.input.normal;
    const double scale = 1e-9 * std::max(1.0, got.impulse_n_s);
    RC_ASSERT(near(got.axis_impulse_nm_s, JointVector(B * got.delta_qd), scale));
    RC_ASSERT(near(JointVector((M + B) * got.delta_qd), JointVector(lever * got.impulse_n_s), scale));
    const JointVector after = blow.input.qd + got.delta_qd;
    const double nail = std::isinf(blow.input.nail_mass_kg)
                            ? 0.0
                            : 0.5 * blow.input.nail_mass_kg * got.nail_speed_after_m_s * got.nail_speed_after_m_s;
    const auto energy = [H = Eigen::MatrixXd(M + B)](const Eigen::VectorXd& qd) { return 0.5 * qd.dot(H * qd); };
    const double lost = energy(blow.input.qd) - energy(after) - nail;
    // Of the energy of approach, (1 - e^2) is lost.
    const double reduced = 1.0 / (1.0 / got.effective_mass_kg + 1.0 / blow.input.nail_mass_kg);
    const double expected = 0.5 * (1.0 - blow.input.restitution * blow.input.restitution) * reduced *
                            got.speed_before_m_s * got.speed_before_m_s;
    RC_ASSERT(near(lost, expected, 1e-8 * std::max(1.0, got.impulse_n_s)));
  }));
}

TEST(AnyArm, ForgetsHowTheWorldIsTurnedAndMirrored) {
  expect(rc::check("frames", [] {
    const Blow blow = *blows(true);
    const ImpactPrediction got = predict(Chain(blow.robot), blow.input);
    RC_PRE(well_conditioned(got));
    const double scale = 1e-8 * std::max(1.0, got.impulse_n_s);
    Random random(*whole_range<std::uint64_t>(0, 1000));
    Blow turned = blow;
    const Eigen::Matrix3d R = test::random_rotation(random);
    FrameOffset& base = turned.robot.joints.front().offset;
    base.rotation = (R * base.rotation).eval();
    base.translation_m = R * base.translation_m + test::random_unit(random);
    turned.input.normal = R * blow.input.normal;
    const ImpactPrediction same = predict(Chain(turned.robot), turned.input);
    RC_ASSERT(near(same.axis_impulse_nm_s, got.axis_impulse_nm_s, scale));
    RC_ASSERT(near(same.impulse_n_s, got.impulse_n_s, scale));
    RC_ASSERT(near(same.wrench[0].force_n_s.norm(), got.wrench[0].force_n_s.norm(), 10.0 * scale));
    // Seen in a mirror: an axis of rotation is a pseudovector.
    const Eigen::Matrix3d S = Eigen::Vector3d(1.0, -1.0, 1.0).asDiagonal();
    Blow mirrored = blow;
    for (JointDescription& joint : mirrored.robot.joints) {
      joint.offset.rotation = (S * joint.offset.rotation * S).eval();
      joint.offset.translation_m = S * joint.offset.translation_m;
      joint.axis = -(S * joint.axis);
      joint.link.com_m = S * joint.link.com_m;
      joint.link.inertia_kg_m2 = (S * joint.link.inertia_kg_m2 * S).eval();
    }
    mirrored.robot.hammer.face.translation_m = S * blow.robot.hammer.face.translation_m;
    mirrored.input.normal = S * blow.input.normal;
    const ImpactPrediction image = predict(Chain(mirrored.robot), mirrored.input);
    RC_ASSERT(near(image.axis_impulse_nm_s, got.axis_impulse_nm_s, scale));
    RC_ASSERT(near(image.impulse_n_s, got.impulse_n_s, scale));
  }));
}

TEST(AnyArm, EverySelectionOfASweepIsWhatPredictSaysAlone) {
  expect(rc::check("selections", [] {
    const Blow blow = blow_of(*whole_range<std::uint64_t>(0, 1U << 30), *whole_range(1, 10), false);
    const int n = blow.dof();
    const Chain chain(blow.robot);
    const Formulation formulation = *rc::gen::element(Formulation::corrected, Formulation::as_printed);
    const RotorModel rotors = *rc::gen::element(RotorModel::diag, RotorModel::lower, RotorModel::sym);
    std::array<double, kMaxJoints> extra{};
    Random random(7);
    for (double& k : extra) k = random.uniform(0.0, 3.0);
    const SelectionSweep sweep(chain, chain.pose(blow.input.q), blow.input.normal, extra, rotors, formulation);
    RC_ASSERT(sweep.usable());
    std::uint32_t seen = 0;
    sweep.for_each((1U << n) - 1U, 0, [&](const SelectionBlow& s) {
      ++seen;
      ImpactInput in = blow.input;
      in.rotor_model = rotors;
      in.formulation = formulation;
      for (std::size_t i = 0; i < static_cast<std::size_t>(n); ++i) {
        in.joints[i] = (s.passive >> i & 1U) != 0 ? JointState{} : JointState{JointHold::controlled, extra[i]};
      }
      const ImpactPrediction alone = predict(chain, in);
      if (!well_conditioned(alone) || !alone.approaching) return;
      const double impulse = s.impulse_n_s(alone.speed_before_m_s, in.restitution, in.nail_mass_kg);
      const double scale = 1e-8 * std::max(1.0, impulse);
      RC_ASSERT(near(impulse, alone.impulse_n_s, scale));
      RC_ASSERT(near(JointVector(impulse * s.axis_nm_s_per_n_s), alone.axis_impulse_nm_s, scale));
    });
    RC_ASSERT(seen == 1U << n);
    for (int i = 0; i < n && n > 1; ++i) {
      ImpactInput in = blow.input;
      in.rotor_model = rotors;
      in.formulation = formulation;
      in.joints = {};
      in.joints[static_cast<std::size_t>(i)].hold = JointHold::held;
      const ImpactPrediction alone = predict(chain, in);
      if (!well_conditioned(alone)) continue;
      const SelectionBlow held = sweep.held(i);
      const double impulse = held.impulse_n_s(alone.speed_before_m_s, in.restitution, in.nail_mass_kg);
      RC_ASSERT(
          near(JointVector(impulse * held.axis_nm_s_per_n_s), alone.axis_impulse_nm_s, 1e-7 * std::max(1.0, impulse)));
    }
  }));
}

TEST(AnyArm, SweepOfSixteenJointsVisitsAllSelectionsExactlyOnce) {
  const Blow blow = blow_of(5, 16, false);
  const Chain chain(blow.robot);
  std::array<double, kMaxJoints> extra{};
  extra.fill(0.7);
  const SelectionSweep sweep(chain, chain.pose(blow.input.q), blow.input.normal, extra);
  std::vector<bool> seen(1U << 16, false);
  sweep.for_each(0xFFFFU, 0, [&](const SelectionBlow& s) {
    EXPECT_FALSE(seen[s.passive]);
    seen[s.passive] = true;
  });
  EXPECT_EQ(std::count(seen.begin(), seen.end(), true), 1 << 16);
  // Joints that may not change stay as they are.
  int count = 0;
  sweep.for_each(0b110U, 0b1U, [&](const SelectionBlow& s) {
    EXPECT_EQ(s.passive & ~0b110U, 0b1U);
    ++count;
  });
  EXPECT_EQ(count, 4);
}

bool sound(const ImpactPrediction& p) {
  for (Eigen::Index i = 0; i < p.delta_qd.size(); ++i) {
    const WrenchImpulse& wrench = p.wrench[static_cast<std::size_t>(i)];
    if (!wrench.force_n_s.allFinite() || !wrench.torque_nm_s.allFinite()) return false;
    if (!p.feasible && !near(wrench, WrenchImpulse::none(), 0.0)) return false;
  }
  if (!p.feasible) return p.impulse_n_s == 0.0 && p.delta_qd.isZero() && p.axis_impulse_nm_s.isZero();
  return std::isfinite(p.impulse_n_s) && p.impulse_n_s >= 0.0 && p.delta_qd.allFinite() &&
         p.axis_impulse_nm_s.allFinite() && !std::isnan(p.effective_mass_kg);
}

TEST(AnyArm, GivesARightAnswerOrNoneAtTheEdges) {
  expect(rc::check("edges", [] {
    Blow blow = *blows(true);
    const auto edge = *whole_range(0, 10);
    bool must_refuse = false;
    for (JointDescription& joint : blow.robot.joints) {
      if (edge == 0) joint.motor.rotor_inertia_kg_m2 = 0.0;
      if (edge == 1) joint.offset.rotation.setIdentity();  // stretched: all axes alike where they are
      if (edge == 1) joint.axis = Eigen::Vector3d::UnitZ();
      if (edge == 2) joint.link.inertia_kg_m2.setZero();
    }
    ImpactInput& in = blow.input;
    const Chain chain(blow.robot);
    if (edge == 1) in.normal = Eigen::Vector3d::UnitZ();  // n orthogonal to everything the face can do
    if (edge == 3) in.restitution = 0.0;
    if (edge == 4) in.restitution = 1.0;
    if (edge == 5) in.nail_mass_kg = 0.0;
    if (edge == 6) in.nail_mass_kg = kInfinity;
    if (edge == 7) in.qd.setZero();
    if (edge == 8) in.q[0] = kNan;
    if (edge == 9) {
      for (JointState& joint : in.joints) joint.hold = JointHold::held;
      in.nail_mass_kg = kInfinity;
    }
    must_refuse = edge == 5 || edge == 8;
    const ImpactPrediction p = predict(chain, in);
    RC_ASSERT(sound(p));
    if (must_refuse) RC_ASSERT(!p.feasible);
    if (edge == 3 && p.feasible && p.approaching && std::isinf(in.nail_mass_kg)) {
      RC_ASSERT(near(p.speed_after_m_s, 0.0, 1e-9));  // it sticks
    }
    if (edge == 7) RC_ASSERT(!p.approaching && p.impulse_n_s == 0.0);
    if (edge == 9 && p.feasible) RC_ASSERT(!p.approaching);  // nothing could yield
    RC_TAG(edge);
  }));
}

TEST(AnyArm, OneJointStrikesLikeAPendulum) {
  expect(rc::check("closed form", [] {
    Blow blow = blow_of(*whole_range<std::uint64_t>(0, 1U << 30), 1, false);
    blow.input.joints = {};
    const Chain chain(blow.robot);
    const ImpactPrediction p = predict(chain, blow.input);
    RC_PRE(well_conditioned(p) && p.approaching);
    const ChainPose pose = chain.pose(blow.input.q);
    const double arm = pose.axis[0].cross(pose.face.position_m - pose.link[0].position_m).dot(blow.input.normal);
    const LinkDescription& link = blow.robot.joints[0].link;
    const Eigen::Vector3d axis = blow.robot.joints[0].axis;
    const double own = axis.dot(link.inertia_kg_m2 * axis) + link.mass_kg * axis.cross(link.com_m).squaredNorm() +
                       blow.robot.joints[0].reflected_inertia_kg_m2();
    const double P =
        -(1.0 + blow.input.restitution) * arm * blow.input.qd[0] / (arm * arm / own + 1.0 / blow.input.nail_mass_kg);
    RC_ASSERT(near(p.impulse_n_s, P, 1e-9 * std::max(1.0, P)));
  }));
}

TEST(AnyArm, MeasuresAreNeverNanAndKnowTheirLimits) {
  expect(rc::check("measures", [] {
    const Blow blow = blow_of(*whole_range<std::uint64_t>(0, 1U << 30), *whole_range(1, 9), false);
    RobotDescription robot = blow.robot;
    for (JointDescription& joint : robot.joints) {
      joint.transmission.rated_nm = 20.0;
      joint.transmission.repeated_peak_nm = 40.0;
      joint.control.position_gain_nm_rad = 400.0;
      joint.control.velocity_gain_nm_s_rad = 17.0;
    }
    const Chain chain(robot);
    MeasureSetting setting;
    setting.normal = blow.input.normal;
    for (const MeasureInfo& one : kMeasures) {
      const double value = measure_at(robot, chain, blow.input.q, one.measure, setting);
      RC_ASSERT(value >= 0.0);
    }
    // The effective mass along a principal axis is that axis of the dynamic ellipsoid.
    const Eigen::Matrix3d W = linear_mobility(chain, chain.pose(blow.input.q));
    const ImpactEllipsoid ellipsoid = dynamic_impact_ellipsoid(W);
    for (int k = 0; k < 3; ++k) {
      if (!(ellipsoid.semi_axes[k] < 1e4)) continue;
      RC_ASSERT(near(effective_mass_kg(W, ellipsoid.axes.col(k)) / ellipsoid.semi_axes[k], 1.0, 1e-6));
    }
    // A load per newton second does not depend on how hard the blow is.
    setting.restitution = 0.3;
    const double soft = measure_at(robot, chain, blow.input.q, Measure::load_ratio, setting);
    setting.restitution = 1.0;
    const double hard = measure_at(robot, chain, blow.input.q, Measure::load_ratio, setting);
    RC_ASSERT(soft == hard);
  }));
}

}  // namespace
}  // namespace mrr::sup
