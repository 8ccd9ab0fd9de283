// Frames of the plant bus, the cut of the robot's bus at ticks, Linux's frames: all without a CAN interface.
#include <gtest/gtest.h>

#include <functional>

#include "can_protocol/plant_io/plant_link.h"
#include "can_protocol/socketcan/arrival.h"
#include "can_protocol/socketcan/linux_frame.h"
#include "common/core/random.h"
#include "module_fw/targets/linux/joint_bytes.h"
#include "module_fw/targets/linux/lateness.h"

namespace mrr {
namespace {

using namespace plant_io;

template <typename Bytes>
Bytes random_bytes(Random& random) {
  Bytes b{};
  for (auto& byte : b) byte = static_cast<std::uint8_t>(random.below(256));
  return b;
}

Tick some_tick(Random& random) {
  Tick t;
  t.group = static_cast<std::uint32_t>(random.below(6));
  t.lockstep = random.below(2) != 0;
  t.ending = random.below(2) != 0;
  t.now = Time{static_cast<std::int64_t>(random.next() >> 16U)};
  t.asked = static_cast<std::uint32_t>(random.next());
  t.number = static_cast<std::uint32_t>(random.next());
  for (Block& b : t.blocks) b = random_bytes<Block>(random);
  return t;
}

Participant some_participant(Random& random) {
  const auto p = static_cast<Participant>(random.below(kMaxJointParticipants + 1));
  return p == kMaxJointParticipants ? kSupervisor : p;
}

TEST(PlantFrames, WhatIsEncodedIsDecoded) {
  Random random(1);
  for (int i = 0; i < 2000; ++i) {
    const Tick tick = some_tick(random);
    EXPECT_EQ(decode_tick(encode(tick)), tick);
    const Answer answer{some_participant(random), static_cast<std::uint32_t>(random.next()), random.below(2) != 0,
                        random_bytes<AnswerPayload>(random)};
    EXPECT_EQ(decode_answer(encode(answer)), answer);
    const Announcement announcement{some_participant(random), static_cast<std::uint32_t>(random.next())};
    EXPECT_EQ(decode_announcement(encode(announcement)), announcement);
  }
}

TEST(PlantFrames, FitWhatCanFdCarries) {
  Random random(2);
  for (const can::Frame& f : {encode(some_tick(random)), encode(Answer{}), encode(Announcement{})}) {
    EXPECT_TRUE(f.fd);
    EXPECT_TRUE(can::is_fd_length(f.length));
  }
}

/// Each of the ways to spoil a frame must make all three unreadable as what they were.
TEST(PlantFrames, SpoiltFramesAreNotRead) {
  Random random(3);
  const std::vector<std::pair<const char*, std::function<void(can::Frame&)>>> ways{
      {"version", [](can::Frame& f) { f.data[0] ^= 0xFFU; }}, {"classic", [](can::Frame& f) { f.fd = false; }},
      {"extended", [](can::Frame& f) { f.extended = true; }}, {"remote", [](can::Frame& f) { f.remote = true; }},
      {"identifier", [](can::Frame& f) { f.id += 0x020; }},   {"far identifier", [](can::Frame& f) { f.id += 0x400; }},
  };
  for (const auto& [name, spoil] : ways) {
    SCOPED_TRACE(name);
    can::Frame tick = encode(some_tick(random));
    can::Frame answer = encode(Answer{});
    can::Frame announcement = encode(Announcement{});
    spoil(tick);
    spoil(answer);
    spoil(announcement);
    EXPECT_FALSE(decode_tick(tick));
    EXPECT_FALSE(decode_answer(answer));
    EXPECT_FALSE(decode_announcement(announcement));
  }
  const can::Frame tick = encode(some_tick(random));
  const can::Frame answer = encode(Answer{});
  const can::Frame announcement = encode(Announcement{});
  const auto with_length = [](can::Frame f, std::uint8_t length) {
    f.length = length;
    return f;
  };
  for (std::uint8_t length = 0; length <= 64; ++length) {
    EXPECT_EQ(decode_tick(with_length(tick, length)).has_value(), length == tick.length);
    EXPECT_EQ(decode_answer(with_length(answer, length)).has_value(), length == answer.length);
    EXPECT_EQ(decode_announcement(with_length(announcement, length)).has_value(), length == announcement.length);
  }
  can::Frame unknown_flag = encode(some_tick(random));
  unknown_flag.data[1] |= 0x80U;
  EXPECT_FALSE(decode_tick(unknown_flag));
  can::Frame nobody = encode(Answer{});
  nobody.id = kAnswerId + kMaxJointParticipants;  // between the joints and the supervisor
  EXPECT_FALSE(decode_answer(nobody));
}

TEST(PlantFrames, JointBytesKeepEveryValue) {
  fw::RawSensors s{-123456789, -32768, 32767, 251, -40, 65535, 0x3F, 0x1F};
  const fw::RawSensors back = fw::decode_sensors(fw::encode(s));
  EXPECT_EQ(back.encoder_count, s.encoder_count);
  EXPECT_EQ(back.torque_adc, s.torque_adc);
  EXPECT_EQ(back.current_adc, s.current_adc);
  EXPECT_EQ(back.winding_temperature_adc, s.winding_temperature_adc);
  EXPECT_EQ(back.drive_temperature_adc, s.drive_temperature_adc);
  EXPECT_EQ(back.bus_voltage_adc, s.bus_voltage_adc);
  EXPECT_EQ(back.inputs, s.inputs);
  EXPECT_EQ(back.fresh, s.fresh);
  for (unsigned bits = 0; bits < 16; ++bits) {
    fw::JointAnswer a;
    a.actuator = {static_cast<std::int16_t>(-32767 + static_cast<int>(bits)), (bits & 1U) != 0, (bits & 2U) != 0};
    a.passive = (bits & 4U) != 0;
    a.wholly_passive = (bits & 8U) != 0;
    a.reference_position_rad = -1.5F;
    a.reference_velocity_rad_s = 2.5F;
    a.joint_torque_nm = 3.25F;
    a.torque_command_nm = -4.125F;
    const fw::JointAnswer b = fw::decode_joint_answer(fw::encode(a));
    EXPECT_EQ(b.actuator.current_duty, a.actuator.current_duty);
    EXPECT_EQ(b.actuator.power_stage_enabled, a.actuator.power_stage_enabled);
    EXPECT_EQ(b.actuator.brake_release, a.actuator.brake_release);
    EXPECT_EQ(b.passive, a.passive);
    EXPECT_EQ(b.wholly_passive, a.wholly_passive);
    EXPECT_EQ(b.reference_position_rad, a.reference_position_rad);
    EXPECT_EQ(b.reference_velocity_rad_s, a.reference_velocity_rad_s);
    EXPECT_EQ(b.joint_torque_nm, a.joint_torque_nm);
    EXPECT_EQ(b.torque_command_nm, a.torque_command_nm);
  }
  const SupervisorTelemetry t{3, 517, 12.5F};
  EXPECT_EQ(decode_supervisor(encode(t)), t);
}

can::ReceivedFrame arrived(std::uint32_t id, std::int64_t at_ns, std::uint8_t mark = 0, bool extended = false) {
  can::Frame f;
  f.id = id;
  f.extended = extended;
  f.length = 1;
  f.data[0] = mark;
  return {f, Time{at_ns}};
}

TEST(TickInbox, WhatArrivedAfterTheTickWaitsForTheNextOne) {
  TickInbox inbox;
  ASSERT_TRUE(inbox.push(arrived(0x181, 10)));
  ASSERT_TRUE(inbox.push(arrived(0x182, 20)));
  EXPECT_FALSE(inbox.reaches_beyond(Time{20}));
  ASSERT_TRUE(inbox.push(arrived(0x080, 21)));
  EXPECT_TRUE(inbox.reaches_beyond(Time{20}));
  const auto first = inbox.take(Time{20}, Time{7});
  ASSERT_EQ(first.size(), 2U);
  EXPECT_EQ(first[0].frame.id, 0x181U);
  EXPECT_EQ(first[1].at, Time{7});
  EXPECT_TRUE(inbox.take(Time{20}, Time{7}).empty());
  const auto second = inbox.take(Time{30}, Time{8});
  ASSERT_EQ(second.size(), 1U);
  EXPECT_EQ(second[0].frame.id, 0x080U);
}

/// Whatever the order in which processes happened to send, the core sees the same: identifiers in order, and the frames
/// of one identifier (one sender) as they came.
TEST(TickInbox, OrderDoesNotDependOnTheScheduler) {
  Random random(4);
  for (int round = 0; round < 200; ++round) {
    struct Sender {
      std::uint32_t id;
      bool extended;
      std::uint8_t count;
      std::uint8_t sent;
    };
    std::vector<Sender> senders{{0x000, false, 2, 0}, {0x080, false, 1, 0},        {0x181, false, 3, 0},
                                {0x283, false, 1, 0}, {0x181U << 18U, true, 1, 0}, {0x703, false, 2, 0}};
    TickInbox inbox;
    std::int64_t at = 0;
    std::size_t total = 10;
    while (inbox.size() < total) {
      Sender& s = senders[random.below(senders.size())];
      if (s.sent == s.count) continue;
      ASSERT_TRUE(inbox.push(arrived(s.id, ++at, s.sent++, s.extended)));
    }
    const auto taken = inbox.take(Time{1000}, Time{1});
    ASSERT_EQ(taken.size(), total);
    std::size_t k = 0;
    for (const auto& [id, extended] : std::vector<std::pair<std::uint32_t, bool>>{
             {0x000, false}, {0x080, false}, {0x181, false}, {0x181U << 18U, true}, {0x283, false}, {0x703, false}}) {
      for (std::uint8_t mark = 0; k < total && taken[k].frame.id == id && taken[k].frame.extended == extended; ++k)
        EXPECT_EQ(taken[k].frame.data[0], mark++);
    }
    EXPECT_EQ(k, total);
  }
}

TEST(TickInbox, RefusesWhatItCannotHold) {
  TickInbox inbox;
  for (std::size_t i = 0; i < TickInbox::kCapacity; ++i) ASSERT_TRUE(inbox.push(arrived(0x100, 1)));
  EXPECT_FALSE(inbox.push(arrived(0x100, 1)));
  EXPECT_EQ(inbox.take(Time{1}, Time{0}).size(), TickInbox::kCapacity);
  EXPECT_TRUE(inbox.push(arrived(0x100, 2)));
}

TEST(PlantFrames, AnInstantIsTheNearestOneItsBitsCanMean) {
  constexpr std::int64_t kWrap = std::int64_t{1} << 48;
  for (const std::int64_t ns :
       {std::int64_t{0}, std::int64_t{5}, kWrap - 1, kWrap, kWrap + 7, 9 * kWrap - 3, 9 * kWrap}) {
    for (const std::int64_t away : {std::int64_t{0}, std::int64_t{1'000'000}, kWrap / 2 - 1, -kWrap / 2}) {
      if (ns + away < 0) continue;
      EXPECT_EQ(whole_instant(Time{ns % kWrap}, Time{ns + away}).ns, ns) << ns << " seen from " << away;
    }
  }
}

TEST(TickInbox, FreeRunningKeepsOrderAndTimes) {
  TickInbox inbox;
  ASSERT_TRUE(inbox.push(arrived(0x703, 5)));
  ASSERT_TRUE(inbox.push(arrived(0x080, 6)));
  const auto taken = inbox.take_as_received(Time{6});
  ASSERT_EQ(taken.size(), 2U);
  EXPECT_EQ(taken[0].frame.id, 0x703U);
  EXPECT_EQ(taken[1].at, Time{6});
}

/// A frame stamped before the system's time was set back must neither wait for that time to come again nor hold up the
/// frames behind it.
TEST(TickInbox, AClockThatWasSetBackHoldsUpNothing) {
  TickInbox inbox;
  constexpr std::int64_t kHour = 3'600'000'000'000;
  ASSERT_TRUE(inbox.push(arrived(0x080, kHour + 5)));
  ASSERT_TRUE(inbox.push(arrived(0x181, 10)));
  ASSERT_TRUE(inbox.push(arrived(0x182, 25)));
  const auto first = inbox.take(Time{20}, Time{1}, Time{30});
  ASSERT_EQ(first.size(), 2U);
  EXPECT_EQ(first[0].frame.id, 0x080U);
  EXPECT_EQ(first[1].frame.id, 0x181U);
  EXPECT_EQ(inbox.take(Time{30}, Time{2}, Time{40}).size(), 1U);
}

TEST(ArrivalClock, FollowsAStepOfTheSystemsTimeEitherWay) {
  const Time real = Time{} + seconds(1'000'000.0);
  const Time now = Time{} + seconds(500.0);
  for (const double by_s : {3600.0, 0.3, -0.3, -3600.0}) {
    SCOPED_TRACE(by_s);
    can::ArrivalClock clock;
    clock.set(now - real);
    EXPECT_FALSE(clock.stepped(now, real));
    EXPECT_EQ(clock.arrival(real - milliseconds(2), now), now - milliseconds(2));
    const Time real_after = real + seconds(by_s);
    ASSERT_TRUE(clock.stepped(now, real_after));
    clock.set(now - real_after);
    EXPECT_FALSE(clock.stepped(now, real_after));
    EXPECT_EQ(clock.arrival(real_after - milliseconds(1), now), now - milliseconds(1)) << "stamped after the step";
    EXPECT_LE(clock.arrival(real - milliseconds(2), now), now) << "stamped before it";
    EXPECT_GE(clock.arrival(real - milliseconds(2), now), now - can::ArrivalClock::kOld);
  }
}

TEST(ArrivalClock, NothingArrivesInTheFutureAndWhatIsOldStaysOld) {
  can::ArrivalClock clock;
  clock.set(seconds(-100.0));
  const Time now = Time{} + seconds(10.0);
  EXPECT_EQ(clock.arrival(Time{} + seconds(110.5), now), now);
  EXPECT_EQ(clock.arrival(Time{} + seconds(105.0), now), Time{} + seconds(5.0));
}

TEST(LinuxFrame, EveryFrameSurvivesTheWayThere) {
  Random random(5);
  for (int i = 0; i < 5000; ++i) {
    can::Frame f;
    f.extended = random.below(2) != 0;
    f.id = static_cast<std::uint32_t>(random.next()) & (f.extended ? 0x1FFF'FFFFU : 0x7FFU);
    f.fd = random.below(2) != 0;
    f.remote = !f.fd && random.below(4) == 0;
    f.bit_rate_switch = f.fd && random.below(2) != 0;
    do f.length = static_cast<std::uint8_t>(random.below(f.fd ? 65 : 9));
    while (!can::is_fd_length(f.length));
    for (std::size_t k = 0; k < f.length && !f.remote; ++k) f.data[k] = static_cast<std::uint8_t>(random.below(256));
    canfd_frame raw{};
    const std::size_t size = can::to_linux(f, raw);
    ASSERT_EQ(size, f.fd ? CANFD_MTU : CAN_MTU);
    EXPECT_EQ(can::from_linux(raw, size), f);
  }
}

TEST(LinuxFrame, RefusesWhatNoFrameIs) {
  canfd_frame raw{};
  can::Frame f;
  f.length = 9;
  EXPECT_EQ(can::to_linux(f, raw), 0U);
  f.fd = true;
  EXPECT_EQ(can::to_linux(f, raw), 0U);
  f.length = 8;
  f.id = 0x800;
  EXPECT_EQ(can::to_linux(f, raw), 0U);
  raw = {};
  EXPECT_FALSE(can::from_linux(raw, 15));
  raw.len = 9;
  EXPECT_FALSE(can::from_linux(raw, CAN_MTU));
  raw.len = 13;
  EXPECT_FALSE(can::from_linux(raw, CANFD_MTU));
  raw.len = 8;
  EXPECT_TRUE(can::from_linux(raw, CAN_MTU));
  raw.can_id = CAN_ERR_FLAG;
  EXPECT_FALSE(can::from_linux(raw, CAN_MTU));
}

TEST(CanSocket, SaysWhatIsMissingAndWhatToDo) {
  try {
    (void)can::CanSocket::open("mrr-none");
    FAIL() << "there is no such interface";
  } catch (const can::CanError& error) {
    const std::string text = error.what();
    // Which of the two it is depends on the machine's kernel; each names its remedy.
    EXPECT_TRUE(text.find("the kernel has no CAN sockets") != std::string::npos ||
                text.find("there is no interface mrr-none") != std::string::npos)
        << text;
    EXPECT_NE(text.find("sudo "), std::string::npos) << text;
  }
}

TEST(Lateness, PercentilesAreThoseOfWhatWasAdded) {
  fw::Lateness l;
  for (int us = 0; us < 1000; ++us) l.add(microseconds(us));
  EXPECT_EQ(l.percentile(0.5), microseconds(500));
  EXPECT_EQ(l.percentile(0.99), microseconds(990));
  EXPECT_EQ(l.max(), microseconds(999));
  l.add(milliseconds(300));
  EXPECT_EQ(l.max(), milliseconds(300));
  EXPECT_EQ(l.percentile(1.0), milliseconds(300));
  EXPECT_EQ(l.count(), 1001);
}

}  // namespace
}  // namespace mrr
