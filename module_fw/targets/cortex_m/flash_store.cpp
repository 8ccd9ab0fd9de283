#include "module_fw/targets/cortex_m/flash_store.h"

namespace mrr::fw {

FlashStore::Result FlashStore::settled() noexcept {
  switch (flash_.state()) {
    case Flash::State::idle:
      return Result::done;
    case Flash::State::busy:
      return Result::busy;
    case Flash::State::failed:
      break;
  }
  page_ = taken_ = 0;
  return Result::failed;
}

FlashStore::Result FlashStore::read(std::uint8_t slot, std::size_t offset, std::span<std::uint8_t> out) noexcept {
  const Result flash = settled();
  if (flash == Result::busy) return flash;
  const std::span<const std::uint8_t> all = flash_.bytes();
  const std::size_t at = start_of(slot) + offset;
  if (at > all.size() || out.size() > all.size() - at) return Result::failed;
  std::copy_n(all.begin() + static_cast<std::ptrdiff_t>(at), out.size(), out.begin());
  return Result::done;
}

FlashStore::Result FlashStore::erase(std::uint8_t slot) noexcept {
  if (const Result flash = settled(); flash != Result::done) return flash;
  const std::size_t pages = slot_pages(flash_.page_bytes());
  if (page_ == pages) {
    page_ = taken_ = end_ = 0;
    return Result::done;
  }
  flash_.erase(slot * pages + page_++);
  return Result::busy;
}

FlashStore::Result FlashStore::write(std::uint8_t slot, std::size_t offset, std::span<const std::uint8_t> in) noexcept {
  if (const Result flash = settled(); flash != Result::done) return flash;
  while (taken_ < in.size()) {
    word_[(offset + taken_) % Flash::kWordBytes] = in[taken_];
    ++taken_;
    end_ = offset + taken_;
    if (end_ % Flash::kWordBytes == 0) {
      flash_.program(start_of(slot) + end_ - Flash::kWordBytes, word_);
      if (taken_ < in.size()) return Result::busy;
    }
  }
  taken_ = 0;
  return Result::done;
}

FlashStore::Result FlashStore::flush(std::uint8_t slot) noexcept {
  if (const Result flash = settled(); flash != Result::done) return flash;
  const std::size_t rest = end_ % Flash::kWordBytes;
  if (rest == 0) return Result::done;
  std::fill(word_.begin() + static_cast<std::ptrdiff_t>(rest), word_.end(), std::uint8_t{0xFF});
  flash_.program(start_of(slot) + end_ - rest, word_);
  end_ += Flash::kWordBytes - rest;
  return Result::busy;
}

}  // namespace mrr::fw
