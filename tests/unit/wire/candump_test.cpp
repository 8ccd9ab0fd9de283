#include "sim_vcan/wire/candump.h"

#include <gtest/gtest.h>

#include <sstream>

namespace mrr::sim {
namespace {

std::string line(const can::Frame& frame, Time at) {
  std::ostringstream out;
  CandumpWriter(out, "vcan0").write(frame, at);
  return out.str();
}

TEST(Candump, WritesEachKindOfFrame) {
  can::Frame frame;
  frame.id = 0x12;
  frame.length = 3;
  frame.data = {0xDE, 0x0A, 0xFF};
  EXPECT_EQ(line(frame, {1'234'567'891}), "(0000000001.234567) vcan0 012#DE0AFF\n");
  frame.extended = true;
  EXPECT_EQ(line(frame, {0}), "(0000000000.000000) vcan0 00000012#DE0AFF\n");
  frame.fd = true;
  EXPECT_EQ(line(frame, {0}), "(0000000000.000000) vcan0 00000012##0DE0AFF\n");
  frame.bit_rate_switch = true;
  EXPECT_EQ(line(frame, {0}), "(0000000000.000000) vcan0 00000012##1DE0AFF\n");
  frame = {};
  EXPECT_EQ(line(frame, {0}), "(0000000000.000000) vcan0 000#\n");
  frame.remote = true;
  EXPECT_EQ(line(frame, {0}), "(0000000000.000000) vcan0 000#R\n");
  frame.length = 8;
  EXPECT_EQ(line(frame, {0}), "(0000000000.000000) vcan0 000#R8\n");
}

TEST(Candump, HoldsTheLongestFrame) {
  can::Frame frame;
  frame.fd = true;
  frame.length = 64;
  frame.data.fill(0xA5);
  EXPECT_EQ(line(frame, {0}).size(), std::string("(0000000000.000000) vcan0 000##0").size() + 128 + 1);
}

}  // namespace
}  // namespace mrr::sim
