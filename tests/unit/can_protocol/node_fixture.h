// A node on a bench: an application that notes what it is told, a clock turned by hand, frames in and out.
#pragma once

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <initializer_list>
#include <span>
#include <vector>

#include "can_protocol/node.h"

namespace mrr::can {

constexpr std::uint8_t kId = 5;

struct NotingApplication : NodeApplication {
  struct Write {
    ObjectId id;
    WriteSource source;
  };
  std::vector<Write> writes;
  std::vector<std::pair<std::uint8_t, Time>> pdos;
  std::vector<std::optional<std::uint8_t>> syncs;
  std::vector<SelectionCommand> selections;
  std::vector<NmtState> states;
  std::vector<ResetKind> resets;
  std::vector<std::uint8_t> lost;
  std::vector<std::uint8_t> seen;
  int stores = 0;
  int restores = 0;
  Abort verdict = Abort::none;        // on every write
  Abort store_verdict = Abort::none;  // on 1010h and 1011h

  Abort may_write(ObjectId, const Value&) noexcept override { return verdict; }
  void written(ObjectId id, WriteSource source, Time) noexcept override { writes.push_back({id, source}); }
  void pdo_delivered(std::uint8_t number, Time received) noexcept override { pdos.emplace_back(number, received); }
  void sync(Time, std::optional<std::uint8_t> counter) noexcept override { syncs.push_back(counter); }
  void selection(const SelectionCommand& c, Time) noexcept override { selections.push_back(c); }
  void nmt_changed(NmtState s, Time) noexcept override { states.push_back(s); }
  void reset(ResetKind k, Time) noexcept override { resets.push_back(k); }
  void heartbeat_lost(std::uint8_t n, Time) noexcept override { lost.push_back(n); }
  void heartbeat_seen(std::uint8_t n, NmtState, Time) noexcept override { seen.push_back(n); }
  Abort store(Time) noexcept override {
    ++stores;
    return store_verdict;
  }
  Abort restore_defaults(Time) noexcept override {
    ++restores;
    return store_verdict;
  }
};

inline Frame frame(std::uint32_t id, std::initializer_list<int> bytes) {
  Frame f;
  f.id = id;
  f.length = static_cast<std::uint8_t>(bytes.size());
  std::size_t i = 0;
  for (const int b : bytes) f.data[i++] = static_cast<std::uint8_t>(b);
  return f;
}

class NodeTest : public ::testing::Test {
 protected:
  explicit NodeTest(NodeConfig config = {.node_id = kId}) : node(od, config, app) {}

  /// Feeds one frame; returns what the node answers.
  std::vector<Frame> give(const Frame& f) {
    TransmitQueue tx;
    node.handle({f, now}, tx);
    return {tx.begin(), tx.end()};
  }
  std::vector<Frame> give(std::uint32_t id, std::initializer_list<int> bytes) { return give(frame(id, bytes)); }
  std::vector<Frame> nmt(NmtCommand c, std::uint8_t id = 0) { return give(nmt_frame(c, id)); }
  std::vector<Frame> sync() { return give(sync_frame(std::nullopt)); }
  std::vector<Frame> sync(int counter) { return give(sync_frame(static_cast<std::uint8_t>(counter))); }

  /// Lets time pass in ticks of a millisecond; returns all that was sent.
  std::vector<Frame> wait(int ms) {
    std::vector<Frame> all;
    for (int i = 0; i < ms; ++i) {
      now += milliseconds(1);
      TransmitQueue tx;
      node.tick(now, tx);
      all.insert(all.end(), tx.begin(), tx.end());
    }
    return all;
  }
  std::vector<Frame> boot() { return wait(1); }
  void go_operational() {
    boot();
    nmt(NmtCommand::start);
    wait(1);  // the first event-driven TPDOs
  }

  static std::vector<Frame> only(const std::vector<Frame>& frames, std::uint32_t id) {
    std::vector<Frame> out;
    for (const Frame& f : frames) {
      if (f.id == id) out.push_back(f);
    }
    return out;
  }

  /// One SDO request of 8 bytes, its one answer.
  std::array<std::uint8_t, 8> sdo(std::initializer_list<int> request) {
    Frame f = frame(0x600 + kId, request);
    f.length = 8;
    const auto answers = give(f);
    EXPECT_EQ(answers.size(), 1U);
    std::array<std::uint8_t, 8> data{};
    if (answers.size() == 1) {
      EXPECT_EQ(answers[0].id, 0x580U + kId);
      EXPECT_EQ(answers[0].length, 8);
      std::copy_n(answers[0].data.begin(), 8, data.begin());
    }
    return data;
  }
  /// Expedited download of `size` bytes; the abort code, 0 if accepted.
  std::uint32_t write(int index, int sub, std::uint64_t value, int size) {
    const auto byte = [&](int i) { return static_cast<int>((value >> (8 * i)) & 0xFF); };
    const auto a = sdo({0x23 | ((4 - size) << 2), index & 0xFF, index >> 8, sub, byte(0), byte(1), byte(2), byte(3)});
    if (a[0] == 0x60) {
      EXPECT_EQ(a[1] | a[2] << 8, index);
      EXPECT_EQ(a[3], sub);
      return 0;
    }
    EXPECT_EQ(a[0], 0x80);
    return get<std::uint32_t>(a.data() + 4);
  }
  /// Abort code of an upload, or 0.
  std::uint32_t read_abort(int index, int sub) {
    const auto a = sdo({0x40, index & 0xFF, index >> 8, sub});
    return a[0] == 0x80 ? get<std::uint32_t>(a.data() + 4) : 0;
  }
  /// Value of an expedited upload.
  std::uint32_t read(int index, int sub) {
    const auto a = sdo({0x40, index & 0xFF, index >> 8, sub});
    EXPECT_EQ(a[0] & 0xE3, 0x43) << std::hex << index;
    return get<std::uint32_t>(a.data() + 4);
  }

  ObjectDictionary od;
  NotingApplication app;
  Time now{seconds(1.0).ns};
  Node node;
};

}  // namespace mrr::can
