// 1010h and what it keeps: two slots, a power cut at every byte, older layouts, refused values, the hash on the wire.
#include "can_protocol/storage.h"

#include <gtest/gtest.h>

#include <vector>

#include "can_protocol/codec.h"
#include "can_protocol/object_access.h"
#include "common/core/random.h"
#include "module_fw/module.h"
#include "tests/unit/module/module_bench.h"
#include "tests/unit/module/seeds.h"

namespace mrr::fw {
namespace {

using can::StorageState;

/// A memory whose power goes after `bytes_left` bytes; every second call is busy first.
class Memory final : public can::StoragePort {
 public:
  std::array<std::vector<std::uint8_t>, 2> slot{std::vector<std::uint8_t>(2 * can::kSlotBytes, 0xFF),
                                                std::vector<std::uint8_t>(2 * can::kSlotBytes, 0xFF)};
  long bytes_left = -1;  ///< -1: the power stays
  bool broken = false;
  std::size_t written = 0;
  std::size_t largest_step = 0;

  Result read(std::uint8_t s, std::size_t offset, std::span<std::uint8_t> out) noexcept override {
    if (busy()) return Result::busy;
    std::copy_n(slot[s].begin() + static_cast<long>(offset), out.size(), out.begin());
    return Result::done;
  }
  Result erase(std::uint8_t s) noexcept override {
    if (busy()) return Result::busy;
    for (auto& b : slot[s]) put(b, 0xFF);
    return broken ? Result::failed : Result::done;
  }
  Result write(std::uint8_t s, std::size_t offset, std::span<const std::uint8_t> in) noexcept override {
    if (busy()) return Result::busy;
    largest_step = std::max(largest_step, in.size());
    for (std::size_t i = 0; i < in.size(); ++i) put(slot[s][offset + i], in[i]);
    return broken ? Result::failed : Result::done;
  }
  Result flush(std::uint8_t) noexcept override { return busy() ? Result::busy : Result::done; }

 private:
  bool busy() { return (++calls_ % 2) == 0; }
  void put(std::uint8_t& to, std::uint8_t value) {
    if (bytes_left == 0) return;
    if (bytes_left > 0) --bytes_left;
    to = value;
    ++written;
  }
  int calls_ = 0;
};

void write_all(can::ParameterStore& store) {
  for (int i = 0; i < 100'000 && store.state() == StorageState::writing; ++i) store.tick();
}
can::ObjectDictionary with(std::uint32_t deceleration) {
  can::ObjectDictionary od;
  od.quick_stop_deceleration_mrad_s2 = deceleration;
  od.module_name = {'h', 'i'};
  od.controlword = 15;
  return od;
}
void store_into(Memory& memory, const can::ObjectDictionary& what, std::uint8_t node_id = 2) {
  can::ParameterStore store;
  can::ObjectDictionary old;
  store.load(memory, old, node_id);
  ASSERT_TRUE(store.begin_write(&what, node_id));
  write_all(store);
}
/// Rewrites the entry of `index` in the newest slot with `change`, CRC included.
void tamper(std::vector<std::uint8_t>& slot, const std::function<void(std::vector<std::uint8_t>&)>& change) {
  change(slot);
  const std::size_t end = can::kStorageHeaderBytes + can::get<std::uint32_t>(slot.data() + 16);
  can::put<std::uint32_t>(slot.data() + end, ~can::crc32_more(can::kCrc32Start, std::span(slot).first(end)));
}
std::size_t place_of(const std::vector<std::uint8_t>& slot, std::uint16_t index, std::uint8_t sub) {
  for (std::size_t at = can::kStorageHeaderBytes; at < slot.size(); at += 4U + slot[at + 3]) {
    if (can::get<std::uint16_t>(slot.data() + at) == index && slot[at + 2] == sub) return at;
  }
  return 0;
}

TEST(Storage, KeepsWhatIsMarkedStoredAndNothingElseInSmallSteps) {
  Memory memory;
  store_into(memory, with(777));
  EXPECT_LE(memory.largest_step, can::StoragePort::kStepBytes);
  can::ObjectDictionary od;
  can::ParameterStore store;
  store.load(memory, od, 2);
  EXPECT_EQ(store.state(), StorageState::good);
  EXPECT_EQ(store.version(), 1U);
  EXPECT_EQ(od.quick_stop_deceleration_mrad_s2, 777U);
  EXPECT_STREQ(od.module_name.data(), "hi");
  EXPECT_EQ(od.controlword, 0);
}

TEST(Storage, SlotsAlternateAndTheNewestCounts) {
  Memory memory;
  for (std::uint32_t i = 1; i <= 5; ++i) store_into(memory, with(100 * i));
  can::ObjectDictionary od;
  can::ParameterStore store;
  store.load(memory, od, 2);
  EXPECT_EQ(store.version(), 5U);
  EXPECT_EQ(store.slot(), 0U);
  EXPECT_EQ(od.quick_stop_deceleration_mrad_s2, 500U);
}

TEST(Storage, APowerCutAtEveryByteLosesAtMostTheLastChangeAndIsReported) {
  Memory before;
  store_into(before, with(100));
  store_into(before, with(200));
  Memory whole = before;
  whole.written = 0;
  store_into(whole, with(300));
  const auto bytes = static_cast<long>(whole.written);
  ASSERT_GT(bytes, 1000);
  int kept = 0;
  int lost = 0;
  for (long cut = 0; cut <= bytes; ++cut) {
    Memory memory = before;
    memory.bytes_left = cut;
    store_into(memory, with(300));
    memory.bytes_left = -1;
    can::ObjectDictionary od;
    can::ParameterStore store;
    store.load(memory, od, 2);
    const std::uint32_t value = od.quick_stop_deceleration_mrad_s2;
    if (value == 300U) {
      ++kept;
      EXPECT_EQ(store.state(), StorageState::good);
    } else {
      ++lost;
      ASSERT_EQ(value, 200U) << "cut after " << cut << " bytes";
      // Before the first byte of the header changes nothing has happened; from then on it is said.
      if (cut > 0) {
        ASSERT_EQ(store.state(), StorageState::torn) << "cut after " << cut << " bytes";
      }
    }
    // And the next store heals it.
    if (cut % 97 == 0) {
      store_into(memory, with(400));
      can::ParameterStore again;
      again.load(memory, od, 2);
      ASSERT_EQ(again.state(), StorageState::good);
      ASSERT_EQ(od.quick_stop_deceleration_mrad_s2, 400U);
    }
  }
  EXPECT_GE(kept, 1);
  EXPECT_GT(lost, 1000);
}

/// Every stored object that is not a COB-ID with any value that it takes.
can::ObjectDictionary anything(Random& random) {
  can::ObjectDictionary od;
  for (const can::Entry& entry : can::kEntries) {
    if ((entry.flags & can::kStored) == 0 || entry.type == can::Type::string || entry.index < 0x2000) continue;
    for (int attempt = 0; attempt < 40; ++attempt) {
      can::Value v;
      v.size = static_cast<std::uint8_t>(entry.size);
      const std::uint64_t bits = random.next() >> random.below(64);
      std::memcpy(v.bytes.data(), &bits, 8);
      if (entry.type == can::Type::f32) {
        const auto x = static_cast<float>(random.uniform());
        std::memcpy(v.bytes.data(), &x, 4);
      }
      if (can::check_value(entry, v) != can::Abort::none) continue;
      can::write_value(od, entry, v);
      break;
    }
  }
  return od;
}
/// The stored objects.
std::vector<std::uint8_t> picture(const can::ObjectDictionary& od) {
  std::vector<std::uint8_t> bytes;
  for (const can::Entry& entry : can::kEntries) {
    if ((entry.flags & can::kStored) == 0) continue;
    const can::Value v = can::read_value(od, entry);
    bytes.insert(bytes.end(), v.bytes.begin(), v.bytes.begin() + v.size);
  }
  return bytes;
}

TEST(Storage, APowerCutAnywhereLeavesTheLastChangeOrTheOneBeforeWhateverTheContents) {
  for (const std::uint64_t seed : mrr::test::seeds(2)) {
    Random random(seed);
    Memory before;
    store_into(before, anything(random));
    const can::ObjectDictionary old = anything(random);
    const can::ObjectDictionary wanted = anything(random);
    ASSERT_NE(picture(old), picture(wanted));
    store_into(before, old);
    Memory whole = before;
    whole.written = 0;
    store_into(whole, wanted);
    int lost = 0;
    for (long cut = 0; cut <= static_cast<long>(whole.written); ++cut) {
      Memory memory = before;
      memory.bytes_left = cut;
      store_into(memory, wanted);
      memory.bytes_left = -1;
      can::ObjectDictionary od;
      can::ParameterStore store;
      store.load(memory, od, 2);
      const auto found = picture(od);
      if (found == picture(wanted)) {
        ASSERT_EQ(store.state(), StorageState::good);
        continue;
      }
      ++lost;
      ASSERT_EQ(found, picture(old)) << "seed " << seed << ", cut after " << cut << " bytes";
      ASSERT_TRUE(cut == 0 || store.state() == StorageState::torn) << "seed " << seed << ", cut after " << cut;
    }
    EXPECT_GT(lost, 1000);
  }
}

TEST(Storage, ACutInTheVeryFirstWriteLeavesTheConfiguredValues) {
  for (const long cut :
       {1L, 20L, static_cast<long>(2 * can::kSlotBytes + 10), static_cast<long>(3 * can::kSlotBytes - 100)}) {
    Memory memory;
    memory.bytes_left = cut;
    store_into(memory, with(300));
    memory.bytes_left = -1;
    can::ObjectDictionary od;
    can::ParameterStore store;
    store.load(memory, od, 2);
    EXPECT_EQ(od.quick_stop_deceleration_mrad_s2, 20000U);
    EXPECT_NE(store.state(), StorageState::good);
  }
}

TEST(Storage, AnyWrongBitIsFound) {
  Memory memory;
  store_into(memory, with(200));
  const std::size_t used = can::kStorageHeaderBytes + can::get<std::uint32_t>(memory.slot[0].data() + 16) + 4;
  for (std::size_t bit = 0; bit < 8 * used; bit += 3) {
    Memory spoiled = memory;
    spoiled.slot[0][bit / 8] ^= static_cast<std::uint8_t>(1U << (bit % 8));
    can::ObjectDictionary od;
    can::ParameterStore store;
    store.load(spoiled, od, 2);
    ASSERT_EQ(od.quick_stop_deceleration_mrad_s2, 20000U);
    ASSERT_EQ(store.state(), StorageState::torn);
  }
}

TEST(Storage, TwoDamagedSlotsAreRefusedLoudly) {
  Memory memory;
  store_into(memory, with(200));
  store_into(memory, with(300));
  memory.slot[0][30] ^= 1;
  memory.slot[1][30] ^= 1;
  can::ObjectDictionary od;
  can::ParameterStore store;
  store.load(memory, od, 2);
  EXPECT_EQ(store.state(), StorageState::refused);
  EXPECT_EQ(od.quick_stop_deceleration_mrad_s2, 20000U);
}

TEST(Storage, AValueOutOfRangeRefusesTheSlotAndNamesTheObject) {
  Memory memory;
  store_into(memory, with(200));
  tamper(memory.slot[0], [](auto& s) { can::put<std::uint32_t>(s.data() + place_of(s, 0x2003, 0) + 4, 10); });
  can::ObjectDictionary od;
  can::ParameterStore store;
  store.load(memory, od, 2);
  EXPECT_EQ(store.state(), StorageState::refused);
  EXPECT_EQ(store.refused_object(), 0x200300U);
  EXPECT_EQ(od.quick_stop_deceleration_mrad_s2, 20000U) << "all or nothing";
}

TEST(Storage, AnOlderSchemaIsMigratedAndSaysHowMuchItLeftOut) {
  Memory memory;
  store_into(memory, with(200));
  const auto rename = [](std::vector<std::uint8_t>& s) {
    can::put<std::uint16_t>(s.data() + place_of(s, 0x2003, 0), 0x2FFE);  // an object that is no more
  };
  Memory older = memory;
  tamper(older.slot[0], [&](auto& s) {
    rename(s);
    can::put<std::uint32_t>(s.data() + 12, can::kProtocolHash + 1);
  });
  can::ObjectDictionary od;
  can::ParameterStore store;
  store.load(older, od, 2);
  EXPECT_EQ(store.state(), StorageState::good);
  EXPECT_EQ(store.migrated(), 1);
  EXPECT_EQ(od.quick_stop_deceleration_mrad_s2, 200U);
  EXPECT_EQ(od.knot_period_us, 4000U);
  // Of this very schema it cannot be.
  tamper(memory.slot[0], rename);
  can::ObjectDictionary other;
  store.load(memory, other, 2);
  EXPECT_EQ(store.state(), StorageState::refused);
  EXPECT_EQ(other.quick_stop_deceleration_mrad_s2, 20000U);
}

TEST(Storage, AWriteThatFailsKeepsTheOldSlotAndSaysSo) {
  Memory memory;
  store_into(memory, with(200));
  can::ParameterStore store;
  can::ObjectDictionary od;
  store.load(memory, od, 2);
  memory.broken = true;
  const can::ObjectDictionary wanted = with(300);
  ASSERT_TRUE(store.begin_write(&wanted, 2));
  EXPECT_FALSE(store.begin_write(&wanted, 2)) << "one at a time";
  write_all(store);
  EXPECT_EQ(store.state(), StorageState::write_failed);
  EXPECT_TRUE(store.lost_something());
}

TEST(Storage, CobIdsFollowTheNodeId) {
  auto c = test::module_config(test::hammer_joint());
  c.node_id = 2;
  Memory memory;
  store_into(memory, Module(c).objects(), 2);
  can::ObjectDictionary od;
  can::ParameterStore store;
  store.load(memory, od, 5);
  EXPECT_EQ(od.rpdo_communication[0].cob_id, 0x205U);
  EXPECT_EQ(od.rpdo_communication[3].cob_id, 0x181U);
}

// ---- the module behind it ----

struct ModuleWithMemory : testing::Test {
  Memory memory;
  std::unique_ptr<test::ModuleBench> boot() {
    auto c = test::module_config(test::hammer_joint());
    c.configuration_hash = 0x12345678;
    auto b = std::make_unique<test::ModuleBench>(test::hammer_joint(), c);
    b->module.load_parameters(memory);
    b->run(0.01);
    return b;
  }
  static void save(test::ModuleBench& b) {
    b.write(0x1010, 1, 0x65766173, 4);
    b.run(1.0);
  }
};

TEST_F(ModuleWithMemory, AChangedStoredParameterIsInForceAfterAResetAndChangesTheHash) {
  auto first = boot();
  EXPECT_EQ(first->module.objects().storage_state, static_cast<int>(StorageState::empty));
  EXPECT_EQ(first->module.objects().configuration_hash, 0x12345678U);
  first->write(0x2120, 2, std::bit_cast<std::uint32_t>(20.0F), 4);
  save(*first);
  EXPECT_EQ(first->module.objects().storage_state, static_cast<int>(StorageState::good));
  const std::uint32_t changed = first->module.objects().configuration_hash;
  EXPECT_NE(changed, 0x12345678U) << "the supervisor must not take it for the module it planned with";

  auto second = boot();
  EXPECT_FLOAT_EQ(second->module.objects().limit_torque_nm, 20.0F);
  EXPECT_EQ(second->module.objects().configuration_hash, changed);
  ASSERT_TRUE(second->enable());
  // Not while it is led.
  second->write(0x1010, 1, 0x65766173, 4);
  EXPECT_EQ(second->module.objects().storage_version, 1U);
  second->command(0x06);
  second->run(0.3);
  second->write(0x1011, 1, 0x64616F6C, 4);
  second->run(1.0);
  EXPECT_FLOAT_EQ(second->module.objects().limit_torque_nm, 20.0F) << "until the reset";
  second->receive(can::nmt_frame(can::NmtCommand::reset_node, second->config.node_id));
  second->run(0.1);
  EXPECT_FLOAT_EQ(second->module.objects().limit_torque_nm, second->config.limits.torque_nm);
  EXPECT_EQ(second->module.objects().configuration_hash, 0x12345678U);
  auto third = boot();
  EXPECT_FLOAT_EQ(third->module.objects().limit_torque_nm, third->config.limits.torque_nm);
  EXPECT_EQ(third->module.objects().configuration_hash, 0x12345678U);
}

TEST_F(ModuleWithMemory, WhatASupervisorSetsAtEachStartAndWhatCalibrationFindsDoNotChangeTheHash) {
  auto b = boot();
  b->write(0x1017, 0, 50, 2);
  b->write(0x2180, 3, std::bit_cast<std::uint32_t>(0.7F), 4);
  save(*b);
  EXPECT_EQ(b->module.objects().configuration_hash, 0x12345678U);
  EXPECT_FLOAT_EQ(boot()->module.objects().torque_sensor_offset_nm, 0.7F);
}

TEST_F(ModuleWithMemory, ANodeIdThatLssStoredIsInForceFromTheNextStart) {
  auto b = boot();
  b->write(0x2120, 2, std::bit_cast<std::uint32_t>(20.0F), 4);  // written, not stored
  const auto lss = [&](std::uint8_t command, std::uint8_t value) -> std::optional<int> {
    can::Frame f;
    f.id = can::kLssRequestCobId;
    f.length = 8;
    f.data[0] = command;
    f.data[1] = value;
    b->sent.clear();
    b->receive(f);
    b->tick();
    for (const can::Frame& answer : b->sent) {
      if (answer.id == can::kLssAnswerCobId && answer.data[0] == command) return answer.data[1];
    }
    return std::nullopt;
  };
  b->receive(can::nmt_frame(can::NmtCommand::enter_pre_operational, 0));
  b->run(0.01);
  lss(0x04, 1);
  EXPECT_EQ(lss(0x11, 77), 0);
  EXPECT_EQ(lss(0x17, 0), 0);
  EXPECT_EQ(lss(0x17, 0), 2) << "the memory is busy";
  b->run(1.0);
  EXPECT_EQ(b->module.objects().storage_state, static_cast<int>(StorageState::good));

  auto after = boot();
  EXPECT_EQ(after->module.objects().stored_node_id, 77);
  EXPECT_EQ(after->module.objects().sdo_server_cob_id_receive, 0x600U + 77);
  EXPECT_EQ(after->module.objects().tpdo_communication[0].cob_id & 0x7FFU, 0x180U + 77);
  EXPECT_TRUE(std::any_of(after->sent.begin(), after->sent.end(),
                          [](const can::Frame& f) { return f.id == can::kHeartbeatCobId + 77; }));
  EXPECT_FALSE(std::any_of(after->sent.begin(), after->sent.end(),
                           [&](const can::Frame& f) { return f.id == can::kHeartbeatCobId + after->config.node_id; }));
  EXPECT_EQ(after->module.objects().configuration_hash, 0x12345678U) << "a name is no configuration";
  EXPECT_FLOAT_EQ(after->module.objects().limit_torque_nm, after->config.limits.torque_nm) << "the node id alone";
}

TEST_F(ModuleWithMemory, ATornWriteIsAWarningThatTheNextStoreTakesAway) {
  save(*boot());
  save(*boot());
  auto b = boot();
  b->write(0x1010, 1, 0x65766173, 4);
  memory.bytes_left = static_cast<long>(2 * can::kSlotBytes + 500);
  b->run(1.0);
  memory.bytes_left = -1;
  auto after = boot();
  EXPECT_EQ(after->module.objects().storage_state, static_cast<int>(StorageState::torn));
  EXPECT_EQ(after->module.objects().error_code, static_cast<int>(can::Emergency::storage));
  EXPECT_NE(after->module.objects().statusword & kStatusWarning, 0);
  EXPECT_EQ(after->status().fault, can::Emergency::none);
  save(*after);
  EXPECT_EQ(after->module.objects().storage_state, static_cast<int>(StorageState::good));
  EXPECT_EQ(after->module.objects().statusword & kStatusWarning, 0);
}

TEST_F(ModuleWithMemory, ARefusedSlotIsAFaultUntilItIsReset) {
  save(*boot());
  tamper(memory.slot[0], [](auto& s) { can::put<std::uint32_t>(s.data() + place_of(s, 0x2003, 0) + 4, 10); });
  auto b = boot();
  EXPECT_EQ(b->status().fault, can::Emergency::parameter);
  EXPECT_EQ(b->status().state, DriveState::fault);
  EXPECT_EQ(b->module.objects().storage_refused, 0x200300U);
  EXPECT_EQ(b->module.objects().knot_period_us, 4000U);
  b->receive(can::nmt_frame(can::NmtCommand::start, b->config.node_id));
  b->run(0.01);
  b->command(0x80);
  b->run(0.02);
  EXPECT_TRUE(b->enable());
}

}  // namespace
}  // namespace mrr::fw
