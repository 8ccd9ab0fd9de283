#include "sim_vcan/targets/plant_host.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <fstream>

#include "common/realtime/realtime.h"
#include "common/rpc/runtime_dir.h"
#include "module_fw/targets/host/module_config.h"
#include "supervisor/supervisor.h"

namespace mrr::sim {

namespace {

constexpr Duration kAnswerLimit = milliseconds(1000);  // wall clock; then the participant is dropped
constexpr Duration kWaitSlice = milliseconds(100);     // signals and calls are noticed within it
constexpr Duration kRealtimeSilence = milliseconds(50);
constexpr Duration kMaxLate = milliseconds(100);  // free-running: what is made up for; the world stands still longer
constexpr std::int64_t kServeEvery = 20;          // ticks between looks at the control socket
constexpr std::size_t kMaxRows = 600'000;         // ten minutes
constexpr std::size_t kMaxSwings = 1'000;

rpc::Json number(double x) { return std::isfinite(x) ? rpc::Json(x) : rpc::Json(nullptr); }

can::CanSocket open(const std::string& interface) {
  constexpr std::uint32_t kParticipantMask = 0x7E0;
  const std::array filters{can::CanFilter{plant_io::kAnswerId, kParticipantMask},
                           can::CanFilter{plant_io::kAnnounceId, kParticipantMask}};
  return can::CanSocket::open(interface, {.filters = filters, .fd = true});
}

bool in_swing(int activity) {
  switch (static_cast<sup::Activity>(activity)) {
    case sup::Activity::swinging:
    case sup::Activity::resuming:
    case sup::Activity::returning:
      return true;
    default:
      return false;
  }
}

}  // namespace

PlantHost::PlantHost(const RobotDescription& robot, const PlantDescription& plant, const PlantHostOptions& options)
    : robot_(robot),
      options_(options),
      dof_(robot.dof()),
      period_(seconds(1.0 / robot.bus.loop_rate_hz)),
      plant_(robot, plant, plant_seed(options.seed)),
      socket_(open(options.interface)) {
  for (int i = 0; i < dof_; ++i) {
    Participant& p = participants_[static_cast<std::size_t>(i)];
    p.expected = true;
    p.configuration_hash = fw::module_config(robot, i).configuration_hash;
  }
  participants_[plant_io::kSupervisor].expected = options.expect_supervisor;
  reset(robot.task.nail_height_m);
}

void PlantHost::say(const std::string& sentence) const { fmt::print(stderr, "mrr_plant: {}\n", sentence); }

void PlantHost::reset(double nail_height_m) {
  std::vector<double> park;
  for (const JointDescription& joint : robot_.joints) park.push_back(joint.park_rad);
  plant_.reset(park, nail_height_m);
  epoch_ = now_ - Time{};
  watch_.begin(plant_);
  swings_.clear();
  swing_ = 0;
}

std::uint32_t PlantHost::joined() const {
  std::uint32_t mask = 0;
  for (std::size_t i = 0; i < kParticipants; ++i) {
    if (participants_[i].joined) mask |= plant_io::bit_of(static_cast<plant_io::Participant>(i));
  }
  return mask;
}

std::uint32_t PlantHost::missing() const {
  std::uint32_t mask = 0;
  for (std::size_t i = 0; i < kParticipants; ++i) {
    if (participants_[i].expected && !participants_[i].joined)
      mask |= plant_io::bit_of(static_cast<plant_io::Participant>(i));
  }
  return mask;
}

std::string PlantHost::names(std::uint32_t participants) const {
  std::string text;
  for (std::size_t i = 0; i < kParticipants; ++i) {
    if ((participants >> i & 1U) == 0) continue;
    text = fmt::format(
        "{}{}{}", text, text.empty() ? "" : ", ",
        i == plant_io::kSupervisor ? "supervisor" : fmt::format("joint {} ({})", i + 1, robot_.joints[i].name));
  }
  return text;
}

void PlantHost::drop(plant_io::Participant who, const std::string& why) {
  say(fmt::format("{} {}", names(plant_io::bit_of(who)), why));
  Participant& p = participants_[who];
  p.joined = false;
  p.payload = {};  // power stage off, brake engaged
  if (who < dof_) plant_.set_actuator(who, {});
}

void PlantHost::take(const can::ReceivedFrame& received, Time now) {
  if (const auto announcement = plant_io::decode_announcement(received.frame)) {
    Participant& p = participants_[announcement->from];
    const bool joint = announcement->from != plant_io::kSupervisor;
    if (joint && announcement->from >= dof_) return;
    if (joint && announcement->configuration_hash != p.configuration_hash) {
      if (!p.refused) {
        say(fmt::format("{} is configured for another robot than {}: it is refused",
                        names(plant_io::bit_of(announcement->from)), robot_.name));
      }
      p.refused = true;
      return;
    }
    if (!p.joined && (options_.verbose || ticks_ > 0))
      say(fmt::format("{} takes part", names(plant_io::bit_of(announcement->from))));
    p.joined = true;
    p.refused = false;
    p.heard = now;
    return;
  }
  const auto answer = plant_io::decode_answer(received.frame);
  if (!answer) {
    ++malformed_;
    return;
  }
  Participant& p = participants_[answer->from];
  if (!p.joined) return;
  if (answer->leaving) {
    p.answered = true;
    drop(answer->from, "leaves in order");
    return;
  }
  if (options_.lockstep && answer->number != number_) return;  // of an earlier tick: too late
  p.answered = true;
  p.heard = now;
  p.payload = answer->payload;
}

void PlantHost::receive(Duration timeout) {
  for (auto frames = socket_.receive(timeout); !frames.empty(); frames = socket_.receive()) {
    const bool more = frames.size() == can::CanSocket::kBatch;
    const Time now = can::monotonic_now();
    for (const can::ReceivedFrame& f : frames) take(f, now);
    if (!more) break;
  }
}

void PlantHost::send_tick(bool ending) {
  plant_io::Tick tick;
  tick.lockstep = options_.lockstep;
  tick.ending = ending;
  tick.now = now_;
  tick.asked = joined();
  tick.number = ++number_;
  std::size_t count = 0;
  const std::uint32_t groups = plant_io::group_of(static_cast<plant_io::Participant>(dof_ - 1)) + 1;
  for (std::uint32_t group = groups; group-- > 0;) {
    tick.group = group;
    tick.blocks = {};
    for (std::size_t k = 0; k < plant_io::kBlocksPerTick; ++k) {
      const std::size_t joint = group * plant_io::kBlocksPerTick + k;
      if (joint < static_cast<std::size_t>(dof_)) tick.blocks[k] = fw::encode(plant_.sample(static_cast<int>(joint)));
    }
    frames_[count++] = plant_io::encode(tick);
  }
  socket_.send({frames_.data(), count});
}

void PlantHost::apply_answers() {
  for (int i = 0; i < dof_; ++i) {
    const Participant& p = participants_[static_cast<std::size_t>(i)];
    if (p.joined) plant_.set_actuator(i, fw::decode_joint_answer(p.payload).actuator);
  }
}

void PlantHost::observe() {
  const plant_io::SupervisorTelemetry supervisor =
      plant_io::decode_supervisor(participants_[plant_io::kSupervisor].payload);
  const bool swinging = in_swing(supervisor.activity);
  // The supervisor counts its swings: another number closes the one before, also none, when its job is over.
  if (supervisor.swing != swing_) {
    if (swing_ > 0 && swings_.size() < kMaxSwings) {
      std::uint32_t passive = 0;
      for (std::size_t i = 0; i < static_cast<std::size_t>(dof_); ++i) {
        if (watch_.was_passive(i)) passive |= 1U << i;
      }
      swings_.push_back(watch_.conclude(plant_, passive));
    }
    watch_.begin(plant_);
    swing_ = supervisor.swing;
  }
  if (!swinging && !recording_) return;
  const PlantTruth truth = plant_.truth();
  if (swinging) watch_.observe(truth);
  std::array<JointTelemetry, kMaxJoints> joints;
  for (std::size_t i = 0; i < static_cast<std::size_t>(dof_); ++i) {
    const fw::JointAnswer a = fw::decode_joint_answer(participants_[i].payload);
    // The answer was given at the beginning of the millisecond that has just passed.
    if (swinging && a.wholly_passive) watch_.passive_since(i, plant_.now() - period_);
    joints[i] = {static_cast<double>(a.reference_position_rad), static_cast<double>(a.reference_velocity_rad_s),
                 static_cast<double>(a.joint_torque_nm), static_cast<double>(a.torque_command_nm), a.passive};
  }
  if (recording_ && recording_->rows() < kMaxRows) {
    recording_->append({now_, supervisor.swing, supervisor.activity, static_cast<double>(supervisor.estimated_force_n)},
                       truth, {joints.data(), static_cast<std::size_t>(dof_)});
  }
}

void PlantHost::wait_for_participants(const volatile int& stop) {
  std::uint32_t said = 0;
  while (stop == 0 && missing() != 0) {
    receive(kWaitSlice);
    if (server_ != nullptr) server_->serve();
    const std::uint32_t now = missing();
    if (now != 0 && now != said) say(fmt::format("waiting on {} for {}", options_.interface, names(now)));
    said = now;
  }
}

void PlantHost::run(const volatile int& stop) {
  if (options_.lockstep) wait_for_participants(stop);
  if (stop != 0) return;
  if (options_.verbose) say(options_.lockstep ? "lockstep begins" : "free-running");
  const Time began = can::monotonic_now();
  if (options_.lockstep) {
    run_lockstep(stop);
  } else {
    run_realtime(stop);
  }
  wall_s_ = (can::monotonic_now() - began).seconds();
}

void PlantHost::run_lockstep(const volatile int& stop) {
  bool idle_said = false;
  for (bool ending = false; !ending;) {
    ending = stop != 0 || (options_.ticks > 0 && ticks_ + 1 >= options_.ticks);
    if (joined() == 0 && !ending) {
      if (!idle_said) say("nobody takes part: the world stands still");
      idle_said = true;
      receive(kWaitSlice);
      if (server_ != nullptr) server_->serve();
      continue;
    }
    idle_said = false;
    for (Participant& p : participants_) p.answered = false;
    const std::uint32_t asked = joined();
    send_tick(ending);
    Time deadline{};
    const auto open = [&] {
      std::uint32_t mask = 0;
      for (std::size_t i = 0; i < kParticipants; ++i) {
        if ((asked >> i & 1U) != 0 && !participants_[i].answered)
          mask |= plant_io::bit_of(static_cast<plant_io::Participant>(i));
      }
      return mask;
    };
    while (open() != 0) {
      const std::uint32_t before = open();
      receive(kWaitSlice);
      if (open() != before) continue;
      // Nothing came in a whole slice: only now the clock is read.
      const Time now = can::monotonic_now();
      if (deadline.ns == 0) deadline = now + kAnswerLimit;
      if (now < deadline) continue;
      for (std::size_t i = 0; i < kParticipants; ++i) {
        if ((open() >> i & 1U) != 0) {
          drop(static_cast<plant_io::Participant>(i),
               fmt::format("has not answered for {:.0f} s and is left out", kAnswerLimit.seconds()));
          participants_[i].answered = true;
        }
      }
    }
    apply_answers();
    plant_.step(period_);
    now_ = plant_.now() + epoch_;
    ++ticks_;
    observe();
    if (server_ != nullptr && ticks_ % kServeEvery == 0) server_->serve();
  }
}

// One step at a time: after a delay the world makes up for it in steps that everybody answers, as far as they come
// within a step's time. So controllers, which belong to the hardware, miss nothing because this machine was busy.
void PlantHost::run_realtime(const volatile int& stop) {
  const std::string refused = realtime::ask(realtime::kPlantPriority);
  if (!refused.empty())
    say(fmt::format("{}: the world will be late at times; allow it with CAP_SYS_NICE and CAP_IPC_LOCK", refused));
  now_ = can::monotonic_now();
  epoch_ = now_ - plant_.now();
  Time sent = now_;
  for (bool ending = false; !ending;) {
    const Time scheduled = now_ + period_;
    realtime::sleep_until(std::max(scheduled, sent + period_ * 4 / 5));  // in haste it would take the others' time
    Time woke = can::monotonic_now();
    late_by_.add(woke - scheduled);
    receive({});
    for (const Time limit = sent + period_; woke < limit && unanswered(); woke = can::monotonic_now()) {
      socket_.wait(limit - woke);
      receive({});
    }
    if (woke - scheduled > kMaxLate) {
      const Duration lost = period_ * ((woke - scheduled - kMaxLate) / period_ + 1);
      late_ += lost / period_;
      epoch_ += lost;
    }
    for (std::size_t i = 0; i < kParticipants; ++i) {
      // A process that was late itself must not take the others for dead.
      if (participants_[i].joined && scheduled - participants_[i].heard > kRealtimeSilence)
        drop(static_cast<plant_io::Participant>(i),
             fmt::format("has been silent for {} ms and is left out", kRealtimeSilence / milliseconds(1)));
    }
    apply_answers();
    plant_.step(period_);
    now_ = plant_.now() + epoch_;
    ++ticks_;
    observe();
    ending = stop != 0 || (options_.ticks > 0 && ticks_ >= options_.ticks);
    for (Participant& p : participants_) p.answered = false;
    send_tick(ending);
    sent = woke;
    if (server_ != nullptr && ticks_ % kServeEvery == 0) server_->serve();
  }
}

bool PlantHost::unanswered() const {
  return std::any_of(participants_.begin(), participants_.end(),
                     [](const Participant& p) { return p.joined && !p.answered; });
}

void PlantHost::print_statistics() const {
  say(fmt::format("{} ticks in {:.2f} s: {:.0f} ticks/s, {:.2f} x real time{}", ticks_, wall_s_,
                  static_cast<double>(ticks_) / wall_s_, (period_ * ticks_).seconds() / wall_s_,
                  late_ > 0 ? fmt::format("; stood still for {} ms because the process was late", late_) : ""));
  if (late_by_.count() > 0) say(fmt::format("ticks late by {}", late_by_.in_words()));
  const can::CanSocketStatistics& bus = socket_.statistics();
  say(fmt::format("plant bus: sent {}, received {}, dropped {}, lost {}, malformed {}", bus.sent, bus.received,
                  bus.send_dropped, bus.receive_overflow, malformed_ + bus.malformed));
}

// ---------------------------------------------------------------------------------------------- control socket

rpc::Json PlantHost::truth_json() const {
  const PlantTruth t = plant_.truth();
  rpc::Json joints = rpc::Json::array();
  for (std::size_t i = 0; i < static_cast<std::size_t>(dof_); ++i) {
    const fw::JointAnswer a = fw::decode_joint_answer(participants_[i].payload);
    joints.push_back({{"name", robot_.joints[i].name},
                      {"link_position_rad", t.link_position_rad[i]},
                      {"link_velocity_rad_s", t.link_velocity_rad_s[i]},
                      {"motor_position_rad", t.motor_position_rad[i]},
                      {"motor_velocity_rad_s", t.motor_velocity_rad_s[i]},
                      {"transmission_torque_nm", t.transmission_torque_nm[i]},
                      {"current_a", t.current_a[i]},
                      {"winding_temperature_degc", t.winding_temperature_c[i]},
                      {"brake_released", t.brake_released[i]},
                      {"power_stage_enabled", a.actuator.power_stage_enabled},
                      {"passive", a.passive},
                      {"takes_part", participants_[i].joined}});
  }
  return {{"board", plant_.actual_description().board.name},
          {"time_s", now_.seconds()},
          {"ticks", ticks_},
          {"pace", options_.lockstep ? "lockstep" : "realtime"},
          {"supervisor_takes_part", participants_[plant_io::kSupervisor].joined},
          {"nail_height_m", t.nail_height_m},
          {"contact", t.contact},
          {"contact_force_n", t.contact_force_n},
          {"face_gap_m", t.face_gap_m},
          {"face_position_m", {t.face_position_m.x(), t.face_position_m.y(), t.face_position_m.z()}},
          {"contacts", plant_.contact_count()},
          {"swings", swings_.size()},
          {"recording_rows", recording_ ? rpc::Json(recording_->rows()) : rpc::Json(nullptr)},
          {"joints", joints}};
}

rpc::Json PlantHost::contacts_json(std::size_t from) const {
  rpc::Json list = rpc::Json::array();
  const ContactRecords& contacts = plant_.contacts();
  for (std::size_t i = from; i < contacts.size(); ++i) {
    const ContactRecord& c = contacts[i];
    rpc::Json peak = rpc::Json::array();
    rpc::Json impulse = rpc::Json::array();
    for (std::size_t k = 0; k < static_cast<std::size_t>(dof_); ++k) {
      peak.push_back(c.peak_transmission_torque_nm[k]);
      impulse.push_back(c.transmission_impulse_nm_s[k]);
    }
    list.push_back({{"start_s", (c.start + epoch_).seconds()},
                    {"end_s", (c.end + epoch_).seconds()},
                    {"open", c.open},
                    {"board_struck", c.board_struck},
                    {"impulse_n_s", c.impulse_n_s},
                    {"peak_force_n", c.peak_force_n},
                    {"penetration_m", c.penetration_m},
                    {"speed_at_start_m_s", c.speed_at_start_m_s},
                    {"speed_at_end_m_s", c.speed_at_end_m_s},
                    {"peak_transmission_torque_nm", peak},
                    {"transmission_impulse_nm_s", impulse}});
  }
  return {{"count", plant_.contact_count()}, {"contacts", list}};
}

rpc::Json PlantHost::swings_json() const {
  rpc::Json list = rpc::Json::array();
  for (std::size_t k = 0; k < swings_.size(); ++k) {
    const SwingTruth& s = swings_[k];
    rpc::Json joints = rpc::Json::array();
    for (std::size_t i = 0; i < s.joints.size(); ++i) {
      const JointBlow& j = s.joints[i];
      joints.push_back({{"name", robot_.joints[i].name},
                        {"passive", j.passive},
                        {"switch_lead_s", number(j.switch_lead_s)},
                        {"peak_torque_nm", j.peak_torque_nm},
                        {"peak_torque_swing_nm", j.peak_torque_swing_nm},
                        {"impulse_nm_s", j.impulse_nm_s}});
    }
    list.push_back({{"number", k + 1},
                    {"hit", s.hit},
                    {"contact_start_s", s.hit ? rpc::Json((s.contact_start + epoch_).seconds()) : rpc::Json(nullptr)},
                    {"contact_s", s.contact_s},
                    {"impulse_n_s", s.impulse_n_s},
                    {"peak_force_n", s.peak_force_n},
                    {"penetration_m", s.penetration_m},
                    {"nail_height_m", s.nail_height_m},
                    {"speed_m_s", s.speed_m_s},
                    {"effective_mass_kg", number(s.effective_mass_kg)},
                    {"restitution", s.restitution},
                    {"joints", joints}});
  }
  return {{"swings", list}};
}

rpc::Json PlantHost::stop_recording(const std::string& path) {
  if (!recording_) throw rpc::Error(1, "nothing is being recorded; call recording_start first.");
  const std::string file = path.empty() ? (rpc::runtime_dir() / "plant.csv").string() : path;
  std::ofstream out(file, std::ios::binary | std::ios::trunc);
  if (out) recording_->write_csv(out);
  out.flush();
  if (!out) throw rpc::Error(2, fmt::format("{} cannot be written; give another \"path\".", file));
  const std::size_t rows = recording_->rows();
  recording_.reset();
  return {{"path", file}, {"rows", rows}, {"complete", rows < kMaxRows}};
}

void PlantHost::serve(rpc::Server& server) {
  server_ = &server;
  server.on("truth", [this](const rpc::Params&) { return truth_json(); });
  server.on("contacts", [this](const rpc::Params& p) {
    return contacts_json(p.is_object() ? p.value("from", std::size_t{0}) : 0);
  });
  server.on("swings", [this](const rpc::Params&) { return swings_json(); });
  server.on("reset", [this](const rpc::Params& p) {
    const double height =
        p.is_object() ? p.value("nail_height_m", robot_.task.nail_height_m) : robot_.task.nail_height_m;
    if (!(height >= 0.0 && height <= plant_.actual_description().board.nail_length_m)) {
      throw rpc::Error(rpc::kInvalidParams, fmt::format("nail_height_m is {} m; give 0 to {} m.", height,
                                                        plant_.actual_description().board.nail_length_m));
    }
    reset(height);
    return truth_json();
  });
  server.on("push", [this](const rpc::Params& p) {
    const int joint = p.at("joint").get<int>();
    const double torque_nm = p.at("torque_nm").get<double>();
    if (!(joint >= 1 && joint <= dof_))
      throw rpc::Error(rpc::kInvalidParams, fmt::format("joint is {}; give 1 to {}.", joint, dof_));
    const double limit_nm = robot_.joints[static_cast<std::size_t>(joint - 1)].transmission.momentary_peak_nm;
    if (!(std::abs(torque_nm) <= limit_nm)) {
      throw rpc::Error(rpc::kInvalidParams,
                       fmt::format("torque_nm is {} Nm; joint {} takes -{} to {} Nm, its gear's momentary peak.",
                                   torque_nm, joint, limit_nm, limit_nm));
    }
    plant_.set_external_torque(joint - 1, torque_nm);
    return rpc::Json::object();
  });
  server.on("recording_start", [this](const rpc::Params&) {
    recording_ = std::make_unique<Telemetry>(robot_);
    return rpc::Json{{"columns", recording_->columns()}};
  });
  server.on("recording_stop",
            [this](const rpc::Params& p) { return stop_recording(p.is_object() ? p.value("path", "") : ""); });
}

}  // namespace mrr::sim
