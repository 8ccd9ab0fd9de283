// Room: module_fw/targets/cortex_m. The memory behind 1010h in a microcontroller's flash: two slots of whole pages.
// May touch can_protocol/storage.h. Freestanding.
#pragma once

#include <array>
#include <cstdint>
#include <span>

#include "can_protocol/storage.h"

namespace mrr::fw {

/// Flash for the parameters as a board gives it: memory-mapped, erased by the page, each double word programmed once
/// after that. erase() and program() begin; state() says when they have ended. The core goes on meanwhile: the pages
/// are in a bank of their own, or the board lets the tick wait (1010h is refused while the joint is led).
class Flash {
 public:
  enum class State : std::uint8_t { idle, busy, failed };
  static constexpr std::size_t kWordBytes = 8;
  using Word = std::array<std::uint8_t, kWordBytes>;

  /// As many bytes as two slots of whole pages have.
  [[nodiscard]] virtual std::span<const std::uint8_t> bytes() const noexcept = 0;
  [[nodiscard]] virtual std::size_t page_bytes() const noexcept = 0;
  /// failed: of the last step; the next one begins anew.
  [[nodiscard]] virtual State state() noexcept = 0;
  virtual void erase(std::size_t page) noexcept = 0;
  /// `offset`: a multiple of kWordBytes.
  virtual void program(std::size_t offset, const Word& word) noexcept = 0;

 protected:
  ~Flash() = default;
};

/// One page or one double word at a time, so that a tick never waits for more.
class FlashStore final : public can::StoragePort {
 public:
  /// `flash` must outlive the store.
  explicit FlashStore(Flash& flash) noexcept : flash_(flash) {}

  Result read(std::uint8_t slot, std::size_t offset, std::span<std::uint8_t> out) noexcept override;
  Result erase(std::uint8_t slot) noexcept override;
  Result write(std::uint8_t slot, std::size_t offset, std::span<const std::uint8_t> in) noexcept override;
  Result flush(std::uint8_t slot) noexcept override;

  /// Pages that a slot takes.
  [[nodiscard]] static constexpr std::size_t slot_pages(std::size_t page_bytes) noexcept {
    return (can::kSlotBytes + page_bytes - 1) / page_bytes;
  }

 private:
  [[nodiscard]] std::size_t start_of(std::uint8_t slot) const noexcept {
    return slot * slot_pages(flash_.page_bytes()) * flash_.page_bytes();
  }
  /// What the flash does now; `busy` and `failed` as a port says them.
  [[nodiscard]] Result settled() noexcept;

  Flash& flash_;
  std::size_t page_ = 0;   ///< erasing: pages begun
  std::size_t taken_ = 0;  ///< of the span that is being written
  std::size_t end_ = 0;    ///< bytes of the slot written so far
  Flash::Word word_{};     ///< the last, incomplete one
};

}  // namespace mrr::fw
