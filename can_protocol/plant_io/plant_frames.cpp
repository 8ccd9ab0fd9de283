#include "can_protocol/plant_io/plant_frames.h"

#include <algorithm>
#include <bit>

#include "can_protocol/codec.h"

namespace mrr::plant_io {

namespace {

using can::get;
using can::put;

constexpr std::uint8_t kFlagLockstep = 1U << 0U;
constexpr std::uint8_t kFlagEnding = 1U << 1U;
constexpr std::uint8_t kFlagLeaving = 1U << 0U;
constexpr std::uint8_t kTickBytes = 64;
constexpr std::uint8_t kAnswerFrameBytes = 32;
constexpr std::uint8_t kAnnouncementBytes = 8;
constexpr std::size_t kBlocksAt = 16;
constexpr std::size_t kPayloadAt = 8;

can::Frame frame(std::uint32_t id, std::uint8_t length) noexcept {
  can::Frame f;
  f.id = id;
  f.fd = f.bit_rate_switch = true;
  f.length = length;
  f.data[0] = kVersion;
  return f;
}

bool is(const can::Frame& f, std::uint8_t length) noexcept {
  return f.fd && !f.extended && !f.remote && f.length == length && f.data[0] == kVersion;
}

/// The participant in an identifier, if it is one.
std::optional<Participant> sender(const can::Frame& f, std::uint32_t base) noexcept {
  if (f.id < base || !is_participant(f.id - base)) return std::nullopt;
  return static_cast<Participant>(f.id - base);
}

}  // namespace

can::Frame encode(const Tick& tick) noexcept {
  can::Frame f = frame(kTickId + tick.group, kTickBytes);
  std::uint8_t* d = f.data.data();
  d[1] = static_cast<std::uint8_t>((tick.lockstep ? kFlagLockstep : 0U) | (tick.ending ? kFlagEnding : 0U));
  const auto ns = static_cast<std::uint64_t>(tick.now.ns);
  put<std::uint16_t>(d + 2, static_cast<std::uint16_t>(ns >> 32U));
  put<std::uint32_t>(d + 4, static_cast<std::uint32_t>(ns));
  put<std::uint32_t>(d + 8, tick.asked);
  put<std::uint32_t>(d + 12, tick.number);
  for (std::size_t k = 0; k < kBlocksPerTick; ++k)
    std::copy(tick.blocks[k].begin(), tick.blocks[k].end(), d + kBlocksAt + k * kBlockBytes);
  return f;
}

std::optional<Tick> decode_tick(const can::Frame& f) noexcept {
  constexpr std::uint32_t kGroups = group_of(kMaxJointParticipants - 1) + 1;
  if (!is(f, kTickBytes) || f.id < kTickId || f.id >= kTickId + kGroups) return std::nullopt;
  const std::uint8_t* d = f.data.data();
  if ((d[1] & ~(kFlagLockstep | kFlagEnding)) != 0) return std::nullopt;
  Tick t;
  t.group = f.id - kTickId;
  t.lockstep = (d[1] & kFlagLockstep) != 0;
  t.ending = (d[1] & kFlagEnding) != 0;
  t.now.ns = static_cast<std::int64_t>(get<std::uint16_t>(d + 2)) << 32U | get<std::uint32_t>(d + 4);
  t.asked = get<std::uint32_t>(d + 8);
  t.number = get<std::uint32_t>(d + 12);
  for (std::size_t k = 0; k < kBlocksPerTick; ++k)
    std::copy_n(d + kBlocksAt + k * kBlockBytes, kBlockBytes, t.blocks[k].begin());
  return t;
}

can::Frame encode(const Answer& answer) noexcept {
  can::Frame f = frame(kAnswerId + answer.from, kAnswerFrameBytes);
  f.data[1] = answer.leaving ? kFlagLeaving : std::uint8_t{0};
  put<std::uint32_t>(f.data.data() + 4, answer.number);
  std::copy(answer.payload.begin(), answer.payload.end(), f.data.begin() + kPayloadAt);
  return f;
}

std::optional<Answer> decode_answer(const can::Frame& f) noexcept {
  const std::optional<Participant> from = sender(f, kAnswerId);
  if (!from || !is(f, kAnswerFrameBytes) || (f.data[1] & ~kFlagLeaving) != 0) return std::nullopt;
  Answer a;
  a.from = *from;
  a.leaving = (f.data[1] & kFlagLeaving) != 0;
  a.number = get<std::uint32_t>(f.data.data() + 4);
  std::copy_n(f.data.begin() + kPayloadAt, kAnswerBytes, a.payload.begin());
  return a;
}

can::Frame encode(const Announcement& announcement) noexcept {
  can::Frame f = frame(kAnnounceId + announcement.from, kAnnouncementBytes);
  put<std::uint32_t>(f.data.data() + 4, announcement.configuration_hash);
  return f;
}

std::optional<Announcement> decode_announcement(const can::Frame& f) noexcept {
  const std::optional<Participant> from = sender(f, kAnnounceId);
  if (!from || !is(f, kAnnouncementBytes)) return std::nullopt;
  return Announcement{*from, get<std::uint32_t>(f.data.data() + 4)};
}

AnswerPayload encode(const SupervisorTelemetry& telemetry) noexcept {
  AnswerPayload p{};
  p[0] = telemetry.activity;
  put<std::uint16_t>(p.data() + 2, telemetry.swing);
  put<std::uint32_t>(p.data() + 4, std::bit_cast<std::uint32_t>(telemetry.estimated_force_n));
  return p;
}

SupervisorTelemetry decode_supervisor(const AnswerPayload& p) noexcept {
  return {p[0], get<std::uint16_t>(p.data() + 2), std::bit_cast<float>(get<std::uint32_t>(p.data() + 4))};
}

}  // namespace mrr::plant_io
