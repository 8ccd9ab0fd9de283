// Room: can_protocol/plant_io. Frames between the plant (emulator) and Linux modules, on a bus of their own: made and
// read, no I/O (docs/plant_io.md). May touch can_protocol/frame.h, codec.h and common/core. Freestanding.
#pragma once

#include <array>
#include <cstdint>
#include <optional>

#include "can_protocol/frame.h"
#include "common/core/time.h"

namespace mrr::plant_io {

/// First byte of every frame. A frame of another version is not read.
inline constexpr std::uint8_t kVersion = 1;

/// Who takes part in a tick: joints 0 .. 15, and the supervisor.
using Participant = std::uint8_t;
inline constexpr Participant kMaxJointParticipants = 16;
inline constexpr Participant kSupervisor = 31;
constexpr bool is_participant(unsigned p) noexcept { return p < kMaxJointParticipants || p == kSupervisor; }
constexpr std::uint32_t bit_of(Participant p) noexcept { return 1U << p; }

inline constexpr std::uint32_t kTickId = 0x100;      ///< + group; plant to participants
inline constexpr std::uint32_t kAnswerId = 0x200;    ///< + participant
inline constexpr std::uint32_t kAnnounceId = 0x300;  ///< + participant

/// Sensors of one joint, raw; what is in them is the module's business (module_fw/joint_io.h).
inline constexpr std::size_t kBlockBytes = 16;
using Block = std::array<std::uint8_t, kBlockBytes>;
/// Joints share tick frames: three each.
inline constexpr std::size_t kBlocksPerTick = 3;
constexpr std::uint32_t group_of(Participant joint) noexcept {
  return joint < kMaxJointParticipants ? joint / static_cast<std::uint32_t>(kBlocksPerTick) : 0;
}

/// Of one instant of simulated time. Frames of higher groups are sent first; group 0 is the go.
struct Tick {
  std::uint32_t group = 0;
  bool lockstep = false;  ///< the plant waits for the answers; otherwise it runs on the wall clock
  bool ending = false;    ///< the plant stops after this one
  Time now;  ///< lockstep: simulated, 0 .. 2^48 ns (78 hours); else CLOCK_MONOTONIC of the instant, modulo 2^48 ns
  std::uint32_t asked = 0;   ///< bit per participant that is taken along and must answer
  std::uint32_t number = 0;  ///< counts up by one, wraps
  std::array<Block, kBlocksPerTick> blocks{};

  friend bool operator==(const Tick&, const Tick&) = default;
};

/// The instant nearest to `near` that the 48 bits of a tick can mean.
[[nodiscard]] constexpr Time whole_instant(Time bits, Time near) noexcept {
  constexpr std::int64_t kWrap = std::int64_t{1} << 48;
  const std::int64_t missing = near.ns - bits.ns + kWrap / 2;
  return Time{bits.ns + (missing >= 0 ? missing / kWrap : 0) * kWrap};
}

/// What a participant does until the next tick; the payload is its own business.
inline constexpr std::size_t kAnswerBytes = 24;
using AnswerPayload = std::array<std::uint8_t, kAnswerBytes>;
struct Answer {
  Participant from = 0;
  std::uint32_t number = 0;  ///< of the tick it answers
  bool leaving = false;      ///< the last one: do not ask again
  AnswerPayload payload{};

  friend bool operator==(const Answer&, const Answer&) = default;
};

/// "Here I am": sent until a tick asks this participant.
struct Announcement {
  Participant from = 0;
  /// The module's configuration_hash, so that a plant of another robot is noticed; 0: not compared.
  std::uint32_t configuration_hash = 0;

  friend bool operator==(const Announcement&, const Announcement&) = default;
};

/// What the supervisor adds to the emulator's recording. It has no effect on the physics.
struct SupervisorTelemetry {
  std::uint8_t activity = 0;
  std::uint16_t swing = 0;  ///< counts from 1; 0: none yet
  float estimated_force_n = 0.0F;

  friend bool operator==(const SupervisorTelemetry&, const SupervisorTelemetry&) = default;
};
[[nodiscard]] AnswerPayload encode(const SupervisorTelemetry& telemetry) noexcept;
[[nodiscard]] SupervisorTelemetry decode_supervisor(const AnswerPayload& payload) noexcept;

[[nodiscard]] can::Frame encode(const Tick& tick) noexcept;
[[nodiscard]] can::Frame encode(const Answer& answer) noexcept;
[[nodiscard]] can::Frame encode(const Announcement& announcement) noexcept;

/// Empty: not such a frame, or identifier, version, length or flags are not what they must be.
[[nodiscard]] std::optional<Tick> decode_tick(const can::Frame& frame) noexcept;
[[nodiscard]] std::optional<Answer> decode_answer(const can::Frame& frame) noexcept;
[[nodiscard]] std::optional<Announcement> decode_announcement(const can::Frame& frame) noexcept;

}  // namespace mrr::plant_io
