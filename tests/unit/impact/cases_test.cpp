// Every case of tests/data/cases.json at its own tolerance. Its `conventions` explain the fields.
#include <gtest/gtest.h>

#include <Eigen/LU>
#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>
#include <numbers>

#include "supervisor/impact/dense_oracle.h"
#include "supervisor/impact/external.h"
#include "supervisor/impact/internal.h"
#include "supervisor/impact/limits.h"
#include "supervisor/impact/measures.h"
#include "supervisor/strike/quintic.h"
#include "tests/unit/model/arms.h"

namespace mrr::sup {
namespace {

using Json = nlohmann::json;
using test::DhArm;

const Json& file() {
  static const Json kFile = Json::parse(std::ifstream(MRR_SOURCE_DIR "/tests/data/cases.json"));
  return kFile;
}

Eigen::MatrixXd matrix(const Json& rows) {
  Eigen::MatrixXd m(static_cast<int>(rows.size()), static_cast<int>(rows.at(0).size()));
  for (int i = 0; i < m.rows(); ++i) {
    for (int j = 0; j < m.cols(); ++j) m(i, j) = rows.at(static_cast<std::size_t>(i)).at(static_cast<std::size_t>(j));
  }
  return m;
}

Eigen::VectorXd vector(const Json& list) {
  Eigen::VectorXd v(static_cast<int>(list.size()));
  for (int i = 0; i < v.size(); ++i) v[i] = list.at(static_cast<std::size_t>(i));
  return v;
}

DhArm make_arm(const std::string& name) {
  const Json& arm = file().at("arms").at(name);
  std::vector<test::DhLink> links;
  for (std::size_t i = 0; i < arm.at("dof").get<std::size_t>(); ++i) {
    const Json& dh = arm.at("dh_d_theta0_a_alpha").at(i);
    links.push_back({dh.at(0), dh.at(1), dh.at(2), dh.at(3), arm.at("mass").at(i),
                     vector(arm.at("com_in_link_frame").at(i)), matrix(arm.at("inertia_about_com_in_link_frame").at(i)),
                     arm.at("gear_ratio").at(i), arm.at("rotor_inertia").at(i)});
  }
  return test::make_dh_arm(links, vector(arm.at("tool_in_last_frame")));
}

RotorModel rotor_model(const std::string& name) {
  if (name == "diag") return RotorModel::diag;
  if (name == "lower") return RotorModel::lower;
  if (name == "sym") return RotorModel::sym;
  throw std::invalid_argument("unknown motor model " + name);
}

std::string name_of(ModeDecision decision) {
  switch (decision) {
    case ModeDecision::active:
      return "active";
    case ModeDecision::passive:
      return "passive";
    case ModeDecision::refuse:
      return "refuse";
  }
  return "";
}

class Case : public testing::TestWithParam<std::size_t> {
 protected:
  const Json& root() const { return file().at("cases").at(GetParam()); }
  const Json& in() const { return root().at("input"); }
  const Json& want() const { return root().at("expect"); }

  template <typename A>
  void expect_equal(const std::string& what, const A& got, const Eigen::MatrixXd& expected) const {
    ASSERT_EQ(got.rows(), expected.rows()) << what;
    ASSERT_EQ(got.cols(), expected.cols()) << what;
    for (int i = 0; i < got.rows(); ++i) {
      for (int j = 0; j < got.cols(); ++j) expect_equal(what, double(got(i, j)), expected(i, j));
    }
  }
  void expect_equal(const std::string& what, double got, double expected) const {
    const double tolerance =
        root().at("abs_tol").get<double>() + root().at("rel_tol").get<double>() * std::abs(expected);
    EXPECT_NEAR(got, expected, tolerance) << what;
  }
  void expect_equal(const std::string& what, double got, const Json& expected) const {
    expect_equal(what, got, expected.get<double>());
  }

  void kinematics_dynamics() const;
  void impact() const;
  void l_matrix() const;
  void limit_velocity() const;
  void table4_columns() const;
  void impact_count_case() const;
  void impulse_thresholds() const;
  void mode_decision() const;
  void effective_mass() const;
  void restitution() const;
  void quintic() const;
  void impact_measures() const;
  void pulse() const;
};

void Case::kinematics_dynamics() const {
  DhArm arm = make_arm(root().at("arm"));
  arm.robot.gravity_m_s2 = vector(in().at("gravity_accel"));
  const Chain chain(arm.robot);
  const JointVector q = vector(in().at("q"));
  const JointVector qd = vector(in().at("qd"));
  const Pose face = chain.face_pose(q);
  expect_equal("R_0n", face.rotation, matrix(want().at("R_0n")));
  expect_equal("tip", face.position_m, vector(want().at("tip_position")));
  expect_equal("J_H", chain.jacobian(q), matrix(want().at("J_H")));
  expect_equal("M", chain.mass_matrix(q), matrix(want().at("M")));
  expect_equal("B_diag", chain.reflected_inertia(q, RotorModel::diag), matrix(want().at("B_diag")));
  expect_equal("B_lower", chain.reflected_inertia(q, RotorModel::lower), matrix(want().at("B_lower")));
  expect_equal("B_sym", chain.reflected_inertia(q, RotorModel::sym), matrix(want().at("B_sym")));
  expect_equal("gravity", chain.gravity(q), vector(want().at("gravity_torque")));
  expect_equal("coriolis", JointVector(chain.bias(q, qd) - chain.gravity(q)), vector(want().at("coriolis_torque")));
}

void Case::impact() const {
  const DhArm arm = make_arm(root().at("arm"));
  const Chain chain(arm.robot);
  ImpactInput input;
  input.q = vector(in().at("q"));
  input.qd = vector(in().at("qd"));
  input.normal = vector(in().at("n")).head<3>();
  input.restitution = in().at("e");
  input.nail_mass_kg =
      in().at("M_nail").is_string() ? std::numeric_limits<double>::infinity() : double(in().at("M_nail"));
  const ChainPose pose = chain.pose(input.q);
  const Jacobian J_h = chain.jacobian(pose);
  ASSERT_EQ(want().size(), 3U);
  for (const auto& [variant, expected] : want().items()) {
    SCOPED_TRACE(variant);
    input.rotor_model = rotor_model(variant);
    input.formulation = Formulation::corrected;
    const ImpactPrediction got = predict(chain, input);
    ASSERT_TRUE(got.feasible);
    expect_equal("P", got.impulse_n_s, expected.at("impulse_magnitude"));
    expect_equal("F_ext", Eigen::Vector3d(got.impulse_n_s * input.normal), vector(expected.at("F_ext")).head(3));
    expect_equal("delta_qd", got.delta_qd, vector(expected.at("delta_qd")));
    expect_equal("nail", -got.nail_speed_after_m_s, expected.at("delta_v_nail_along_n"));
    const Vector6 before = J_h * input.qd;
    const Vector6 after = J_h * (input.qd + got.delta_qd);
    expect_equal("v before", before, vector(expected.at("v_tip_before")));
    expect_equal("v after", after, vector(expected.at("v_tip_after")));
    expect_equal("speed before", -got.speed_before_m_s, input.normal.dot(before.head<3>()));
    expect_equal("speed after", -got.speed_after_m_s, input.normal.dot(after.head<3>()));
    expect_equal("effective mass", got.effective_mass_kg, expected.at("directional_effective_mass"));
    expect_equal("axis", got.axis_impulse_nm_s, vector(expected.at("axis_torque_impulse")));
    const Json& forces = expected.at("internal_force_per_joint_link_frame");
    const Json& torques = expected.at("internal_torque_per_joint_link_frame");
    for (int i = 0; i < chain.dof(); ++i) {
      const auto k = static_cast<std::size_t>(i);
      const Eigen::Matrix3d to_frame = arm.distal(pose, i).transpose();
      expect_equal("F_i", Eigen::Vector3d(to_frame * got.wrench[k].force_n_s), vector(forces.at(k)));
      expect_equal("tau_i", Eigen::Vector3d(to_frame * got.wrench[k].torque_nm_s), vector(torques.at(k)));
    }
    const InternalImpactMeasure measure = internal_impact_measure(chain, pose, 1.0, input.rotor_model);
    expect_equal("L singular values", measure.singular_values, vector(expected.at("L_singular_values")));
    expect_equal("w_ii", measure.w_ii, expected.at("w_ii"));
    if (!expected.contains("as_printed_A_TF_sign_plus")) continue;
    const Json& printed = expected.at("as_printed_A_TF_sign_plus");
    input.formulation = Formulation::as_printed;
    expect_equal("axis as printed", predict(chain, input).axis_impulse_nm_s, vector(printed.at("axis_torque_impulse")));
    expect_equal("w_ii as printed",
                 internal_impact_measure(chain, pose, 1.0, input.rotor_model, Formulation::as_printed).w_ii,
                 printed.at("w_ii"));
  }
}

void Case::l_matrix() const {
  const DhArm arm = make_arm(root().at("arm"));
  const Chain chain(arm.robot);
  const JointVector q = vector(in().at("q"));
  const RotorModel rotors = rotor_model(in().at("motor_model"));
  const ChainPose pose = chain.pose(q);
  const Eigen::MatrixXd expected = matrix(want().at("L"));
  const auto in_distal_frames = [&](Eigen::MatrixXd L) {
    for (int block = 0; block < 2 * chain.dof(); ++block) {
      L.middleRows<3>(3 * block) =
          arm.distal(pose, block % chain.dof()).transpose() * L.middleRows<3>(3 * block).eval();
    }
    return L;
  };
  expect_equal("L by recursion", in_distal_frames(impulse_map(chain, pose, rotors)), expected);
  const DenseImpulseModel dense = dense_impulse_model(chain, q, rotors);
  expect_equal("L by matrices", in_distal_frames(dense.L), expected);
  expect_equal("w_ii", internal_impact_measure(chain, pose, 1.0, rotors).w_ii, want().at("w_ii"));
  expect_equal("w_ii by determinant", std::sqrt((dense.L.transpose() * dense.L).determinant()),
               want().at("w_ii_per_eq55_det"));
}

void Case::limit_velocity() const {
  const Eigen::VectorXd gear = vector(in().at("gear"));
  JointVector limit(gear.size());
  for (int i = 0; i < gear.size(); ++i) limit[i] = impact_speed_limit_rad_s(gear[i], in().at("t_s"), in().at("N_S"));
  expect_equal("limit", limit, vector(want().at("qd_limit_rad_s")));
  expect_equal("rpm", JointVector(limit * 30.0 / std::numbers::pi), vector(want().at("link_rpm")));
  const Chain chain(make_arm("thesis3").robot);
  const JointVector home = JointVector::Zero(3);
  expect_equal("tip", Vector6(chain.jacobian(home) * -limit), vector(want().at("tip_velocity_all_minus")));
}

void Case::table4_columns() const {
  const Json& rpm = in().at("motor_rpm");
  expect_equal("safest", kSafestMotorRpm, rpm.at("safest"));
  expect_equal("average", kAverageMotorRpm, rpm.at("avg"));
  expect_equal("max", kMaxMotorRpm, rpm.at("max"));
  for (const auto& [drive, columns] : want().items()) {
    const double gear = in().at("gear").at(drive);
    const Eigen::Vector3d got{link_rpm(kSafestMotorRpm, gear), link_rpm(kAverageMotorRpm, gear),
                              link_rpm(kMaxMotorRpm, gear)};
    expect_equal(drive, got, vector(columns));
  }
}

void Case::impact_count_case() const {
  const Eigen::VectorXd rpm = vector(in().at("motor_rpm"));
  const Eigen::VectorXd contact = vector(in().at("t_s"));
  for (int i = 0; i < rpm.size(); ++i) {
    expect_equal("N", impact_count(rpm[i], contact[i]), want().at("N_S").at(static_cast<std::size_t>(i)));
  }
}

void Case::impulse_thresholds() const {
  int compared = 0;
  for (const auto& [drive, torques] : in().at("torques").items()) {
    TransmissionDescription transmission;
    transmission.rated_nm = torques.at(0);
    transmission.repeated_peak_nm = torques.at(1);
    transmission.momentary_peak_nm = torques.at(2);
    for (const auto& [contact, expected] : want().at(drive).items()) {
      const ImpulseLimits square = impulse_limits(transmission, std::stod(contact), PulseShape::square);
      const ImpulseLimits sine = impulse_limits(transmission, std::stod(contact));
      expect_equal("rated", square.rated_nm_s, expected.at("rated"));
      expect_equal("repeated", square.repeated_nm_s, expected.at("repeated"));
      expect_equal("momentary", square.momentary_nm_s, expected.at("momentary"));
      expect_equal("rated half-sine", sine.rated_nm_s, expected.at("rated_half_sine"));
      expect_equal("repeated half-sine", sine.repeated_nm_s, expected.at("repeated_half_sine"));
      ++compared;
    }
  }
  EXPECT_EQ(compared, 6);
}

void Case::mode_decision() const {
  // Ratings of the two drives are in case V5.
  const auto ratings = [](const std::string& drive) {
    for (const Json& other : file().at("cases")) {
      if (other.at("id") == "V5") return other.at("input").at("torques").at(drive);
    }
    throw std::logic_error("case V5 is missing");
  };
  for (const auto& [which, expected] : want().items()) {
    const Json& impulses = in().at("axis_impulse_" + which);
    for (std::size_t i = 0; i < expected.size(); ++i) {
      const Json torques = ratings(in().at("drives").at(i));
      TransmissionDescription transmission;
      transmission.rated_nm = torques.at(0);
      transmission.repeated_peak_nm = torques.at(1);
      transmission.momentary_peak_nm = torques.at(2);
      const double impulse = impulses.at(i);
      const ImpulseLimits limits = impulse_limits(transmission, in().at("t_s"), PulseShape::square);
      EXPECT_EQ(name_of(decide_mode(impulse, impulse, limits)), expected.at(i)) << which << " joint " << i + 1;
    }
  }
}

void Case::effective_mass() const {
  for (std::size_t test = 0; test < 2; ++test) {
    for (std::size_t swing = 0; swing < 4; ++swing) {
      const double contact = double(in().at("duration_ms").at(test).at(swing)) * 1e-3;
      const double depth = double(in().at("penetration_mm").at(test).at(swing)) * 1e-3;
      expect_equal("M*", effective_nail_mass_kg(in().at("impulse_Ns").at(test).at(swing), contact, depth),
                   want().at("M_star_kg").at(test).at(swing));
    }
  }
}

void Case::restitution() const {
  const Chain chain(make_arm(root().at("arm")).robot);
  ImpactInput input;
  input.q = JointVector::Zero(3);
  input.qd = JointVector::Zero(3);
  input.qd[1] = in().at("qd2");
  input.rotor_model = rotor_model(in().at("motor_model"));
  const ImpactPrediction prediction = predict(chain, input);
  const Json& impulses = in().at("impulse_Ns");
  for (std::size_t i = 0; i < impulses.size(); ++i) {
    expect_equal("e",
                 restitution_from_impulse(impulses.at(i), prediction.speed_before_m_s, prediction.effective_mass_kg),
                 want().at("e").at(i));
  }
}

void Case::quintic() const {
  const auto state = [](const Json& list) {
    return QuinticState{.position = list.at(0), .velocity = list.at(1), .acceleration = list.at(2)};
  };
  const Quintic quintic =
      Quintic::between(state(in().at("start_pos_vel_acc")), state(in().at("end_pos_vel_acc")), in().at("T"));
  for (std::size_t k = 0; k < 6; ++k) {
    expect_equal("coefficient", quintic.coefficients()[k], want().at("coeff_ascending").at(k));
  }
  for (std::size_t k = 0; k < in().at("t").size(); ++k) {
    const QuinticState sample = quintic.sample(in().at("t").at(k));
    expect_equal("position", sample.position, want().at("pos").at(k));
    expect_equal("velocity", sample.velocity, want().at("vel").at(k));
    expect_equal("acceleration", sample.acceleration, want().at("acc").at(k));
  }
}

void Case::impact_measures() const {
  const Chain chain(make_arm(root().at("arm")).robot);
  const JointVector q = vector(in().at("q"));
  const Eigen::Vector3d u = vector(in().at("direction"));
  const Eigen::Matrix3d W = linear_mobility(chain, chain.pose(q), rotor_model(in().at("motor_model")));
  expect_equal("W", W, matrix(want().at("mobility_W")));
  expect_equal("Lambda", Eigen::Matrix3d(W.inverse()), matrix(want().at("Lambda")));
  expect_equal("effective mass", effective_mass_kg(W, u), want().at("effective_mass_u"));
  expect_equal("impulse geometry", normalised_impulse_n_s(W, u, 0.0), want().at("effective_mass_u"));
  const ImpactEllipsoid dynamic = dynamic_impact_ellipsoid(W);
  expect_equal("dynamic", dynamic.semi_axes, vector(want().at("impulse_ellipsoid_semi_axes_per_unit_speed")));
  expect_equal("volume", dynamic.semi_axes.prod(), want().at("volume_measure_det_Lambda"));
  for (int i = 0; i < 3; ++i) {
    expect_equal("axis", Eigen::Vector3d(W * dynamic.axes.col(i) * dynamic.semi_axes[i]),
                 Eigen::Vector3d(dynamic.axes.col(i)));
  }
  expect_equal("generalised", generalised_impact_ellipsoid(W).semi_axes,
               vector(want().at("generalized_impact_ellipsoid_semi_axes")));
}

void Case::pulse() const {
  const double peak = in().at("peak_N");
  const double duration = in().at("duration_s");
  const double dt = in().at("sample_dt");
  std::vector<double> force;
  for (int k = 0; k < in().at("samples").get<int>(); ++k) {
    force.push_back(k * dt <= duration ? peak * std::sin(std::numbers::pi * k * dt / duration) : 0.0);
  }
  expect_equal("trapezoids", impulse_of_samples_n_s(force, dt), want().at("impulse_trapz"));
  expect_equal("exact", impulse_limit_nm_s(peak, duration, PulseShape::half_sine), want().at("impulse_exact"));
}

TEST_P(Case, AsTabulated) {
  const std::string kind = root().at("kind");
  if (kind == "kinematics_dynamics") return kinematics_dynamics();
  if (kind == "impact") return impact();
  if (kind == "L_matrix") return l_matrix();
  if (kind == "limit_velocity") return limit_velocity();
  if (kind == "table4_columns") return table4_columns();
  if (kind == "impact_count") return impact_count_case();
  if (kind == "impulse_thresholds") return impulse_thresholds();
  if (kind == "mode_decision") return mode_decision();
  if (kind == "effective_mass") return effective_mass();
  if (kind == "restitution_from_impulse") return restitution();
  if (kind == "quintic") return quintic();
  if (kind == "impact_measures") return impact_measures();
  if (kind == "pulse_trapz") return pulse();
  FAIL() << "no test for cases of kind " << kind;
}

INSTANTIATE_TEST_SUITE_P(Reference, Case, testing::Range(std::size_t{0}, file().at("cases").size()),
                         [](const auto& which) {
                           return file().at("cases").at(which.param).at("id").template get<std::string>();
                         });

TEST(Cases, AreAllThere) { EXPECT_EQ(file().at("cases").size(), 19U); }

}  // namespace
}  // namespace mrr::sup
