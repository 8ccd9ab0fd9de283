// Room: module_fw/targets/host. The memory behind 1010h as a file: two slots. Host only.
// May touch can_protocol/storage.h.
#pragma once

#include <atomic>
#include <string>
#include <thread>

#include "can_protocol/storage.h"

namespace mrr::fw {

/// Reads and writes go to the page cache; a thread of its own brings them to the disk, so that no tick waits for it.
class FileStore final : public can::StoragePort {
 public:
  /// Opens or creates the file, for this process alone. Throws std::system_error, naming it.
  explicit FileStore(const std::string& path);
  ~FileStore();
  FileStore(const FileStore&) = delete;
  FileStore& operator=(const FileStore&) = delete;

  Result read(std::uint8_t slot, std::size_t offset, std::span<std::uint8_t> out) noexcept override;
  Result erase(std::uint8_t slot) noexcept override;
  Result write(std::uint8_t slot, std::size_t offset, std::span<const std::uint8_t> in) noexcept override;
  Result flush(std::uint8_t slot) noexcept override;

  static constexpr std::size_t kSlotDistance = 32768;  ///< of the slots' starts in the file
  static_assert(can::kSlotBytes <= kSlotDistance);

 private:
  enum class Sync : int { idle, wanted, done, failed, end };
  void bring_to_disk() noexcept;

  int file_;
  std::atomic<Sync> sync_{Sync::idle};
  std::thread thread_;
};

}  // namespace mrr::fw
