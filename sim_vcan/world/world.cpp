#include "sim_vcan/world/world.h"

#include <algorithm>
#include <cmath>

#include "module_fw/targets/host/module_config.h"

namespace mrr::sim {

namespace {

constexpr int kSupervisorPort = 0;
/// Streams of the world's seed, one per actor.
enum Stream : std::uint64_t { kPlantStream = 1, kWireStream = 2, kModuleStream = 16 };

// Multiplies and divides without overflow.
std::int64_t scale(std::int64_t value, std::int64_t numerator, std::int64_t denominator) noexcept {
  __extension__ using Wide = __int128;
  return static_cast<std::int64_t>(static_cast<Wide>(value) * numerator / denominator);
}

constexpr std::int64_t kBillion = 1'000'000'000;

BusConfig bus_config(const RobotDescription& robot, const WorldOptions& options) {
  BusConfig config;
  config.ports = robot.dof() + 1;
  config.bit_rates = {static_cast<std::int64_t>(robot.bus.bit_rate),
                      static_cast<std::int64_t>(robot.bus.data_bit_rate)};
  config.queue_capacity = options.queue_capacity;
  config.seed = Random(options.seed, kWireStream).next();
  return config;
}

}  // namespace

std::uint64_t plant_seed(std::uint64_t run_seed) { return run_seed == 0 ? 0 : Random(run_seed, kPlantStream).next(); }

Time World::Node::local(Time world_time) const noexcept {
  return clock_offset + Duration{world_time.ns + scale(world_time.ns, drift_ppb, kBillion)};
}

Time World::Node::world(Time local_time) const noexcept {
  return Time{scale((local_time - clock_offset).ns, kBillion, kBillion + drift_ppb)};
}

World::World(const RobotDescription& robot, const PlantDescription& plant, const WorldOptions& options)
    : robot_(robot),
      dof_(robot.dof()),
      plant_(robot, plant, plant_seed(options.seed)),
      bus_(bus_config(robot, options)),
      supervisor_period_(options.supervisor.step) {
  sup::SupervisorConfig supervisor = options.supervisor;
  modules_.resize(at(dof_));
  for (int i = 0; i < dof_; ++i) {
    Node& node = modules_[at(i)];
    fw::ModuleConfig config = fw::module_config(robot, i);
    supervisor.configuration_hash[at(i)] = config.configuration_hash;
    if (options.flash) options.flash(i, config);
    node.module = std::make_unique<fw::Module>(config);
    node.period = config.tick;
    Random random(options.seed, kModuleStream + at(i));
    node.clock_offset = Time{static_cast<std::int64_t>(random.below(kBillion))};
    node.drift_ppb = std::llround(random.uniform(-1.0, 1.0) * options.max_clock_drift_ppm * 1e3);
    const auto boot = static_cast<std::int64_t>(random.uniform() * static_cast<double>(options.max_boot_delay.ns));
    node.first_tick = node.local(Time{boot});
    node.next_tick = node.world(node.first_tick);
  }
  supervisor_ = std::make_unique<sup::Supervisor>(robot, supervisor);
}

void World::reset(std::span<const double> position_rad, double nail_height_m) {
  plant_.reset(position_rad, nail_height_m);
}

void World::step() {
  Time next = next_supervisor_step_;
  for (const Node& node : modules_) next = std::min(next, node.next_tick);
  if (next > now_) {
    plant_.step(next - now_);
    now_ = next;
  }
  bus_.advance(now_, [this](const Delivery& delivery) { deliver(delivery); });
  for (int i = 0; i < dof_; ++i) {
    if (modules_[at(i)].next_tick <= now_) tick_module(i);
  }
  supervisor_stepped_ = next_supervisor_step_ <= now_;
  if (supervisor_stepped_) step_supervisor();
}

void World::deliver(const Delivery& delivery) {
  if (on_frame) on_frame(delivery);
  // A full inbox loses frames, as a controller's receive memory does.
  if (delivery.reaches(kSupervisorPort)) (void)supervisor_inbox_.push_back({delivery.frame, delivery.at});
  for (int i = 0; i < dof_; ++i) {
    Node& node = modules_[at(i)];
    if (delivery.reaches(i + 1)) (void)node.inbox.push_back({delivery.frame, node.local(delivery.at)});
  }
}

void World::send_all(int port) {
  for (const can::Frame& frame : tx_) (void)bus_.send(port, frame, now_);
  tx_.clear();
}

void World::tick_module(int joint) {
  Node& node = modules_[at(joint)];
  const Time local = node.first_tick + node.period * node.ticks;
  fw::ActuatorCommand command;
  node.module->step(local, plant_.sample(joint), {node.inbox.data(), node.inbox.size()}, command, tx_);
  node.inbox.clear();
  plant_.set_actuator(joint, command);
  send_all(joint + 1);
  ++node.ticks;
  node.next_tick = node.world(node.first_tick + node.period * node.ticks);

  const fw::ModuleStatus& status = node.module->status();
  if (status.blend_ended_at.ns != node.blend_seen_ns) {
    node.blend_seen_ns = status.blend_ended_at.ns;
    node.trace.passive_since = now_;
  }
  if (status.selection_executed_at.ns != node.selection_seen_ns) {
    node.selection_seen_ns = status.selection_executed_at.ns;
    node.trace.selected_since = now_;
  }
  if (on_tick) on_tick(joint, now_, status);
}

void World::step_supervisor() {
  supervisor_->step(now_, {supervisor_inbox_.data(), supervisor_inbox_.size()}, tx_);
  supervisor_inbox_.clear();
  send_all(kSupervisorPort);
  next_supervisor_step_ += supervisor_period_;
}

}  // namespace mrr::sim
