// Room: can_protocol. What 1010h keeps: two alternating slots in a memory that can lose its power at any byte.
// Freestanding, fixed memory, small steps; what the memory is, the shell knows (StoragePort).
#pragma once

#include <array>
#include <cstdint>
#include <span>

#include "can_protocol/object_access.h"

namespace mrr::can {

/// A memory of two slots. Every call is one small step that does not block: `busy` means "call again with the same
/// arguments". Bytes that were never written read as 0xFF, or as the memory has them: nothing relies on it.
class StoragePort {
 public:
  enum class Result : std::uint8_t { done, busy, failed };
  static constexpr std::uint8_t kSlots = 2;
  /// Largest span in one call.
  static constexpr std::size_t kStepBytes = 64;

  virtual Result read(std::uint8_t slot, std::size_t offset, std::span<std::uint8_t> out) noexcept = 0;
  /// Makes the slot ready to be written from its start.
  virtual Result erase(std::uint8_t slot) noexcept = 0;
  /// Offsets rise from 0 without gaps after erase().
  virtual Result write(std::uint8_t slot, std::size_t offset, std::span<const std::uint8_t> in) noexcept = 0;
  /// What was written survives a power cut from now on.
  virtual Result flush(std::uint8_t slot) noexcept = 0;

 protected:
  ~StoragePort() = default;
};

/// Values as 2190h:01 shows them.
enum class StorageState : std::uint8_t { none, reading, empty, good, writing, torn, refused, write_failed };

/// CRC-32 (IEEE), in pieces: crc32_more(crc32_more(kCrc32Start, a), b), then its complement.
inline constexpr std::uint32_t kCrc32Start = 0xFFFF'FFFFU;
constexpr std::uint32_t crc32_more(std::uint32_t crc, std::span<const std::uint8_t> bytes) noexcept {
  for (const std::uint8_t b : bytes) {
    crc ^= b;
    for (int k = 0; k < 8; ++k) crc = (crc >> 1U) ^ ((crc & 1U) ? 0xEDB88320U : 0U);
  }
  return crc;
}

/// Slot layout, little-endian: magic u32, layout u16, node id u8, 0 u8, version u32, schema u32 (2000h), length u32;
/// then `length` bytes of entries (index u16, sub u8, size u8, value); then CRC-32 of all before it.
inline constexpr std::uint32_t kStorageMagic = 0x3150524D;  // "MRP1"
inline constexpr std::uint16_t kStorageLayout = 2;
inline constexpr std::size_t kStorageHeaderBytes = 20;

/// Bytes that a slot needs.
inline constexpr std::size_t kSlotBytes = [] {
  std::size_t n = kStorageHeaderBytes + 4;
  for (const Entry& e : kEntries) n += (e.flags & kStored) ? 4U + e.size : 0U;
  return n;
}();

/// Stored objects that are not part of the plan: a name, a node id, and what calibrations find. Communication objects
/// that a master sets at each start do not count either.
constexpr bool counts_for_configuration(const Entry& e) noexcept {
  if ((e.flags & kStored) == 0) return false;
  if (e.index < 0x1400) return false;
  return e.index != 0x2004 && e.index != 0x2180 && e.index != 0x2191;
}

/// `planned`, the hash of a configuration, once more with every stored object that differs from `configured`.
[[nodiscard]] std::uint32_t hash_with_changes(std::uint32_t planned, const ObjectDictionary& configured,
                                              const ObjectDictionary& now) noexcept;

class ParameterStore {
 public:
  /// Before the first tick, so it may wait for the memory. What was stored last is written to `od`, all or nothing.
  /// `node_id`: of this module; COB-IDs that were stored under another one follow it.
  void load(StoragePort& port, ObjectDictionary& od, std::uint8_t node_id) noexcept;

  /// Begins to store all of `od` that is marked so, or, with `od` null, that nothing is stored.
  /// False: there is no memory, or it is busy.
  bool begin_write(const ObjectDictionary* od, std::uint8_t node_id) noexcept;
  /// One small step of a write, at most StoragePort::kStepBytes.
  void tick() noexcept;

  [[nodiscard]] StorageState state() const noexcept { return state_; }
  [[nodiscard]] bool has_memory() const noexcept { return port_ != nullptr; }
  /// The last change was lost, a write failed: to be reported until a write succeeds.
  [[nodiscard]] bool lost_something() const noexcept {
    return state_ == StorageState::torn || state_ == StorageState::write_failed;
  }
  [[nodiscard]] std::uint32_t version() const noexcept { return version_; }
  [[nodiscard]] std::uint8_t slot() const noexcept { return slot_; }
  [[nodiscard]] std::uint16_t migrated() const noexcept { return migrated_; }
  /// index << 8 | sub of the first object that was refused; 0: none, or both slots are damaged.
  [[nodiscard]] std::uint32_t refused_object() const noexcept { return refused_; }

 private:
  enum class Finding : std::uint8_t { empty, damaged, whole };
  enum class Step : std::uint8_t { erase, header, entries, end, flush, verify };
  struct Header {
    std::uint32_t version = 0;
    std::uint32_t schema = 0;
    std::uint32_t length = 0;
    std::uint8_t node_id = 0;
  };
  [[nodiscard]] bool read_all(std::uint8_t slot, std::size_t offset, std::span<std::uint8_t> out) noexcept;
  [[nodiscard]] Finding examine(std::uint8_t slot, Header& header) noexcept;
  [[nodiscard]] bool take_over(std::uint8_t slot, const Header& header, ObjectDictionary& od, std::uint8_t node_id,
                               bool apply) noexcept;
  [[nodiscard]] std::span<const std::uint8_t> next_piece() noexcept;
  void fail() noexcept { state_ = StorageState::write_failed; }

  StoragePort* port_ = nullptr;
  StorageState state_ = StorageState::none;
  std::uint32_t version_ = 0;
  std::uint8_t slot_ = 1;  ///< so that the first write goes to slot 0
  std::uint16_t migrated_ = 0;
  std::uint32_t refused_ = 0;

  // A write on its way.
  ObjectDictionary snapshot_;
  bool nothing_ = false;
  std::uint8_t target_ = 0;
  std::uint8_t node_id_ = 0;
  Step step_ = Step::erase;
  std::size_t offset_ = 0;
  std::size_t length_ = 0;
  std::size_t entry_ = 0;
  std::uint32_t crc_ = kCrc32Start;
  std::uint32_t written_crc_ = 0;
  std::array<std::uint8_t, StoragePort::kStepBytes> piece_{};
  std::size_t piece_size_ = 0;  ///< not yet accepted by the port
};

}  // namespace mrr::can
