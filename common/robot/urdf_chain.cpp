// Room: common/robot. See urdf_chain.h.
#include "common/robot/urdf_chain.h"

#include <console_bridge/console.h>
#include <tinyxml.h>
#include <urdf_model/model.h>
#include <urdf_parser/urdf_parser.h>

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <cmath>
#include <fstream>
#include <initializer_list>
#include <mutex>
#include <numbers>
#include <set>
#include <sstream>

namespace mrr {
namespace {

constexpr std::uintmax_t kMaxFileBytes = 4U << 20U;
constexpr double kMaxAngle = 4.0 * std::numbers::pi;

/// Collects what urdfdom would print. Its logger is a process-wide switch, hence the lock while one is installed.
class LogCapture : public console_bridge::OutputHandler {
 public:
  LogCapture() : lock_(mutex()) { console_bridge::useOutputHandler(this); }
  ~LogCapture() override { console_bridge::restorePreviousOutputHandler(); }
  LogCapture(const LogCapture&) = delete;
  LogCapture& operator=(const LogCapture&) = delete;
  void log(const std::string& text, console_bridge::LogLevel level, const char* /*file*/, int /*line*/) override {
    if (level >= console_bridge::CONSOLE_BRIDGE_LOG_ERROR && first_.empty()) first_ = text;
  }
  [[nodiscard]] const std::string& first() const { return first_; }

 private:
  static std::mutex& mutex() {
    static std::mutex instance;
    return instance;
  }
  std::lock_guard<std::mutex> lock_;
  std::string first_;
};

/// Without a full stop at its end, ready to stand inside a sentence.
std::string as_clause(std::string text) {
  while (!text.empty() && (text.back() == '.' || text.back() == '\n' || text.back() == ' ')) text.pop_back();
  return text;
}

/// The finite numbers of an attribute's text; nothing if there is anything else.
std::optional<std::vector<double>> parse_numbers(const std::string& text) {
  std::istringstream stream(text);
  stream.imbue(std::locale::classic());
  std::vector<double> result;
  while (!(stream >> std::ws).eof()) {
    double value = 0.0;
    if (!(stream >> value) || !std::isfinite(value)) return std::nullopt;
    result.push_back(value);
  }
  return result;
}

/// The XML text and the errors that name a place in it.
class Document {
 public:
  explicit Document(const std::filesystem::path& file) : file_(file.string()) {
    std::error_code ec;
    if (!std::filesystem::is_regular_file(file, ec)) fail(0, "there is no such file; check the path");
    if (const auto size = std::filesystem::file_size(file, ec); ec || size > kMaxFileBytes) {
      fail(0, "the file is larger than 4 MiB or its size is unknown; check the path");
    }
    std::ifstream stream(file, std::ios::binary);
    std::ostringstream content;
    content << stream.rdbuf();
    if (!stream || !content) fail(0, "the file cannot be read or is empty; check it");
    text_ = content.str();
    xml_.Parse(text_.c_str(), nullptr, TIXML_ENCODING_UTF8);
    if (xml_.Error()) {
      fail(xml_.ErrorRow(), "this is not well-formed XML (" + as_clause(xml_.ErrorDesc()) + "); correct it");
    }
    robot_ = xml_.FirstChildElement("robot");
    if (robot_ == nullptr) fail(0, "there is no <robot> element; this must be a URDF");
  }

  [[noreturn]] void fail(int line, const std::string& problem) const {
    throw description_error(line > 0 ? file_ + ", line " + std::to_string(line) : file_, problem);
  }
  [[noreturn]] void fail(const TiXmlElement& at, const std::string& problem) const { fail(at.Row(), problem); }
  [[noreturn]] void fail_link(const std::string& link, const std::string& problem) const {
    fail(line_of("link", link), "link '" + link + "' " + problem);
  }
  [[noreturn]] void fail_joint(const std::string& joint, const std::string& problem) const {
    fail(line_of("joint", joint), "joint '" + joint + "' " + problem);
  }

  [[nodiscard]] const TiXmlElement& robot() const { return *robot_; }
  [[nodiscard]] const std::string& text() const { return text_; }

  [[nodiscard]] std::string attribute(const TiXmlElement& element, const char* name, const std::string& owner) const {
    const char* value = element.Attribute(name);
    if (value == nullptr || *value == '\0') {
      fail(element, owner + " lacks the attribute '" + name + "' of its <" + element.ValueStr() + ">; add it");
    }
    return value;
  }
  [[nodiscard]] std::vector<double> numbers(const TiXmlElement& element, const char* name, std::size_t count,
                                            const std::string& owner) const {
    const std::string text = attribute(element, name, owner);
    const auto values = parse_numbers(text);
    if (!values || values->size() != count) {
      fail(element, owner + " has " + name + "='" + as_clause(text) + "' in its <" + element.ValueStr() +
                        ">, but that must be " + (count == 1 ? "one finite number" : "three finite numbers"));
    }
    return *values;
  }

 private:
  [[nodiscard]] int line_of(const char* kind, const std::string& name) const {
    for (auto* e = robot_->FirstChildElement(kind); e != nullptr; e = e->NextSiblingElement(kind)) {
      if (const char* n = e->Attribute("name"); n != nullptr && name == n) return e->Row();
    }
    return 0;
  }

  std::string file_;
  std::string text_;
  TiXmlDocument xml_;
  const TiXmlElement* robot_ = nullptr;
};

void check_origin(const Document& document, const TiXmlElement& parent, const std::string& owner) {
  const TiXmlElement* origin = parent.FirstChildElement("origin");
  if (origin == nullptr) return;
  if (origin->Attribute("xyz") != nullptr) (void)document.numbers(*origin, "xyz", 3, owner);
  if (origin->Attribute("rpy") != nullptr) (void)document.numbers(*origin, "rpy", 3, owner);
}

void check_link_element(const Document& document, const TiXmlElement& link, const std::string& owner) {
  const TiXmlElement* inertial = link.FirstChildElement("inertial");
  if (inertial == nullptr) return;
  check_origin(document, *inertial, owner);
  const TiXmlElement* mass = inertial->FirstChildElement("mass");
  if (mass == nullptr) document.fail(*inertial, owner + " has an <inertial> without <mass>; add it, in kg");
  (void)document.numbers(*mass, "value", 1, owner);
  const TiXmlElement* inertia = inertial->FirstChildElement("inertia");
  if (inertia == nullptr) document.fail(*inertial, owner + " has an <inertial> without <inertia>; add it, in kg m^2");
  for (const char* name : {"ixx", "ixy", "ixz", "iyy", "iyz", "izz"}) (void)document.numbers(*inertia, name, 1, owner);
}

void check_limits(const Document& document, const TiXmlElement& joint, const std::string& owner) {
  const TiXmlElement* limit = joint.FirstChildElement("limit");
  if (limit == nullptr) {
    document.fail(joint, owner + " has no <limit>; add lower, upper (rad), velocity (rad/s) and effort (Nm)");
  }
  const double lower = document.numbers(*limit, "lower", 1, owner).front();
  const double upper = document.numbers(*limit, "upper", 1, owner).front();
  const double velocity = document.numbers(*limit, "velocity", 1, owner).front();
  const double effort = document.numbers(*limit, "effort", 1, owner).front();
  if (!(lower < upper)) document.fail(*limit, owner + " has lower not below upper in its <limit>; both are in rad");
  if (!(lower >= -kMaxAngle && upper <= kMaxAngle)) {
    document.fail(*limit, owner + " has a <limit> beyond two turns either way; lower and upper are in rad");
  }
  if (!(velocity > 0.0)) document.fail(*limit, owner + " has a velocity limit that is not above 0 rad/s; correct it");
  if (!(effort > 0.0)) document.fail(*limit, owner + " has an effort limit that is not above 0 Nm; correct it");
}

void check_joint_element(const Document& document, const TiXmlElement& joint, const std::string& owner) {
  const std::string type = document.attribute(joint, "type", owner);
  if (type == "continuous") document.fail(joint, owner + " is continuous; make it revolute and give it limits");
  if (type != "revolute" && type != "fixed") {
    document.fail(joint, owner + " is " + as_clause(type) + ", but only revolute and fixed joints are supported");
  }
  if (joint.FirstChildElement("mimic") != nullptr) {
    document.fail(joint, owner + " mimics another joint, which is not supported; remove <mimic>");
  }
  check_origin(document, joint, owner);
  if (type == "fixed") return;
  const TiXmlElement* axis = joint.FirstChildElement("axis");
  if (axis == nullptr) document.fail(joint, owner + " has no <axis>; add it, for example xyz=\"0 0 1\"");
  const auto xyz = document.numbers(*axis, "xyz", 3, owner);
  if (!(std::hypot(xyz[0], xyz[1], xyz[2]) > 1e-6)) {
    document.fail(*axis, owner + " has a zero axis; give the direction it turns about");
  }
  check_limits(document, joint, owner);
}

/// Everything that can be said about single elements, with their line, before urdfdom builds the tree.
void check_elements(const Document& document) {
  (void)document.attribute(document.robot(), "name", "the robot");
  std::set<std::string> link_names;
  std::set<std::string> joint_names;
  std::map<std::string, std::string> parent_of;
  for (auto* e = document.robot().FirstChildElement("link"); e != nullptr; e = e->NextSiblingElement("link")) {
    const std::string name = document.attribute(*e, "name", "a link");
    if (!link_names.insert(name).second) document.fail(*e, "link '" + name + "' is given twice; rename one");
    check_link_element(document, *e, "link '" + name + "'");
  }
  for (auto* e = document.robot().FirstChildElement("joint"); e != nullptr; e = e->NextSiblingElement("joint")) {
    const std::string name = document.attribute(*e, "name", "a joint");
    const std::string owner = "joint '" + name + "'";
    if (!joint_names.insert(name).second) document.fail(*e, owner + " is given twice; rename one");
    for (const char* end : {"parent", "child"}) {
      const TiXmlElement* element = e->FirstChildElement(end);
      if (element == nullptr) document.fail(*e, owner + " has no <" + end + ">; name the link");
      const std::string link = document.attribute(*element, "link", owner);
      if (!link_names.contains(link)) {
        document.fail(*element, owner + " has '" + link + "' as " + end + ", but there is no such link");
      }
    }
    const std::string child = e->FirstChildElement("child")->Attribute("link");
    if (!parent_of.emplace(child, e->FirstChildElement("parent")->Attribute("link")).second) {
      document.fail(*e, "link '" + child + "' is the child of two joints; a chain has one joint per link");
    }
    check_joint_element(document, *e, owner);
  }
  // urdfdom would not notice a loop beside a sound tree (and leaks it).
  for (const auto& [link, parent] : parent_of) {
    std::size_t steps = 0;
    for (auto at = parent_of.find(link); at != parent_of.end(); at = parent_of.find(at->second)) {
      if (++steps > parent_of.size()) document.fail_link(link, "hangs in a loop of joints; a chain has a beginning");
    }
  }
}

Eigen::Vector3d to_eigen(const urdf::Vector3& v) { return {v.x, v.y, v.z}; }

FrameOffset to_offset(const urdf::Pose& pose) {
  const Eigen::Quaterniond q(pose.rotation.w, pose.rotation.x, pose.rotation.y, pose.rotation.z);
  return {q.normalized().toRotationMatrix(), to_eigen(pose.position)};
}

/// The inertial of a link, its inertia turned into link-frame axes.
LinkDescription to_body(const urdf::Link& link) {
  const urdf::Inertial& in = *link.inertial;
  const FrameOffset pose = to_offset(in.origin);
  Eigen::Matrix3d I;
  I << in.ixx, in.ixy, in.ixz, in.ixy, in.iyy, in.iyz, in.ixz, in.iyz, in.izz;
  return {link.name, in.mass, pose.translation_m, pose.rotation * I * pose.rotation.transpose()};
}

/// Everything rigidly attached to one moving link (or the base), and the joint that leaves it.
struct Group {
  std::vector<PlacedBody> bodies;
  urdf::JointConstSharedPtr next;
  FrameOffset next_offset;
};

void collect(const Document& document, const urdf::ModelInterface& model, const urdf::Link& link,
             const FrameOffset& pose, int carrier, Group& group, UrdfChain& chain) {
  chain.links[link.name] = {carrier, pose};
  if (link.inertial) {
    const LinkDescription body = to_body(link);
    if (const auto problem = impossible_body(body)) document.fail_link(link.name, *problem);
    group.bodies.push_back({pose, body});
  }
  for (const auto& joint : link.child_joints) {
    const FrameOffset there = compose(pose, to_offset(joint->parent_to_joint_origin_transform));
    if (joint->type == urdf::Joint::FIXED) {
      collect(document, model, *model.getLink(joint->child_link_name), there, carrier, group, chain);
    } else if (group.next) {
      document.fail_joint(joint->name, "branches off beside '" + group.next->name +
                                           "', but the robot must be one serial chain; fix or remove one of the two");
    } else {
      group.next = joint;
      group.next_offset = there;
    }
  }
}

}  // namespace

FrameOffset compose(const FrameOffset& outer, const FrameOffset& inner) {
  return {outer.rotation * inner.rotation, outer.translation_m + outer.rotation * inner.translation_m};
}

LinkDescription merge_bodies(const std::string& name, const std::vector<PlacedBody>& bodies) {
  LinkDescription merged;
  merged.name = name;
  for (const auto& [pose, body] : bodies) {
    merged.mass_kg += body.mass_kg;
    merged.com_m += body.mass_kg * (pose.translation_m + pose.rotation * body.com_m);
  }
  if (!(merged.mass_kg > 0.0)) return merged;
  merged.com_m /= merged.mass_kg;
  for (const auto& [pose, body] : bodies) {
    const Eigen::Vector3d d = pose.translation_m + pose.rotation * body.com_m - merged.com_m;
    merged.inertia_kg_m2 += pose.rotation * body.inertia_kg_m2 * pose.rotation.transpose() +
                            body.mass_kg * (d.squaredNorm() * Eigen::Matrix3d::Identity() - d * d.transpose());
  }
  return merged;
}

std::optional<std::string> impossible_body(const LinkDescription& body) {
  std::ostringstream text;
  if (!(body.mass_kg > 0.0 && body.mass_kg <= 1e4)) {
    text << "has a mass of " << body.mass_kg << " kg, but a mass must be above 0 kg and at most 10000 kg";
    return text.str();
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(body.inertia_kg_m2, Eigen::EigenvaluesOnly);
  const Eigen::Vector3d& moments = solver.eigenvalues();  // ascending
  if (!(moments(0) > 0.0)) {
    text << "has an inertia with a principal moment of " << moments(0)
         << " kg m^2, but all must be above 0; correct its <inertia>";
    return text.str();
  }
  if (!(moments(2) <= moments(0) + moments(1) + 1e-9 * moments.sum())) {
    text << "has principal moments of inertia " << moments(0) << ", " << moments(1) << " and " << moments(2)
         << " kg m^2, but no body has one larger than the sum of the others; correct its <inertia>";
    return text.str();
  }
  return std::nullopt;
}

UrdfChain read_urdf_chain(const std::filesystem::path& file) {
  const Document document(file);
  check_elements(document);

  urdf::ModelInterfaceSharedPtr model;
  {
    LogCapture log;
    model = urdf::parseURDF(document.text());
    if (!model || !model->getRoot()) {
      const std::string reason = as_clause(log.first());
      document.fail(0, "the URDF cannot be used (" + (reason.empty() ? "no root link" : reason) + "); correct it");
    }
  }

  UrdfChain chain;
  chain.name = model->getName();
  Group group;
  collect(document, *model, *model->getRoot(), {}, -1, group, chain);
  while (group.next) {
    if (chain.joints.size() == static_cast<std::size_t>(kMaxJoints)) {
      document.fail_joint(group.next->name,
                          "is one too many, as at most " + std::to_string(kMaxJoints) + " joints are supported");
    }
    JointDescription joint;
    joint.name = group.next->name;
    joint.offset = group.next_offset;
    joint.axis = to_eigen(group.next->axis).normalized();
    joint.limits.lower_rad = group.next->limits->lower;
    joint.limits.upper_rad = group.next->limits->upper;
    joint.limits.velocity_rad_s = group.next->limits->velocity;
    joint.limits.torque_nm = group.next->limits->effort;
    const urdf::LinkConstSharedPtr link = model->getLink(group.next->child_link_name);
    group = Group{};
    collect(document, *model, *link, {}, static_cast<int>(chain.joints.size()), group, chain);
    joint.link = merge_bodies(link->name, group.bodies);
    if (!(joint.link.mass_kg > 0.0)) {
      document.fail_link(link->name,
                         "moves with joint '" + joint.name + "' but has no <inertial>; add its mass and inertia");
    }
    chain.joints.push_back(joint);
  }
  if (chain.joints.empty()) document.fail(0, "there is no revolute joint; a robot has at least one");
  return chain;
}

}  // namespace mrr
