#include "node_fixture.h"

namespace mrr::can {
namespace {

using NmtTest = NodeTest;

TEST_F(NmtTest, says_nothing_and_hears_nothing_before_boot_up) {
  EXPECT_TRUE(nmt(NmtCommand::start).empty());
  EXPECT_EQ(node.state(), NmtState::initialising);
}

TEST_F(NmtTest, boot_up_is_the_first_frame_and_leads_to_pre_operational) {
  const auto sent = boot();
  ASSERT_FALSE(sent.empty());
  EXPECT_EQ(sent[0], frame(0x700 + kId, {0}));
  EXPECT_EQ(node.state(), NmtState::pre_operational);
  EXPECT_THAT(app.states, ::testing::ElementsAre(NmtState::pre_operational));
}

TEST_F(NmtTest, every_command_leads_where_it_should_from_every_state) {
  boot();
  for (const NmtCommand from : {NmtCommand::start, NmtCommand::stop, NmtCommand::enter_pre_operational}) {
    for (const auto& [command, state] :
         {std::pair{NmtCommand::start, NmtState::operational}, std::pair{NmtCommand::stop, NmtState::stopped},
          std::pair{NmtCommand::enter_pre_operational, NmtState::pre_operational},
          std::pair{NmtCommand::reset_node, NmtState::pre_operational},
          std::pair{NmtCommand::reset_communication, NmtState::pre_operational}}) {
      for (const std::uint8_t address : {std::uint8_t{0}, kId}) {
        nmt(from);
        nmt(command, address);
        EXPECT_EQ(node.state(), state);
      }
    }
  }
}

TEST_F(NmtTest, commands_to_others_short_long_and_unknown_ones_are_ignored) {
  boot();
  nmt(NmtCommand::start, kId + 1);
  give(0x000, {});
  give(0x000, {1});
  give(0x000, {1, 0, 0});
  for (int c = 0; c < 256; ++c) {
    if (c != 1 && c != 2 && c != 0x80 && c != 0x81 && c != 0x82) give(0x000, {c, 0});
  }
  EXPECT_EQ(node.state(), NmtState::pre_operational);
  EXPECT_EQ(od.count_rejected_frames, 3U + 251U);
}

TEST_F(NmtTest, reset_sends_boot_up_and_brings_back_power_on_values) {
  go_operational();
  ASSERT_EQ(write(0x1017, 0, 33, 2), 0U);
  ASSERT_EQ(write(0x6085, 0, 777, 4), 0U);
  auto sent = nmt(NmtCommand::reset_communication);
  EXPECT_THAT(sent, ::testing::ElementsAre(frame(0x700 + kId, {0})));
  EXPECT_EQ(od.producer_heartbeat_ms, 100);
  EXPECT_EQ(od.quick_stop_deceleration_mrad_s2, 777U) << "not a communication object";
  sent = nmt(NmtCommand::reset_node);
  EXPECT_THAT(sent, ::testing::ElementsAre(frame(0x700 + kId, {0})));
  EXPECT_EQ(od.quick_stop_deceleration_mrad_s2, 20000U);
  EXPECT_THAT(app.resets, ::testing::ElementsAre(ResetKind::communication, ResetKind::node));
}

TEST_F(NmtTest, what_the_application_sets_before_the_first_tick_is_its_power_on_value) {
  od.control_lambda_1_s = 50.0F;
  boot();
  ASSERT_EQ(write(0x2100, 1, std::bit_cast<std::uint32_t>(20.0F), 4), 0U);
  nmt(NmtCommand::reset_node);
  EXPECT_EQ(od.control_lambda_1_s, 50.0F);
}

TEST_F(NmtTest, heartbeat_tells_the_state_at_its_period) {
  boot();
  auto beats = only(wait(300), 0x700 + kId);
  ASSERT_EQ(beats.size(), 3U);
  EXPECT_EQ(beats[0], frame(0x700 + kId, {0x7F}));
  nmt(NmtCommand::start);
  EXPECT_EQ(only(wait(100), 0x700 + kId).back().data[0], 5);
  nmt(NmtCommand::stop);
  EXPECT_EQ(only(wait(100), 0x700 + kId).back().data[0], 4);
}

TEST_F(NmtTest, heartbeat_period_changes_at_once_and_stops_at_zero) {
  boot();
  wait(30);
  ASSERT_EQ(write(0x1017, 0, 10, 2), 0U);
  EXPECT_EQ(only(wait(1), 0x700 + kId).size(), 1U);
  EXPECT_EQ(only(wait(100), 0x700 + kId).size(), 10U);
  ASSERT_EQ(write(0x1017, 0, 0, 2), 0U);
  EXPECT_TRUE(only(wait(1000), 0x700 + kId).empty());
  ASSERT_EQ(write(0x1017, 0, 10, 2), 0U);
  EXPECT_EQ(only(wait(1), 0x700 + kId).size(), 1U);
}

TEST_F(NmtTest, consumer_heartbeat_watches_from_the_first_one_and_reports_loss_and_return) {
  boot();
  wait(2000);
  EXPECT_TRUE(app.lost.empty()) << "nobody spoke yet";
  give(0x701, {0});
  wait(2000);
  EXPECT_TRUE(app.lost.empty()) << "boot-up is no heartbeat";
  for (int i = 0; i < 4; ++i) {
    give(0x701, {5});
    EXPECT_TRUE(only(wait(400), 0x080 + kId).empty());
  }
  const auto sent = only(wait(150), 0x080 + kId);
  EXPECT_THAT(app.lost, ::testing::ElementsAre(1));
  ASSERT_EQ(sent.size(), 1U);
  EXPECT_EQ(sent[0], frame(0x080 + kId, {0x30, 0x81, 0x11, 1, 0, 0, 0, 0}));
  EXPECT_EQ(node.state(), NmtState::pre_operational);
  give(0x701, {5});
  EXPECT_THAT(only(wait(20), 0x080 + kId), ::testing::ElementsAre(frame(0x080 + kId, {0, 0, 0, 0, 0, 0, 0, 0})));
}

TEST_F(NmtTest, error_behaviour_decides_the_state_after_a_lost_heartbeat) {
  for (const auto& [behaviour, state] : {std::pair{0, NmtState::pre_operational}, std::pair{1, NmtState::operational},
                                         std::pair{2, NmtState::stopped}}) {
    nmt(NmtCommand::reset_node);
    go_operational();
    ASSERT_EQ(write(0x1029, 1, static_cast<std::uint64_t>(behaviour), 1), 0U);
    give(0x701, {5});
    wait(501);
    EXPECT_EQ(node.state(), state) << behaviour;
  }
}

TEST_F(NmtTest, one_node_is_watched_by_one_entry_only) {
  boot();
  EXPECT_EQ(write(0x1016, 2, 0x00010064, 4), 0x06040043U);
  EXPECT_EQ(write(0x1016, 2, 0x00020064, 4), 0U);
  EXPECT_EQ(write(0x1016, 1, 0, 4), 0U);
  EXPECT_EQ(write(0x1016, 3, 0x00010064, 4), 0U);
  for (const std::uint8_t entry : {std::uint8_t{1}, std::uint8_t{4}}) {
    EXPECT_EQ(write(0x1016, entry, 0x00800064, 4), 0U) << "there is no node 128: the entry is unused";
  }
}

TEST_F(NmtTest, extended_remote_fd_and_overlong_frames_have_no_effect_and_are_counted) {
  go_operational();
  std::uint32_t expected = od.count_rejected_frames;
  for (const std::uint32_t id : {0x000U, 0x080U, 0x181U, 0x200U + kId, 0x600U + kId, 0x701U}) {
    for (int kind = 0; kind < 4; ++kind) {
      Frame f = frame(id, {2, 0, 0, 0, 0, 0, 0, 0});
      if (id == 0) f.length = 2;
      if (kind == 0) f.extended = true;
      if (kind == 1) f.remote = true;
      if (kind == 2) f.fd = true;
      if (kind == 3) f.length = 12;
      const ObjectDictionary before = od;
      EXPECT_TRUE(give(f).empty());
      EXPECT_EQ(od.count_rejected_frames, ++expected);
      EXPECT_EQ(before.count_sync, od.count_sync);
    }
  }
  EXPECT_EQ(node.state(), NmtState::operational);
}

}  // namespace
}  // namespace mrr::can
