#include "module_fw/targets/linux/shell.h"

#include <fmt/format.h>

#include <algorithm>
#include <limits>

#include "can_protocol/messages.h"
#include "can_protocol/pdo.h"
#include "common/realtime/realtime.h"
#include "common/robot/errors.h"
#include "module_fw/targets/linux/heap_watch.h"
#include "module_fw/targets/linux/joint_bytes.h"

namespace mrr::fw {

namespace {

constexpr Duration kPlantSilence = milliseconds(3000);  // lockstep: longer than the plant waits for a participant
constexpr Duration kWaitSlice = milliseconds(200);      // a signal is noticed within it
constexpr Duration kStopTime = milliseconds(3000);      // for a controlled stop and the brake, then exit anyway
// Free-running, samples come over a general-purpose scheduler: an ordinary delay of it is not a broken sensor.
constexpr Duration kSchedulerDelay = milliseconds(40);
// ... and neither is a supervisor that was late: the last set point is continued for so long before the joint stops.
constexpr Duration kSetPointDelay = milliseconds(24);
constexpr Duration kPlantGrace = milliseconds(5);     // how long a tick waits for a sample that is late
constexpr Duration kClockCheck = milliseconds(1000);  // the system's time may be stepped: look again
constexpr Duration kPlantForgotten = milliseconds(200);
constexpr Duration kTwinListen = milliseconds(150);  // an operational module sends at every SYNC, and heartbeats
constexpr std::int64_t kTimedTicks = 8;              // reading the clock is dear in some virtual machines

struct CobIds {
  StaticVector<can::CanFilter, can::CanSocket::kMaxFilters> filters;
  std::uint64_t fingerprint = 14695981039346656037ULL;

  void add(std::uint32_t id) noexcept {
    id &= 0x7FFU;
    fingerprint = (fingerprint ^ (id + 1U)) * 1099511628211ULL;
    (void)filters.push_back({id});
  }
};

/// Every identifier the node listens to at present.
CobIds cob_ids(const can::ObjectDictionary& od) noexcept {
  constexpr std::uint32_t kNotValid = 0x8000'0000U;
  CobIds ids;
  ids.add(can::kNmtCobId);
  ids.add(od.sync_cob_id);
  ids.add(can::kLssRequestCobId);
  ids.add(od.sdo_server_cob_id_receive);                                   // LSS may have changed the node id
  ids.add(can::kHeartbeatCobId + (od.sdo_server_cob_id_receive & 0x7FU));  // a twin's
  for (const std::uint32_t entry : od.consumer_heartbeat) {
    const std::uint32_t watched = (entry >> 16U) & 0xFFU;
    if (watched >= 1 && watched <= can::kMaxNodeId) ids.add(can::kHeartbeatCobId + watched);
  }
  for (const auto& rpdo : od.rpdo_communication) {
    if ((rpdo.cob_id & kNotValid) == 0) ids.add(rpdo.cob_id);
  }
  return ids;
}

/// Two modules with one node id take each other's orders, and nobody could tell their answers apart.
void refuse_twin(const ModuleConfig& config, const ShellOptions& options) {
  const std::array<can::CanFilter, 2> own{can::CanFilter{can::kHeartbeatCobId + config.node_id},
                                          can::CanFilter{can::kTpdo1CobId + config.node_id}};
  can::CanSocket socket = can::CanSocket::open(options.can, {.filters = own});
  const Time end = can::monotonic_now() + kTwinListen;
  for (Time now = can::monotonic_now(); now < end; now = can::monotonic_now()) {
    if (socket.receive(end - now).empty()) continue;
    throw DescriptionError(fmt::format(
        "--can {}: another module is node {} there already, the node of joint {} ({}); stop that one first.",
        options.can, config.node_id, options.number, options.name));
  }
}

can::CanSocket open_bus(const ModuleConfig& config, const ShellOptions& options) {
  refuse_twin(config, options);
  const CobIds ids = cob_ids(Module(config).objects());
  return can::CanSocket::open(options.can, {.filters = {ids.filters.data(), ids.filters.size()}});
}

}  // namespace

Shell::Shell(const ModuleConfig& config, const ShellOptions& options)
    : config_(config), options_(options), can_(open_bus(config, options)) {
  if (!options.store.empty()) store_ = std::make_unique<FileStore>(options.store);
  if (!options.plant.empty()) {
    plant_.emplace(options.plant, static_cast<plant_io::Participant>(options.number - 1), config.configuration_hash);
  }
}

void Shell::say(std::string_view sentence) const {
  fmt::print(stderr, "mrr_module: joint {} ({}): {}\n", options_.number, options_.name, sentence);
}

void Shell::wait_for_plant(const volatile int& stop) {
  bool said = false;
  while (stop == 0) {
    first_ = plant_->wait(kWaitSlice);
    if (first_) return;
    if (!said)
      say(fmt::format("waiting for the plant on {}; start mrr_plant --plant {}", options_.plant, options_.plant));
    said = true;
  }
}

void Shell::run(const volatile int& stop) {
  say(fmt::format("node {} on {}", config_.node_id, options_.can));
  Pace pace = options_.pace;
  if (!plant_) {
    say("no --plant was given, so there is no hardware behind it: it answers on the bus and will not enable");
    pace = Pace::realtime;
  } else if (pace != Pace::realtime) {
    wait_for_plant(stop);
    if (!first_) return;
    if (pace == Pace::lockstep && !first_->lockstep)
      say("the plant is free-running, not in lockstep; following the plant");
    pace = first_->lockstep ? Pace::lockstep : Pace::realtime;
    if (options_.verbose) say(pace == Pace::lockstep ? "in lockstep with the plant" : "free-running");
  }
  if (pace == Pace::realtime) {
    const std::int64_t periods = (kSetPointDelay + config_.knot_period - Duration{1}) / config_.knot_period;
    config_.watchdog.missing_knots = static_cast<std::uint8_t>(
        std::clamp<std::int64_t>(periods, config_.watchdog.missing_knots, std::numeric_limits<std::uint8_t>::max()));
    timer_of_plant_ = first_.has_value();
    if (plant_ && !timer_of_plant_) {
      config_.sensing.encoder_timeout += kSchedulerDelay;
      config_.sensing.torque_timeout += kSchedulerDelay;
      config_.sensing.current_timeout += kSchedulerDelay;
      config_.watchdog.loop += kSchedulerDelay;
    }
    // What is taken for granted on a microcontroller has to be asked for here.
    const std::string refused = realtime::ask(realtime::kModulePriority);
    if (!refused.empty())
      say(fmt::format("{}: ticks will come later at times; allow it with CAP_SYS_NICE and CAP_IPC_LOCK", refused));
  }
  module_ = std::make_unique<Module>(config_);
  if (store_) module_->load_parameters(*store_);
  cob_ids_ = cob_ids(module_->objects()).fingerprint;
  if (pace == Pace::lockstep) {
    // What came after the first tick belongs to the next one, however late this process is.
    plant_->discard_up_to(can_, *first_);
  } else {
    can_.discard_received();
  }
  forbid_heap();
  Next next = pace == Pace::lockstep ? Next::lockstep : Next::clock;
  while (next != Next::done) next = next == Next::lockstep ? run_lockstep(stop) : run_on_clock(stop);
  allow_heap();
  if (plant_) plant_->leave();
}

bool Shell::tick(Time now, const RawSensors& sensors, std::span<const can::ReceivedFrame> received,
                 bool stopping) noexcept {
  for (const can::ReceivedFrame& f : received) {
    const bool heartbeat = f.frame.id == can::kHeartbeatCobId + config_.node_id && f.frame.length == 1;
    if (twin_seen_ || !heartbeat || f.frame.remote || f.frame.extended) continue;
    twin_seen_ = true;
    say(fmt::format("another module says that it is node {} too; stop one of the two", config_.node_id));
  }
  if (stopping && !stopping_) {
    // The core's own way to stop in order: as if NMT "stop" had come. An enabled joint stops, holds, and brakes.
    stopping_ = true;
    stopping_since_ = now;
    received_.clear();
    for (const can::ReceivedFrame& f : received) (void)received_.push_back(f);
    (void)received_.push_back({can::nmt_frame(can::NmtCommand::stop, 0), now});
    received = {received_.data(), received_.size()};
  } else if (stopping_) {
    received = {};  // nobody shall start it again
  }
  now_ = now;
  tx_.clear();
  // One that was over before this tick was one all the same.
  const std::int64_t times_off = can_.statistics().bus_off_events;
  if (can_.bus_off() || times_off != times_off_) {
    times_off_ = times_off;
    module_->bus_off(now);
  } else {
    module_->bus_recovered(now);
  }
  module_->bus_passive(can_.error_passive(), now);  // told once; again after a reset of the node
  module_->step(now, sensors, received, actuator_, tx_);
  if (!tx_.empty()) can_.send({tx_.data(), tx_.size()});
  if (!received.empty()) follow_cob_ids();  // only a frame can have changed them
  ++ticks_;
  const bool safe = !actuator_.power_stage_enabled && !actuator_.brake_release;
  return !(stopping_ && now > stopping_since_ && (safe || now - stopping_since_ > kStopTime));
}

void Shell::follow_cob_ids() noexcept {
  const CobIds ids = cob_ids(module_->objects());
  if (ids.fingerprint == cob_ids_) return;
  if (can_.set_filters({ids.filters.data(), ids.filters.size()})) cob_ids_ = ids.fingerprint;
}

plant_io::AnswerPayload Shell::answer() noexcept {
  const ModuleStatus& status = module_->status();
  if (status.law != Law::passive) wholly_passive_ = false;
  if (status.blend_ended_at != blend_seen_) {
    blend_seen_ = status.blend_ended_at;
    wholly_passive_ = status.law == Law::passive;
  }
  return encode(joint_answer(actuator_, status, wholly_passive_));
}

Shell::Next Shell::run_lockstep(const volatile int& stop) {
  std::optional<plant_io::OwnTick> at = first_;
  Time silent_since;
  while (true) {
    if (!at) {
      const Time before = can::monotonic_now();
      if (silent_since.ns == 0) silent_since = before;
      at = plant_->wait(kWaitSlice);
    }
    if (!at) {
      const bool stopping = stop != 0;
      if (!stopping && can::monotonic_now() - silent_since < kPlantSilence) continue;
      // At an ordinary end the plant may have gone first.
      if (!stopping) say("the plant is silent: going on by the wall clock without sensors");
      plant_->forget();
      return Next::clock;
    }
    silent_since = {};
    const plant_io::OwnTick now = *at;
    at.reset();
    const RawSensors sensors = decode_sensors(now.sensors);
    const bool on = tick(now.now, sensors, plant_->robot_frames(can_, now), stop != 0);
    plant_->answer(now, answer(), !on);
    if (!on) return Next::done;
    if (now.ending) {
      say("the plant has stopped: going on by the wall clock without sensors");
      plant_->forget();
      return Next::clock;
    }
  }
}

// The next instant to tick at, and the sample for it, if one came.
std::optional<plant_io::OwnTick> Shell::wait_for_instant(Time& scheduled) noexcept {
  std::optional<plant_io::OwnTick> at;
  while (timer_of_plant_ && plant_->joined()) {
    at = plant_->wait(kPlantGrace);
    // Once more: when this machine stood still both were late, and it is the plant's turn.
    if (!at) at = plant_->wait(kPlantGrace);
    if (!at || at->lockstep) break;
    if (at->now <= scheduled) {  // that instant has passed on the own clock
      plant_->answer(*at, answer());
      continue;
    }
    overruns_ += (at->now - scheduled) / config_.tick - 1;
    scheduled = at->now;
    if (ticks_ % kTimedTicks == 0) lateness_.add(can::monotonic_now() - scheduled);
    if (at->ending) plant_->forget();
    return at;
  }
  scheduled += config_.tick;
  realtime::sleep_until(scheduled);
  const Duration late = can::monotonic_now() - scheduled;
  lateness_.add(late);
  // Without its plant the joint makes up for the time it has waited; on a clock of its own it leaves out what it
  // missed.
  const std::int64_t missed = timer_of_plant_ ? 0 : late / config_.tick;
  overruns_ += missed;
  scheduled += config_.tick * missed;
  if (plant_ && !at) at = missed > 0 && plant_->joined() ? plant_->wait(kPlantGrace) : plant_->poll();
  if (!at) ++without_sample_;
  return at;
}

Shell::Next Shell::run_on_clock(const volatile int& stop) {
  // CLOCK_MONOTONIC, or what simulated time became when the plant went away.
  const Time start = can::monotonic_now();
  const Duration shift = now_.ns != 0 ? now_ - start : Duration{};
  Time scheduled = start;
  Time clock_checked = start;
  Time sampled = start;
  StaticVector<can::ReceivedFrame, plant_io::TickInbox::kCapacity> shifted;
  can_.use_kernel_times(false);
  while (true) {
    if (plant_) plant_->advance_clock(now_);
    const std::optional<plant_io::OwnTick> at = wait_for_instant(scheduled);
    if (at && at->lockstep && !stopping_ && ticks_ > 0) {
      // The plant is back, in lockstep: its time is ours again.
      first_ = at;
      inbox_.clear();
      say("the plant is back");
      return Next::lockstep;
    }
    if (at) sampled = scheduled;
    if (plant_ && !at && scheduled - sampled > kPlantForgotten) plant_->forget();
    if (scheduled - clock_checked > kClockCheck) {
      can_.measure_clock_offset();
      clock_checked = scheduled;
    }
    inbox_.fill(can_, scheduled);
    std::span<const can::ReceivedFrame> frames = inbox_.take_as_received(scheduled);
    if (shift.ns != 0) {
      shifted.clear();
      for (const can::ReceivedFrame& f : frames) (void)shifted.push_back({f.frame, f.at + shift});
      frames = {shifted.data(), shifted.size()};
    }
    const RawSensors sensors = at ? decode_sensors(at->sensors) : RawSensors{};
    const bool on = tick(scheduled + shift, sensors, frames, stop != 0);
    if (at) plant_->answer(*at, answer(), !on);
    if (!on) return Next::done;
  }
}

void Shell::print_statistics() const {
  const can::CanSocketStatistics& bus = can_.statistics();
  say(fmt::format("{} ticks; frames received {}, sent {}, dropped when sending {}, lost when receiving {}", ticks_,
                  bus.received, bus.sent, bus.send_dropped, bus.receive_overflow));
  if (lateness_.count() > 0) {
    say(fmt::format("lateness of {} of {} ticks by the wall clock: {}; {} left out; {} without a new sample",
                    lateness_.count(), ticks_, lateness_.in_words(), overruns_, without_sample_));
  }
  say(fmt::format("allocations after start: {}", forbidden_allocations()));
}

}  // namespace mrr::fw
