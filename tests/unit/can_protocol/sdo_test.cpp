#include <cmath>
#include <limits>

#include "can_protocol/client.h"
#include "common/core/random.h"
#include "node_fixture.h"

namespace mrr::can {
namespace {

class SdoTest : public NodeTest {
 protected:
  SdoTest() { boot(); }
};

TEST_F(SdoTest, expedited_upload_announces_the_size_of_the_object) {
  EXPECT_EQ(sdo({0x40, 0x00, 0x10, 0}), (std::array<std::uint8_t, 8>{0x43, 0x00, 0x10, 0, 0x92, 0x01, 0x02, 0x00}));
  od.statusword = 0x1237;
  EXPECT_EQ(sdo({0x40, 0x41, 0x60, 0}), (std::array<std::uint8_t, 8>{0x4B, 0x41, 0x60, 0, 0x37, 0x12, 0, 0}));
  od.error_register = 0x11;
  EXPECT_EQ(sdo({0x40, 0x01, 0x10, 0}), (std::array<std::uint8_t, 8>{0x4F, 0x01, 0x10, 0, 0x11, 0, 0, 0}));
}

TEST_F(SdoTest, node_id_is_in_the_cob_ids) {
  EXPECT_EQ(read(0x1014, 0), 0x080U + kId);
  EXPECT_EQ(read(0x1200, 1), 0x600U + kId);
  EXPECT_EQ(read(0x1200, 2), 0x580U + kId);
  EXPECT_EQ(read(0x1400, 1), 0x200U + kId);
  EXPECT_EQ(read(0x1403, 1), 0x181U) << "the selection is the same for all";
  EXPECT_EQ(read(0x1801, 1), 0x40000280U + kId);
}

TEST_F(SdoTest, segmented_upload_gives_the_announced_number_of_bytes) {
  // "MRR joint module" is 16 bytes: 7 + 7 + 2.
  EXPECT_EQ(sdo({0x40, 0x08, 0x10, 0}), (std::array<std::uint8_t, 8>{0x41, 0x08, 0x10, 0, 16, 0, 0, 0}));
  EXPECT_EQ(sdo({0x60}), (std::array<std::uint8_t, 8>{0x00, 'M', 'R', 'R', ' ', 'j', 'o', 'i'}));
  EXPECT_EQ(sdo({0x70}), (std::array<std::uint8_t, 8>{0x10, 'n', 't', ' ', 'm', 'o', 'd', 'u'}));
  EXPECT_EQ(sdo({0x60}), (std::array<std::uint8_t, 8>{0x0B, 'l', 'e', 0, 0, 0, 0, 0}));
  EXPECT_EQ(sdo({0x70})[0], 0x80) << "the transfer is over";
}

TEST_F(SdoTest, segmented_upload_is_a_picture_of_one_instant) {
  od.uptime_us = 0x1122334455667788;
  sdo({0x40, 0x05, 0x20, 0});
  EXPECT_EQ(sdo({0x60}), (std::array<std::uint8_t, 8>{0x00, 0x88, 0x77, 0x66, 0x55, 0x44, 0x33, 0x22}));
  od.uptime_us = 0;
  EXPECT_EQ(sdo({0x70}), (std::array<std::uint8_t, 8>{0x1D, 0x11, 0, 0, 0, 0, 0, 0}));
}

TEST_F(SdoTest, segmented_download_writes_a_string_and_reports_it_once) {
  EXPECT_EQ(sdo({0x21, 0x04, 0x20, 0, 9}), (std::array<std::uint8_t, 8>{0x60, 0x04, 0x20, 0}));
  EXPECT_EQ(sdo({0x00, 's', 'h', 'o', 'u', 'l', 'd', 'e'}), (std::array<std::uint8_t, 8>{0x20}));
  EXPECT_STREQ(od.module_name.data(), "") << "no effect before the end";
  EXPECT_EQ(sdo({0x1B, 'r', '1'}), (std::array<std::uint8_t, 8>{0x30}));
  EXPECT_STREQ(od.module_name.data(), "shoulder1");
  ASSERT_EQ(app.writes.size(), 1U);
  EXPECT_EQ(app.writes[0].id, ObjectId::module_name);
  EXPECT_EQ(app.writes[0].source, WriteSource::sdo);
}

TEST_F(SdoTest, a_shorter_string_leaves_nothing_of_the_longer_one) {
  ASSERT_EQ(write(0x2004, 0, 0x64636261, 4), 0U);
  ASSERT_EQ(write(0x2004, 0, 0x7A, 1), 0U);
  EXPECT_STREQ(od.module_name.data(), "z");
}

TEST_F(SdoTest, segmented_download_of_a_number_is_checked_like_an_expedited_one) {
  EXPECT_EQ(sdo({0x21, 0x03, 0x20, 0, 4})[0], 0x60);
  EXPECT_EQ(sdo({0x07, 0x10, 0x27, 0, 0})[0], 0x20);  // 10000
  EXPECT_EQ(od.knot_period_us, 10000U);
  EXPECT_EQ(sdo({0x21, 0x03, 0x20, 0, 4})[0], 0x60);
  const auto a = sdo({0x07, 1, 0, 0, 0});
  EXPECT_EQ(get<std::uint32_t>(a.data() + 4), 0x06090032U);
  EXPECT_EQ(od.knot_period_us, 10000U);
}

TEST_F(SdoTest, abort_codes_of_what_is_not_there_or_not_allowed) {
  EXPECT_EQ(read_abort(0x5FFF, 0), 0x06020000U);
  EXPECT_EQ(write(0x5FFF, 0, 0, 1), 0x06020000U);
  EXPECT_EQ(read_abort(0x1018, 5), 0x06090011U);
  EXPECT_EQ(read_abort(0x6041, 1), 0x06090011U);
  EXPECT_EQ(write(0x1018, 9, 0, 4), 0x06090011U);
  EXPECT_EQ(write(0x6041, 0, 0, 2), 0x06010002U);
  EXPECT_EQ(write(0x1000, 0, 0, 4), 0x06010002U);
  EXPECT_EQ(write(0x1018, 0, 0, 1), 0x06010002U);
  EXPECT_EQ(od.count_sdo_aborts, 8U);
}

TEST_F(SdoTest, abort_codes_of_wrong_lengths) {
  EXPECT_EQ(write(0x6040, 0, 6, 4), 0x06070012U);
  EXPECT_EQ(write(0x6040, 0, 6, 1), 0x06070013U);
  const auto too_long = sdo({0x21, 0x40, 0x60, 0, 3});
  EXPECT_EQ(get<std::uint32_t>(too_long.data() + 4), 0x06070012U);
  const auto too_short = sdo({0x21, 0x40, 0x60, 0, 1});
  EXPECT_EQ(get<std::uint32_t>(too_short.data() + 4), 0x06070013U);
  const auto string_too_long = sdo({0x21, 0x04, 0x20, 0, 33});
  EXPECT_EQ(get<std::uint32_t>(string_too_long.data() + 4), 0x06070012U);
  // Fewer and more bytes than announced.
  sdo({0x21, 0x04, 0x20, 0, 9});
  const auto fewer = sdo({0x09, 'a', 'b', 'c'});
  EXPECT_EQ(get<std::uint32_t>(fewer.data() + 4), 0x06070010U);
  sdo({0x21, 0x04, 0x20, 0, 2});
  const auto more = sdo({0x01, 'a', 'b', 'c', 'd', 'e', 'f', 'g'});
  EXPECT_EQ(get<std::uint32_t>(more.data() + 4), 0x06070010U);
  // Without an announced size: refused when it no longer fits.
  sdo({0x20, 0x40, 0x60, 0});
  const auto unannounced = sdo({0x01, 1, 2, 3, 4, 5, 6, 7});
  EXPECT_EQ(get<std::uint32_t>(unannounced.data() + 4), 0x06070012U);
  EXPECT_EQ(od.controlword, 0);
  EXPECT_STREQ(od.module_name.data(), "");
  EXPECT_TRUE(app.writes.empty());
}

TEST_F(SdoTest, a_download_without_announced_size_ends_where_the_object_does) {
  sdo({0x20, 0x04, 0x20, 0});
  for (const int toggle : {0x00, 0x10, 0x00, 0x10}) {
    EXPECT_EQ(sdo({toggle, 'a', 'b', 'c', 'd', 'e', 'f', 'g'})[0], 0x20 | toggle);
  }
  const auto a = sdo({0x00, 'a', 'b', 'c', 'd', 'e', 'f', 'g'});  // 35 bytes into 32
  EXPECT_EQ(get<std::uint32_t>(a.data() + 4), 0x06070012U);
  EXPECT_STREQ(od.module_name.data(), "");
}

TEST_F(SdoTest, expedited_download_without_a_size_takes_the_objects_own) {
  EXPECT_EQ(sdo({0x22, 0x40, 0x60, 0, 0x0F, 0x00, 0xEE, 0xEE})[0], 0x60);
  EXPECT_EQ(od.controlword, 0x000F);
}

TEST_F(SdoTest, values_out_of_range_are_refused_with_the_right_code) {
  EXPECT_EQ(write(0x6060, 0, 11, 1), 0x06090031U);
  EXPECT_EQ(write(0x6060, 0, 0x80, 1), 0x06090032U) << "-128";
  EXPECT_EQ(write(0x6060, 0, 3, 1), 0x06090030U) << "between, but no mode of ours";
  EXPECT_EQ(write(0x6060, 0, 0xFF, 1), 0U) << "-1 is passive";
  EXPECT_EQ(od.modes_of_operation, -1);
  EXPECT_EQ(write(0x6085, 0, 0, 4), 0x06090032U);
  EXPECT_EQ(write(0x6085, 0, 0xFFFFFFFF, 4), 0U);
}

TEST_F(SdoTest, reals_that_are_no_numbers_never_get_in) {
  const float before = od.control_lambda_1_s;
  for (const float bad : {std::nanf(""), -std::nanf(""), std::numeric_limits<float>::infinity(),
                          -std::numeric_limits<float>::infinity()}) {
    EXPECT_EQ(write(0x2100, 1, std::bit_cast<std::uint32_t>(bad), 4), 0x06090030U);
  }
  EXPECT_EQ(write(0x2100, 1, std::bit_cast<std::uint32_t>(-1.0F), 4), 0x06090032U);
  EXPECT_EQ(write(0x2100, 1, std::bit_cast<std::uint32_t>(250.5F), 4), 0x06090031U);
  EXPECT_EQ(od.control_lambda_1_s, before);
}

TEST_F(SdoTest, the_application_may_refuse_a_write_and_then_nothing_changes) {
  app.verdict = Abort::state;
  EXPECT_EQ(write(0x6098, 0, 35, 1), 0x08000022U);
  EXPECT_EQ(od.homing_method, -1);
  EXPECT_TRUE(app.writes.empty());
}

TEST_F(SdoTest, wrong_toggle_ends_a_transfer_either_way) {
  sdo({0x40, 0x08, 0x10, 0});
  auto a = sdo({0x70});
  EXPECT_EQ(get<std::uint32_t>(a.data() + 4), 0x05030000U);
  EXPECT_EQ(a[1] | a[2] << 8, 0x1008);
  a = sdo({0x60});
  EXPECT_EQ(get<std::uint32_t>(a.data() + 4), 0x05040001U);
  sdo({0x21, 0x04, 0x20, 0, 9});
  a = sdo({0x10, 'x', 'x', 'x', 'x', 'x', 'x', 'x'});
  EXPECT_EQ(get<std::uint32_t>(a.data() + 4), 0x05030000U);
}

TEST_F(SdoTest, block_transfer_and_unknown_commands_are_refused_as_unknown) {
  for (const int command : {0xA0, 0xA4, 0xC0, 0xC6, 0xE0, 0x60, 0x00}) {
    const auto a = sdo({command, 0x08, 0x10, 0});
    EXPECT_EQ(a[0], 0x80) << command;
    EXPECT_EQ(get<std::uint32_t>(a.data() + 4), 0x05040001U) << command;
  }
}

TEST_F(SdoTest, requests_that_are_not_eight_bytes_long_are_not_answered) {
  for (int n = 0; n < 8; ++n) {
    Frame f = frame(0x600 + kId, {0x40, 0x00, 0x10, 0, 0, 0, 0, 0});
    f.length = static_cast<std::uint8_t>(n);
    EXPECT_TRUE(give(f).empty());
  }
  EXPECT_EQ(od.count_rejected_frames, 8U);
}

TEST_F(SdoTest, an_abandoned_transfer_times_out_and_a_new_one_replaces_an_old) {
  sdo({0x40, 0x08, 0x10, 0});
  EXPECT_TRUE(only(wait(1000), 0x580 + kId).empty());
  const auto sent = only(wait(1), 0x580 + kId);
  ASSERT_EQ(sent.size(), 1U);
  EXPECT_EQ(sent[0], frame(0x580 + kId, {0x80, 0x08, 0x10, 0, 0, 0, 0x04, 0x05}));
  EXPECT_TRUE(only(wait(3000), 0x580 + kId).empty()) << "told once";

  sdo({0x21, 0x04, 0x20, 0, 9});
  EXPECT_EQ(read(0x1000, 0), 0x20192U);
  EXPECT_EQ(sdo({0x00})[0], 0x80) << "the download is gone";
}

TEST_F(SdoTest, the_clients_abort_is_not_answered) {
  sdo({0x40, 0x08, 0x10, 0});
  EXPECT_TRUE(give(0x600 + kId, {0x80, 0x08, 0x10, 0, 0, 0, 0x04, 0x05}).empty());
  EXPECT_EQ(sdo({0x60})[0], 0x80);
}

TEST_F(SdoTest, works_in_operational_not_in_stopped) {
  nmt(NmtCommand::start);
  EXPECT_EQ(read(0x1000, 0), 0x20192U);
  nmt(NmtCommand::stop);
  EXPECT_TRUE(give(0x600 + kId, {0x40, 0x00, 0x10, 0, 0, 0, 0, 0}).empty());
  nmt(NmtCommand::enter_pre_operational);
  EXPECT_EQ(read(0x1000, 0), 0x20192U);
}

TEST_F(SdoTest, every_entry_is_readable_or_says_write_only) {
  for (const Entry& e : kEntries) {
    if (e.flags & kTestOnly) continue;
    if (e.index == 0x1003 && e.sub > 0) continue;  // empty: no data
    const auto a = sdo({0x40, e.index & 0xFF, e.index >> 8, e.sub});
    EXPECT_EQ(a[0] & 0xE0, 0x40) << std::hex << e.index << ":" << int{e.sub};
  }
}

TEST_F(SdoTest, error_history_is_empty_fills_newest_first_and_is_cleared_by_zero_alone) {
  EXPECT_EQ(read(0x1003, 0), 0U);
  EXPECT_EQ(read_abort(0x1003, 1), 0x08000024U);
  node.raise(Emergency::following_error, {0x34, 0x12}, now);
  node.raise(Emergency::encoder, now);
  EXPECT_EQ(read(0x1003, 0), 2U);
  EXPECT_EQ(read(0x1003, 1), 0x00007305U);
  EXPECT_EQ(read(0x1003, 2), 0x12348611U);
  EXPECT_EQ(write(0x1003, 0, 1, 1), 0x06090030U);
  EXPECT_EQ(write(0x1003, 1, 0, 4), 0x06010002U);
  EXPECT_EQ(write(0x1003, 0, 0, 1), 0U);
  EXPECT_EQ(read(0x1003, 0), 0U);
}

TEST_F(SdoTest, store_and_restore_need_their_signatures) {
  EXPECT_EQ(read(0x1010, 1), 1U);
  EXPECT_EQ(write(0x1010, 1, 0x12345678, 4), 0x08000020U);
  EXPECT_EQ(app.stores, 0);
  ASSERT_EQ(write(0x6085, 0, 777, 4), 0U);
  EXPECT_EQ(write(0x1010, 1, 0x65766173, 4), 0U);
  EXPECT_EQ(app.stores, 1);
  EXPECT_EQ(read(0x1010, 1), 1U);
  nmt(NmtCommand::reset_node);
  EXPECT_EQ(od.quick_stop_deceleration_mrad_s2, 777U) << "stored";
  EXPECT_EQ(write(0x1011, 1, 0x65766173, 4), 0x08000020U);
  EXPECT_EQ(write(0x1011, 1, 0x64616F6C, 4), 0U);
  EXPECT_EQ(app.restores, 1);
  EXPECT_EQ(od.quick_stop_deceleration_mrad_s2, 777U) << "in force after the reset";
  nmt(NmtCommand::reset_node);
  EXPECT_EQ(od.quick_stop_deceleration_mrad_s2, 20000U);
}

TEST_F(SdoTest, a_store_that_the_application_refuses_is_refused) {
  app.store_verdict = Abort::state;
  ASSERT_EQ(write(0x6085, 0, 777, 4), 0U);
  EXPECT_EQ(write(0x1010, 1, 0x65766173, 4), 0x08000022U);
  nmt(NmtCommand::reset_node);
  EXPECT_EQ(od.quick_stop_deceleration_mrad_s2, 20000U);
}

TEST_F(SdoTest, test_objects_do_not_exist_without_the_switch) {
  EXPECT_EQ(read_abort(0x2F00, 0), 0x06020000U);
  EXPECT_EQ(write(0x2F00, 0, 0x7305, 2), 0x06020000U);
}

class TestObjectsTest : public NodeTest {
 protected:
  TestObjectsTest() : NodeTest({.node_id = kId, .test_objects = true}) { boot(); }
};

TEST_F(TestObjectsTest, exist_with_it_and_are_write_only) {
  EXPECT_EQ(read_abort(0x2F00, 0), 0x06010001U);
  EXPECT_EQ(write(0x2F00, 0, 0x7305, 2), 0U);
  EXPECT_EQ(od.test_fault, 0x7305);
}

// ---- client against server ----

class ClientTest : public NodeTest {
 protected:
  ClientTest() { boot(); }
  SdoClient client{kId, milliseconds(50)};

  /// Lets both talk until the client is through; the number of milliseconds it took.
  int talk() {
    for (int ms = 0; ms < 200; ++ms) {
      TransmitQueue to_server;
      client.tick(now, to_server);
      for (int k = 0; k < 20 && !to_server.empty(); ++k) {
        TransmitQueue to_client;
        for (const Frame& f : to_server) node.handle({f, now}, to_client);
        to_server.clear();
        for (const Frame& f : to_client) client.handle(f, now, to_server);
      }
      if (!client.busy()) return ms;
      now += milliseconds(1);
    }
    return -1;
  }
};

TEST_F(ClientTest, writes_and_reads_back_every_writable_number) {
  Random random(7);
  int written = 0;
  for (std::size_t i = 0; i < kEntryCount; ++i) {
    const Entry& e = kEntries[i];
    if (!(e.flags & kWritable) || (e.flags & kTestOnly) || e.index < 0x2000 || e.type == Type::string) continue;
    const auto id = static_cast<ObjectId>(i);
    for (int k = 0; k < 20; ++k) {
      Value v;
      v.size = static_cast<std::uint8_t>(e.size);
      for (std::size_t b = 0; b < e.size; ++b) v.bytes[b] = static_cast<std::uint8_t>(random.next());
      const Abort expected = check_value(e, v);
      const Value before = read_value(od, e);
      if (e.type == Type::f32) {
        ASSERT_TRUE(client.download_real(id, v.as_real()));
      } else {
        ASSERT_TRUE(client.download_integer(id, v.as_signed()));
      }
      talk();
      EXPECT_EQ(client.abort_code(), expected);
      EXPECT_EQ(client.status(), expected == Abort::none ? SdoClient::Status::done : SdoClient::Status::failed);
      ASSERT_TRUE(client.upload(id));
      talk();
      ASSERT_EQ(client.status(), SdoClient::Status::done);
      EXPECT_EQ(client.value().bytes, expected == Abort::none ? v.bytes : before.bytes);
      written += expected == Abort::none;
    }
  }
  EXPECT_GT(written, 100);
}

TEST_F(ClientTest, carries_strings_of_every_length) {
  for (std::size_t n = 0; n <= 32; ++n) {
    std::vector<std::uint8_t> text(n);
    for (std::size_t i = 0; i < n; ++i) text[i] = static_cast<std::uint8_t>('a' + i % 26);
    ASSERT_TRUE(client.download(0x2004, 0, text));
    EXPECT_GE(talk(), 0);
    ASSERT_EQ(client.status(), SdoClient::Status::done) << n;
    ASSERT_TRUE(client.upload(ObjectId::module_name));
    EXPECT_GE(talk(), 0);
    ASSERT_EQ(client.status(), SdoClient::Status::done) << n;
    EXPECT_EQ(client.value().size, n);
    EXPECT_TRUE(std::equal(text.begin(), text.end(), client.value().bytes.begin()));
  }
  EXPECT_FALSE(client.download(0x2004, 0, std::vector<std::uint8_t>(33)));
}

TEST_F(ClientTest, times_out_when_nobody_answers_and_can_start_again) {
  ASSERT_TRUE(client.upload(0x1000, 0));
  EXPECT_FALSE(client.upload(0x1001, 0)) << "busy";
  nmt(NmtCommand::stop);
  talk();
  EXPECT_EQ(client.status(), SdoClient::Status::failed);
  EXPECT_EQ(client.abort_code(), Abort::timeout);
  nmt(NmtCommand::enter_pre_operational);
  ASSERT_TRUE(client.upload(0x1000, 0));
  talk();
  EXPECT_EQ(client.status(), SdoClient::Status::done);
  EXPECT_EQ(client.value().as_unsigned(), 0x20192U);
}

TEST_F(ClientTest, an_answer_to_an_earlier_question_is_not_taken_for_this_one) {
  ASSERT_TRUE(client.upload(0x1000, 0));
  TransmitQueue tx;
  client.tick(now, tx);
  client.handle(frame(0x580 + kId, {0x43, 0x18, 0x10, 1, 9, 9, 9, 9}), now, tx);
  EXPECT_TRUE(client.busy());
  client.handle(frame(0x580 + kId + 1, {0x43, 0x00, 0x10, 0, 9, 9, 9, 9}), now, tx);
  EXPECT_TRUE(client.busy());
  client.handle(frame(0x580 + kId, {0x43, 0x00, 0x10, 0, 1, 2, 3, 4}), now, tx);
  EXPECT_EQ(client.value().as_unsigned(), 0x04030201U);
}

}  // namespace
}  // namespace mrr::can
