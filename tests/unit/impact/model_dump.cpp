// mrr_model_dump ROBOT SEED COUNT: the model's and the predictor's numbers at COUNT random states, as JSON on standard
// output. ROBOT is a robot directory, or "random:DOF" for a random chain, whose description is then in the output too.
// tests/python/test_model_pinocchio.py compares them with Pinocchio.
#include <cstdio>
#include <exception>
#include <iostream>
#include <nlohmann/json.hpp>
#include <string>

#include "supervisor/impact/external.h"
#include "tests/unit/model/arms.h"

namespace {

using mrr::Random;
using Json = nlohmann::json;
namespace sup = mrr::sup;

template <typename Matrix>
Json rows(const Matrix& m) {
  Json list = Json::array();
  for (int i = 0; i < m.rows(); ++i) {
    Json row = Json::array();
    for (int j = 0; j < m.cols(); ++j) row.push_back(double(m(i, j)));
    list.push_back(row);
  }
  return list;
}

template <typename Vector>
Json values(const Vector& v) {
  Json list = Json::array();
  for (int i = 0; i < v.size(); ++i) list.push_back(double(v[i]));
  return list;
}

Json offset(const mrr::FrameOffset& frame) {
  return {{"rotation", rows(frame.rotation)}, {"translation", values(frame.translation_m)}};
}

Json description(const mrr::RobotDescription& robot) {
  Json joints = Json::array();
  for (const mrr::JointDescription& joint : robot.joints) {
    joints.push_back({{"name", joint.name},
                      {"offset", offset(joint.offset)},
                      {"axis", values(joint.axis)},
                      {"mass", joint.link.mass_kg},
                      {"com", values(joint.link.com_m)},
                      {"inertia", rows(joint.link.inertia_kg_m2)},
                      {"gear_ratio", joint.transmission.gear_ratio},
                      {"rotor_inertia", joint.motor.rotor_inertia_kg_m2}});
  }
  return {{"gravity", values(robot.gravity_m_s2)}, {"joints", joints}, {"face", offset(robot.hammer.face)}};
}

const char* name_of(sup::JointHold hold) {
  switch (hold) {
    case sup::JointHold::free:
      return "free";
    case sup::JointHold::held:
      return "held";
    case sup::JointHold::controlled:
      return "controlled";
  }
  return "";
}

Json blow(const sup::Chain& chain, Random& random, const sup::JointVector& q, const sup::JointVector& qd) {
  sup::ImpactInput input;
  input.q = q;
  input.normal = mrr::test::random_unit(random);
  const double approach = -input.normal.dot((chain.jacobian(q) * qd).head<3>());
  input.qd = approach > 0.0 ? qd : sup::JointVector(-qd);
  input.restitution = random.uniform();
  if (random.below(2) == 0) input.nail_mass_kg = random.uniform(0.5, 30.0);
  if (random.below(2) == 0) input.rotor_model = sup::RotorModel::diag;
  Json holds = Json::array();
  Json extra = Json::array();
  const bool all_free = random.below(2) == 0;
  for (int i = 0; i < chain.dof(); ++i) {
    sup::JointState& joint = input.joints[static_cast<std::size_t>(i)];
    if (!all_free && random.below(3) == 0) {
      joint = {.hold = sup::JointHold::controlled, .extra_inertia_kg_m2 = random.uniform(0.1, 2.0)};
    } else if (!all_free && random.below(4) == 0) {
      joint.hold = sup::JointHold::held;
    }
    holds.push_back(name_of(joint.hold));
    extra.push_back(joint.extra_inertia_kg_m2);
  }
  const sup::ImpactPrediction got = sup::predict(chain, input);
  return {{"qd", values(input.qd)},
          {"normal", values(input.normal)},
          {"restitution", input.restitution},
          {"nail_mass", std::isinf(input.nail_mass_kg) ? Json() : Json(input.nail_mass_kg)},
          {"rotors", input.rotor_model == sup::RotorModel::diag ? "diag" : "sym"},
          {"holds", holds},
          {"extra_inertia", extra},
          {"feasible", got.feasible},
          {"impulse", got.impulse_n_s},
          {"delta_qd", values(got.delta_qd)},
          {"axis_impulse", values(got.axis_impulse_nm_s)}};
}

int run(const std::string& source, std::uint64_t seed, int count) {
  Random random(seed);
  constexpr const char* kRandom = "random:";
  const mrr::RobotDescription robot =
      source.starts_with(kRandom)
          ? mrr::test::random_robot(random, std::stoi(source.substr(std::string(kRandom).size())))
          : mrr::load_robot(source);
  const sup::Chain chain(robot);
  const int n = chain.dof();
  Json states = Json::array();
  for (int k = 0; k < count; ++k) {
    const sup::JointVector q = mrr::test::random_vector(random, n, -3.0, 3.0);
    const sup::JointVector qd = mrr::test::random_vector(random, n, -2.0, 2.0);
    const sup::JointVector qdd = mrr::test::random_vector(random, n, -10.0, 10.0);
    const sup::Pose face = chain.face_pose(q);
    states.push_back({{"q", values(q)},
                      {"qd", values(qd)},
                      {"qdd", values(qdd)},
                      {"face_position", values(face.position_m)},
                      {"face_rotation", rows(face.rotation)},
                      {"jacobian", rows(chain.jacobian(q))},
                      {"mass", rows(chain.mass_matrix(q))},
                      {"rotors_diag", rows(chain.reflected_inertia(q, sup::RotorModel::diag))},
                      {"rotors_sym", rows(chain.reflected_inertia(q, sup::RotorModel::sym))},
                      {"gravity", values(chain.gravity(q))},
                      {"bias", values(chain.bias(q, qd))},
                      {"torque", values(chain.inverse_dynamics(q, qd, qdd))},
                      {"blow", blow(chain, random, q, qd)}});
  }
  std::cout << Json{{"robot", description(robot)}, {"states", states}}.dump() << "\n";
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 4) {
    std::fputs("usage: mrr_model_dump ROBOT_DIRECTORY|random:DOF SEED COUNT\n", stderr);
    return 2;
  }
  try {
    return run(argv[1], std::stoull(argv[2]), std::stoi(argv[3]));
  } catch (const std::exception& error) {
    std::fprintf(stderr, "mrr_model_dump: %s\n", error.what());
    return 1;
  }
}
