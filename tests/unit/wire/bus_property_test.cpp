// Random traffic on the simulated wire: what must hold whatever is sent.

#include <gtest/gtest.h>

#include <deque>
#include <vector>

#include "sim_vcan/wire/bus.h"
#include "tests/unit/wire/random_frame.h"

namespace mrr::sim {
namespace {

struct Sent {
  int port;
  can::Frame frame;
  Time at;
};

/// Some milliseconds of traffic between idle and overload.
std::vector<Sent> random_traffic(Random& random, int ports, int count) {
  std::vector<Sent> out;
  Time now;
  const std::uint64_t gap_ns = 20'000 + random.below(300'000);
  for (int i = 0; i < count; ++i) {
    if (random.below(3) != 0) now += nanoseconds(static_cast<std::int64_t>(random.below(gap_ns)));
    out.push_back({static_cast<int>(random.below(static_cast<std::uint64_t>(ports))), test::random_frame(random), now});
  }
  return out;
}

struct Seen {
  int from;
  can::Frame frame;
  Time at;
  std::uint32_t receivers;
  friend bool operator==(const Seen&, const Seen&) = default;
};

/// Plays the traffic, stepping the bus at every send and, when step > 0, also every `step` in between.
std::vector<Seen> play(Bus& bus, const std::vector<Sent>& traffic, Duration step, std::int64_t* accepted = nullptr) {
  std::vector<Seen> seen;
  const auto sink = [&seen](const Delivery& d) { seen.push_back({d.from, d.frame, d.at, d.receivers}); };
  Time now;
  const auto go = [&](Time until) {
    for (; step.ns > 0 && now + step < until; now += step) bus.advance(now + step, sink);
    bus.advance(until, sink);
    now = until;
  };
  for (const Sent& s : traffic) {
    go(s.at);
    const bool queued = bus.send(s.port, s.frame, s.at);
    if (accepted != nullptr) *accepted += queued ? 1 : 0;
  }
  go(now + seconds(0.2));
  return seen;
}

TEST(BusProperty, StepSizeDoesNotChangeWhatHappens) {
  for (std::uint64_t seed = 0; seed < 40; ++seed) {
    Random random(seed);
    const std::vector<Sent> traffic = random_traffic(random, 5, 300);
    const BusConfig config{.ports = 5, .error_probability = seed % 2 == 0 ? 0.0 : 0.05, .seed = seed};
    Bus coarse(config);
    Bus fine(config);
    Bus again(config);
    const std::vector<Seen> expected = play(coarse, traffic, {});
    ASSERT_EQ(expected, play(fine, traffic, nanoseconds(3'700)));
    ASSERT_EQ(expected, play(again, traffic, {}));
  }
}

TEST(BusProperty, AnotherSeedDisturbsOtherwise) {
  Random random(1);
  const std::vector<Sent> traffic = random_traffic(random, 3, 300);
  Bus a({.ports = 3, .error_probability = 0.1, .seed = 1});
  Bus b({.ports = 3, .error_probability = 0.1, .seed = 2});
  EXPECT_NE(play(a, traffic, {}), play(b, traffic, {}));
}

TEST(BusProperty, NothingIsLostInventedReorderedOrOverlapping) {
  for (std::uint64_t seed = 100; seed < 160; ++seed) {
    Random random(seed);
    const std::vector<Sent> traffic = random_traffic(random, 6, 400);
    Bus bus({.ports = 6, .queue_capacity = 8, .error_probability = seed % 3 == 0 ? 0.02 : 0.0, .seed = seed});
    std::int64_t accepted = 0;
    const std::vector<Seen> seen = play(bus, traffic, {}, &accepted);
    std::int64_t lost = 0;
    std::int64_t queued = 0;
    std::int64_t refused = 0;
    for (int i = 0; i < bus.ports(); ++i) {
      lost += bus.status(i).discarded;
      queued += bus.status(i).queued;
      refused += bus.status(i).overflows + bus.status(i).refused;
    }
    ASSERT_EQ(accepted, static_cast<std::int64_t>(seen.size()) + lost + queued);
    ASSERT_EQ(accepted + refused, static_cast<std::int64_t>(traffic.size()));
    ASSERT_EQ(queued, 0);

    Time free;
    for (const Seen& s : seen) {
      const Time start = s.at - can::frame_time(s.frame, {});
      ASSERT_GE(start, free);
      free = s.at + microseconds(can::kIntermissionBits);
    }
    // Each port's frames come in the order in which it sent them.
    std::vector<std::size_t> next(6, 0);
    for (const Seen& s : seen) {
      std::size_t& k = next[static_cast<std::size_t>(s.from)];
      while (k < traffic.size() && !(traffic[k].port == s.from && traffic[k].frame == s.frame)) ++k;
      ASSERT_LT(k, traffic.size());
      ASSERT_GE(s.at - can::frame_time(s.frame, {}), traffic[k].at);
      ++k;
    }
  }
}

// One frame at a time per port, so that all contenders are known: whoever starts had the smallest key among those
// waiting, and the wire is never idle while someone waits.
TEST(BusProperty, TheMostUrgentOfThoseWaitingGoesNext) {
  for (std::uint64_t seed = 0; seed < 40; ++seed) {
    Random random(seed, 9);
    constexpr int kPorts = 8;
    Bus bus({.ports = kPorts, .queue_capacity = 1});
    struct Waiting {
      bool is = false;
      std::uint64_t key = 0;
      Time since;
    };
    std::vector<Waiting> waiting(kPorts);
    Time free;
    int checked = 0;
    const auto sink = [&](const Delivery& d) {
      const Time start = d.at - can::frame_time(d.frame, {});
      const auto winner = static_cast<std::size_t>(d.from);
      ASSERT_TRUE(waiting[winner].is);
      Time earliest = start;
      for (const Waiting& w : waiting) {
        if (!w.is) continue;
        earliest = std::min(earliest, w.since);
        if (w.since <= start) {
          ASSERT_LE(waiting[winner].key, w.key);
          ++checked;
        }
      }
      ASSERT_EQ(start, std::max(free, earliest));
      waiting[winner].is = false;
      free = d.at + microseconds(can::kIntermissionBits);
    };
    Time now;
    for (int i = 0; i < 1000; ++i) {
      now += nanoseconds(static_cast<std::int64_t>(random.below(90'000)));
      bus.advance(now, sink);
      const auto port = static_cast<std::size_t>(random.below(kPorts));
      const can::Frame frame = test::random_frame(random);
      const bool queued = bus.send(static_cast<int>(port), frame, now);
      ASSERT_EQ(queued, !waiting[port].is);
      if (queued) waiting[port] = {true, can::arbitration_key(frame), now};
    }
    EXPECT_GT(checked, 1000);
  }
}

// next_event() promises that nothing is delivered earlier, and stepping from event to event misses nothing.
TEST(BusProperty, NextEventIsNeverLate) {
  for (std::uint64_t seed = 0; seed < 20; ++seed) {
    Random random(seed, 4);
    Bus bus({.ports = 4, .error_probability = 0.05, .seed = seed});
    for (const Sent& s : random_traffic(random, 4, 12)) (void)bus.send(s.port, s.frame, Time{});
    int guard = 0;
    while (const auto event = bus.next_event()) {
      ASSERT_LT(++guard, 1000);
      bus.advance(*event - nanoseconds(1), [](const Delivery&) { FAIL() << "delivered before next_event()"; });
      bus.advance(*event, [&event](const Delivery& d) { ASSERT_EQ(d.at, *event); });
    }
    for (int i = 0; i < 4; ++i) EXPECT_EQ(bus.status(i).queued, 0);
  }
}

}  // namespace
}  // namespace mrr::sim
