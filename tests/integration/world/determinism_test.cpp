// One seed, one run, bit by bit; another seed, another run.
#include <gtest/gtest.h>

#include <bit>
#include <set>

#include "tests/integration/world/whole_robot.h"

namespace mrr::sim::test {
namespace {

/// FNV-1a over everything on the wire, times included.
class WireHash {
 public:
  void add(const Delivery& delivery) {
    const can::Frame& frame = delivery.frame;
    mix(static_cast<std::uint64_t>(delivery.at.ns));
    mix(static_cast<std::uint64_t>(delivery.from));
    mix(frame.id);
    mix(frame.length);
    for (std::size_t i = 0; i < frame.length; ++i) mix(frame.data[i]);
    ++frames_;
  }
  [[nodiscard]] std::uint64_t value() const { return value_; }
  [[nodiscard]] std::int64_t frames() const { return frames_; }

 private:
  void mix(std::uint64_t v) {
    for (int byte = 0; byte < 8; ++byte) value_ = (value_ ^ ((v >> (8 * byte)) & 0xFFU)) * 0x100000001B3U;
  }
  std::uint64_t value_ = 0xCBF29CE484222325U;
  std::int64_t frames_ = 0;
};

struct RecordedJob {
  WireHash wire;
  HammerJobResult job;
};

RecordedJob record(const char* robot, const char* board, std::uint64_t seed) {
  RecordedJob result;
  result.job = hammer(example(robot), board, seeded(seed), [&result](World& world) {
    world.on_frame = [&result](const Delivery& delivery) { result.wire.add(delivery); };
  });
  return result;
}

class SameSeed : public testing::TestWithParam<std::pair<const char*, const char*>> {};
INSTANTIATE_TEST_SUITE_P(Jobs, SameSeed,
                         testing::Values(std::pair{"mrr3", "styrofoam"}, std::pair{"mrr3", "hardwood"},
                                         std::pair{"arm7", "styrofoam"}));

TEST_P(SameSeed, GivesTheSameFramesAtTheSameTimesAndTheSameTruth) {
  const auto [robot, board] = GetParam();
  const RecordedJob first = record(robot, board, 7);
  const RecordedJob second = record(robot, board, 7);
  EXPECT_GT(first.wire.frames(), 10'000);
  EXPECT_EQ(first.wire.frames(), second.wire.frames());
  EXPECT_EQ(first.wire.value(), second.wire.value());
  ASSERT_EQ(first.job.truth.size(), second.job.truth.size());
  for (std::size_t k = 0; k < first.job.truth.size(); ++k) {
    const SwingTruth& a = first.job.truth[k];
    const SwingTruth& b = second.job.truth[k];
    EXPECT_EQ(a.contact_start, b.contact_start);
    EXPECT_EQ(std::bit_cast<std::uint64_t>(a.impulse_n_s), std::bit_cast<std::uint64_t>(b.impulse_n_s));
    EXPECT_EQ(std::bit_cast<std::uint64_t>(a.peak_force_n), std::bit_cast<std::uint64_t>(b.peak_force_n));
    for (std::size_t i = 0; i < a.joints.size(); ++i) {
      EXPECT_EQ(std::bit_cast<std::uint64_t>(a.joints[i].peak_torque_nm),
                std::bit_cast<std::uint64_t>(b.joints[i].peak_torque_nm));
    }
  }
}

TEST(Seed, EveryOneGivesAnotherRun) {
  std::set<std::uint64_t> hashes;
  for (std::uint64_t seed = 0; seed < 6; ++seed) hashes.insert(record("mrr3", "styrofoam", seed).wire.value());
  EXPECT_EQ(hashes.size(), 6U);
}

}  // namespace
}  // namespace mrr::sim::test
