// A million random frames, more or less likely to be nearly right, against a reference that knows only who may change
// what.

#include "common/core/random.h"
#include "node_fixture.h"

namespace mrr::can {
namespace {

struct Storm : NodeTest {
  void TestBody() override {}
  using NodeTest::app;
  using NodeTest::node;
  using NodeTest::now;
  using NodeTest::od;
};

Frame random_frame(Random& random, bool with_nmt) {
  Frame f;
  const std::uint32_t ids[] = {0x080,       0x181,       0x200 + kId, 0x300 + kId, 0x400 + kId,
                               0x600 + kId, 0x600 + kId, 0x701,       0x600 + kId};
  f.id = random.below(4) != 0 ? ids[random.below(std::size(ids))]
                              : static_cast<std::uint32_t>(random.below(random.below(8) == 0 ? 0x20000000 : 0x800));
  if (!with_nmt && f.id == 0) f.id = 1;
  f.extended = f.id > 0x7FF || random.below(32) == 0;
  f.remote = random.below(32) == 0;
  f.fd = random.below(64) == 0;
  f.length = static_cast<std::uint8_t>(random.below(16) == 0  ? random.below(256)
                                       : random.below(3) == 0 ? random.below(9)
                                                              : 8);
  for (auto& b : f.data) b = static_cast<std::uint8_t>(random.next());
  if (f.id == 0x600 + kId && random.below(4) != 0) {
    // A likely command and an object that exists.
    const int commands[] = {0x40, 0x60, 0x70, 0x2F, 0x2B, 0x27, 0x23, 0x22, 0x21, 0x20, 0x00, 0x10, 0x01, 0x11, 0x80};
    const Entry& e = kEntries[random.below(kEntryCount)];
    f.data[0] = static_cast<std::uint8_t>(commands[random.below(std::size(commands))] |
                                          (random.below(8) == 0 ? random.below(32) : 0));
    put<std::uint16_t>(f.data.data() + 1, e.index);
    f.data[3] = e.sub;
    if (random.below(2) == 0) {
      for (std::size_t i = 5; i < 8; ++i) f.data[i] = 0;
    }
  }
  return f;
}

bool same(const ObjectDictionary& a, const ObjectDictionary& b, const Entry& e) {
  return std::memcmp(reinterpret_cast<const char*>(&a) + e.offset, reinterpret_cast<const char*>(&b) + e.offset,
                     e.size) == 0;
}

/// What the node itself keeps: counters, error register and history.
bool is_the_nodes_own(const Entry& e) { return e.index == 0x2040 || e.index == 0x1001 || e.index == 0x1003; }

TEST(RandomFrames, never_change_a_read_only_object_nor_leave_a_value_out_of_its_limits) {
  for (const std::uint64_t seed : {1U, 2U, 3U, 4U}) {
    Storm s;
    Random random(seed);
    TransmitQueue tx;
    s.node.tick(s.now, tx);
    const ObjectDictionary first = s.od;
    std::size_t accepted = 0;
    for (int i = 0; i < 250'000; ++i) {
      tx.clear();
      s.now += microseconds(static_cast<std::int64_t>(random.below(500)));
      s.node.handle({random_frame(random, true), s.now}, tx);
      ASSERT_LE(tx.size(), 1U + kTpdoCount) << "answers to one frame are few";
      if (i % 4 == 0) {
        tx.clear();
        s.node.tick(s.now, tx);
        ASSERT_LE(tx.size(), 8U);
      }
      for (const Frame& f : tx) {
        ASSERT_LE(f.length, 8);
        ASSERT_LE(f.id, 0x7FFU);
      }
      if (i % 1000 == 0) {
        for (const Entry& e : kEntries) {
          if (is_the_nodes_own(e)) continue;
          if (!(e.flags & kWritable)) {
            ASSERT_TRUE(same(first, s.od, e)) << std::hex << e.index << ":" << int{e.sub};
          }
          ASSERT_EQ(check_value(e, read_value(s.od, e)), Abort::none) << std::hex << e.index << ":" << int{e.sub};
        }
      }
      accepted += s.app.writes.size();
      s.app.writes.clear();
      s.app.pdos.clear();
      s.app.syncs.clear();
      s.app.states.clear();
    }
    EXPECT_GT(accepted, 500U) << "the storm reaches the objects";
    EXPECT_TRUE(s.node.state() == NmtState::operational || s.node.state() == NmtState::pre_operational ||
                s.node.state() == NmtState::stopped);
  }
}

TEST(RandomFrames, without_nmt_a_node_never_becomes_operational_and_only_sdo_changes_objects) {
  Storm s;
  Random random(99);
  TransmitQueue tx;
  s.node.tick(s.now, tx);
  for (int i = 0; i < 250'000; ++i) {
    tx.clear();
    s.now += microseconds(static_cast<std::int64_t>(random.below(500)));
    const Frame f = random_frame(random, false);
    const ObjectDictionary before = s.od;
    s.node.handle({f, s.now}, tx);
    ASSERT_EQ(s.node.state(), NmtState::pre_operational);
    const bool plain = !f.extended && !f.remote && !f.fd && f.length == 8;
    if (!(plain && f.id == 0x600 + kId)) {
      ASSERT_TRUE(s.app.writes.empty());
      for (const Entry& e : kEntries) {
        ASSERT_TRUE(is_the_nodes_own(e) || same(before, s.od, e)) << std::hex << e.index;
      }
    } else {
      // At most one object, and one the client named or is in the middle of.
      ASSERT_LE(s.app.writes.size(), 1U);
    }
    s.app.writes.clear();
    s.app.syncs.clear();
  }
  EXPECT_TRUE(s.app.pdos.empty());
}

TEST(RandomFrames, an_sdo_write_changes_the_named_object_alone) {
  Storm s;
  Random random(5);
  TransmitQueue tx;
  s.node.tick(s.now, tx);
  int accepted = 0;
  for (int i = 0; i < 100'000; ++i) {
    tx.clear();
    const Entry& e = kEntries[random.below(kEntryCount)];
    Frame f = frame(0x600 + kId, {0x23, e.index & 0xFF, e.index >> 8, e.sub, 0, 0, 0, 0});
    f.data[0] = static_cast<std::uint8_t>(0x23U | (random.below(4) << 2U));
    for (std::size_t b = 4; b < 8; ++b) f.data[b] = static_cast<std::uint8_t>(random.below(2) == 0 ? 0 : random.next());
    const ObjectDictionary before = s.od;
    s.node.handle({f, s.now}, tx);
    ASSERT_EQ(tx.size(), 1U);
    const bool ok = tx[0].data[0] == 0x60;
    accepted += ok;
    for (const Entry& other : kEntries) {
      if (is_the_nodes_own(other) || (ok && &other == &e)) continue;
      ASSERT_TRUE(same(before, s.od, other)) << std::hex << other.index << " after " << e.index;
    }
    s.app.writes.clear();
  }
  EXPECT_GT(accepted, 3000);
}

TEST(RandomFrames, the_same_seed_gives_the_same_answers) {
  std::array<std::uint64_t, 2> hash{};
  for (auto& h : hash) {
    Storm s;
    Random random(11);
    for (int i = 0; i < 50'000; ++i) {
      TransmitQueue tx;
      s.now += microseconds(100);
      s.node.tick(s.now, tx);
      s.node.handle({random_frame(random, true), s.now}, tx);
      for (const Frame& f : tx) {
        h = h * 1099511628211U + f.id;
        for (std::size_t b = 0; b < f.length; ++b) h = h * 1099511628211U + f.data[b];
      }
    }
  }
  EXPECT_EQ(hash[0], hash[1]);
}

}  // namespace
}  // namespace mrr::can
