#include "can_protocol/bit_timing.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <string>
#include <string_view>
#include <vector>

#include "tests/unit/wire/random_frame.h"

namespace mrr::can {
namespace {

Frame data_frame(std::uint32_t id, std::vector<std::uint8_t> bytes, bool extended = false) {
  Frame frame;
  frame.id = id;
  frame.extended = extended;
  frame.length = static_cast<std::uint8_t>(bytes.size());
  std::copy(bytes.begin(), bytes.end(), frame.data.begin());
  return frame;
}

std::string text(const BitSequence& bits) {
  std::string out;
  for (const std::uint8_t bit : bits) out += bit != 0 ? '1' : '0';
  return out;
}

std::string without_blanks(std::string_view bits) {
  std::string out;
  for (const char c : bits) {
    if (c != ' ') out += c;
  }
  return out;
}

/// Takes out every bit after five equal ones, as a receiver does, up to `count` bits of payload.
std::string unstuffed(const std::string& bits, std::size_t count) {
  std::string out;
  int run = 0;
  char last = ' ';
  for (std::size_t i = 0; i < bits.size() && out.size() < count; ++i) {
    run = bits[i] == last ? run + 1 : 1;
    last = bits[i];
    out += bits[i];
    if (run == 5) {
      ++i;
      EXPECT_NE(bits.at(i), last) << "six equal bits at " << i;
      last = bits.at(i);
      run = 1;
    }
  }
  return out;
}

unsigned crc_of_text(std::string_view message, unsigned polynomial, unsigned width) {
  unsigned crc = 0;
  for (const char c : message) {
    for (unsigned i = 8; i-- > 0;) {
      crc = bits::crc_bit(crc, (static_cast<unsigned>(c) >> i) & 1U, polynomial, width);
    }
  }
  return crc;
}

// The check values of the RevEng catalogue of CRC algorithms.
TEST(BitTiming, CrcsHaveTheCataloguedCheckValues) {
  EXPECT_EQ(crc_of_text("123456789", bits::kCrc15, 15), 0x059EU);
  EXPECT_EQ(crc_of_text("123456789", bits::kCrc17, 17), 0x04F03U);
  EXPECT_EQ(crc_of_text("123456789", bits::kCrc21, 21), 0x0ED841U);
}

// Frames published with the CanOverhead calculator (BSD-3-Clause); its acknowledge slot is recessive, ours
// acknowledged.
TEST(BitTiming, PublishedFramesBitByBit) {
  EXPECT_EQ(text(encode(data_frame(0, {}))), without_blanks("0 000 01000 00100 0 0 01 0000"
                                                            "0100 00010 0000 10000"
                                                            "1 0 1 1111111"));
  EXPECT_EQ(text(encode(data_frame(0, {0}))), without_blanks("0 000 01000 00100 0 0 01 0001 0000 01000"
                                                             "100 0100 0010 0110"
                                                             "1 0 1 1111111"));
  const std::string third = text(encode(data_frame(0x133, {0xFF, 0, 0, 0, 0, 0, 0, 0xFF})));
  EXPECT_EQ(unstuffed(third, 98),
            without_blanks("0 001 0011 0011 0 0 0 1000"
                           "11111111 00000000 00000000 00000000 00000000 00000000 00000000 11111111"
                           "001 1000 0101 1111"));
}

TEST(BitTiming, LengthsWithoutStuffing) {
  EXPECT_EQ(wire_bits(data_frame(0, {})).total(), 44 + 6);  // counted in the published frame above
  EXPECT_EQ(wire_bits(data_frame(0, {0})).total(), 52 + 4);
  // 47 + 8 n and 67 + 8 n, intermission included, are the least. Lengths up to 3 have five dominant control bits in a
  // row (RTR to the first two bits of the length), so one stuff bit is certain.
  Random random(3);
  for (const bool extended : {false, true}) {
    for (std::uint8_t n = 0; n <= 8; ++n) {
      int least = 1000;
      for (int i = 0; i < 20'000; ++i) {
        Frame frame;
        frame.extended = extended;
        frame.id = static_cast<std::uint32_t>(random.below(extended ? 0x2000'0000U : 0x800U));
        frame.length = n;
        for (auto& byte : frame.data) byte = static_cast<std::uint8_t>(random.below(2) == 0 ? 0x55 : random.below(256));
        least = std::min(least, wire_bits(frame).total() + kIntermissionBits);
      }
      EXPECT_EQ(least, (extended ? 67 : 47) + 8 * n + (n <= 3 ? 1 : 0)) << "length " << int{n};
    }
  }
}

TEST(BitTiming, ClassicWorstCasesAreTheFormula) {
  EXPECT_EQ(worst_case_bits({.id = 1, .length = 8}).total(), 135);
  EXPECT_EQ(worst_case_bits({.id = 1, .length = 0}).total(), 55);
  EXPECT_EQ(worst_case_bits({.id = 1, .length = 8, .extended = true}).total(), 160);
  for (int n = 0; n <= 8; ++n) {
    EXPECT_EQ(worst_case_bits({.id = 1, .length = static_cast<std::uint8_t>(n)}).total(),
              47 + 8 * n + (33 + 8 * n) / 4);
  }
}

// The formula is the bound of the stuffing rule, and the rule attains it when all bits can be chosen.
TEST(BitTiming, StufferReachesItsBoundOnAnAdversarialPattern) {
  for (int region : {34, 50, 98, 118}) {
    bits::Stuffer stuffer;  // start of frame is sent
    for (int i = 1; i < region; ++i) stuffer.feed(i < 5 ? 0 : ((i - 5) / 4 + 1) % 2, 1);
    EXPECT_EQ(stuffer.inserted, (region - 1) / 4);
  }
}

TEST(BitTiming, FeedingByTableEqualsFeedingBitByBit) {
  Random random(11);
  for (int i = 0; i < 20'000; ++i) {
    const int count = 1 + static_cast<int>(random.below(64));
    const std::uint64_t value = random.below(2) == 0 ? random.next() : random.next() & random.next() & random.next();
    bits::Stuffer by_table;
    bits::Stuffer by_bit;
    by_table.feed(value, count);
    for (int k = count; k-- > 0;) by_bit.feed((value >> static_cast<unsigned>(k)) & 1U, 1);
    ASSERT_EQ(by_table.inserted, by_bit.inserted);
    ASSERT_EQ(by_table.state, by_bit.state);
  }
}

// All identifiers, all contents: short frames exhaustively. The control bits keep them 2 and 3 bits below the formula.
TEST(BitTiming, ShortFramesNeverExceedTheWorstCase) {
  for (int n = 0; n <= 1; ++n) {
    int most = 0;
    for (std::uint32_t id = 0; id < 0x800; ++id) {
      for (unsigned value = 0; value < (n == 0 ? 1U : 256U); ++value) {
        Frame frame;
        frame.id = id;
        frame.length = static_cast<std::uint8_t>(n);
        frame.data[0] = static_cast<std::uint8_t>(value);
        most = std::max(most, wire_bits(frame).total() + kIntermissionBits);
      }
    }
    const int bound = worst_case_bits({.id = 0, .length = static_cast<std::uint8_t>(n)}).total();
    EXPECT_LE(most, bound);
    EXPECT_GE(most, bound - 3);
  }
}

TEST(BitTimingProperty, CountEqualsTheEncodedBitsAndStaysInBounds) {
  Random random(5);
  for (int i = 0; i < 100'000; ++i) {
    const Frame frame = test::random_frame(random);
    const WireBits bits = wire_bits(frame);
    ASSERT_EQ(bits.total(), static_cast<int>(encode(frame).size()));
    PeriodicFrame shape{.id = frame.id, .length = frame.remote ? std::uint8_t{0} : frame.length};
    shape.extended = frame.extended;
    shape.fd = frame.fd;
    shape.bit_rate_switch = frame.bit_rate_switch;
    const WireBits worst = worst_case_bits(shape);
    ASSERT_LE(bits.nominal + kIntermissionBits, worst.nominal);
    ASSERT_LE(bits.data, worst.data);
    if (!frame.fd) {
      ASSERT_GE(bits.total(), (frame.extended ? 64 : 44) + 8 * shape.length);
    }
    if (!frame.bit_rate_switch) {
      ASSERT_EQ(bits.data, 0);
    }
  }
}

// A receiver's view: no six equal bits before the CRC delimiter, the header and data come back, and the CRC register
// fed with everything, CRC included, ends at zero.
TEST(BitTimingProperty, ClassicFramesDecodeAndTheirCrcClosesToZero) {
  Random random(6);
  for (int i = 0; i < 20'000; ++i) {
    Frame frame = test::random_frame(random);
    if (frame.fd) continue;
    const int payload = frame.remote ? 0 : 8 * frame.length;
    const std::size_t region = (frame.extended ? 54U : 34U) + static_cast<std::size_t>(payload);
    const std::string plain = unstuffed(text(encode(frame)), region);
    ASSERT_EQ(plain.size(), region);
    unsigned crc = 0;
    for (const char c : plain) crc = bits::crc_bit(crc, c == '1' ? 1 : 0, bits::kCrc15, 15);
    ASSERT_EQ(crc, 0U);
    const auto number = [&plain](std::size_t from, std::size_t count) {
      return std::stoul(plain.substr(from, count), nullptr, 2);
    };
    if (frame.extended) {
      ASSERT_EQ((number(1, 11) << 18U) | number(14, 18), frame.id);
      ASSERT_EQ(number(35, 4), frame.length);
    } else {
      ASSERT_EQ(number(1, 11), frame.id);
      ASSERT_EQ(number(15, 4), frame.length);
    }
    for (int b = 0; b < payload / 8; ++b) {
      const auto index = static_cast<std::size_t>(b);
      ASSERT_EQ(number((frame.extended ? 39 : 19) + 8 * index, 8), frame.data[index]);
    }
  }
}

// FD: fixed stuff bits, one before the stuff count and one after every fourth bit from there, complement their
// predecessor; the rest of the field closes the CRC over the dynamically stuffed bits.
TEST(BitTimingProperty, FdFramesHaveFixedStuffBitsAndAClosingCrc) {
  Random random(7);
  int seen = 0;
  for (int i = 0; i < 20'000; ++i) {
    const Frame frame = test::random_frame(random);
    if (!frame.fd) continue;
    ++seen;
    const std::string all = text(encode(frame));
    const unsigned width = frame.length <= 16 ? 17 : 21;
    const std::size_t field = 4 + width + (width == 17 ? 6 : 7);
    const std::size_t begin = all.size() - 10 - field;
    unsigned crc = 1U << (width - 1);
    const unsigned polynomial = width == 17 ? bits::kCrc17 : bits::kCrc21;
    for (std::size_t k = 0; k < begin; ++k) crc = bits::crc_bit(crc, all[k] == '1' ? 1 : 0, polynomial, width);
    std::string stuff_count;
    for (std::size_t k = 0; k < field; ++k) {
      const char bit = all[begin + k];
      if (k % 5 == 0) {
        ASSERT_NE(bit, all[begin + k - 1]);
        continue;
      }
      if (stuff_count.size() < 4) stuff_count += bit;
      crc = bits::crc_bit(crc, bit == '1' ? 1 : 0, polynomial, width);
    }
    ASSERT_EQ(crc, 0U);
    // ISO 11898-1:2015 table of the stuff count: 0-7 in Gray code with even parity.
    const char* const table[8] = {"0000", "0011", "0110", "0101", "1100", "1111", "1010", "1001"};
    const std::size_t plain = (frame.extended ? 41U : 22U) + 8U * frame.length;
    ASSERT_EQ(stuff_count, table[(begin - plain) % 8]);
  }
  EXPECT_GT(seen, 1000);
}

TEST(BitTiming, TimesFollowBothBitRates) {
  const Frame classic = data_frame(0, {});
  EXPECT_EQ(frame_time(classic, {.nominal = 1'000'000}), microseconds(50));
  EXPECT_EQ(occupied_time(classic, {.nominal = 1'000'000}), microseconds(53));
  EXPECT_EQ(frame_time(classic, {.nominal = 500'000}), microseconds(100));
  EXPECT_EQ(frame_time(classic, {.nominal = 800'000}), nanoseconds(62'500));
  Frame fd = data_frame(0x555, std::vector<std::uint8_t>(64, 0x55));
  fd.fd = true;
  const Duration slow = frame_time(fd, {});
  fd.bit_rate_switch = true;
  const Duration fast = frame_time(fd, {});
  // Without dynamic stuff bits: 17 + 9 bits at 1 us, 5 + 512 + 32 + 1 at 0.2 us.
  EXPECT_EQ(fast, nanoseconds(26 * 1000 + 550 * 200));
  EXPECT_EQ(slow, microseconds(576));
}

TEST(BitTiming, WorstCaseLoadOfAThreeJointArm) {
  // 250 Hz: SYNC with a counter, per joint RPDO2, RPDO3, TPDO1, TPDO2 of 8 bytes: (65 + 540 n) f_sync bit/s.
  std::vector<PeriodicFrame> frames{{.id = 0x80, .length = 1, .rate_hz = 250}};
  for (std::uint32_t node = 2; node < 5; ++node) {
    for (const std::uint32_t base : {0x300U, 0x400U, 0x180U, 0x280U}) frames.push_back({base + node, 8, 250.0});
  }
  EXPECT_NEAR(worst_case_load(frames, {}), (65 + 540 * 3) * 250 / 1e6, 1e-9);
  EXPECT_NEAR(worst_case_load(frames, {.nominal = 500'000}), 2 * (65 + 540 * 3) * 250 / 1e6, 1e-9);
}

TEST(BitTiming, MalformedFramesAreNone) {
  Frame frame;
  EXPECT_TRUE(well_formed(frame));
  frame.id = 0x800;
  EXPECT_FALSE(well_formed(frame));
  frame.extended = true;
  EXPECT_TRUE(well_formed(frame));
  frame.id = 0x2000'0000;
  EXPECT_FALSE(well_formed(frame));
  frame.id = 1;
  frame.length = 9;
  EXPECT_FALSE(well_formed(frame));
  frame.fd = true;
  EXPECT_FALSE(well_formed(frame));
  frame.length = 12;
  EXPECT_TRUE(well_formed(frame));
  frame.remote = true;
  EXPECT_FALSE(well_formed(frame));
  frame = Frame{};
  frame.bit_rate_switch = true;
  EXPECT_FALSE(well_formed(frame));
}

// The oracle is the wire itself: of two nodes that start together the one that sends a recessive bit against a dominant
// one loses. Stuff bits agree as long as the bits before them do.
TEST(BitTimingProperty, ArbitrationKeyOrdersLikeTheFirstDifferingBit) {
  Random random(8);
  int compared = 0;
  for (int i = 0; i < 200'000; ++i) {
    Frame a = test::random_frame(random);
    Frame b = test::random_frame(random);
    if (random.below(2) == 0) {  // same base identifier
      const std::uint32_t base = a.extended ? a.id >> 18U : a.id;
      b.id = b.extended
                 ? (base << 18U) | static_cast<std::uint32_t>(random.below(2) == 0 ? a.id & 0x3FFFFU : b.id & 0x3FFFFU)
                 : base;
    }
    if (arbitration_key(a) == arbitration_key(b)) continue;
    const BitSequence bits_a = encode(a);
    const BitSequence bits_b = encode(b);
    std::size_t k = 0;
    while (k < bits_a.size() && k < bits_b.size() && bits_a[k] == bits_b[k]) ++k;
    ASSERT_LT(k, std::min(bits_a.size(), bits_b.size()));
    ASSERT_EQ(arbitration_key(a) < arbitration_key(b), bits_a[k] < bits_b[k])
        << std::hex << a.id << " ext " << a.extended << " / " << b.id << " ext " << b.extended;
    ++compared;
  }
  EXPECT_GT(compared, 100'000);
}

}  // namespace
}  // namespace mrr::can
