// What one control tick of a module costs, all laws and PDOs included: ns (median, p99.9, max) over a million ticks, as
// they ran on this machine and without what else ran there, and whether a tick ever touches the heap. `--count
// active|passive` runs a few thousand ticks inside measured_step() for a profiler that counts instructions
// (scripts/bench: callgrind --toggle-collect) and prints their number.
#include <sys/resource.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <new>
#include <vector>

#include "can_protocol/client.h"
#include "can_protocol/pdo.h"
#include "can_protocol/selection.h"
#include "can_protocol/units.h"
#include "module_fw/module.h"
#include "module_fw/targets/host/module_config.h"

namespace {

bool guard_up = false;
long allocations = 0;

}  // namespace

void* operator new(std::size_t size) {
  if (guard_up) ++allocations;
  return std::malloc(size == 0 ? 1 : size);
}
void operator delete(void* p) noexcept { std::free(p); }
void operator delete(void* p, std::size_t) noexcept { std::free(p); }

/// The tick and nothing else; not inlined, so that a profiler can find it.
[[gnu::noinline]] void measured_step(mrr::fw::Module& module, mrr::Time now, const mrr::fw::RawSensors& sensors,
                                     std::span<const mrr::can::ReceivedFrame> received,
                                     mrr::fw::ActuatorCommand& actuator, mrr::can::TransmitQueue& tx) noexcept {
  module.step(now, sensors, received, actuator, tx);
}

namespace {

using namespace mrr;  // NOLINT: a program of its own

/// A module on a joint that is always where it shall be, led along a sine by knots as a supervisor sends them.
class Tick {
 public:
  Tick() : config_(make_config()), module_(config_) {
    run(10);
    send(can::nmt_frame(can::NmtCommand::start, config_.node_id));
    run(200);
    for (const std::uint16_t word : std::array<std::uint16_t, 3>{0x06, 0x07, 0x0F}) {
      send(can::pack_rpdo1(config_.node_id, {word, 8}));
      run(10);
    }
    run(1000);
    if (!module_.status().following_knots) {
      std::fprintf(stderr, "the joint does not follow: limit %d, fault %04Xh\n",
                   static_cast<int>(module_.status().limit), static_cast<unsigned>(module_.status().fault));
      std::exit(3);
    }
    moving_ = true;
  }
  /// Ready to be stepped: the frames of this tick are in, the sensors read.
  void prepare() {
    if (ticks_ % 4 == 0) {
      const double t = moving_ ? seconds_ + 4e-3 : 0.0;
      constexpr double kW = 3.14159265358979;
      const double q = 0.3 * (1.0 - std::cos(kW * t));
      const double v = 0.3 * kW * std::sin(kW * t);
      const double a = moving_ ? 0.3 * kW * kW * std::cos(kW * t) : 0.0;
      send(can::pack_rpdo2(config_.node_id, {*can::urad_from_rad(q), *can::urad_s_from_rad_s(v)}));
      send(can::pack_rpdo3(config_.node_id, {*can::mrad_s2_from_rad_s2(a), 0, ++sequence_}));
      send(can::sync_frame(std::nullopt));
    }
    const double t = moving_ ? seconds_ : 0.0;
    const double q = 0.3 * (1.0 - std::cos(3.14159265358979 * t));
    const double counts = q * config_.sensing.encoder_counts_per_turn * static_cast<double>(config_.drive.gear_ratio) /
                          (2.0 * 3.14159265358979);
    sensors_.encoder_count = static_cast<std::int32_t>(std::lround(counts));
    sensors_.torque_adc = static_cast<std::int16_t>(1000 + ticks_ % 37);
    sensors_.current_adc = actuator_.current_duty;
    sensors_.winding_temperature_adc = 350;
    sensors_.drive_temperature_adc = 300;
    sensors_.bus_voltage_adc = 4800;
    sensors_.inputs = actuator_.brake_release ? fw::kInputBrakeReleased : 0;
    sensors_.fresh =
        fw::kFreshEncoder | fw::kFreshTorque | fw::kFreshCurrent | fw::kFreshTemperature | fw::kFreshBusVoltage;
  }
  void step() { measured_step(module_, now_, sensors_, {inbox_.data(), inbox_.size()}, actuator_, tx_); }
  void finish() {
    inbox_.clear();
    tx_.clear();
    now_ += config_.tick;
    ++ticks_;
    if (moving_) seconds_ += 1e-3;
  }
  void select(bool active) {
    selection_ = static_cast<std::uint8_t>(selection_ % 31U + 1U);
    send(can::pack_rpdo4(
        {active ? 1U << config_.selection_bit : 0U, 0, 0, can::selection_byte(selection_, can::SelectionAction::now)}));
  }
  [[nodiscard]] const fw::ModuleStatus& status() const { return module_.status(); }

 private:
  static fw::ModuleConfig make_config() {
    const RobotDescription robot = load_robot(std::filesystem::path(MRR_SOURCE_DIR) / "robots" / "mrr3");
    fw::ModuleConfig c = fw::module_config(robot, 2);
    c.passive.max_time = milliseconds(3'600'000);
    c.passive.max_travel_rad = 6.0F;
    return c;
  }
  void send(const can::Frame& f) { (void)inbox_.push_back({f, now_}); }
  void run(int ticks) {
    for (int i = 0; i < ticks; ++i) {
      prepare();
      module_.step(now_, sensors_, {inbox_.data(), inbox_.size()}, actuator_, tx_);  // not counted
      finish();
    }
  }
  fw::ModuleConfig config_;
  fw::Module module_;
  Time now_;
  std::int64_t ticks_ = 0;
  double seconds_ = 0.0;
  bool moving_ = false;
  std::uint16_t sequence_ = 0;
  std::uint8_t selection_ = 0;
  fw::RawSensors sensors_;
  fw::ActuatorCommand actuator_;
  StaticVector<can::ReceivedFrame, 16> inbox_;
  can::TransmitQueue tx_;
};

using Clock = std::chrono::steady_clock;

void print_times(const char* what, std::vector<float>& ns) {
  std::sort(ns.begin(), ns.end());
  const auto at = [&](double share) {
    return static_cast<double>(ns[static_cast<std::size_t>(share * static_cast<double>(ns.size() - 1))]);
  };
  std::printf("  %-18s %9zu %9.0f %9.0f %9.0f %9.0f\n", what, ns.size(), at(0.5), at(0.99), at(0.999), at(1.0));
}

long preemptions() {
  rusage usage{};
  getrusage(RUSAGE_THREAD, &usage);
  return usage.ru_nivcsw;
}

/// @returns whether the joint stayed in its law.
bool run_ticks(bool passive, std::vector<float>& ns) {
  Tick tick;
  if (passive) tick.select(false);
  for (float& took : ns) {
    tick.prepare();
    guard_up = true;
    const Clock::time_point began = Clock::now();
    tick.step();
    const Clock::time_point ended = Clock::now();
    guard_up = false;
    tick.finish();
    took = static_cast<float>(std::chrono::nanoseconds(ended - began).count());
  }
  return passive ? tick.status().law == fw::Law::passive : tick.status().following_knots;
}

// Every run does the same in the same tick, so the shortest time of each tick over some runs is what the code takes:
// what else the machine did meanwhile hits another tick each time.
void time_ticks(bool passive, std::size_t n) {
  constexpr int kRuns = 7;
  const char* name = passive ? "passive law" : "active law";
  std::vector<float> ns(n);
  std::vector<float> shortest(n);
  allocations = 0;
  bool right = true;
  for (int run = 0; run < kRuns; ++run) {
    const long before = preemptions();
    right = run_ticks(passive, ns) && right;
    if (run == 0) {
      const long taken = preemptions() - before;
      shortest = ns;
      print_times(name, ns);
      std::printf("  %-18s the process was preempted %ld times meanwhile\n", "", taken);
    } else {
      for (std::size_t i = 0; i < n; ++i) shortest[i] = std::min(shortest[i], ns[i]);
    }
  }
  print_times("  shortest of 7", shortest);
  if (!right) std::printf("  NOT MEASURED: the joint did not stay in this law\n");
  if (allocations != 0) std::printf("  %ld ALLOCATIONS\n", allocations);
}

int count_ticks(bool passive) {
  constexpr int kTicks = 4000;
  Tick tick;
  if (passive) tick.select(false);
  for (int i = 0; i < kTicks; ++i) {
    tick.prepare();
    tick.step();
    tick.finish();
  }
  const bool right = passive ? tick.status().law == fw::Law::passive : tick.status().following_knots;
  if (!right) return 1;
  std::printf("%d\n", kTicks);
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc == 3 && std::strcmp(argv[1], "--count") == 0) return count_ticks(std::strcmp(argv[2], "passive") == 0);
  constexpr std::size_t kTicks = 1'000'000;
  std::vector<float> clock;
  for (int i = 0; i < 100'000; ++i) {
    const Clock::time_point began = Clock::now();
    clock.push_back(static_cast<float>(std::chrono::nanoseconds(Clock::now() - began).count()));
  }
  std::printf("\nmodule.step, ns per 1 kHz tick, knots at 250 Hz, reading the clock included\n");
  std::printf("  %-18s %9s %9s %9s %9s %9s\n", "", "ticks", "median", "p99", "p99.9", "max");
  print_times("nothing (clock)", clock);
  time_ticks(false, kTicks);
  time_ticks(true, kTicks);
}
