// Room: can_protocol. CANopen's small messages (NMT, SYNC, heartbeat, EMCY) and COB-IDs, made and read. Freestanding.
#pragma once

#include <array>
#include <cstdint>
#include <optional>

#include "can_protocol/codec.h"
#include "can_protocol/frame.h"

namespace mrr::can {

inline constexpr std::uint32_t kNmtCobId = 0x000;
inline constexpr std::uint32_t kSyncCobId = 0x080;
inline constexpr std::uint32_t kEmergencyCobId = 0x080;   ///< + node id
inline constexpr std::uint32_t kSdoReplyCobId = 0x580;    ///< + node id; server to client
inline constexpr std::uint32_t kSdoRequestCobId = 0x600;  ///< + node id; client to server
inline constexpr std::uint32_t kHeartbeatCobId = 0x700;   ///< + node id

inline constexpr std::uint8_t kSupervisorNodeId = 1;
inline constexpr std::uint8_t kMaxNodeId = 127;

/// Values as in the heartbeat.
enum class NmtState : std::uint8_t { initialising = 0x00, stopped = 0x04, operational = 0x05, pre_operational = 0x7F };

enum class NmtCommand : std::uint8_t {
  start = 0x01,
  stop = 0x02,
  enter_pre_operational = 0x80,
  reset_node = 0x81,
  reset_communication = 0x82,
};

/// node_id 0: all nodes.
constexpr Frame nmt_frame(NmtCommand command, std::uint8_t node_id) noexcept {
  Frame f;
  f.id = kNmtCobId;
  f.length = 2;
  f.data[0] = static_cast<std::uint8_t>(command);
  f.data[1] = node_id;
  return f;
}

/// Empty without a counter (1019h = 0), else one byte, 1-240.
constexpr Frame sync_frame(std::optional<std::uint8_t> counter) noexcept {
  Frame f;
  f.id = kSyncCobId;
  if (counter) {
    f.length = 1;
    f.data[0] = *counter;
  }
  return f;
}

constexpr Frame heartbeat_frame(std::uint8_t node_id, NmtState state) noexcept {
  Frame f;
  f.id = kHeartbeatCobId + node_id;
  f.length = 1;
  f.data[0] = static_cast<std::uint8_t>(state);
  return f;
}

/// A heartbeat, or a boot-up message when `state` is initialising.
struct Heartbeat {
  std::uint8_t node_id = 0;
  NmtState state = NmtState::initialising;
};

constexpr std::optional<Heartbeat> parse_heartbeat(const Frame& f) noexcept {
  if (f.extended || f.remote || f.length != 1) return std::nullopt;
  if (!(f.id > kHeartbeatCobId && f.id <= kHeartbeatCobId + kMaxNodeId)) return std::nullopt;
  const std::uint8_t s = f.data[0];
  if (!(s == 0x00 || s == 0x04 || s == 0x05 || s == 0x7F)) return std::nullopt;
  return Heartbeat{static_cast<std::uint8_t>(f.id - kHeartbeatCobId), static_cast<NmtState>(s)};
}

struct EmergencyMessage {
  std::uint8_t node_id = 0;
  std::uint16_t code = 0;  ///< enum Emergency; 0: error reset
  std::uint8_t error_register = 0;
  std::array<std::uint8_t, 5> detail{};
};

constexpr std::optional<EmergencyMessage> parse_emergency(const Frame& f) noexcept {
  if (f.extended || f.remote || f.length != 8) return std::nullopt;
  if (!(f.id > kEmergencyCobId && f.id <= kEmergencyCobId + kMaxNodeId)) return std::nullopt;
  EmergencyMessage m;
  m.node_id = static_cast<std::uint8_t>(f.id - kEmergencyCobId);
  m.code = get<std::uint16_t>(f.data.data());
  m.error_register = f.data[2];
  for (std::size_t i = 0; i < 5; ++i) m.detail[i] = f.data[3 + i];
  return m;
}

}  // namespace mrr::can
