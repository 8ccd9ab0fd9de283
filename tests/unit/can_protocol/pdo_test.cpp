#include "can_protocol/pdo.h"

#include "can_protocol/client.h"
#include "node_fixture.h"

namespace mrr::can {
namespace {

class PdoTest : public NodeTest {
 protected:
  PdoTest() { go_operational(); }
  static constexpr std::uint64_t kOff = 0x80000000U;

  std::vector<Frame> tpdo(int number, const std::vector<Frame>& sent) {
    return only(sent, 0x080U + 0x100U * static_cast<std::uint32_t>(number) + kId);
  }
  /// Disables, maps, enables; the first abort code met.
  std::uint32_t map(int communication, std::uint64_t cob_id, std::initializer_list<std::uint64_t> objects) {
    const int mapping = communication + 0x200;
    if (const auto a = write(communication, 1, cob_id | kOff, 4)) return a;
    if (const auto a = write(mapping, 0, 0, 1)) return a;
    int sub = 0;
    for (const std::uint64_t o : objects) {
      if (const auto a = write(mapping, ++sub, o, 4)) return a;
    }
    if (const auto a = write(mapping, 0, objects.size(), 1)) return a;
    return write(communication, 1, cob_id, 4);
  }
};

// ---- receiving ----

TEST_F(PdoTest, command_takes_effect_at_once) {
  give(pack_rpdo1(kId, {0x000F, 8}));
  EXPECT_EQ(od.controlword, 0x000F);
  EXPECT_EQ(od.modes_of_operation, 8);
  ASSERT_EQ(app.writes.size(), 2U);
  EXPECT_EQ(app.writes[0].id, ObjectId::controlword);
  EXPECT_EQ(app.writes[0].source, WriteSource::rpdo);
  ASSERT_EQ(app.pdos.size(), 1U);
  EXPECT_EQ(app.pdos[0].first, 1);
}

TEST_F(PdoTest, knots_take_effect_at_the_next_sync_the_last_one_counts) {
  give(pack_rpdo2(kId, {111, -222}));
  const Time first = now;
  now += milliseconds(1);
  give(pack_rpdo2(kId, {333, -444}));
  give(pack_rpdo3(kId, {5, -6, 7}));
  EXPECT_EQ(od.target_position_urad, 0);
  EXPECT_TRUE(app.writes.empty());
  const Time second = now;
  now += milliseconds(1);
  sync();
  EXPECT_EQ(od.target_position_urad, 333);
  EXPECT_EQ(od.velocity_offset_urad_s, -444);
  EXPECT_EQ(od.target_acceleration_mrad_s2, 5);
  EXPECT_EQ(od.torque_offset_permille, -6);
  EXPECT_EQ(od.knot_sequence, 7);
  EXPECT_THAT(app.pdos, ::testing::ElementsAre(std::pair{std::uint8_t{2}, second}, std::pair{std::uint8_t{3}, second}));
  EXPECT_GT(second, first);
  sync();
  EXPECT_EQ(app.pdos.size(), 2U) << "delivered once";
}

TEST_F(PdoTest, only_operational_nodes_receive_and_what_waited_is_forgotten) {
  give(pack_rpdo2(kId, {111, 222}));
  nmt(NmtCommand::enter_pre_operational);
  give(pack_rpdo1(kId, {0x000F, 8}));
  sync();
  nmt(NmtCommand::start);
  sync();
  EXPECT_EQ(od.controlword, 0);
  EXPECT_EQ(od.target_position_urad, 0);
  EXPECT_TRUE(app.writes.empty());
}

TEST_F(PdoTest, a_short_pdo_is_an_emergency_without_effect_and_a_good_one_clears_it) {
  for (std::uint8_t n = 0; n < 8; ++n) {
    Frame f = pack_rpdo2(kId, {111, 222});
    f.length = n;
    give(f);
  }
  sync();
  EXPECT_EQ(od.target_position_urad, 0);
  EXPECT_TRUE(app.pdos.empty());
  EXPECT_EQ(od.count_rejected_pdos, 8U);
  EXPECT_EQ(od.error_register, 0x11);
  EXPECT_THAT(only(wait(30), 0x080 + kId),
              ::testing::ElementsAre(frame(0x080 + kId, {0x10, 0x82, 0x11, 2, 0, 8, 0, 0})));
  give(pack_rpdo2(kId, {111, 222}));
  EXPECT_EQ(od.error_register, 0);
  EXPECT_THAT(only(wait(30), 0x080 + kId), ::testing::ElementsAre(frame(0x080 + kId, {0, 0, 0, 0, 0, 0, 0, 0})));
}

TEST_F(PdoTest, a_longer_pdo_is_taken_by_its_first_bytes) {
  give(0x200 + kId, {0x0F, 0x00, 8, 0xEE, 0xEE});
  EXPECT_EQ(od.controlword, 0x000F);
}

TEST_F(PdoTest, one_value_out_of_range_and_the_whole_pdo_has_no_effect) {
  give(pack_rpdo1(kId, {0x000F, 3}));  // no such mode
  EXPECT_EQ(od.controlword, 0);
  EXPECT_EQ(od.count_rejected_pdos, 1U);
  EXPECT_TRUE(app.writes.empty());
  EXPECT_TRUE(app.pdos.empty());
}

TEST_F(PdoTest, disabled_pdos_are_not_received) {
  ASSERT_EQ(write(0x1400, 1, kOff | (0x200 + kId), 4), 0U);
  give(pack_rpdo1(kId, {0x000F, 8}));
  EXPECT_EQ(od.controlword, 0);
}

TEST_F(PdoTest, a_late_pdo_is_an_emergency_once_one_has_come) {
  ASSERT_EQ(write(0x1400, 5, 20, 2), 0U);
  EXPECT_TRUE(only(wait(100), 0x080 + kId).empty());
  give(pack_rpdo1(kId, {6, 0}));
  EXPECT_TRUE(only(wait(20), 0x080 + kId).empty());
  EXPECT_THAT(only(wait(1), 0x080 + kId),
              ::testing::ElementsAre(frame(0x080 + kId, {0x50, 0x82, 0x11, 1, 0, 0, 0, 0})));
  EXPECT_TRUE(only(wait(100), 0x080 + kId).empty()) << "told once";
  give(pack_rpdo1(kId, {6, 0}));
  EXPECT_EQ(only(wait(15), 0x080 + kId).size(), 1U) << "error reset";
}

TEST_F(PdoTest, dummies_fill_and_a_remapped_rpdo_delivers_what_it_now_carries) {
  ASSERT_EQ(map(0x1400, 0x200 + kId, {0x00050008, 0x60710010, 0x00060010}), 0U);
  give(0x200 + kId, {0x99, 0x34, 0x12, 0x77, 0x77});
  EXPECT_EQ(od.target_torque_permille, 0x1234);
  EXPECT_EQ(od.controlword, 0);
  give(0x200 + kId, {0x99, 0x78, 0x56, 0x77});
  EXPECT_EQ(od.target_torque_permille, 0x1234) << "the dummies count for the length";
}

// ---- selection ----

TEST_F(PdoTest, selection_arrives_whole_and_the_same_for_all) {
  const SelectionCommand c{0xA5A5A5A5, 17, 4321, 9, SelectionAction::arm};
  const Frame f = selection_frame(c);
  EXPECT_EQ(f, frame(0x181, {0xA5, 0xA5, 0xA5, 0xA5, 17, 0xE1, 0x10, 9}));
  give(f);
  EXPECT_THAT(app.selections, ::testing::ElementsAre(c));
  EXPECT_EQ(parse_selection(f), c);
  const SelectionCommand cancel{0, 0, 0, 31, SelectionAction::cancel};
  give(selection_frame(cancel));
  EXPECT_EQ(app.selections.back(), cancel);
}

TEST_F(PdoTest, a_selection_with_an_unknown_action_or_too_short_has_no_effect) {
  Frame f = selection_frame({1, 2, 3, 4, SelectionAction::now});
  f.data[7] = 0x60 | 4;
  give(f);
  EXPECT_EQ(parse_selection(f), std::nullopt);
  f = selection_frame({1, 2, 3, 4, SelectionAction::now});
  f.length = 7;
  give(f);
  EXPECT_EQ(parse_selection(f), std::nullopt);
  EXPECT_TRUE(app.selections.empty());
  EXPECT_EQ(od.selection_mask, 0U);
  EXPECT_EQ(od.count_rejected_pdos, 2U);
}

TEST_F(PdoTest, a_plain_client_may_select_by_sdo) {
  ASSERT_EQ(write(0x2010, 1, 0x00000004, 4), 0U);
  EXPECT_TRUE(app.selections.empty());
  ASSERT_EQ(write(0x2010, 4, 0x20 | 3, 1), 0U);
  EXPECT_THAT(app.selections, ::testing::ElementsAre(SelectionCommand{4, 0, 0, 3, SelectionAction::now}));
}

// ---- SYNC ----

TEST_F(PdoTest, sync_without_counter_is_told_and_one_with_a_byte_is_an_error) {
  sync();
  EXPECT_THAT(app.syncs, ::testing::ElementsAre(std::nullopt));
  sync(1);
  EXPECT_EQ(app.syncs.size(), 1U);
  EXPECT_EQ(od.error_register, 0x11);
  EXPECT_EQ(only(wait(1), 0x080 + kId).at(0), frame(0x080 + kId, {0x40, 0x82, 0x11, 1, 0, 0, 0, 0}));
  sync();
  EXPECT_EQ(od.error_register, 0);
}

TEST_F(PdoTest, sync_with_counter_wants_one_from_1_to_its_overflow) {
  ASSERT_EQ(write(0x1019, 0, 240, 1), 0U);
  sync(1);
  sync(240);
  sync(0);
  sync(241);
  sync();
  EXPECT_THAT(app.syncs, ::testing::ElementsAre(1, 240));
  EXPECT_EQ(od.count_sync, 2U);
}

TEST_F(PdoTest, counter_overflow_is_fixed_while_a_period_is_announced) {
  EXPECT_EQ(write(0x1019, 0, 1, 1), 0x06090030U);
  EXPECT_EQ(write(0x1019, 0, 241, 1), 0x06090031U);
  ASSERT_EQ(write(0x1006, 0, 4000, 4), 0U);
  EXPECT_EQ(write(0x1019, 0, 240, 1), 0x08000022U);
  ASSERT_EQ(write(0x1006, 0, 0, 4), 0U);
  EXPECT_EQ(write(0x1019, 0, 240, 1), 0U);
}

TEST_F(PdoTest, sync_is_told_in_pre_operational_and_not_in_stopped) {
  nmt(NmtCommand::enter_pre_operational);
  EXPECT_TRUE(sync().empty());
  EXPECT_EQ(app.syncs.size(), 1U);
  nmt(NmtCommand::stop);
  EXPECT_TRUE(sync().empty());
  EXPECT_EQ(app.syncs.size(), 1U);
}

// ---- sending ----

TEST_F(PdoTest, state_goes_out_with_every_sync) {
  od.statusword = 0x1637;
  od.modes_of_operation_display = -1;
  od.position_actual_urad = -123456;
  od.selection_acknowledged = 3;
  od.velocity_actual_urad_s = 42;
  od.torque_actual_permille = -7;
  od.error_or_limit = 0x8611;
  const auto sent = sync();
  ASSERT_EQ(sent.size(), 2U);
  EXPECT_EQ(sent[0].id, 0x180U + kId);
  EXPECT_EQ(unpack_tpdo1(sent[0]), (Tpdo1{0x1637, -1, -123456, 3}));
  EXPECT_EQ(sent[1].id, 0x280U + kId);
  EXPECT_EQ(unpack_tpdo2(sent[1]), (Tpdo2{42, -7, 0x8611}));
}

TEST_F(PdoTest, condition_goes_out_ten_times_a_second) {
  int changes = 0;
  std::size_t count = 0;
  for (int i = 0; i < 100; ++i) {
    od.bus_voltage_cv = static_cast<std::uint16_t>(4800 + ++changes % 7);
    count += tpdo(3, wait(10)).size();
  }
  EXPECT_EQ(count, 10U);
}

TEST_F(PdoTest, nothing_goes_out_unless_operational) {
  for (const NmtCommand c : {NmtCommand::enter_pre_operational, NmtCommand::stop}) {
    nmt(c);
    EXPECT_TRUE(sync().empty());
    for (const Frame& f : wait(500)) EXPECT_EQ(f.id, 0x700U + kId);
  }
}

TEST_F(PdoTest, type_n_goes_out_with_every_nth_sync) {
  for (const int n : {1, 2, 5, 240}) {
    ASSERT_EQ(write(0x1800, 2, static_cast<std::uint64_t>(n), 1), 0U);
    std::vector<int> when;
    for (int i = 1; i <= 3 * n; ++i) {
      if (!tpdo(1, sync()).empty()) when.push_back(i);
    }
    EXPECT_THAT(when, ::testing::ElementsAre(n, 2 * n, 3 * n));
  }
}

TEST_F(PdoTest, type_0_goes_out_at_the_sync_after_a_change) {
  ASSERT_EQ(write(0x1800, 2, 0, 1), 0U);
  EXPECT_EQ(tpdo(1, sync()).size(), 1U);
  EXPECT_EQ(tpdo(1, sync()).size(), 0U);
  od.statusword = 0x40;
  EXPECT_TRUE(tpdo(1, wait(10)).empty());
  EXPECT_EQ(tpdo(1, sync()).size(), 1U);
  EXPECT_EQ(tpdo(1, sync()).size(), 0U);
}

TEST_F(PdoTest, type_255_goes_out_on_change_not_faster_than_the_inhibit_time_and_by_event_timer) {
  ASSERT_EQ(write(0x1800, 1, kOff | 0x40000180 | kId, 4), 0U);
  ASSERT_EQ(write(0x1800, 2, 255, 1), 0U);
  ASSERT_EQ(write(0x1800, 3, 50, 2), 0U);  // 5 ms
  ASSERT_EQ(write(0x1800, 1, 0x40000180 | kId, 4), 0U);
  EXPECT_EQ(tpdo(1, wait(1)).size(), 1U) << "where things stand, first";
  EXPECT_EQ(tpdo(1, sync()).size(), 0U);
  EXPECT_EQ(tpdo(1, wait(100)).size(), 0U);
  std::size_t count = 0;
  for (int i = 0; i < 100; ++i) {
    od.position_actual_urad = i + 1;
    count += tpdo(1, wait(1)).size();
  }
  EXPECT_EQ(count, 20U);
  wait(10);
  ASSERT_EQ(write(0x1800, 5, 30, 2), 0U);
  EXPECT_EQ(tpdo(1, wait(300)).size(), 10U);
}

TEST_F(PdoTest, sync_start_value_delays_the_first_one) {
  ASSERT_EQ(write(0x1019, 0, 10, 1), 0U);
  EXPECT_EQ(write(0x1800, 6, 7, 1), 0x08000022U) << "while enabled";
  ASSERT_EQ(write(0x1800, 1, kOff | 0x40000180 | kId, 4), 0U);
  ASSERT_EQ(write(0x1800, 6, 7, 1), 0U);
  ASSERT_EQ(write(0x1800, 1, 0x40000180 | kId, 4), 0U);
  std::vector<int> when;
  for (int i = 1; i <= 12; ++i) {
    if (!tpdo(1, sync((i - 1) % 10 + 1)).empty()) when.push_back(i);
  }
  EXPECT_THAT(when, ::testing::ElementsAre(7, 8, 9, 10, 11, 12));
}

TEST_F(PdoTest, remapping_changes_what_goes_out) {
  ASSERT_EQ(map(0x1800, 0x40000180 | kId, {0x60770010, 0x60640020}), 0U);
  od.torque_actual_permille = 0x0102;
  od.position_actual_urad = 0x03040506;
  EXPECT_EQ(tpdo(1, sync()).at(0), frame(0x180 + kId, {0x02, 0x01, 0x06, 0x05, 0x04, 0x03}));
  ASSERT_EQ(map(0x1800, 0x40000190, {0x60640020}), 0U);
  EXPECT_EQ(only(sync(), 0x190).at(0).length, 4);
}

// ---- the order of configuration ----

TEST_F(PdoTest, mapping_is_fixed_while_enabled_and_entries_while_counted) {
  EXPECT_EQ(write(0x1A00, 0, 0, 1), 0x08000022U);
  EXPECT_EQ(write(0x1A00, 1, 0x60640020, 4), 0x08000022U);
  ASSERT_EQ(write(0x1800, 1, kOff | 0x40000180 | kId, 4), 0U);
  EXPECT_EQ(write(0x1A00, 1, 0x60640020, 4), 0x08000022U) << "still counted";
  ASSERT_EQ(write(0x1A00, 0, 0, 1), 0U);
  EXPECT_EQ(write(0x1A00, 1, 0x60640020, 4), 0U);
}

TEST_F(PdoTest, mapping_aborts_say_what_is_wrong) {
  ASSERT_EQ(write(0x1800, 1, kOff | 0x40000180 | kId, 4), 0U);
  ASSERT_EQ(write(0x1A00, 0, 0, 1), 0U);
  EXPECT_EQ(write(0x1A00, 1, 0x5FFF0008, 4), 0x06020000U);
  EXPECT_EQ(write(0x1A00, 1, 0x60640120, 4), 0x06090011U);
  EXPECT_EQ(write(0x1A00, 1, 0x60640010, 4), 0x06040041U) << "wrong length";
  EXPECT_EQ(write(0x1A00, 1, 0x10180120, 4), 0x06040041U) << "not mappable";
  EXPECT_EQ(write(0x1A00, 1, 0x60400010, 4), 0x06040041U) << "receive only";
  EXPECT_EQ(write(0x1A00, 1, 0x00050008, 4), 0x06020000U) << "dummies are for receiving";
  ASSERT_EQ(write(0x1A00, 1, 0x60640020, 4), 0U);
  ASSERT_EQ(write(0x1A00, 2, 0x606C0020, 4), 0U);
  ASSERT_EQ(write(0x1A00, 3, 0x60410010, 4), 0U);
  EXPECT_EQ(write(0x1A00, 0, 3, 1), 0x06040042U) << "ten bytes";
  EXPECT_EQ(write(0x1A00, 0, 9, 1), 0x06090031U);
  ASSERT_EQ(write(0x1A00, 3, 0, 4), 0U);
  EXPECT_NE(write(0x1A00, 0, 3, 1), 0U) << "an empty entry is counted";
  EXPECT_EQ(write(0x1A00, 0, 2, 1), 0U);
}

TEST_F(PdoTest, cob_ids_are_checked) {
  EXPECT_EQ(write(0x1800, 1, 0x40000190, 4), 0x06090030U) << "moved while enabled";
  ASSERT_EQ(write(0x1800, 1, kOff | 0x40000180 | kId, 4), 0U);
  EXPECT_EQ(write(0x1800, 1, 0x180 + kId, 4), 0x06090030U) << "remote requests are not answered";
  EXPECT_EQ(write(0x1800, 1, 0x60000190, 4), 0x06090030U) << "29 bit";
  for (const std::uint64_t id : {0x000U, 0x07FU, 0x101U, 0x180U, 0x581U, 0x605U, 0x6E0U, 0x701U, 0x7FFU}) {
    EXPECT_EQ(write(0x1800, 1, 0x40000000 | id, 4), 0x06090030U) << std::hex << id;
  }
  EXPECT_EQ(write(0x1800, 1, 0x40000190, 4), 0U);
  EXPECT_EQ(write(0x1005, 0, 0x40000080, 4), 0x06090030U) << "a module makes no SYNC";
}

TEST_F(PdoTest, reserved_transmission_types_are_refused) {
  for (std::uint64_t t = 241; t < 254; ++t) EXPECT_EQ(write(0x1800, 2, t, 1), 0x06090030U);
  for (const std::uint64_t t : {0U, 1U, 240U, 254U, 255U}) EXPECT_EQ(write(0x1800, 2, t, 1), 0U);
}

// ---- EMCY ----

TEST_F(PdoTest, an_error_is_told_once_its_end_too_and_the_register_tells_what_remains) {
  node.raise(Emergency::over_current, {1, 2, 3, 4, 5}, now);
  node.raise(Emergency::over_current, {9, 9, 9, 9, 9}, now);
  node.raise(Emergency::encoder, now);
  node.clear(Emergency::over_current, now);
  node.clear(Emergency::over_current, now);
  node.clear(Emergency::torque_sensor, now);
  EXPECT_THAT(only(wait(100), 0x080 + kId),
              ::testing::ElementsAre(frame(0x080 + kId, {0x10, 0x23, 0x03, 1, 2, 3, 4, 5}),
                                     frame(0x080 + kId, {0x05, 0x73, 0x03, 0, 0, 0, 0, 0}),
                                     frame(0x080 + kId, {0, 0, 0x01, 0, 0, 0, 0, 0})));
  EXPECT_TRUE(node.is_present(Emergency::encoder));
  EXPECT_EQ(parse_emergency(frame(0x080 + kId, {0x10, 0x23, 0x03, 1, 2, 3, 4, 5}))->code,
            static_cast<std::uint16_t>(Emergency::over_current));
}

TEST_F(PdoTest, emergencies_keep_their_inhibit_time_and_their_place) {
  ASSERT_EQ(write(0x1015, 0, 500, 2), 0U);  // 50 ms
  node.raise(Emergency::over_current, now);
  node.raise(Emergency::encoder, now);
  EXPECT_EQ(only(wait(1), 0x080 + kId).size(), 1U);
  EXPECT_EQ(only(wait(49), 0x080 + kId).size(), 0U);
  EXPECT_EQ(only(wait(1), 0x080 + kId).size(), 1U);
  ASSERT_EQ(write(0x1014, 0, kOff | (0x080 + kId), 4), 0U);
  node.raise(Emergency::torque_sensor, now);
  EXPECT_EQ(only(wait(200), 0x080 + kId).size(), 0U) << "disabled";
}

TEST_F(PdoTest, a_storm_of_errors_stays_bounded) {
  for (int i = 0; i < 10000; ++i) {
    Frame f = pack_rpdo2(kId, {1, 2});
    f.length = i % 2 ? 8 : 3;
    give(f);
  }
  EXPECT_LE(only(wait(1000), 0x080 + kId).size(), 16U);
  EXPECT_EQ(od.error_history_count, 8);
}

TEST_F(PdoTest, a_full_transmit_queue_loses_frames_counts_them_and_says_so_later) {
  TransmitQueue full;
  while (full.push_back(Frame{})) {
  }
  node.handle({sync_frame(std::nullopt), now}, full);
  EXPECT_EQ(od.count_transmit_overflow, 2U);
  const auto sent = only(wait(30), 0x080 + kId);
  ASSERT_EQ(sent.size(), 2U);
  EXPECT_EQ(get<std::uint16_t>(sent[0].data.data()), 0x8110);
  EXPECT_EQ(get<std::uint16_t>(sent[1].data.data()), 0x0000);
}

TEST_F(PdoTest, after_bus_off_nothing_stale_is_delivered) {
  give(pack_rpdo2(kId, {111, 222}));
  node.bus_off(now);
  node.bus_recovered(now);
  sync();
  EXPECT_EQ(od.target_position_urad, 0);
  EXPECT_EQ(od.count_bus_off, 1U);
  EXPECT_EQ(get<std::uint16_t>(only(wait(1), 0x080 + kId).at(0).data.data()), 0x8140);
}

}  // namespace
}  // namespace mrr::can
