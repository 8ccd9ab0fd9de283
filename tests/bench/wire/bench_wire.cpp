// Cost of the simulated wire. Wanted: 5000 frames a simulated second, three joints at 250 Hz, well under 5 ms.

#include <benchmark/benchmark.h>

#include "can_protocol/bit_timing.h"
#include "sim_vcan/wire/bus.h"

namespace {

using namespace mrr;  // NOLINT: a program of its own

void wire_bits(benchmark::State& state) {
  can::Frame frame;
  frame.length = 8;
  std::uint32_t i = 0;
  while (state.KeepRunning()) {
    frame.id = ++i & 0x7FFU;
    frame.data[3] = static_cast<std::uint8_t>(i);
    benchmark::DoNotOptimize(can::wire_bits(frame));
  }
}
BENCHMARK(wire_bits);

/// One simulated second of 250 Hz knots for `range` joints, stepped at 1 kHz.
void simulated_second(benchmark::State& state) {
  const auto joints = static_cast<int>(state.range(0));
  std::int64_t frames = 0;
  while (state.KeepRunning()) {
    sim::Bus bus({.ports = joints + 1, .queue_capacity = 64});
    for (int tick = 0; tick < 1000; ++tick) {
      const Time now = Time{} + milliseconds(1) * tick;
      bus.advance(now, [&frames](const sim::Delivery&) { ++frames; });
      if (tick % 4 != 0) continue;
      can::Frame frame;
      frame.length = 8;
      for (int joint = 1; joint <= joints; ++joint) {
        for (const std::uint32_t base : {0x300U, 0x400U, 0x180U, 0x280U}) {
          frame.id = base + static_cast<std::uint32_t>(joint);
          frame.data[0] = static_cast<std::uint8_t>(tick);
          benchmark::DoNotOptimize(bus.send(base < 0x300U ? joint : 0, frame, now));
        }
      }
    }
  }
  state.counters["per_frame"] =
      benchmark::Counter(static_cast<double>(frames), benchmark::Counter::kIsRate | benchmark::Counter::kInvert);
}
BENCHMARK(simulated_second)->Arg(3)->Arg(5)->Unit(benchmark::kMicrosecond);

}  // namespace
