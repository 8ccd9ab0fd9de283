#include "supervisor/daemon/service.h"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <limits>

#include "common/robot/errors.h"
#include "supervisor/master/bus_budget.h"
#include "supervisor/report_json.h"
#include "supervisor/strike/move.h"

namespace mrr::sup {

namespace {

using rpc::Json;
using rpc::Params;

constexpr std::size_t kMostRows = 300'000;  // 300 s at one a millisecond
constexpr std::size_t kMostRowsAtOnce = 2000;
constexpr std::size_t kKeptJobs = 8;
constexpr std::size_t kKeptFaults = 64;
constexpr double kDefaultSpeed = 0.2;
constexpr double kBusFullShown_s = 1.0;
constexpr double kLeastTravel_rad = 0.1;  // of friction identification, to either side
constexpr double kClearance_m = 0.02;     // hammer over the nail's head while a joint swings to and fro
constexpr double kNearNail_m = 0.25;

const char* code_name(RpcError error) noexcept {
  switch (error) {
    case RpcError::not_ready:
      return "not_ready";
    case RpcError::busy:
      return "busy";
    case RpcError::outside_limits:
      return "outside_limits";
    case RpcError::unknown_joint:
      return "unknown_joint";
    case RpcError::joint_unavailable:
      return "joint_unavailable";
    case RpcError::nothing_to_do:
      return "nothing_to_do";
    case RpcError::no_clock:
      return "no_clock";
    case RpcError::no_job:
      return "no_job";
    case RpcError::shutting_down:
      return "shutting_down";
    case RpcError::stale_configuration:
      return "stale_configuration";
  }
  return "?";
}

[[noreturn]] void refuse(RpcError error, const std::string& sentence) {
  throw rpc::Error(static_cast<int>(error), sentence, {{"code", code_name(error)}});
}

[[noreturn]] void refuse_parameter(const std::string& sentence) { throw rpc::Error(rpc::kInvalidParams, sentence); }

/// Params as an object with no key but `allowed`.
const Params& object_with(const Params& params, std::initializer_list<const char*> allowed) {
  static const Params empty = Params::object();
  if (params.is_null()) return empty;
  if (!params.is_object()) refuse_parameter("params is not an object; give parameters by name");
  for (const auto& [key, value] : params.items()) {
    if (std::find(allowed.begin(), allowed.end(), key) != allowed.end()) continue;
    std::string known;
    for (const char* name : allowed) known = fmt::format("{}{}{}", known, known.empty() ? "" : ", ", name);
    refuse_parameter(
        fmt::format("{} is not a parameter of this method; it takes {}", key, known.empty() ? "none" : known));
  }
  return params;
}

std::int64_t whole_number(const Params& params, const char* key, std::int64_t standard, std::int64_t least,
                          std::int64_t most) {
  const auto it = params.find(key);
  if (it == params.end()) return standard;
  const bool fits = it->is_number_unsigned() ? it->get<std::uint64_t>() <= static_cast<std::uint64_t>(most)
                                             : it->is_number_integer() && it->get<std::int64_t>() <= most;
  if (!fits || it->get<std::int64_t>() < least) {
    refuse_parameter(fmt::format("{} is {}; give a whole number from {} to {}", key, it->dump(), least, most));
  }
  return it->get<std::int64_t>();
}

/// Names of the object dictionary as words.
std::string words(std::string name) {
  std::replace(name.begin(), name.end(), '_', ' ');
  return name;
}

std::string snake(std::string name) {
  std::replace(name.begin(), name.end(), ' ', '_');
  return name;
}

/// Kind of the event towards clients.
std::string kind_name(EventKind kind) {
  switch (kind) {
    case EventKind::all_enabled:
      return "all_enabled";
    case EventKind::selection_pulled:
      return "selection_pulled";
    case EventKind::command_ended:
      return "command";
    default:
      return snake(describe(kind));
  }
}

Json percentiles(const LatencyHistogram& histogram) {
  const LatencyHistogram::Summary s = histogram.summary();
  return {{"p50", s.p50_us}, {"p99", s.p99_us}, {"p999", s.p999_us}, {"max", s.max_us}};
}

const char* calibration_state(ActionState state) noexcept {
  switch (state) {
    case ActionState::running:
      return "running";
    case ActionState::attained:
      return "done";
    case ActionState::failed:
      return "failed";
    case ActionState::none:
    case ActionState::aborted:
      return "stopped";
  }
  return "?";
}

/// The joints say more about it.
bool of_a_joint(CommandFailure failure) noexcept {
  return failure == CommandFailure::timed_out || failure == CommandFailure::joint_fault ||
         failure == CommandFailure::joint_refused;
}

}  // namespace

struct Service::Job {
  std::int64_t number = 0;
  SessionOptions options;
  std::unique_ptr<HammerSession> session;
  bool running = true;
  bool cancelled = false;
  std::size_t swings_told = 0;
  Verdict verdict = Verdict::none;
  std::string reason;
  double began_s = 0.0;
  double ended_s = 0.0;
};

Service::Service(const RobotDescription& robot, const ServiceOptions& options, Cycle& cycle, Call call, LogBook& log)
    : robot_(robot),
      options_(options),
      cycle_(cycle),
      call_(std::move(call)),
      log_(log),
      state_(&cycle.state()),
      load_computed_(bus_budget(robot).load) {}

Service::~Service() = default;

void Service::attach(rpc::Server& server) {
  server_ = &server;
  const auto plain = [&server](const char* name, std::function<Json()> method) {
    server.on(name, [method = std::move(method)](const Params& params) {
      (void)object_with(params, {});
      return method();
    });
  };
  plain("hello", [this] { return hello(); });
  plain("status", [this] { return status(); });
  plain("faults", [this] { return faults(); });
  plain("enable", [this] {
    require_no_job();
    require_configuration();
    if (activity() == Activity::faulted) {
      refuse(RpcError::not_ready, fmt::format("{}; clear the cause and reset", why_not_ready()));
    }
    return command(RequestKind::enable);
  });
  plain("reset", [this] {
    require_no_job();
    require_configuration();
    bool any = activity() == Activity::faulted;
    for (int i = 0; i < robot_.dof(); ++i) {
      const NodeStage stage = report(i).stage;
      any = any || stage == NodeStage::faulted || stage == NodeStage::refused;
    }
    if (!any) refuse(RpcError::nothing_to_do, "there is no fault to acknowledge");
    return command(RequestKind::reset);
  });
  plain("disable", [this] {
    if (!jobs_.empty()) jobs_.back()->cancelled = true;
    return command(RequestKind::disable);
  });
  plain("stop", [this] {
    if (!jobs_.empty()) jobs_.back()->cancelled = true;
    return command(RequestKind::stop);
  });
  for (const RequestKind kind : {RequestKind::home, RequestKind::passive, RequestKind::active}) {
    const char* name = kind == RequestKind::home ? "home" : kind == RequestKind::passive ? "passive" : "active";
    server.on(name, [this, kind](const Params& params) {
      const int joint = joint_of(object_with(params, {"joint"}));
      require_no_job();
      if (kind == RequestKind::home) require_configuration();
      return command(kind, joint);
    });
  }
  server.on("move", [this](const Params& params) { return move(object_with(params, {"positions_rad", "speed"})); });
  server.on("calibrate", [this](const Params& params) {
    return calibrate(object_with(params, {"joint", "what", "travel_rad", "speed_rad_s", "torque_nm"}));
  });
  plain("calibration", [this] { return calibration(); });
  server.on("hammer", [this](const Params& params) {
    return hammer(object_with(params, {"mode", "swings", "seed", "as_printed"}));
  });
  server.on("job", [this](const Params& params) { return job(object_with(params, {"job", "from_swing"})); });
  server.on("recording", [this](const Params& params) {
    return recording(object_with(params, {"from_row", "max_rows"}));
  });
  server.on("log", [this](const Params& params) { return log_lines(object_with(params, {"count"})); });
  plain("shutdown", [this] {
    shut_down("a client asked for it");
    return Json::object();
  });
}

// ---------------------------------------------------------------------------------------------- for the session

void Service::enable(bool wanted) { (void)ask({.kind = wanted ? RequestKind::enable : RequestKind::disable}); }

Refusal Service::execute(const StrikePlan& plan) {
  if (options_.test_switch_late.ns == 0) return ask({.kind = RequestKind::execute, .plan = &plan}).refusal;
  StrikePlan late = plan;
  late.switch_time += options_.test_switch_late;
  return ask({.kind = RequestKind::execute, .plan = &late}).refusal;
}

Answer Service::ask(const Request& request) {
  const std::optional<Answer> answer = call_(request);
  refresh();
  if (!answer) {
    refuse(RpcError::no_clock, "the supervisor's cycle stands still, so nothing can be commanded; see its log");
  }
  return *answer;
}

// ---------------------------------------------------------------------------------------------- methods

const std::string& Service::name_of(int joint) const { return robot_.joints[static_cast<std::size_t>(joint)].name; }

int Service::joint_of(const Params& params) const {
  const auto it = params.find("joint");
  if (it == params.end()) refuse_parameter("joint is missing; give a name or a number from 1");
  std::string names;
  for (int i = 0; i < robot_.dof(); ++i) {
    if (it->is_string() && it->get<std::string>() == name_of(i)) return i;
    if (it->is_number_integer() && *it == i + 1) return i;
    names = fmt::format("{}{}{}", names, names.empty() ? "" : ", ", name_of(i));
  }
  if (!it->is_string() && !it->is_number_integer()) {
    refuse_parameter(fmt::format("joint is {}; give a name or a number from 1", it->dump().substr(0, 40)));
  }
  refuse(RpcError::unknown_joint, fmt::format("joint {}: {} has {}", it->dump().substr(0, 40), robot_.name, names));
}

std::string Service::problem_of(int joint) const {
  const NodeReport node = report(joint);
  const JointDescription& description = robot_.joints[static_cast<std::size_t>(joint)];
  std::string text = fmt::format("joint {} ({}, node {}) is {}", joint + 1, description.name, description.node_id,
                                 describe(node.stage));
  if (node.stage == NodeStage::enabled && !node.measured.follows_knots()) {
    return fmt::format("{} but does not follow its set points: {}", text,
                       words(can::name_of_code(node.measured.error_or_limit)));
  }
  if (node.problem != NodeProblem::none) text = fmt::format("{}: {}", text, describe(node.problem));
  if (node.problem == NodeProblem::fault) {
    const auto code = static_cast<std::uint16_t>(node.problem_detail);
    text = fmt::format("{}, {} ({:04X}h)", text, words(can::name_of_code(code)), code);
  } else if (node.problem_detail != 0) {
    text = fmt::format("{} (0x{:08X})", text, node.problem_detail);
  }
  return text;
}

std::string Service::why_not_ready() const {
  std::string text;
  for (int i = 0; i < robot_.dof(); ++i) {
    const NodeReport node = report(i);
    if (node.stage == NodeStage::enabled && node.measured.follows_knots()) continue;
    text = fmt::format("{}{}{}", text, text.empty() ? "" : "; ", problem_of(i));
  }
  return text.empty() ? fmt::format("the robot is {}", describe(activity())) : text;
}

void Service::require_running() const {
  if (shutting_down_) refuse(RpcError::shutting_down, "the supervisor is shutting down; start it again");
  if (clock_running_) return;
  refuse(RpcError::no_clock, fmt::format("the plant on {0} does not tick, and it is the clock; start mrr_plant --plant "
                                         "{0} --lockstep and all modules",
                                         options_.plant));
}

std::string Service::reason_of(CommandFailure failure) const {
  if (of_a_joint(failure)) return fmt::format("{}: {}", describe(failure), why_not_ready());
  if (failure == CommandFailure::calibration_failed) {
    const std::string why = why_failed(state_->calibration);
    return why.empty() ? "the joint does not answer" : why;
  }
  return describe(failure);
}

void Service::require_configuration() const {
  if (!source_changed(robot_)) return;
  refuse(RpcError::stale_configuration,
         fmt::format("the robot description in {} was changed after it was read here; restart modules and supervisor "
                     "(scripts/robot down, scripts/robot up)",
                     robot_.source.string()));
}

void Service::require_holding() const {
  if (activity() == Activity::holding) return;
  if (moves(activity())) refuse(RpcError::busy, fmt::format("the robot is {}; stop it first", describe(activity())));
  if (activity() == Activity::disabled) refuse(RpcError::not_ready, "the robot is disabled; enable it first");
  refuse(RpcError::not_ready, why_not_ready());
}

void Service::require_no_job() const {
  if (!jobs_.empty() && jobs_.back()->running) {
    refuse(RpcError::busy, fmt::format("job {} is under way; stop it first", jobs_.back()->number));
  }
}

Json Service::command(RequestKind kind, int joint) {
  require_running();
  const Answer answer = ask({.kind = kind, .joint = joint});
  switch (answer.refusal) {
    case Refusal::none:
      return {{"command", answer.command}};
    case Refusal::not_ready:
      if (moves(activity()))
        refuse(RpcError::busy, fmt::format("the robot is {}; stop it first", describe(activity())));
      if (activity() == Activity::disabled) refuse(RpcError::not_ready, "the robot is disabled; enable it first");
      refuse(RpcError::not_ready,
             fmt::format("{}; {}", why_not_ready(),
                         activity() == Activity::faulted ? "clear the cause and reset" : "wait until all joints hold"));
    case Refusal::unknown_joint:
      refuse(RpcError::unknown_joint, "there is no such joint");
    case Refusal::joint_unavailable:
      refuse(RpcError::joint_unavailable, fmt::format("{}; enable it first", problem_of(joint)));
    case Refusal::not_passive:
      refuse(RpcError::nothing_to_do, fmt::format("{} was not let go", words_of(joint)));
    case Refusal::wrong_start:
    case Refusal::not_usable:
      break;
  }
  refuse(RpcError::not_ready, fmt::format("{}; try again", describe(answer.refusal)));
}

Json Service::move(const Params& params) {
  const auto targets = params.find("positions_rad");
  if (targets == params.end()) refuse_parameter("positions_rad is missing; give radians by joint name, or a list");
  if (!targets->is_object() && !(targets->is_array() && targets->size() == static_cast<std::size_t>(robot_.dof()))) {
    refuse_parameter(fmt::format("positions_rad is neither an object nor a list of {} values", robot_.dof()));
  }
  double speed = kDefaultSpeed;
  if (const auto it = params.find("speed"); it != params.end()) {
    if (!it->is_number()) refuse_parameter("speed is no number; give a share of the limits above 0, up to 1");
    speed = it->get<double>();
  }
  if (!(speed > 0.0 && speed <= 1.0)) {
    refuse_parameter(fmt::format("speed is {:g}; give a share of the limits above 0, up to 1", speed));
  }
  const JointVector start = reference_position();
  JointVector target = start;
  const auto set = [&](int joint, const Params& value) {
    if (!value.is_number() || !std::isfinite(value.get<double>())) {
      refuse_parameter(
          fmt::format("positions_rad: {} of {} is no number", value.dump().substr(0, 40), words_of(joint)));
    }
    target[joint] = value.get<double>();
  };
  if (targets->is_object()) {
    for (const auto& [name, value] : targets->items()) set(joint_of(Params{{"joint", name}}), value);
  } else {
    for (int i = 0; i < robot_.dof(); ++i) {
      const Params& value = (*targets)[static_cast<std::size_t>(i)];
      if (!value.is_null()) set(i, value);
    }
  }
  require_no_job();
  require_running();
  require_holding();
  JointTrajectory motion;
  try {
    motion = plan_move(robot_, cycle_.chain(), start, target, speed, seconds(1.0 / robot_.bus.knot_rate_hz));
  } catch (const PlanError& error) {
    refuse(RpcError::outside_limits, error.what());
  }
  const Answer answer = ask({.kind = RequestKind::move, .motion = &motion});
  if (answer.refusal != Refusal::none)
    refuse(RpcError::not_ready, fmt::format("{}; try again", describe(answer.refusal)));
  return {{"command", answer.command}, {"duration_s", motion.duration().seconds()}};
}

Json Service::hammer(const Params& params) {
  SessionOptions options;
  if (const auto it = params.find("mode"); it != params.end()) {
    const std::string mode = it->is_string() ? it->get<std::string>() : it->dump().substr(0, 40);
    if (mode != "planned" && mode != "never" && mode != "always") {
      refuse_parameter(fmt::format("mode is {}; give planned, never or always", mode));
    }
    options.mode = mode == "never" ? PassiveMode::never : mode == "always" ? PassiveMode::always : PassiveMode::planned;
  }
  options.max_swings = static_cast<int>(whole_number(params, "swings", 0, 1, 1000));
  options.seed = static_cast<std::uint64_t>(whole_number(params, "seed", 1, 0, 999'999'999'999'999'999));
  if (const auto it = params.find("as_printed"); it != params.end()) {
    if (!it->is_boolean()) refuse_parameter("as_printed is neither true nor false");
    if (it->get<bool>()) options.formulation = Formulation::as_printed;
  }
  require_running();
  require_no_job();
  require_configuration();
  if (moves(activity())) refuse(RpcError::busy, fmt::format("the robot is {}; stop it first", describe(activity())));
  if (activity() == Activity::faulted) {
    refuse(RpcError::not_ready, fmt::format("{}; clear the cause and reset", why_not_ready()));
  }
  auto next = std::make_unique<Job>();
  next->number = jobs_.empty() ? 1 : jobs_.back()->number + 1;
  next->options = options;
  next->session = std::make_unique<HammerSession>(robot_, static_cast<RobotPort&>(*this), options);
  next->began_s = state_->now.seconds();
  jobs_.push_back(std::move(next));
  if (jobs_.size() > kKeptJobs) jobs_.erase(jobs_.begin());
  take_rows();
  rows_.clear();
  rows_too_many_ = 0;
  rows_lost_before_ = cycle_.dropped_rows();
  cycle_.record(1);
  log_.info(fmt::format("job {} begins: hammering, {} at most", jobs_.back()->number,
                        options.max_swings > 0 ? options.max_swings : robot_.task.max_swings));
  return {{"job", jobs_.back()->number}};
}

// The joint swings about where it stands: its limits and the nail must be far enough away.
void Service::require_clearance(int joint, double travel_rad) const {
  const JointDescription& description = robot_.joints[static_cast<std::size_t>(joint)];
  JointVector q = reference_position();
  const double here_rad = q[joint];
  const double room_rad = std::min(description.limits.upper_rad - here_rad, here_rad - description.limits.lower_rad);
  if (!(room_rad >= kLeastTravel_rad)) {
    refuse(RpcError::outside_limits,
           fmt::format("{} stands at {:.3f} rad, {:.3f} rad from a limit, and needs {:g} rad to either side; move it "
                       "away from there first",
                       words_of(joint), here_rad, room_rad, kLeastTravel_rad));
  }
  constexpr int kSteps = 20;
  double least_m = std::numeric_limits<double>::infinity();
  for (int k = -kSteps; k <= kSteps; ++k) {
    q[joint] = here_rad + travel_rad * k / kSteps;
    const Eigen::Vector3d from_nail_m = cycle_.chain().face_pose(q).position_m - robot_.task.nail_position_m;
    const double height_m = from_nail_m.dot(robot_.task.normal);
    const double beside_m = (from_nail_m - height_m * robot_.task.normal).norm();
    if (beside_m < kNearNail_m) least_m = std::min(least_m, height_m - robot_.task.nail_height_m);
  }
  if (least_m >= kClearance_m) return;
  refuse(RpcError::outside_limits,
         fmt::format("{} would bring the hammer {} the nail's head within {:g} rad of where it stands; {:.0f} mm above "
                     "it are needed: move the arm up, or give less travel",
                     words_of(joint), least_m < 0.0 ? "below" : fmt::format("to {:.0f} mm above", least_m * 1e3),
                     travel_rad, kClearance_m * 1e3));
}

Json Service::calibrate(const Params& params) {
  const int joint = joint_of(params);
  CalibrationSettings settings;
  const auto what = params.find("what");
  if (what != params.end()) {
    const auto* const kind = std::find_if(kCalibrationKinds.begin(), kCalibrationKinds.end(), [&](CalibrationKind k) {
      return what->is_string() && what->get<std::string>() == describe(k);
    });
    if (kind == kCalibrationKinds.end()) {
      refuse_parameter(fmt::format("what is {}; give friction, torque-zero or brake", what->dump().substr(0, 40)));
    }
    settings.kind = *kind;
  }
  const auto set = [&](const char* key, float& value, CalibrationKind kind, double lo, double hi, const char* unit) {
    const auto it = params.find(key);
    if (it == params.end()) return;
    if (settings.kind != kind) refuse_parameter(fmt::format("{} is of {} only; leave it out", key, describe(kind)));
    const double given = it->is_number() ? it->get<double>() : std::nan("");
    if (!(given >= lo && given <= hi)) {
      refuse_parameter(fmt::format("{} is {}; give {:g} to {:g} {}", key, it->dump().substr(0, 40), lo, hi, unit));
    }
    value = static_cast<float>(given);
  };
  set("travel_rad", settings.travel_rad, CalibrationKind::friction, kLeastTravel_rad, 3.0, "rad");
  set("speed_rad_s", settings.speed_rad_s, CalibrationKind::friction, 0.1, 10.0, "rad/s");
  const JointDescription& description = robot_.joints[static_cast<std::size_t>(joint)];
  set("torque_nm", settings.torque_nm, CalibrationKind::brake, 0.1, description.limits.torque_nm, "Nm");
  if (settings.kind == CalibrationKind::torque_zero && !description.sensors.torque_sensor) {
    refuse(RpcError::nothing_to_do, fmt::format("{} has no torque sensor", words_of(joint)));
  }
  require_running();
  require_no_job();
  require_configuration();
  require_holding();
  if (settings.kind == CalibrationKind::friction) {
    require_clearance(joint, double{settings.travel_rad});
  } else if (settings.kind == CalibrationKind::torque_zero) {
    settings.load_nm = static_cast<float>(cycle_.chain().gravity(reference_position())[joint]);
  }
  const Answer answer = ask({.kind = RequestKind::calibrate, .joint = joint, .calibration = settings});
  if (answer.refusal != Refusal::none)
    refuse(RpcError::not_ready, fmt::format("{}; try again", describe(answer.refusal)));
  return {{"command", answer.command}};
}

Json Service::calibration() const {
  const CalibrationReport& report = state_->calibration;
  if (report.joint < 0) refuse(RpcError::no_job, "nothing was calibrated yet; begin with calibrate");
  const bool ended = report.state != ActionState::running;
  const bool found = ended && report.has_result;
  const CalibrationKind kind = report.settings.kind;
  const auto only = [&](CalibrationKind wanted, const Json& value) { return kind == wanted ? value : Json(nullptr); };
  const auto direction = [&](std::size_t way) {
    const auto& f = report.friction[way];
    return Json{{"coulomb_nm", number(double{f[0]})},
                {"static_nm", number(double{f[1]})},
                {"stribeck_decay_s2_rad2", number(double{f[2]})},
                {"viscous_nm_s_rad", number(double{f[3]})}};
  };
  const bool fitted = found && kind == CalibrationKind::friction && report.points > 0;
  Json friction = nullptr;
  if (fitted) {
    friction = {{"positive", direction(0)},
                {"negative", direction(1)},
                {"torque_constant_positive_nm_a", number(double{report.torque_constant_nm_a[0]})},
                {"torque_constant_negative_nm_a", number(double{report.torque_constant_nm_a[1]})},
                {"residual_nm", number(double{report.residual_nm})},
                {"points", report.points}};
  }
  const bool failed = ended && report.state != ActionState::attained;
  return {{"command", report.command},
          {"joint", name_of(report.joint)},
          {"what", describe(kind)},
          {"state", calibration_state(report.state)},
          {"reason", !failed                                ? ""
                     : report.state == ActionState::aborted ? "it was stopped"
                                                            : reason_of(CommandFailure::calibration_failed)},
          {"progress_percent", report.progress_percent},
          {"travel_rad", only(CalibrationKind::friction, number(double{report.settings.travel_rad}))},
          {"speed_rad_s", only(CalibrationKind::friction, number(double{report.settings.speed_rad_s}))},
          {"load_nm", only(CalibrationKind::torque_zero, number(double{report.settings.load_nm}))},
          {"friction", friction},
          {"torque_offset_nm", found ? only(CalibrationKind::torque_zero, number(double{report.offset_nm})) : nullptr},
          {"slip_rad", found ? only(CalibrationKind::brake, number(double{report.slip_rad})) : nullptr}};
}

Json Service::job(const Params& params) const {
  if (jobs_.empty()) refuse(RpcError::no_job, "there was no job yet; begin one with hammer");
  const std::int64_t wanted = whole_number(params, "job", jobs_.back()->number, 1, 1'000'000'000);
  const auto from = static_cast<std::size_t>(whole_number(params, "from_swing", 1, 1, 1'000'000));
  const auto it = std::find_if(jobs_.begin(), jobs_.end(), [&](const auto& j) { return j->number == wanted; });
  if (it == jobs_.end()) {
    refuse(RpcError::no_job,
           fmt::format("job {} is not kept; jobs {} to {} are", wanted, jobs_.front()->number, jobs_.back()->number));
  }
  const Job& job = **it;
  const std::vector<SwingReport>& swings = job.session->swings();
  Json list = Json::array();
  for (std::size_t k = from - 1; k < swings.size(); ++k) list.push_back(swing_json(robot_, swings[k]));
  return {{"job", job.number},
          {"state", job.running ? "running" : "done"},
          {"verdict", describe(job.verdict)},
          {"reason", job.reason},
          {"robot", robot_.name},
          {"mode", mode_name(job.options.mode)},
          {"formulation", formulation_name(job.options.formulation)},
          {"seed", job.options.seed},
          {"began_s", job.began_s},
          {"ended_s", job.running ? Json(nullptr) : Json(job.ended_s)},
          {"nail_height_mm", number(job.session->head_height_m() * 1e3)},
          {"geometry", geometry_json(robot_)},
          {"plan", swings.empty() ? Json(nullptr) : plan_json(robot_, swings.front().plan)},
          {"swings", list}};
}

Json Service::recording(const Params& params) const {
  const auto from = static_cast<std::size_t>(whole_number(params, "from_row", 0, 0, 1'000'000'000));
  const auto most =
      static_cast<std::size_t>(whole_number(params, "max_rows", 500, 1, static_cast<std::int64_t>(kMostRowsAtOnce)));
  if (jobs_.empty()) refuse(RpcError::no_job, "nothing was recorded yet; begin a job with hammer");
  Json columns = {"time [s]", "swing [1]", "activity [1]", "estimated_force [N]"};
  for (const JointDescription& joint : robot_.joints) {
    for (const char* quantity : {"reference [rad]", "position [rad]", "reference_velocity [rad/s]",
                                 "motor_velocity [rad/s]", "sensed_torque [Nm]", "passive [1]"}) {
      columns.push_back(fmt::format("{}_{}", joint.name, quantity));
    }
  }
  Json rows = Json::array();
  const std::size_t end = std::min(rows_.size(), from + most);
  for (std::size_t r = from; r < end; ++r) {
    const RecordRow& row = rows_[r];
    Json values = {row.time_s, row.swing, static_cast<int>(row.activity), row.force_n};
    for (int i = 0; i < robot_.dof(); ++i) {
      const RecordRow::Joint& joint = row.joints[static_cast<std::size_t>(i)];
      for (const double value : {joint.reference_rad, joint.position_rad, joint.reference_velocity_rad_s,
                                 joint.velocity_rad_s, joint.torque_nm, joint.passive ? 1.0 : 0.0}) {
        values.push_back(value);
      }
    }
    rows.push_back(std::move(values));
  }
  return {{"job", jobs_.back()->number},
          {"columns", columns},
          {"rows", rows},
          {"next_row", std::max(from, end)},
          {"total_rows", rows_.size()},
          {"dropped_rows", cycle_.dropped_rows() - rows_lost_before_ + rows_too_many_},
          {"complete", !jobs_.back()->running && end == rows_.size()}};
}

Json Service::log_lines(const Params& params) const {
  const auto count = static_cast<std::size_t>(whole_number(params, "count", 100, 1, 1000));
  const auto& all = log_.lines();
  Json lines = Json::array();
  for (std::size_t i = all.size() > count ? all.size() - count : 0; i < all.size(); ++i) {
    lines.push_back({{"time_s", all[i].time_s}, {"level", level_name(all[i].level)}, {"text", all[i].text}});
  }
  return {{"lines", lines}};
}

Json Service::hello() const {
  Json joints = Json::array();
  for (const JointDescription& joint : robot_.joints) {
    joints.push_back({{"name", joint.name},
                      {"node_id", joint.node_id},
                      {"lower_rad", joint.limits.lower_rad},
                      {"upper_rad", joint.limits.upper_rad},
                      {"velocity_rad_s", joint.limits.velocity_rad_s},
                      {"acceleration_rad_s2", joint.limits.acceleration_rad_s2},
                      {"absolute_encoder", joint.sensors.encoder_absolute},
                      {"max_passive_s", joint.control.max_passive_s},
                      {"max_passive_travel_rad", joint.control.max_passive_travel_rad}});
  }
  return {{"interface_version", rpc::kInterfaceVersion},
          {"software_version", MRR_VERSION},
          {"pid", ::getpid()},
          {"robot",
           {{"name", robot_.name},
            {"source", std::filesystem::absolute(robot_.source).lexically_normal().string()},
            {"joints", joints}}},
          {"bus",
           {{"interface", options_.can},
            {"bit_rate", robot_.bus.bit_rate},
            {"knot_rate_hz", robot_.bus.knot_rate_hz},
            {"load_computed", load_computed_}}},
          {"clock",
           {{"kind", options_.plant.empty() ? "realtime" : "lockstep"},
            {"plant_interface", options_.plant.empty() ? Json(nullptr) : Json(options_.plant)},
            {"period_us", 1000.0}}},
          {"protocol_hash", options_.protocol_hash}};
}

Json Service::joint_json(int joint) const {
  const NodeReport node = report(joint);
  const NodeMeasurement& measured = node.measured;
  const NodeCondition& condition = node.condition;
  const auto if_known = [](bool known, const Json& value) { return known ? value : Json(nullptr); };
  const bool enabled = node.stage == NodeStage::enabled;
  const bool is_limit = measured.valid && measured.error_or_limit != 0 && measured.error_or_limit < 0x1000U;
  const bool not_homed = is_limit && measured.error_or_limit == static_cast<std::uint16_t>(can::LimitCode::not_homed);
  const bool has_problem = node.problem != NodeProblem::none;
  return {{"name", name_of(joint)},
          {"node_id", robot_.joints[static_cast<std::size_t>(joint)].node_id},
          {"stage", describe(node.stage)},
          {"problem", if_known(has_problem, describe(node.problem))},
          {"problem_detail", node.problem_detail},
          {"position_rad", if_known(measured.valid, measured.position_rad)},
          {"velocity_rad_s", if_known(measured.valid, measured.velocity_rad_s)},
          {"torque_nm", if_known(measured.valid, measured.torque_nm)},
          {"reference_rad", if_known(enabled, number(state_->reference.q[joint]))},
          {"mode", if_known(measured.valid, measured.mode_display)},
          {"statusword", if_known(measured.valid, measured.statusword)},
          {"state", if_known(measured.valid, describe_state(measured.statusword))},
          {"following", enabled && measured.follows_knots()},
          {"homed", if_known(enabled, !not_homed)},
          {"active_limit", if_known(is_limit, words(can::name_of_code(measured.error_or_limit)))},
          {"fault", node.fault == 0 ? Json(nullptr)
                                    : Json{{"code", node.fault},
                                           {"name", words(can::name_of_code(node.fault))},
                                           {"time_s", node.fault_at.seconds()}}},
          {"winding_c", if_known(condition.valid, condition.winding_c)},
          {"drive_c", if_known(condition.valid, condition.drive_c)},
          {"bus_v", if_known(condition.valid, condition.bus_v)},
          {"loop_load", if_known(condition.valid, condition.loop_load)}};
}

Json Service::status() {
  refresh();
  Json joints = Json::array();
  for (int i = 0; i < robot_.dof(); ++i) joints.push_back(joint_json(i));
  const CommandStatus& last = state_->command;
  Json command = nullptr;
  if (last.number > 0) {
    std::string reason = last.number == ended_command_ ? ended_reason_ : "";
    if (last.number != ended_command_ && last.state == CommandState::failed) reason = reason_of(last.failure);
    command = {
        {"number", last.number}, {"method", describe(last.kind)}, {"state", describe(last.state)}, {"reason", reason}};
  }
  Json job = nullptr;
  if (!jobs_.empty()) {
    const Job& current = *jobs_.back();
    job = {{"job", current.number},
           {"state", current.running ? "running" : "done"},
           {"swings", current.session->swings().size()},
           {"verdict", describe(current.verdict)},
           {"nail_height_mm", number(current.session->head_height_m() * 1e3)}};
  }
  if (const double now_s = state_->now.seconds(); now_s < source_checked_s_ || now_s - source_checked_s_ >= 1.0) {
    source_changed_ = source_changed(robot_);
    source_checked_s_ = now_s;
  }
  Json bus_problem = nullptr;
  if (bus_state_ == "down") {
    bus_problem = why_down();
  } else if (bus_state_ == "full") {
    bus_problem = fmt::format("interface {} takes no more frames: nobody acknowledges them, or the bus is overloaded",
                              options_.can);
  }
  return {{"time_s", state_->now.seconds()},
          {"activity", describe(activity())},
          {"ready", activity() == Activity::holding},
          {"joints", joints},
          {"bus",
           {{"interface", options_.can},
            {"state", bus_state_},
            {"problem", bus_problem},
            {"load_computed", load_computed_},
            {"frames_received", state_->bus.received},
            {"frames_sent", state_->bus.sent},
            {"transmit_failures", state_->bus.not_sent}}},
          {"clock",
           {{"kind", options_.plant.empty() ? "realtime" : "lockstep"},
            {"running", clock_running_},
            {"period_us", 1000.0},
            {"cycles", state_->cycles},
            {"missed", state_->missed},
            {"late_us", percentiles(cycle_.late())},
            {"work_us", percentiles(cycle_.work())},
            {"realtime_scheduling", options_.realtime_scheduling},
            {"memory_locked", options_.memory_locked}}},
          {"configuration", {{"source", robot_.source.string()}, {"stale", source_changed_}}},
          {"ledger", ledger()},
          {"command", command},
          {"job", job}};
}

Json Service::ledger() const {
  if (options_.ledger == nullptr) return nullptr;
  Json json = ledger_json(robot_, options_.ledger->ledger());
  json["file"] = options_.ledger->file().string();
  json["problem"] = ledger_problem_.empty() ? Json(nullptr) : Json(ledger_problem_);
  return json;
}

Json Service::faults() const {
  const auto fault_json = [this](int joint, std::uint16_t code, double time_s, const std::string& text) {
    return Json{{"joint", name_of(joint)},
                {"code", code},
                {"name", words(can::name_of_code(code))},
                {"time_s", time_s},
                {"text", text}};
  };
  Json active = Json::array();
  for (int i = 0; i < robot_.dof(); ++i) {
    const NodeReport node = report(i);
    if (node.stage != NodeStage::faulted && node.stage != NodeStage::lost && node.stage != NodeStage::refused) continue;
    // One that is lost reports no time: that of the newest event about it.
    const auto heard = std::find_if(faults_.begin(), faults_.end(), [i](const Fault& f) { return f.joint == i; });
    const double at_s = node.fault != 0          ? node.fault_at.seconds()
                        : heard != faults_.end() ? heard->time_s
                                                 : state_->now.seconds();
    active.push_back(fault_json(i, node.fault, at_s, problem_of(i)));
  }
  Json history = Json::array();
  for (const Fault& fault : faults_) history.push_back(fault_json(fault.joint, fault.code, fault.time_s, fault.text));
  return {{"active", active}, {"history", history}};
}

// ---------------------------------------------------------------------------------------------- going on

void Service::notify(const char* kind, int joint, std::optional<std::int64_t> value, const std::string& text,
                     Json more) {
  if (server_ == nullptr) return;
  Json params = {{"kind", kind},
                 {"time_s", state_->now.seconds()},
                 {"joint", joint < 0 ? Json(nullptr) : Json(name_of(joint))},
                 {"value", value ? Json(*value) : Json(nullptr)},
                 {"text", text}};
  for (auto& [key, item] : more.items()) params[key] = std::move(item);
  server_->notify(kind, params);
}

void Service::take_events() {
  Event event;
  while (cycle_.next_event(event)) {
    refresh();  // at least as new as the event: what is said of it is not of before
    std::string text = describe(event.kind);
    auto level = spdlog::level::debug;
    Json more = Json::object();
    switch (event.kind) {
      case EventKind::node_stage:
        text = fmt::format("{}: {}", words_of(event.joint), describe(static_cast<NodeStage>(event.value)));
        level = spdlog::level::info;
        break;
      case EventKind::node_problem:
        text = fmt::format("{}: {}", words_of(event.joint), describe(static_cast<NodeProblem>(event.value)));
        level = event.value == 0 ? spdlog::level::debug : spdlog::level::warn;
        break;
      case EventKind::fault:
        text = problem_of(event.joint);
        level = spdlog::level::err;
        faults_.push_front({event.at.seconds(), event.joint, report(event.joint).fault, text});
        if (faults_.size() > kKeptFaults) faults_.pop_back();
        break;
      case EventKind::swing_aborted:
        text = fmt::format("swing aborted: {}", describe(static_cast<AbortReason>(event.value)));
        level = spdlog::level::warn;
        break;
      case EventKind::command_ended: {
        const auto failure = static_cast<CommandFailure>(event.detail);
        const bool done = failure == CommandFailure::none;
        ended_command_ = event.value;
        ended_reason_ = done ? "" : reason_of(failure);
        text = fmt::format("command {}: {}", event.value, done ? describe(failure) : ended_reason_);
        level = done ? spdlog::level::debug : spdlog::level::warn;
        more["state"] = done ? "done" : "failed";
        break;
      }
      case EventKind::homing_ended:
        text = fmt::format("{}: homing {}", words_of(event.joint),
                           static_cast<ActionState>(event.value) == ActionState::attained ? "attained" : "failed");
        level = spdlog::level::info;
        break;
      case EventKind::calibration_began:
        text = fmt::format("{}: calibration of {} began", words_of(event.joint),
                           describe(static_cast<CalibrationKind>(event.value)));
        level = spdlog::level::info;
        break;
      case EventKind::calibration_progress:
        text = fmt::format("{}: {} % of the calibration", words_of(event.joint), event.value);
        break;
      case EventKind::calibration_ended:
        text = fmt::format("{}: calibration {}", words_of(event.joint),
                           calibration_state(static_cast<ActionState>(event.value)));
        level = spdlog::level::info;
        break;
      case EventKind::all_enabled:
      case EventKind::disabled:
        level = spdlog::level::info;
        break;
      default:
        if (event.joint >= 0) text = fmt::format("{}: {}", words_of(event.joint), text);
        break;
    }
    log_.set_time(event.at.seconds());
    log_.say(level, text);
    notify(kind_name(event.kind).c_str(), event.joint, event.value, text, std::move(more));
  }
  log_.set_time(state_->now.seconds());
}

void Service::take_rows() {
  RecordRow row;
  while (cycle_.next_row(row)) {
    if (rows_.size() < kMostRows) {
      rows_.push_back(row);
    } else {
      ++rows_too_many_;
    }
  }
}

std::string Service::why_down() const {
  if (state_->bus.bus_off) {
    return fmt::format(
        "{0} is bus-off: look at wiring, terminators and bit rate; it comes back by itself only with ip "
        "link set {0} type can restart-ms 100",
        options_.can);
  }
  return fmt::format("interface {0} is down; ip link set {0} up", options_.can);
}

void Service::watch_bus() {
  const double now_s = state_->now.seconds();
  if (state_->bus.not_sent > not_sent_seen_) full_until_s_ = now_s + kBusFullShown_s;
  not_sent_seen_ = state_->bus.not_sent;
  const char* now = state_->bus.down || state_->bus.bus_off ? "down" : now_s < full_until_s_ ? "full" : "up";
  if (bus_state_ == now) return;
  bus_state_ = now;
  const std::string text = bus_state_ == "up" ? fmt::format("{} takes frames again", options_.can)
                           : bus_state_ == "down"
                               ? why_down()
                               : fmt::format("{} takes no more frames; they are dropped", options_.can);
  log_.say(bus_state_ == "up" ? spdlog::level::info : spdlog::level::err, text);
  notify("bus", -1, std::nullopt, text);
}

void Service::watch_clock() {
  const double now_s = state_->now.seconds();
  if (state_->missed == missed_told_ || now_s - missed_told_at_s_ < 1.0) return;
  const std::string text =
      fmt::format("{} cycles were left out: the process was not woken in time", state_->missed - missed_told_);
  log_.warn(text);
  notify("clock", -1, state_->missed, text);
  missed_told_ = state_->missed;
  missed_told_at_s_ = now_s;
}

void Service::set_clock_running(bool running) {
  if (running == clock_running_) return;
  clock_running_ = running;
  const std::string text = running ? "the clock runs" : "the clock stands still: the plant does not tick";
  log_.say(running ? spdlog::level::info : spdlog::level::warn, text);
  notify("clock", -1, std::nullopt, text);
}

void Service::step() {
  refresh();
  take_events();
  take_rows();
  watch_bus();
  watch_clock();
  step_job();
}

void Service::step_job() {
  if (jobs_.empty() || !jobs_.back()->running) return;
  Job& job = *jobs_.back();
  HammerSession& session = *job.session;
  // A stop ends a swing, and the session learns of it; before and after swings there is only the session to be ended.
  if (job.cancelled && session.state() != SessionState::swinging && session.state() != SessionState::learning) {
    if (!moves(activity())) end_job(Verdict::swing_aborted, describe(AbortReason::stop_requested));
    return;
  }
  bool over = false;
  try {
    over = session.step(state_->now);
  } catch (const rpc::Error& error) {
    end_job(Verdict::plan_refused, error.what());
    return;
  }
  while (job.swings_told < session.swings().size()) {
    const SwingReport& swing = session.swings()[job.swings_told++];
    const std::string text =
        fmt::format("swing {}: nail {:.1f} mm proud", swing.number, swing.head_height_after_m * 1e3);
    log_.info(text);
    notify("swing", -1, swing.number, text, {{"swing", swing_json(robot_, swing)}});
    enter_in_ledger(swing);
    cycle_.record(swing.number + 1);
  }
  if (over) end_job(session.verdict(), session.reason());
}

void Service::enter_in_ledger(const SwingReport& swing) {
  if (options_.ledger == nullptr) return;
  try {
    options_.ledger->enter(swing);
    ledger_problem_.clear();
  } catch (const DescriptionError& error) {  // kept in memory, and written with the next swing if it can be
    ledger_problem_ = error.what();
    log_.error(ledger_problem_);
  }
}

void Service::end_job(Verdict verdict, const std::string& reason) {
  Job& job = *jobs_.back();
  job.running = false;
  job.verdict = verdict;
  job.reason = reason;
  job.ended_s = state_->now.seconds();
  cycle_.record(0);
  take_rows();
  log_.info(fmt::format("job {} ended: {}", job.number, reason));
  notify("job", -1, job.number, reason, {{"verdict", describe(verdict)}});
}

void Service::shut_down(const std::string& why) {
  if (shutting_down_) return;
  shutting_down_ = true;
  log_.info(fmt::format("shutting down: {}", why));
  if (!jobs_.empty()) jobs_.back()->cancelled = true;
  if (!clock_running_) return;
  try {
    (void)ask({.kind = RequestKind::disable});
  } catch (const rpc::Error& error) {
    log_.error(error.what());
  }
}

bool Service::is_down() const {
  if (!clock_running_) return true;
  return activity() == Activity::disabled && state_->command.kind == CommandKind::disable &&
         state_->command.state != CommandState::running;
}

}  // namespace mrr::sup
