// A microcontroller's flash behind 1010h: pages and double words, each a step that takes its time; the power cut at
// every one of them.
#include "module_fw/targets/cortex_m/flash_store.h"

#include <gtest/gtest.h>

#include <utility>
#include <vector>

namespace mrr::fw {
namespace {

using can::StorageState;

/// NOR flash: a word is programmed once after its page was erased; every step is busy for a while.
class EmulatedFlash final : public Flash {
 public:
  explicit EmulatedFlash(std::size_t page_bytes)
      : page_bytes_(page_bytes), memory_(2 * FlashStore::slot_pages(page_bytes) * page_bytes, 0xFF) {}
  [[nodiscard]] std::span<const std::uint8_t> bytes() const noexcept override { return memory_; }
  [[nodiscard]] std::size_t page_bytes() const noexcept override { return page_bytes_; }
  [[nodiscard]] State state() noexcept override {
    if (failed) return std::exchange(failed, false), State::failed;
    if (busy_ == 0) return State::idle;
    --busy_;
    return State::busy;
  }
  void erase(std::size_t page) noexcept override {
    if (!step(20)) return;
    std::fill_n(memory_.begin() + static_cast<long>(page * page_bytes_), page_bytes_, std::uint8_t{0xFF});
  }
  void program(std::size_t offset, const Word& word) noexcept override {
    if (!step(1)) return;
    EXPECT_EQ(offset % kWordBytes, 0U);
    for (std::size_t i = 0; i < word.size(); ++i) {
      EXPECT_EQ(memory_[offset + i], 0xFF) << "programmed twice, offset " << offset;
      memory_[offset + i] = word[i];
    }
  }
  long steps_left = -1;  ///< until the power goes; -1: it stays
  long steps = 0;
  bool failed = false;

 private:
  bool step(int busy) {
    EXPECT_EQ(busy_, 0) << "a step before the last one had ended";
    busy_ = busy;
    if (steps_left == 0) return false;
    if (steps_left > 0) --steps_left;
    ++steps;
    return true;
  }
  std::size_t page_bytes_;
  std::vector<std::uint8_t> memory_;
  int busy_ = 0;
};

can::ObjectDictionary with(std::uint32_t deceleration) {
  can::ObjectDictionary od;
  od.quick_stop_deceleration_mrad_s2 = deceleration;
  return od;
}
StorageState store(Flash& flash, std::uint32_t deceleration) {
  FlashStore port(flash);
  can::ParameterStore parameters;
  can::ObjectDictionary old;
  parameters.load(port, old, 2);
  const can::ObjectDictionary od = with(deceleration);
  EXPECT_TRUE(parameters.begin_write(&od, 2));
  for (int i = 0; i < 100'000 && parameters.state() == StorageState::writing; ++i) parameters.tick();
  return parameters.state();
}
std::uint32_t stored(Flash& flash, StorageState& state) {
  FlashStore port(flash);
  can::ParameterStore parameters;
  can::ObjectDictionary od;
  parameters.load(port, od, 2);
  state = parameters.state();
  return od.quick_stop_deceleration_mrad_s2;
}

TEST(FlashStore, KeepsParametersInSlotsOfWholePages) {
  for (const std::size_t page : {512U, 2048U, 4096U, 131072U}) {
    EmulatedFlash flash(page);
    StorageState state{};
    for (const std::uint32_t value : {11U, 22U, 33U}) {
      EXPECT_EQ(store(flash, value), StorageState::good) << page;
      EXPECT_EQ(stored(flash, state), value) << page;
      EXPECT_EQ(state, StorageState::good);
    }
  }
}

TEST(FlashStore, APowerCutAtEveryStepLosesAtMostTheLastChange) {
  EmulatedFlash start(2048);
  store(start, 11);
  store(start, 22);
  EmulatedFlash whole = start;
  whole.steps = 0;
  store(whole, 33);
  const long steps = whole.steps;
  ASSERT_GT(steps, 100);
  int torn = 0;
  for (long cut = 0; cut < steps; ++cut) {
    EmulatedFlash flash = start;
    flash.steps_left = cut;
    store(flash, 33);
    flash.steps_left = -1;
    StorageState state{};
    EXPECT_EQ(stored(flash, state), 22U) << cut;
    if (cut > 0) {
      EXPECT_EQ(state, StorageState::torn) << cut << ": not reported";
    }
    torn += state == StorageState::torn ? 1 : 0;
    EXPECT_EQ(store(flash, 44), StorageState::good) << "the next one mends it";
    EXPECT_EQ(stored(flash, state), 44U);
  }
  EXPECT_EQ(torn, steps - 1);
}

TEST(FlashStore, AStepThatFailsIsAWriteThatFailed) {
  EmulatedFlash flash(2048);
  store(flash, 11);
  FlashStore port(flash);
  can::ParameterStore parameters;
  can::ObjectDictionary old;
  parameters.load(port, old, 2);
  const can::ObjectDictionary od = with(22);
  ASSERT_TRUE(parameters.begin_write(&od, 2));
  for (int i = 0; i < 200; ++i) parameters.tick();
  ASSERT_EQ(parameters.state(), StorageState::writing);
  flash.failed = true;
  for (int i = 0; i < 100'000 && parameters.state() == StorageState::writing; ++i) parameters.tick();
  EXPECT_EQ(parameters.state(), StorageState::write_failed);
  StorageState state{};
  EXPECT_EQ(stored(flash, state), 11U);
}

}  // namespace
}  // namespace mrr::fw
