#include "sim_vcan/wire/bus.h"

#include <gtest/gtest.h>

#include <cstdlib>
#include <new>
#include <vector>

namespace {
bool heap_forbidden = false;
}

void* operator new(std::size_t size) {
  if (heap_forbidden) std::abort();
  if (void* memory = std::malloc(size)) return memory;
  throw std::bad_alloc();
}
void operator delete(void* memory) noexcept { std::free(memory); }
void operator delete(void* memory, std::size_t) noexcept { std::free(memory); }

namespace mrr::sim {
namespace {

constexpr Time kStart{};
constexpr Duration kBit = microseconds(1);
constexpr Duration kIntermission = kBit * 3;

can::Frame frame_of(std::uint32_t id, std::uint8_t first = 0, std::uint8_t length = 1) {
  can::Frame frame;
  frame.id = id;
  frame.length = length;
  frame.data[0] = first;
  return frame;
}

Duration time_of(const can::Frame& frame) { return can::frame_time(frame, {}); }

std::vector<Delivery> run(Bus& bus, Time until) {
  std::vector<Delivery> out;
  bus.advance(until, [&out](const Delivery& delivery) { out.push_back(delivery); });
  return out;
}

TEST(Bus, DeliversAtEndOfFrameToAllOthers) {
  Bus bus({.ports = 3});
  const can::Frame frame = frame_of(0x123, 7);
  EXPECT_FALSE(bus.next_event().has_value());
  ASSERT_TRUE(bus.send(1, frame, Time{500}));
  const Time end = Time{500} + time_of(frame);
  ASSERT_EQ(bus.next_event(), end);
  EXPECT_TRUE(run(bus, end - nanoseconds(1)).empty());
  EXPECT_EQ(bus.next_event(), end);
  const auto got = run(bus, end);
  ASSERT_EQ(got.size(), 1U);
  EXPECT_EQ(got[0].from, 1);
  EXPECT_EQ(got[0].frame, frame);
  EXPECT_EQ(got[0].at, end);
  EXPECT_EQ(got[0].receivers, 0b101U);
  EXPECT_EQ(bus.status(1).sent, 1);
  EXPECT_EQ(bus.status(0).received, 1);
  EXPECT_EQ(bus.status(1).received, 0);
  EXPECT_FALSE(bus.next_event().has_value());
}

TEST(Bus, NextFrameWaitsForTheIntermission) {
  Bus bus({.ports = 2});
  const can::Frame a = frame_of(0x10);
  const can::Frame b = frame_of(0x20);
  ASSERT_TRUE(bus.send(0, a, kStart));
  ASSERT_TRUE(bus.send(0, b, kStart));
  const auto got = run(bus, kStart + milliseconds(1));
  ASSERT_EQ(got.size(), 2U);
  EXPECT_EQ(got[0].at, kStart + time_of(a));
  EXPECT_EQ(got[1].at, kStart + time_of(a) + kIntermission + time_of(b));
}

TEST(Bus, FramesSentAtOneInstantArbitrateWhateverTheOrderOfCalls) {
  Bus bus({.ports = 4});
  can::Frame extended = frame_of(0x100U << 18U);
  extended.extended = true;
  can::Frame remote = frame_of(0x100);
  remote.remote = true;
  ASSERT_TRUE(bus.send(0, extended, kStart));
  ASSERT_TRUE(run(bus, kStart).empty());  // stepping to the same instant must not start anything yet
  ASSERT_TRUE(bus.send(1, remote, kStart));
  ASSERT_TRUE(bus.send(2, frame_of(0x100), kStart));
  ASSERT_TRUE(bus.send(3, frame_of(0x0FF), kStart));
  const auto got = run(bus, kStart + milliseconds(1));
  ASSERT_EQ(got.size(), 4U);
  EXPECT_EQ(got[0].from, 3);
  EXPECT_EQ(got[1].from, 2);
  EXPECT_EQ(got[2].from, 1);
  EXPECT_EQ(got[3].from, 0);
  EXPECT_EQ(bus.statistics().identifier_conflicts, 0);
}

TEST(Bus, AFrameOnTheWireIsNotPreempted) {
  Bus bus({.ports = 2});
  ASSERT_TRUE(bus.send(0, frame_of(0x700), kStart));
  ASSERT_TRUE(run(bus, kStart + kBit).empty());
  ASSERT_TRUE(bus.send(1, frame_of(0x001), kStart + kBit));
  const auto got = run(bus, kStart + milliseconds(1));
  ASSERT_EQ(got.size(), 2U);
  EXPECT_EQ(got[0].frame.id, 0x700U);
  EXPECT_EQ(got[1].frame.id, 0x001U);
}

TEST(Bus, QueueIsFirstInFirstOutSoAnUrgentFrameWaitsBehindItsOwn) {
  Bus bus({.ports = 2});
  ASSERT_TRUE(bus.send(0, frame_of(0x700), kStart));
  ASSERT_TRUE(bus.send(0, frame_of(0x001), kStart));
  ASSERT_TRUE(bus.send(1, frame_of(0x300), kStart));
  const auto got = run(bus, kStart + milliseconds(1));
  ASSERT_EQ(got.size(), 3U);
  EXPECT_EQ(got[0].frame.id, 0x300U);
  EXPECT_EQ(got[1].frame.id, 0x700U);
  EXPECT_EQ(got[2].frame.id, 0x001U);
  EXPECT_EQ(bus.standard_id(0x001).worst_queue_delay, (got[1].at + kIntermission) - kStart);
}

TEST(Bus, FullQueueRefusesAndCounts) {
  Bus bus({.ports = 2, .queue_capacity = 4});
  for (int i = 0; i < 4; ++i) EXPECT_TRUE(bus.send(0, frame_of(0x10), kStart));
  EXPECT_FALSE(bus.send(0, frame_of(0x10), kStart));
  EXPECT_TRUE(bus.send(1, frame_of(0x11), kStart));
  EXPECT_EQ(bus.status(0).overflows, 1);
  EXPECT_EQ(bus.statistics().overflows, 1);
  EXPECT_EQ(run(bus, kStart + milliseconds(1)).size(), 5U);
  EXPECT_TRUE(bus.send(0, frame_of(0x10), kStart + milliseconds(1)));
}

TEST(Bus, MalformedFramesAreRefused) {
  Bus bus({.ports = 2});
  EXPECT_FALSE(bus.send(0, frame_of(0x800), kStart));
  EXPECT_FALSE(bus.send(0, frame_of(0x100, 0, 9), kStart));
  EXPECT_EQ(bus.status(0).refused, 2);
  EXPECT_FALSE(bus.next_event().has_value());
}

TEST(Bus, TheSinkMayAnswerAtOnce) {
  Bus bus({.ports = 2});
  ASSERT_TRUE(bus.send(0, frame_of(0x10, 0), kStart));
  int answers = 0;
  Time last;
  bus.advance(kStart + milliseconds(10), [&](const Delivery& delivery) {
    last = delivery.at;
    if (delivery.from == 0 && ++answers <= 3) {
      EXPECT_TRUE(bus.send(1, frame_of(0x20), delivery.at));
    }
    if (delivery.from == 1 && answers < 3) {
      EXPECT_TRUE(bus.send(0, frame_of(0x10), delivery.at));
    }
  });
  EXPECT_EQ(answers, 3);
  EXPECT_EQ(last, kStart + (time_of(frame_of(0x10)) + time_of(frame_of(0x20))) * 3 + kIntermission * 5);
}

TEST(Bus, CorruptedFrameIsSentAgainAndCounted) {
  Bus bus({.ports = 3});
  ASSERT_TRUE(bus.inject(WireFault::kCorrupt, 0x10));
  const can::Frame frame = frame_of(0x10);
  ASSERT_TRUE(bus.send(0, frame, kStart));
  const auto got = run(bus, kStart + milliseconds(1));
  ASSERT_EQ(got.size(), 1U);
  // At least one bit, an error frame and intermission are lost, at most a whole frame more.
  EXPECT_GE(got[0].at, kStart + kBit * (1 + 20) + kIntermission + time_of(frame));
  EXPECT_LE(got[0].at, kStart + time_of(frame) + kBit * 20 + kIntermission + time_of(frame));
  EXPECT_EQ(bus.statistics().error_frames, 1);
  EXPECT_EQ(bus.status(0).transmit_errors, 8 - 1);
  EXPECT_EQ(bus.status(1).receive_errors, 1 - 1);
  EXPECT_EQ(bus.status(0).sent, 1);
}

TEST(Bus, OtherIdentifiersAreSpared) {
  Bus bus({.ports = 2});
  ASSERT_TRUE(bus.inject(WireFault::kCorrupt, 0x10, /*extended=*/true));
  ASSERT_TRUE(bus.inject(WireFault::kCorrupt, 0x11));
  ASSERT_TRUE(bus.send(0, frame_of(0x10), kStart));
  EXPECT_EQ(run(bus, kStart + milliseconds(1)).size(), 1U);
  EXPECT_EQ(bus.statistics().error_frames, 0);
}

TEST(Bus, SenderGoesPassiveThenBusOffAndComesBackAfterRestart) {
  Bus bus({.ports = 2});
  ASSERT_TRUE(bus.inject(WireFault::kCorrupt, 0x10, false, 32));
  ASSERT_TRUE(bus.send(0, frame_of(0x10), kStart));
  ASSERT_TRUE(bus.send(0, frame_of(0x12), kStart));
  bool was_passive = false;
  Time now = kStart;
  for (; now < kStart + milliseconds(20); now += kBit * 10) {
    ASSERT_TRUE(run(bus, now).empty());
    if (bus.status(0).state == ErrorState::kPassive) {
      was_passive = true;
      EXPECT_GE(bus.status(0).transmit_errors, 128);
    }
  }
  EXPECT_TRUE(was_passive);
  EXPECT_EQ(bus.statistics().error_frames, 32);  // 32 * 8 = 256 > 255
  EXPECT_EQ(bus.status(0).state, ErrorState::kBusOff);
  EXPECT_EQ(bus.status(0).discarded, 2);
  EXPECT_FALSE(bus.send(0, frame_of(0x10), now));
  EXPECT_FALSE(bus.next_event().has_value());
  EXPECT_EQ(bus.status(1).state, ErrorState::kActive);

  bus.restart(0, now);
  run(bus, now + kBit * (128 * 11 - 1));
  EXPECT_FALSE(bus.send(0, frame_of(0x10), now + kBit * (128 * 11 - 1)));
  now += kBit * (128 * 11);
  run(bus, now);
  EXPECT_EQ(bus.status(0).state, ErrorState::kActive);
  EXPECT_EQ(bus.status(0).transmit_errors, 0);
  ASSERT_TRUE(bus.send(0, frame_of(0x10), now));
  EXPECT_EQ(run(bus, now + milliseconds(1)).size(), 1U);
}

TEST(Bus, ANodeAloneStaysErrorPassiveAndIsHeardOnceSomeoneIsThere) {
  Bus bus({.ports = 2});
  bus.connect(1, false);
  ASSERT_TRUE(bus.send(0, frame_of(0x10), kStart));
  EXPECT_TRUE(run(bus, kStart + milliseconds(100)).empty());
  EXPECT_EQ(bus.status(0).state, ErrorState::kPassive);
  EXPECT_EQ(bus.status(0).transmit_errors, 128);
  EXPECT_EQ(bus.status(0).queued, 1);
  bus.connect(1, true);
  EXPECT_EQ(run(bus, kStart + milliseconds(101)).size(), 1U);
  EXPECT_EQ(bus.status(0).transmit_errors, 127);
  EXPECT_EQ(bus.status(0).state, ErrorState::kActive);
}

TEST(Bus, DroppedFrameIsLostToTheChosenReceiverOnly) {
  Bus bus({.ports = 3});
  ASSERT_TRUE(bus.inject(WireFault::kDrop, 0x10, false, 1, 1U << 2U));
  ASSERT_TRUE(bus.send(0, frame_of(0x10), kStart));
  ASSERT_TRUE(bus.send(0, frame_of(0x10), kStart));
  const auto got = run(bus, kStart + milliseconds(1));
  ASSERT_EQ(got.size(), 2U);
  EXPECT_TRUE(got[0].reaches(1));
  EXPECT_FALSE(got[0].reaches(2));
  EXPECT_TRUE(got[1].reaches(2));
  EXPECT_EQ(bus.status(0).sent, 2);
  EXPECT_EQ(bus.status(2).received, 1);
}

TEST(Bus, PullingTheSendersPlugBreaksItsFrameOff) {
  Bus bus({.ports = 3});
  ASSERT_TRUE(bus.send(0, frame_of(0x10), kStart));
  ASSERT_TRUE(bus.send(1, frame_of(0x20), kStart));
  run(bus, kStart + kBit * 10);
  bus.connect(0, false);
  const auto got = run(bus, kStart + milliseconds(1));
  ASSERT_EQ(got.size(), 1U);
  EXPECT_EQ(got[0].frame.id, 0x20U);
  EXPECT_FALSE(got[0].reaches(0));
  EXPECT_EQ(got[0].at, kStart + kBit * (10 + 20) + kIntermission + time_of(frame_of(0x20)));
  EXPECT_EQ(bus.status(0).discarded, 1);
  EXPECT_FALSE(bus.send(0, frame_of(0x10), kStart + milliseconds(1)));
}

TEST(Bus, ClearedQueueKeepsOnlyWhatIsOnTheWire) {
  Bus bus({.ports = 2});
  for (int i = 0; i < 3; ++i) ASSERT_TRUE(bus.send(0, frame_of(0x10, static_cast<std::uint8_t>(i)), kStart));
  run(bus, kStart + kBit);
  bus.clear_queue(0);
  const auto got = run(bus, kStart + milliseconds(1));
  ASSERT_EQ(got.size(), 1U);
  EXPECT_EQ(got[0].frame.data[0], 0);
  EXPECT_EQ(bus.status(0).discarded, 2);
}

TEST(Bus, SameIdentifierFromTwoPortsAtOnceIsReported) {
  Bus bus({.ports = 2});
  ASSERT_TRUE(bus.send(1, frame_of(0x10, 1), kStart));
  ASSERT_TRUE(bus.send(0, frame_of(0x10, 0), kStart));
  const auto got = run(bus, kStart + milliseconds(1));
  ASSERT_EQ(got.size(), 2U);
  EXPECT_EQ(got[0].from, 0);
  EXPECT_EQ(bus.statistics().identifier_conflicts, 1);
}

TEST(Bus, LoadIsTheShareOfTimeTheWireIsTaken) {
  Bus bus({.ports = 2});
  const can::Frame frame = frame_of(0x10);
  const Duration taken = time_of(frame) + kIntermission;
  for (int i = 0; i < 10; ++i) {
    const Time now = kStart + milliseconds(1) * i;
    run(bus, now);
    ASSERT_TRUE(bus.send(0, frame, now));
  }
  run(bus, kStart + milliseconds(10));
  EXPECT_EQ(bus.statistics().busy, taken * 10);
  EXPECT_EQ(bus.statistics().elapsed, milliseconds(10));
  EXPECT_DOUBLE_EQ(bus.statistics().load(), taken.seconds() * 10 / 0.010);
  EXPECT_EQ(bus.standard_id(0x10).frames, 10);
  EXPECT_EQ(bus.standard_id(0x10).bits * 1000, taken.ns * 10);
  bus.reset_statistics();
  EXPECT_EQ(bus.statistics().frames, 0);
  EXPECT_EQ(bus.standard_id(0x10).frames, 0);
}

TEST(Bus, LoadOfASaturatedWireIsOneAtAnyInstant) {
  Bus bus({.ports = 2});
  Time now = kStart;
  for (int i = 0; i < 5000; ++i, now += nanoseconds(7777)) {
    run(bus, now);
    while (bus.send(0, frame_of(0x10), now)) {
    }
    if (i == 2000) bus.reset_statistics();
    if (i > 0 && i != 2000) {
      ASSERT_EQ(bus.statistics().busy, bus.statistics().elapsed) << i;
    }
  }
}

// Six joints with set points, state and SYNC at 1 kHz do not fit on 1 Mbit/s: queues must overflow rather than grow.
TEST(Bus, SixJointsAtOneKilohertzDoNotFit) {
  Bus bus({.ports = 7});
  for (int tick = 0; tick < 200; ++tick) {
    const Time now = kStart + milliseconds(1) * tick;
    run(bus, now);
    (void)bus.send(0, frame_of(0x80, static_cast<std::uint8_t>(tick)), now);
    for (int joint = 1; joint < 7; ++joint) {
      const auto id = static_cast<std::uint32_t>(joint);
      (void)bus.send(0, frame_of(0x300 + id, 1, 8), now);
      (void)bus.send(0, frame_of(0x400 + id, 2, 8), now);
      (void)bus.send(joint, frame_of(0x180 + id, 3, 8), now);
    }
  }
  EXPECT_GT(bus.statistics().overflows, 100);
  EXPECT_GT(bus.statistics().load(), 0.99);
}

TEST(Bus, UsesNoHeapOnceConstructed) {
  Bus bus({.ports = 4, .error_probability = 0.05, .seed = 3});
  int deliveries = 0;
  heap_forbidden = true;
  for (int i = 0; i < 1000; ++i) {
    const Time now = kStart + microseconds(250) * i;
    bus.advance(now, [&deliveries](const Delivery&) { ++deliveries; });
    for (int port = 0; port < 4; ++port) (void)bus.send(port, frame_of(static_cast<std::uint32_t>(0x100 + port)), now);
    if (i == 500) {
      bus.connect(2, false);
      (void)bus.inject(WireFault::kCorrupt, 0x101, false, 40);
    }
    if (i == 700) bus.restart(1, now);
  }
  heap_forbidden = false;
  EXPECT_GT(deliveries, 1000);
}

TEST(Bus, ImpossibleConfigurationsAreRefused) {
  EXPECT_THROW(Bus({.ports = 0}), std::invalid_argument);
  EXPECT_THROW(Bus({.ports = kMaxPorts + 1}), std::invalid_argument);
  EXPECT_THROW(Bus({.queue_capacity = 0}), std::invalid_argument);
  EXPECT_THROW(Bus({.bit_rates = {.nominal = 0}}), std::invalid_argument);
}

}  // namespace
}  // namespace mrr::sim
