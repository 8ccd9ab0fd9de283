// Room: bindings/python. The Python module: plain structs in and out, every size checked before it becomes a vector of
// bounded length. May touch common/robot and supervisor/{model,impact,strike}.
#include <fmt/format.h>
#include <pybind11/eigen.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <map>
#include <stdexcept>
#include <string>
#include <vector>

#include "common/robot/errors.h"
#include "supervisor/impact/prediction.h"
#include "supervisor/strike/measure_map.h"
#include "supervisor/strike/planner.h"

namespace py = pybind11;

namespace {

using namespace mrr;  // NOLINT: a module of its own
using sup::JointVector;

struct Robot {
  explicit Robot(const std::string& folder) : description(load_robot(folder)), arm(description) {}
  RobotDescription description;
  sup::StrikeArm arm;
};

JointVector joints(const std::string& name, const Eigen::VectorXd& v) {
  if (v.size() > kMaxJoints) {
    throw std::invalid_argument(
        fmt::format("{} has {} entries, at most {} joints are possible", name, v.size(), kMaxJoints));
  }
  return v;
}
Eigen::VectorXd array(const JointVector& v) { return v; }

/// A field that is a joint vector.
template <typename Class, typename Owner>
void joint_field(Class& type, const char* name, JointVector Owner::*field, const char* doc) {
  type.def_property(
      name, [field](const Owner& o) { return array(o.*field); },
      [field, name](Owner& o, const Eigen::VectorXd& v) { o.*field = joints(name, v); }, doc);
}
template <typename Class, typename Owner>
void joint_result(Class& type, const char* name, JointVector Owner::*field, const char* doc) {
  type.def_property_readonly(
      name, [field](const Owner& o) { return array(o.*field); }, doc);
}

/// Words for an enumeration, both ways.
template <typename T>
using Words = std::vector<std::pair<const char*, T>>;
template <typename T>
T value_of(const Words<T>& words, const std::string& what, const std::string& word) {
  std::string all;
  for (const auto& [name, value] : words) {
    if (word == name) return value;
    all += (all.empty() ? "" : ", ") + std::string(name);
  }
  throw std::invalid_argument(fmt::format("{} is '{}'; it may be {}", what, word, all));
}
template <typename T>
std::string word_of(const Words<T>& words, T value) {
  for (const auto& [name, one] : words) {
    if (one == value) return name;
  }
  return "";
}
const Words<sup::PassiveMode> kModes{
    {"planned", sup::PassiveMode::planned}, {"never", sup::PassiveMode::never}, {"always", sup::PassiveMode::always}};
const Words<sup::StrikeMeasure> kRankings{{"load_ratio", sup::StrikeMeasure::load_ratio},
                                          {"internal_impact", sup::StrikeMeasure::internal_impact},
                                          {"effective_mass", sup::StrikeMeasure::effective_mass}};
const Words<sup::Formulation> kFormulations{{"corrected", sup::Formulation::corrected},
                                            {"as_printed", sup::Formulation::as_printed}};
const Words<sup::RotorModel> kRotors{
    {"sym", sup::RotorModel::sym}, {"diag", sup::RotorModel::diag}, {"lower", sup::RotorModel::lower}};
const Words<sup::PredictionModel> kModels{{"instant", sup::PredictionModel::instant},
                                          {"finite_time", sup::PredictionModel::finite_time},
                                          {"resolved", sup::PredictionModel::resolved}};
const Words<sup::JointHold> kHolds{
    {"passive", sup::JointHold::free}, {"held", sup::JointHold::held}, {"active", sup::JointHold::controlled}};

std::vector<std::string> passive_joints(const RobotDescription& robot, std::uint32_t mask) {
  std::vector<std::string> names;
  for (int i = 0; i < robot.dof(); ++i) {
    if ((mask >> i & 1U) != 0) names.push_back(robot.joints[static_cast<std::size_t>(i)].name);
  }
  return names;
}

/// A plan and the robot it is for, so that it can explain itself.
struct Plan {
  RobotDescription robot;
  sup::StrikePlan plan;
};

/// Position, speed and acceleration of all joints at times since the start, one row per time.
py::tuple sampled(const sup::JointTrajectory& t, const std::vector<double>& times_s) {
  const auto rows = static_cast<Eigen::Index>(times_s.size());
  Eigen::MatrixXd q(rows, t.dof()), qd(rows, t.dof()), qdd(rows, t.dof());
  sup::JointMotion motion;
  for (Eigen::Index k = 0; k < rows; ++k) {
    const double at = times_s[static_cast<std::size_t>(k)];
    if (!(at >= -1e6 && at <= 1e6)) throw std::invalid_argument("times_s: must be finite, s");
    t.sample(seconds(at), motion);
    q.row(k) = motion.q.transpose();
    qd.row(k) = motion.qd.transpose();
    qdd.row(k) = motion.qdd.transpose();
  }
  return py::make_tuple(q, qd, qdd);
}

sup::MeasureSetting setting_of(const Eigen::Vector3d& normal, double e, double mass_kg, double contact_s) {
  sup::MeasureSetting s;
  s.normal = normal;
  s.restitution = e;
  s.nail_mass_kg = mass_kg;
  s.contact_s = contact_s;
  return s;
}
sup::Measure measure_of(const std::string& name) {
  const auto found = sup::measure_named(name);
  if (found) return *found;
  std::string all;
  for (const sup::MeasureInfo& one : sup::kMeasures) all += (all.empty() ? "" : ", ") + std::string(one.name);
  throw std::invalid_argument(fmt::format("measure is '{}'; it may be {}", name, all));
}

void bind_robot(py::module_& m) {
  py::class_<Robot>(m, "Robot", "A robot description, checked, and its model.")
      .def_property_readonly("name", [](const Robot& r) { return r.description.name; })
      .def_property_readonly("dof", [](const Robot& r) { return r.description.dof(); })
      .def_property_readonly("joint_names",
                             [](const Robot& r) {
                               std::vector<std::string> names;
                               for (const JointDescription& j : r.description.joints) names.push_back(j.name);
                               return names;
                             })
      .def_property_readonly(
          "contact_duration_s", [](const Robot& r) { return r.description.task.assumed_contact_s; },
          "what the task assumes before anything was learnt")
      .def(
          "plan_input",
          [](const Robot& r) {
            const TaskDescription& task = r.description.task;
            sup::PlanInput in;
            in.normal = task.normal;
            in.head_position_m = task.nail_position_m + task.nail_height_m * task.normal;
            in.board_distance_m = task.nail_height_m;
            in.contact_duration_s = task.assumed_contact_s;
            in.start.resize(r.description.dof());
            for (int i = 0; i < r.description.dof(); ++i) {
              in.start[i] = r.description.joints[static_cast<std::size_t>(i)].park_rad;
            }
            return in;
          },
          "The first blow on the task's nail, from where the robot rests.")
      .def(
          "face",
          [](const Robot& r, const Eigen::VectorXd& q) {
            const JointVector v = joints("q", q);
            if (v.size() != r.description.dof()) throw std::invalid_argument("q needs one entry, rad, per joint");
            const sup::Pose pose = r.arm.chain.face_pose(v);
            return py::make_tuple(pose.position_m, pose.rotation);
          },
          py::arg("q"), "Position (m) and rotation of the hammer's face, base frame; its z axis points out of it.")
      .def(
          "jacobian",
          [](const Robot& r, const Eigen::VectorXd& q) {
            const JointVector v = joints("q", q);
            if (v.size() != r.description.dof()) throw std::invalid_argument("q needs one entry, rad, per joint");
            return Eigen::MatrixXd(r.arm.chain.jacobian(v));
          },
          py::arg("q"), "6 x n, linear then angular, of the face's centre, base frame.")
      .def(
          "mass_matrix",
          [](const Robot& r, const Eigen::VectorXd& q) {
            const JointVector v = joints("q", q);
            if (v.size() != r.description.dof()) throw std::invalid_argument("q needs one entry, rad, per joint");
            return Eigen::MatrixXd(r.arm.chain.mass_matrix(v));
          },
          py::arg("q"), "Of the links alone, kg m^2.")
      .def(
          "rotor_matrix",
          [](const Robot& r, const Eigen::VectorXd& q) {
            const JointVector v = joints("q", q);
            if (v.size() != r.description.dof()) throw std::invalid_argument("q needs one entry, rad, per joint");
            return Eigen::MatrixXd(r.arm.chain.reflected_inertia(v));
          },
          py::arg("q"), "B: of the rotors, joint side, kg m^2.");
}

void bind_prediction(py::module_& m) {
  py::class_<sup::ContactLaw>(m, "ContactLaw", "F = k d (1 + c d'); a nail gives way with (F - R) / c_v.")
      .def(py::init<>())
      .def_readwrite("face_stiffness_n_m", &sup::ContactLaw::face_stiffness_n_m)
      .def_readwrite("face_damping_s_m", &sup::ContactLaw::face_damping_s_m)
      .def_readwrite("nail_resistance_n", &sup::ContactLaw::nail_resistance_n)
      .def_readwrite("nail_resistance_slope_n_m", &sup::ContactLaw::nail_resistance_slope_n_m)
      .def_readwrite("nail_damping_n_s_m", &sup::ContactLaw::nail_damping_n_s_m)
      .def_readwrite("nail_room_m", &sup::ContactLaw::nail_room_m);
  using In = sup::PredictInput;
  py::class_<In> input(m, "PredictInput", "A blow to predict.");
  input.def(py::init<const In&>())
      .def(py::init([](const Robot& r) {
        In in;
        in.q = in.qd = JointVector::Zero(r.description.dof());
        in.normal = r.description.task.normal;
        in.switch_lead_s = r.description.task.switch_lead_s;
        in.contact_s = r.description.task.assumed_contact_s;
        in.restitution = 1.0;
        return in;
      }))
      .def_readwrite("normal", &In::normal, "unit, from the surface into the robot, base frame")
      .def_readwrite("contact", &In::contact)
      .def_readwrite("switch_lead_s", &In::switch_lead_s)
      .def_readwrite("passive_s", &In::passive_s)
      .def_readwrite("robots", &In::robots, "robots of this description that the resolved model tries, 1 to 32")
      .def_readwrite("restitution", &In::restitution, "instant model; NaN: from the contact law")
      .def_readwrite("nail_mass_kg", &In::nail_mass_kg, "M*, instant model; inf: rigid")
      .def_readwrite("contact_s", &In::contact_s, "t_s, instant model; NaN: from the contact law")
      .def_property(
          "joints",
          [](const In& in) {
            std::vector<std::string> words;
            for (Eigen::Index i = 0; i < in.q.size(); ++i) {
              words.push_back(word_of(kHolds, in.joints[static_cast<std::size_t>(i)]));
            }
            return words;
          },
          [](In& in, const std::vector<std::string>& words) {
            if (words.size() > in.joints.size()) throw std::invalid_argument("joints: at most 16");
            for (std::size_t i = 0; i < words.size(); ++i) in.joints[i] = value_of(kHolds, "joints", words[i]);
          },
          "passive, active or held, one per joint")
      .def_property(
          "rotor_model", [](const In& in) { return word_of(kRotors, in.rotor_model); },
          [](In& in, const std::string& w) { in.rotor_model = value_of(kRotors, "rotor_model", w); })
      .def_property(
          "formulation", [](const In& in) { return word_of(kFormulations, in.formulation); },
          [](In& in, const std::string& w) { in.formulation = value_of(kFormulations, "formulation", w); });
  joint_field(input, "q", &In::q, "rad, at contact");
  joint_field(input, "qd", &In::qd, "rad/s, just before");

  using Out = sup::Prediction;
  py::class_<Out> output(m, "Prediction", "What a blow does to nail and joints.");
  output.def_readonly("feasible", &Out::feasible)
      .def_readonly("approaching", &Out::approaching)
      .def_readonly("impulse_n_s", &Out::impulse_n_s)
      .def_readonly("impulse_low_n_s", &Out::impulse_low_n_s, "smallest over the robots tried")
      .def_readonly("impulse_high_n_s", &Out::impulse_high_n_s)
      .def_readonly("contact_s", &Out::contact_s)
      .def_readonly("peak_force_n", &Out::peak_force_n)
      .def_readonly("penetration_m", &Out::penetration_m)
      .def_readonly("speed_before_m_s", &Out::speed_before_m_s)
      .def_readonly("speed_after_m_s", &Out::speed_after_m_s)
      .def_readonly("effective_mass_kg", &Out::effective_mass_kg)
      .def_property_readonly(
          "wrench",
          [](const Out& p) {
            Eigen::MatrixXd rows(p.axis_impulse_nm_s.size(), 6);
            for (Eigen::Index i = 0; i < rows.rows(); ++i) {
              const sup::WrenchImpulse& w = p.wrench[static_cast<std::size_t>(i)];
              rows.row(i) << w.force_n_s.transpose(), w.torque_nm_s.transpose();
            }
            return rows;
          },
          "n x 6: link i on link i-1, force (N s) and torque (Nm s) at joint i, base frame");
  joint_result(output, "delta_qd", &Out::delta_qd, "rad/s");
  joint_result(output, "axis_impulse_nm_s", &Out::axis_impulse_nm_s,
               "what each transmission carries over the contact, the arm's weight included; signed");
  joint_result(output, "blow_impulse_nm_s", &Out::blow_impulse_nm_s, "the blow's part of it");
  joint_result(output, "carried_before_nm", &Out::carried_before_nm, "as contact begins");
  joint_result(output, "peak_torque_nm", &Out::peak_torque_nm, "largest magnitude during contact");
  joint_result(output, "axis_impulse_low_nm_s", &Out::axis_impulse_low_nm_s, "smallest over the robots tried");
  joint_result(output, "axis_impulse_high_nm_s", &Out::axis_impulse_high_nm_s, "largest over the robots tried");
  joint_result(output, "peak_torque_low_nm", &Out::peak_torque_low_nm, "smallest over the robots tried");
  joint_result(output, "peak_torque_high_nm", &Out::peak_torque_high_nm, "largest over the robots tried");
  m.def("_predict", [](const Robot& r, const In& in, const std::string& word) {
    const sup::PredictionModel model = value_of(kModels, "model", word);
    const std::string complaint = sup::validate_input(r.arm, in, model);
    if (!complaint.empty()) throw PlanError(complaint);
    return sup::predict(r.arm, in, model);
  });
}

void bind_plan(py::module_& m) {
  using In = sup::PlanInput;
  py::class_<In> input(m, "PlanInput", "What is to be struck, what is known of it, and how to choose.");
  input.def(py::init<>())
      .def(py::init<const In&>())
      .def_readwrite("head_position_m", &In::head_position_m, "centre of the nail's head, base frame")
      .def_readwrite("normal", &In::normal, "unit, from the board into the robot's space")
      .def_readwrite("board_distance_m", &In::board_distance_m, "head to flush")
      .def_readwrite("restitution", &In::restitution)
      .def_readwrite("nail_mass_kg", &In::nail_mass_kg, "M*; inf: rigid")
      .def_readwrite("contact_duration_s", &In::contact_duration_s)
      .def_readwrite("follow_through_m", &In::follow_through_m)
      .def_readwrite("passive", &In::passive, "this selection and no other, bit i = joint i; None: by the mode")
      .def_readwrite("speed_share", &In::speed_share)
      .def_readwrite("wanted_penetration_m", &In::wanted_penetration_m, "> 0: no harder than this takes")
      .def_readwrite("speed_factor", &In::speed_factor, "times what (59) allows, 1 or more")
      .def_readwrite("seed", &In::seed)
      .def_property(
          "mode", [](const In& in) { return word_of(kModes, in.mode); },
          [](In& in, const std::string& w) { in.mode = value_of(kModes, "mode", w); }, "planned, never, always")
      .def_property(
          "measure", [](const In& in) { return word_of(kRankings, in.measure); },
          [](In& in, const std::string& w) { in.measure = value_of(kRankings, "measure", w); })
      .def_property(
          "formulation", [](const In& in) { return word_of(kFormulations, in.formulation); },
          [](In& in, const std::string& w) { in.formulation = value_of(kFormulations, "formulation", w); })
      .def_property(
          "rotors", [](const In& in) { return word_of(kRotors, in.rotors); },
          [](In& in, const std::string& w) { in.rotors = value_of(kRotors, "rotors", w); });
  joint_field(input, "start", &In::start, "present position, rad");

  py::class_<sup::JointLoad>(m, "JointLoad", "Axis impulses of one joint and what it stands, Nm s.")
      .def_readonly("free_nm_s", &sup::JointLoad::free_nm_s)
      .def_readonly("held_nm_s", &sup::JointLoad::held_nm_s)
      .def_readonly("planned_nm_s", &sup::JointLoad::planned_nm_s)
      .def_property_readonly("rated_nm_s", [](const sup::JointLoad& l) { return l.limits.rated_nm_s; })
      .def_property_readonly("repeated_nm_s", [](const sup::JointLoad& l) { return l.limits.repeated_nm_s; });
  using Pose = sup::PoseCandidate;
  py::class_<Pose> pose(m, "PoseCandidate", "One pose that was weighed.");
  pose.def_readonly("tilt_rad", &Pose::tilt_rad)
      .def_readonly("speed_m_s", &Pose::speed_m_s)
      .def_readonly("passive", &Pose::passive)
      .def_readonly("measure", &Pose::measure)
      .def_readonly("impulse_n_s", &Pose::impulse_n_s)
      .def_readonly("back_swing_rad", &Pose::back_swing_rad)
      .def_readonly("swing_s", &Pose::swing_s)
      .def_readonly("feasible", &Pose::feasible)
      .def_readonly("note", &Pose::note);
  joint_result(pose, "q", &Pose::q, "rad");
  joint_result(pose, "load_share", &Pose::load_share, "axis impulse over its rated limit");
  using Selection = sup::SelectionCandidate;
  py::class_<Selection>(m, "SelectionCandidate", "One selection of passive joints that was weighed.")
      .def_readonly("passive", &Selection::passive)
      .def_readonly("feasible", &Selection::feasible)
      .def_property_readonly("model", [](const Selection& s) { return sup::describe(s.model); })
      .def_readonly("load_ratio_per_n_s", &Selection::load_ratio_per_n_s)
      .def_readonly("impulse_n_s", &Selection::impulse_n_s)
      .def_readonly("note", &Selection::note);

  py::class_<Plan>(m, "StrikePlan", "A blow with everything that was weighed; str() explains it.")
      .def_property_readonly(
          "q_impact", [](const Plan& p) { return array(p.plan.q_impact); }, "rad")
      .def_property_readonly(
          "qd_impact", [](const Plan& p) { return array(p.plan.qd_impact); }, "rad/s")
      .def_property_readonly(
          "q_back_swing", [](const Plan& p) { return array(p.plan.q_back_swing); }, "rad")
      .def_property_readonly("speed_m_s", [](const Plan& p) { return p.plan.speed_m_s; })
      .def_property_readonly("impulse_n_s", [](const Plan& p) { return p.plan.impulse_n_s; })
      .def_property_readonly("effective_mass_kg", [](const Plan& p) { return p.plan.effective_mass_kg; })
      .def_property_readonly("measure_value", [](const Plan& p) { return p.plan.measure_value; })
      .def_property_readonly(
          "passive", [](const Plan& p) { return p.plan.passive; }, "bit i = joint i passive at impact")
      .def_property_readonly("passive_joints", [](const Plan& p) { return passive_joints(p.robot, p.plan.passive); })
      .def_property_readonly("contact_time_s", [](const Plan& p) { return p.plan.contact_time.seconds(); })
      .def_property_readonly("switch_time_s", [](const Plan& p) { return p.plan.switch_time.seconds(); })
      .def_property_readonly("strike_duration_s", [](const Plan& p) { return p.plan.strike.duration().seconds(); })
      .def_property_readonly("approach_duration_s", [](const Plan& p) { return p.plan.approach.duration().seconds(); })
      .def_property_readonly("follow_through_m", [](const Plan& p) { return p.plan.follow_through_m; })
      .def_property_readonly("loads",
                             [](const Plan& p) {
                               return std::vector<sup::JointLoad>(p.plan.loads.begin(),
                                                                  p.plan.loads.begin() + p.robot.dof());
                             })
      .def_property_readonly(
          "poses", [](const Plan& p) { return p.plan.poses; }, "best first")
      .def_property_readonly("selections", [](const Plan& p) { return p.plan.selections; })
      .def_property_readonly("selections_weighed", [](const Plan& p) { return p.plan.selections_weighed; })
      .def_property_readonly("why", [](const Plan& p) { return p.plan.why; })
      .def(
          "strike", [](const Plan& p, const std::vector<double>& t) { return sampled(p.plan.strike, t); },
          py::arg("times_s"), "q, q', q'' of the swing at these times, one row each")
      .def(
          "approach", [](const Plan& p, const std::vector<double>& t) { return sampled(p.plan.approach, t); },
          py::arg("times_s"), "q, q', q'' of the way to the back-swing")
      .def(
          "predict_input",
          [](const Plan& p, const sup::ContactLaw& contact) { return sup::predict_input(p.plan, contact); },
          py::arg("contact") = sup::ContactLaw{}, "the blow as the prediction models take it")
      .def("report", [](const Plan& p) { return sup::report(p.robot, p.plan); })
      .def("__str__", [](const Plan& p) { return sup::report(p.robot, p.plan); })
      .def("__repr__", [](const Plan& p) { return fmt::format("<mrr.StrikePlan: {}>", p.plan.why); });
  m.def("_plan", [](const Robot& r, const In& in) {
    return Plan{r.description, sup::plan(r.description, r.arm.chain, in)};
  });
}

void bind_measures(py::module_& m) {
  py::list names;
  for (const sup::MeasureInfo& one : sup::kMeasures) {
    names.append(py::dict(py::arg("name") = one.name, py::arg("unit") = one.unit, py::arg("meaning") = one.meaning,
                          py::arg("source") = one.source, py::arg("most_is_best") = one.most_is_best));
  }
  m.attr("measures") = names;
  m.def("_measure", [](const Robot& r, const Eigen::VectorXd& q, const std::string& name, const Eigen::Vector3d& normal,
                       double e, double mass_kg, double contact_s) {
    const JointVector v = joints("q", q);
    if (v.size() != r.description.dof() || !v.allFinite()) {
      throw std::invalid_argument("q needs one finite entry, rad, per joint");
    }
    sup::MapInput checked;  // the same ranges
    checked.setting = setting_of(normal, e, mass_kg, contact_s);
    const std::string complaint = sup::validate_input(r.description, checked);
    if (!complaint.empty()) throw PlanError(complaint);
    return sup::measure_at(r.description, r.arm.chain, v, measure_of(name), checked.setting);
  });
  using Map = sup::MeasureMap;
  py::class_<Map>(m, "MeasureMap", "An impact measure over a plane of the workspace.")
      .def_property_readonly("values",
                             [](const Map& map) {
                               Eigen::MatrixXd values(map.rows, map.columns);
                               for (int row = 0; row < map.rows; ++row) {
                                 for (int column = 0; column < map.columns; ++column) {
                                   values(row, column) = map.cell(row, column).value;
                                 }
                               }
                               return values;
                             })
      .def_property_readonly("along_m",
                             [](const Map& map) {
                               std::vector<double> x;
                               for (int column = 0; column < map.columns; ++column) x.push_back(map.x_m(column));
                               return x;
                             })
      .def_property_readonly("up_m", [](const Map& map) {
        std::vector<double> z;
        for (int row = 0; row < map.rows; ++row) z.push_back(map.z_m(row));
        return z;
      });
  m.def("_map", [](const Robot& r, const std::string& name, int columns, int rows, double e, double mass_kg,
                   double contact_s, double max_tilt_rad) {
    sup::MapInput in;
    in.measure = measure_of(name);
    in.setting = setting_of(r.description.task.normal, e, mass_kg, contact_s);
    in.columns = columns;
    in.rows = rows;
    in.max_tilt_rad = max_tilt_rad;
    return sup::measure_map(r.description, r.arm.chain, in);
  });
}

}  // namespace

PYBIND11_MODULE(_mrr, m) {
  static const py::exception<PlanError> input_error(m, "InputError", PyExc_ValueError);
  py::register_exception_translator([](std::exception_ptr error) {
    try {
      if (error) std::rethrow_exception(error);
    } catch (const PlanError& e) {
      PyErr_SetString(input_error.ptr(), e.what());
    } catch (const DescriptionError& e) {
      PyErr_SetString(input_error.ptr(), e.what());
    } catch (const std::invalid_argument& e) {
      PyErr_SetString(input_error.ptr(), e.what());
    }
  });
  bind_robot(m);
  m.def("_load_robot", [](const std::string& folder) { return Robot(folder); });
  bind_prediction(m);
  bind_plan(m);
  bind_measures(m);
}
