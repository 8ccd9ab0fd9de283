// One step of the emulator - elastic drives, friction, contact, end stops - beside one step of MuJoCo's plain rigid arm
// in contact, by its C interface. Same arm, from the same description; both lean on something while they are measured.

#ifdef MRR_MUJOCO
#include <mujoco/mujoco.h>
#endif

#include <Eigen/Geometry>
#include <array>
#include <filesystem>

#include "sim_vcan/plant/multibody.h"
#include "sim_vcan/plant/plant.h"
#include "supervisor/model/chain.h"
#include "tests/bench/contest.h"

namespace {

using namespace mrr;  // NOLINT: a program of its own

constexpr double kPress_n = 60.0;  // on the face, the same for both
constexpr double kStep_s = 1e-4;
constexpr int kSettle = 2000;  // steps before a round
constexpr double kTolerance = 1e-9;

/// The arm bent, and what it leans on under its face.
struct Case {
  explicit Case(RobotDescription description) : robot(std::move(description)), chain(robot), q(robot.dof()) {
    for (int i = 0; i < robot.dof(); ++i) q[i] = i % 2 == 0 ? 0.2 : 0.5;
    pose = chain.pose(q);
    normal = -pose.face.rotation.col(2);
    robot.task.normal = normal;
    robot.task.nail_position_m = pose.face.position_m - (robot.task.nail_height_m + 1e-4) * normal;
    hold_nm = chain.gravity(pose) - kPress_n * (chain.jacobian(pose).topRows<3>().transpose() * normal);
  }
  RobotDescription robot;
  sup::Chain chain;
  sup::JointVector q;
  sup::ChainPose pose;
  Eigen::Vector3d normal;
  sup::JointVector hold_nm;  // what presses, and carries the arm
};

void lost(const char* who) {
  fmt::print("{} is not in contact\n", who);
  std::exit(1);
}

class Ours {
 public:
  explicit Ours(const Case& c)
      : case_(c),
        plant_(c.robot, sim::load_plant(c.robot, std::filesystem::path(MRR_SOURCE_DIR) / "robots/boards/hardwood.yaml"),
               0) {}
  void prepare() {
    plant_.reset({case_.q.data(), static_cast<std::size_t>(case_.q.size())}, case_.robot.task.nail_height_m);
    for (int i = 0; i < plant_.dof(); ++i) {
      const auto joint = static_cast<std::size_t>(i);
      const JointDescription& d = case_.robot.joints[joint];
      const auto& per_ampere = plant_.actual_description().joints[joint].drive.torque_constant_nm_a;
      const double ampere =
          case_.hold_nm[i] / (d.transmission.gear_ratio * per_ampere[case_.hold_nm[i] >= 0.0 ? 0 : 1]);
      const double duty = std::clamp(32767.0 * ampere / d.sensors.current_full_scale_a, -32767.0, 32767.0);
      plant_.set_actuator(i, {static_cast<std::int16_t>(duty), true, true});
    }
    for (int k = 0; k < kSettle; ++k) plant_.step(seconds(kStep_s));
    if (!plant_.truth().contact) lost("the emulator");
  }
  double step() {
    plant_.step(seconds(kStep_s));
    return 0.0;
  }
  void check() const {
    if (!plant_.truth().contact) lost("the emulator");
  }

 private:
  const Case& case_;
  sim::Plant plant_;
};

#ifdef MRR_MUJOCO
std::string numbers(const double* v, int count) { return fmt::format("{:.17g}", fmt::join(v, v + count, " ")); }

std::string mjcf(const Case& c) {
  std::string bodies;
  std::string closed;
  for (const JointDescription& j : c.robot.joints) {
    const Eigen::Matrix3d& I = j.link.inertia_kg_m2;
    const std::array<double, 6> inertia{I(0, 0), I(1, 1), I(2, 2), I(0, 1), I(0, 2), I(1, 2)};
    bodies += fmt::format(
        "<body pos=\"{}\" xyaxes=\"{}\"><joint type=\"hinge\" axis=\"{}\" armature=\"{:.17g}\"/>"
        "<inertial mass=\"{:.17g}\" pos=\"{}\" fullinertia=\"{}\"/>",
        numbers(j.offset.translation_m.data(), 3), numbers(j.offset.rotation.data(), 6), numbers(j.axis.data(), 3),
        j.reflected_inertia_kg_m2(), j.link.mass_kg, numbers(j.link.com_m.data(), 3), numbers(inertia.data(), 6));
    closed += "</body>";
  }
  // The face as a ball that touches with its lowest point; one contact without friction, which is what ours is.
  const double radius = c.robot.hammer.face_radius_m;
  const FrameOffset& face = c.robot.hammer.face;
  const Eigen::Vector3d centre = face.translation_m - radius * face.rotation.col(2);
  return fmt::format(
      "<mujoco><compiler angle=\"radian\" balanceinertia=\"false\" boundmass=\"0\" boundinertia=\"0\"/>"
      "<option timestep=\"{}\" gravity=\"{}\"/>"
      "<worldbody><geom type=\"plane\" size=\"1 1 1\" pos=\"{}\" zaxis=\"{}\" condim=\"1\"/>{}"
      "<geom type=\"sphere\" size=\"{:.17g}\" pos=\"{}\" mass=\"0\" condim=\"1\"/>{}</worldbody></mujoco>",
      kStep_s, numbers(c.robot.gravity_m_s2.data(), 3), numbers(c.pose.face.position_m.data(), 3),
      numbers(c.normal.data(), 3), bodies, radius, numbers(centre.data(), 3), closed);
}

class MuJoCo {
 public:
  explicit MuJoCo(const Case& c) : case_(c) {
    std::array<char, 512> why{};
    mjSpec* spec = mj_parseXMLString(mjcf(c).c_str(), nullptr, why.data(), static_cast<int>(why.size()));
    model_ = spec != nullptr ? mj_compile(spec, nullptr) : nullptr;
    if (model_ == nullptr) {
      fmt::print("MuJoCo refuses the arm: {}\n", why.data());
      std::exit(1);
    }
    mj_deleteSpec(spec);
    data_ = mj_makeData(model_);
  }
  MuJoCo(const MuJoCo&) = delete;
  MuJoCo& operator=(const MuJoCo&) = delete;
  ~MuJoCo() {
    mj_deleteData(data_);
    mj_deleteModel(model_);
  }
  void prepare() {
    mj_resetData(model_, data_);
    for (int i = 0; i < model_->nv; ++i) {
      data_->qpos[i] = case_.q[i];
      data_->qfrc_applied[i] = case_.hold_nm[i];
    }
    for (int k = 0; k < kSettle; ++k) mj_step(model_, data_);
    check();
  }
  double step() {
    mj_step(model_, data_);
    return 0.0;
  }
  void check() const {
    if (data_->ncon != 1) lost("MuJoCo");
  }
  /// Largest difference of the mass matrices, rotors included, over the largest entry.
  double difference() {
    prepare();
    const auto n = static_cast<int>(model_->nv);
    Eigen::MatrixXd theirs(n, n);
    const sim::Multibody body(case_.robot, true);
    sim::PerJoint q{};
    std::copy_n(data_->qpos, n, q.begin());
    mj_forward(model_, data_);  // a step leaves the matrix of the position before it
    mj_fullM(model_, data_, theirs.data());
    sim::ArmPose pose;
    body.place(q, pose);
    sim::SquareMatrix m;
    body.mass_matrix(pose, m);
    double worst = 0.0;
    for (int i = 0; i < n; ++i) {
      for (int j = 0; j < n; ++j) {
        double mine = m[static_cast<std::size_t>(i)][static_cast<std::size_t>(j)];
        if (i == j) mine += body.reflected_inertia(i);
        worst = std::max(worst, std::abs(mine - theirs(i, j)));
      }
    }
    return worst / theirs.cwiseAbs().maxCoeff();
  }

 private:
  const Case& case_;
  mjModel* model_ = nullptr;
  mjData* data_ = nullptr;
};
#endif

bool run(const char* name) {
  const Case c(load_robot(std::filesystem::path(MRR_SOURCE_DIR) / "robots" / name));
  Ours ours(c);
  std::vector<bench::Contender> contenders;
  contenders.push_back({"ours", [&](std::size_t) { return ours.step(); }, [&] { ours.prepare(); }});
#ifdef MRR_MUJOCO
  MuJoCo peer(c);
  const double difference = peer.difference();
  if (!(difference <= kTolerance)) {
    fmt::print("{}: the mass matrices differ by {:.1e}, allowed {:.0e}\n", name, difference, kTolerance);
    return false;
  }
  contenders.push_back({"MuJoCo, rigid", [&](std::size_t) { return peer.step(); }, [&] { peer.prepare(); }});
#endif
  bench::measure(contenders);
  ours.check();
  bench::print(name, contenders);
#ifdef MRR_MUJOCO
  peer.check();
  fmt::print("{:<8} mass matrices differ by {:.1e} of their largest entry\n", name, difference);
#else
  fmt::print("MuJoCo is not beside it: .venv has no mujoco\n");
#endif
  return true;
}

}  // namespace

int main() {
  fmt::print("One step of 100 us in contact: ours with elastic drives and friction, MuJoCo's rigid.\n");
  bool good = run("mrr3");
  good = run("arm7") && good;
  return good ? 0 : 1;
}
