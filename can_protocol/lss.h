// Room: can_protocol. Layer setting services (CiA 305), the slave's side: a module gets its node id over the bus,
// without a switch or a rebuild. Freestanding, fixed memory, noexcept; frames in, answers out, nothing else touched.
#pragma once

#include <array>
#include <cstdint>
#include <optional>

#include "can_protocol/frame.h"

namespace mrr::can {

inline constexpr std::uint32_t kLssRequestCobId = 0x7E5;  ///< master to slaves
inline constexpr std::uint32_t kLssAnswerCobId = 0x7E4;   ///< slaves to master
/// A node with this id has none: it says nothing but LSS.
inline constexpr std::uint8_t kUnconfiguredNodeId = 0xFF;

/// The identity object: vendor, product code, revision, serial number. Selects one module among all.
using LssIdentity = std::array<std::uint32_t, 4>;

/// What became of "store configuration" (CiA 305): the error code of its answer.
enum class LssStored : std::uint8_t { done = 0, not_supported = 1, memory_failed = 2 };

/// Where a node id goes that shall outlast power-off.
class LssStore {
 public:
  virtual LssStored store_node_id(std::uint8_t /*node_id*/) noexcept { return LssStored::not_supported; }

 protected:
  ~LssStore() = default;
};

class LssSlave {
 public:
  enum class Mode : std::uint8_t { waiting, configuration };

  LssSlave(std::uint8_t node_id, std::uint32_t bit_rate) noexcept : node_id_(node_id), bit_rate_(bit_rate) {}

  /// Answers one request, or does as it says. Malformed, unknown and others' requests have no answer and no effect.
  [[nodiscard]] std::optional<Frame> handle(const Frame& f, const LssIdentity& identity, LssStore& store) noexcept;

  /// A node id of its own that is known before the bus is: what was stored.
  void begin_with(std::uint8_t node_id) noexcept { node_id_ = active_ = node_id; }
  /// As configured last; comes into force at the next NMT reset. 1-127, or kUnconfiguredNodeId.
  [[nodiscard]] std::uint8_t node_id() const noexcept { return node_id_; }
  [[nodiscard]] Mode mode() const noexcept { return mode_; }
  /// An NMT reset: whatever was being selected is forgotten. `active`: the node id in force from now on.
  void reset(std::uint8_t active) noexcept;

 private:
  [[nodiscard]] bool fastscan(const Frame& f, const LssIdentity& identity) noexcept;

  std::uint8_t node_id_;
  std::uint8_t active_ = 0;  ///< node id in force
  std::uint32_t bit_rate_;
  Mode mode_ = Mode::waiting;
  std::uint8_t selected_ = 0;    ///< switch selective: parts of the identity matched so far
  std::uint8_t identified_ = 0;  ///< identify remote slave: the same
  std::uint8_t scanned_ = 0;     ///< fastscan: part of the identity that is looked for
};

}  // namespace mrr::can
