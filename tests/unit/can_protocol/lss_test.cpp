#include "node_fixture.h"

namespace mrr::can {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;

constexpr std::uint32_t kRequest = 0x7E5;

class LssTest : public NodeTest {
 protected:
  explicit LssTest(std::uint8_t node_id = kId) : NodeTest({.node_id = node_id}) {
    od.identity_vendor_id = 0x11223344;
    od.identity_product_code = 7;
    od.identity_revision = 3;
    od.identity_serial_number = 0xA0B0C0D0;
  }

  std::vector<Frame> lss(std::initializer_list<int> bytes) {
    Frame f = frame(kRequest, bytes);
    f.length = 8;
    return give(f);
  }
  std::vector<Frame> lss(int command, std::uint32_t number, int a = 0, int b = 0, int c = 0) {
    const auto byte = [&](unsigned i) { return static_cast<int>((number >> (8U * i)) & 0xFFU); };
    return lss({command, byte(0), byte(1), byte(2), byte(3), a, b, c});
  }
  static Frame answer(std::initializer_list<int> bytes) {
    Frame f = frame(0x7E4, bytes);
    f.length = 8;
    return f;
  }
  void configuration_mode() { EXPECT_THAT(lss({0x04, 1}), IsEmpty()); }
  void waiting_mode() { EXPECT_THAT(lss({0x04, 0}), IsEmpty()); }
};

class UnconfiguredTest : public LssTest {
 protected:
  UnconfiguredTest() : LssTest(kUnconfiguredNodeId) {}
};

TEST_F(LssTest, tells_who_it_is_in_configuration_mode_only) {
  boot();
  EXPECT_THAT(lss({0x5A}), IsEmpty());
  configuration_mode();
  EXPECT_THAT(lss({0x5A}), ElementsAre(answer({0x5A, 0x44, 0x33, 0x22, 0x11})));
  EXPECT_THAT(lss({0x5B}), ElementsAre(answer({0x5B, 7})));
  EXPECT_THAT(lss({0x5C}), ElementsAre(answer({0x5C, 3})));
  EXPECT_THAT(lss({0x5D}), ElementsAre(answer({0x5D, 0xD0, 0xC0, 0xB0, 0xA0})));
  EXPECT_THAT(lss({0x5E}), ElementsAre(answer({0x5E, kId})));
  waiting_mode();
  EXPECT_THAT(lss({0x5E}), IsEmpty());
}

TEST_F(LssTest, selected_by_all_four_parts_in_their_order) {
  boot();
  const auto select = [&](std::uint32_t vendor, std::uint32_t serial) {
    EXPECT_THAT(lss(0x40, vendor), IsEmpty());
    EXPECT_THAT(lss(0x41, 7), IsEmpty());
    EXPECT_THAT(lss(0x42, 3), IsEmpty());
    return lss(0x43, serial);
  };
  EXPECT_THAT(select(0x11223344, 0xA0B0C0D1), IsEmpty());
  EXPECT_THAT(lss({0x5E}), IsEmpty());
  EXPECT_THAT(select(0x11223345, 0xA0B0C0D0), IsEmpty());
  EXPECT_THAT(lss(0x43, 0xA0B0C0D0), IsEmpty()) << "the last part alone selects nobody";
  lss(0x40, 0x11223344);
  lss(0x42, 3);
  lss(0x41, 7);
  EXPECT_THAT(lss(0x43, 0xA0B0C0D0), IsEmpty()) << "not in their order";
  EXPECT_THAT(select(0x11223344, 0xA0B0C0D0), ElementsAre(answer({0x44})));
  EXPECT_THAT(lss({0x5E}), ElementsAre(answer({0x5E, kId})));
}

TEST_F(LssTest, a_new_node_id_is_in_force_after_reset_communication) {
  boot();
  configuration_mode();
  EXPECT_THAT(lss({0x11, 0x42}), ElementsAre(answer({0x11, 0})));
  EXPECT_EQ(read(0x1200, 1), 0x600U + kId) << "not before";
  const auto sent = nmt(NmtCommand::reset_communication, kId);
  EXPECT_THAT(sent, ElementsAre(frame(0x742, {0})));
  EXPECT_EQ(node.config().node_id, 0x42);
  EXPECT_EQ(od.sdo_server_cob_id_receive, 0x642U);
  EXPECT_EQ(od.emergency_cob_id, 0xC2U);
  EXPECT_EQ(od.rpdo_communication[0].cob_id, 0x242U);
  EXPECT_EQ(od.tpdo_communication[0].cob_id, 0x400001C2U);
  EXPECT_EQ(od.rpdo_communication[3].cob_id, 0x181U) << "shared by all modules";
  // It hears its new name only.
  EXPECT_THAT(give(0x600 + kId, {0x40, 0, 0x10, 0, 0, 0, 0, 0}), IsEmpty());
  EXPECT_EQ(give(0x642, {0x40, 0, 0x10, 0, 0, 0, 0, 0}).size(), 1U);
  nmt(NmtCommand::start, kId);
  EXPECT_EQ(node.state(), NmtState::pre_operational);
  nmt(NmtCommand::start, 0x42);
  EXPECT_EQ(node.state(), NmtState::operational);
  // Also after a reset of the node.
  EXPECT_THAT(nmt(NmtCommand::reset_node, 0x42), ElementsAre(frame(0x742, {0})));
}

TEST_F(LssTest, cob_ids_that_a_client_chose_stay) {
  boot();
  ASSERT_EQ(write(0x1014, 0, 0x80000000U + 0x80 + kId, 4), 0U);
  ASSERT_EQ(write(0x1014, 0, 0x1F0, 4), 0U);
  ASSERT_EQ(write(0x1010, 1, 0x65766173, 4), 0U);
  configuration_mode();
  lss({0x11, 0x42});
  nmt(NmtCommand::reset_communication);
  EXPECT_EQ(od.emergency_cob_id, 0x1F0U);
}

TEST_F(LssTest, node_ids_that_cannot_be_are_refused) {
  boot();
  configuration_mode();
  for (const int id : {0, 128, 200, 254}) EXPECT_THAT(lss({0x11, id}), ElementsAre(answer({0x11, 1}))) << id;
  for (const int id : {1, 127, 255}) EXPECT_THAT(lss({0x11, id}), ElementsAre(answer({0x11, 0}))) << id;
}

TEST_F(LssTest, only_the_bit_rate_in_force_can_be_had_and_without_a_memory_nothing_is_stored) {
  boot();
  configuration_mode();
  EXPECT_THAT(lss({0x13, 0, 0}), ElementsAre(answer({0x13, 0})));
  EXPECT_THAT(lss({0x13, 0, 2}), ElementsAre(answer({0x13, 1})));
  EXPECT_THAT(lss({0x13, 0, 5}), ElementsAre(answer({0x13, 1})));
  EXPECT_THAT(lss({0x13, 0, 200}), ElementsAre(answer({0x13, 1})));
  EXPECT_THAT(lss({0x13, 1, 0}), ElementsAre(answer({0x13, 1})));
  EXPECT_THAT(lss({0x17}), ElementsAre(answer({0x17, 1})));
}

TEST_F(LssTest, found_by_a_range_of_revisions_and_serial_numbers) {
  boot();
  const auto identify = [&](std::uint32_t lowest, std::uint32_t highest) {
    lss(0x46, 0x11223344);
    lss(0x47, 7);
    lss(0x48, 1);
    lss(0x49, 3);
    lss(0x4A, lowest);
    return lss(0x4B, highest);
  };
  EXPECT_THAT(identify(0xA0B0C0D0, 0xA0B0C0D0), ElementsAre(answer({0x4F})));
  EXPECT_THAT(identify(0, 0xFFFFFFFF), ElementsAre(answer({0x4F})));
  EXPECT_THAT(identify(0xA0B0C0D1, 0xFFFFFFFF), IsEmpty());
  EXPECT_THAT(identify(0, 0xA0B0C0CF), IsEmpty());
  EXPECT_THAT(lss({0x4C}), IsEmpty()) << "it has a node id";
}

TEST_F(LssTest, a_node_in_operation_is_not_renamed) {
  go_operational();
  configuration_mode();
  EXPECT_THAT(lss({0x5E}), IsEmpty());
  nmt(NmtCommand::stop);
  configuration_mode();
  EXPECT_THAT(lss({0x5E}), ElementsAre(answer({0x5E, kId})));
}

TEST_F(LssTest, malformed_and_unknown_requests_have_no_answer_and_no_effect) {
  boot();
  configuration_mode();
  for (int length = 0; length < 8; ++length) {
    Frame f = frame(kRequest, {0x5E});
    f.length = static_cast<std::uint8_t>(length);
    EXPECT_THAT(give(f), IsEmpty());
  }
  Frame remote = frame(kRequest, {});
  remote.remote = true;
  EXPECT_THAT(give(remote), IsEmpty());
  for (int command = 0; command < 256; ++command) {
    const bool known = command == 0x04 || command == 0x11 || command == 0x13 || command == 0x17 ||
                       (command >= 0x40 && command <= 0x4C) || (command >= 0x51 && command <= 0x5E);
    if (known) continue;
    EXPECT_THAT(lss({command, 0x33}), IsEmpty()) << command;
  }
  lss({0x04, 2});
  EXPECT_THAT(lss({0x5E}), ElementsAre(answer({0x5E, kId}))) << "no such mode: nothing changes";
  EXPECT_THAT(give(0x7E4, {0x44, 0, 0, 0, 0, 0, 0, 0}), IsEmpty()) << "another slave's answer";
  nmt(NmtCommand::reset_communication);
  EXPECT_EQ(node.config().node_id, kId);
}

TEST_F(UnconfiguredTest, says_nothing_until_it_has_a_node_id) {
  EXPECT_THAT(wait(1000), IsEmpty());
  EXPECT_THAT(nmt(NmtCommand::start), IsEmpty());
  EXPECT_THAT(give(0x6FF, {0x40, 0, 0x10, 0, 0, 0, 0, 0}), IsEmpty());
  EXPECT_EQ(node.state(), NmtState::initialising);
  EXPECT_THAT(lss({0x4C}), ElementsAre(answer({0x50})));
  configuration_mode();
  EXPECT_THAT(lss({0x11, 9}), ElementsAre(answer({0x11, 0})));
  EXPECT_THAT(wait(10), IsEmpty());
  EXPECT_THAT(lss({0x04, 0}), ElementsAre(frame(0x709, {0})));
  EXPECT_EQ(node.state(), NmtState::pre_operational);
  EXPECT_EQ(od.rpdo_communication[1].cob_id, 0x309U);
  EXPECT_THAT(only(wait(200), 0x709), ::testing::SizeIs(2)) << "heartbeats";
  EXPECT_THAT(lss({0x4C}), IsEmpty());
}

TEST_F(UnconfiguredTest, is_found_bit_by_bit) {
  wait(1);
  // As a master does it: a bit is 0 if somebody answers, else 1; once a part is whole it is confirmed.
  EXPECT_THAT(lss(0x51, 0, 0x80), ElementsAre(answer({0x4F})));
  std::array<std::uint32_t, 4> found{};
  for (int part = 0; part < 4; ++part) {
    auto& number = found[static_cast<std::size_t>(part)];
    for (int bit = 31; bit >= 0; --bit) {
      if (lss(0x51, number, bit, part, part).empty()) number |= 1U << static_cast<unsigned>(bit);
    }
    EXPECT_THAT(lss(0x51, number, 0, part, (part + 1) % 4), ElementsAre(answer({0x4F})));
  }
  EXPECT_THAT(found, ElementsAre(0x11223344U, 7U, 3U, 0xA0B0C0D0U));
  EXPECT_THAT(lss({0x5E}), ElementsAre(answer({0x5E, 0xFF}))) << "now in configuration mode";
}

TEST_F(UnconfiguredTest, scans_for_somebody_else_find_nobody) {
  wait(1);
  lss(0x51, 0, 0x80);
  EXPECT_THAT(lss(0x51, 0x80000000, 31, 0, 0), IsEmpty());
  EXPECT_THAT(lss(0x51, 0x11223344, 0, 1, 2), IsEmpty()) << "not the part that is looked for";
  EXPECT_THAT(lss(0x51, 0x11223344, 32, 0, 0), IsEmpty());
  EXPECT_THAT(lss(0x51, 0x11223344, 0, 4, 0), IsEmpty());
  EXPECT_THAT(lss(0x51, 0x11223344, 0, 0, 4), IsEmpty());
}

TEST_F(LssTest, a_node_id_can_be_taken_away) {
  boot();
  configuration_mode();
  lss({0x11, 0xFF});
  EXPECT_THAT(nmt(NmtCommand::reset_communication), IsEmpty());
  EXPECT_THAT(wait(500), IsEmpty());
  EXPECT_THAT(lss({0x4C}), ElementsAre(answer({0x50})));
}

}  // namespace
}  // namespace mrr::can
