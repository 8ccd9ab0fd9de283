#include "can_protocol/units.h"

#include <gtest/gtest.h>

#include <cmath>

#include "can_protocol/client.h"
#include "common/core/random.h"

namespace mrr::can {
namespace {

TEST(Units, nothing_comes_of_a_nan) {
  EXPECT_EQ(urad_from_rad(std::nan("")), std::nullopt);
  EXPECT_EQ(urad_from_rad(std::nanf("")), std::nullopt);
  EXPECT_EQ(permille_from_nm(std::nan(""), 47000), std::nullopt);
  EXPECT_EQ(permille_from_nm(1.0, 0), std::nullopt);
}

TEST(Units, out_of_range_saturates_in_float_and_in_double) {
  const double inf = std::numeric_limits<double>::infinity();
  for (const double big : {2147.483648, 1e9, 1e300, inf}) {
    EXPECT_EQ(urad_from_rad(big), 2147483647);
    EXPECT_EQ(urad_from_rad(-big), -2147483647 - 1);
    EXPECT_EQ(urad_from_rad(static_cast<float>(big)), 2147483647);
    EXPECT_EQ(urad_from_rad(static_cast<float>(-big)), -2147483647 - 1);
  }
  EXPECT_EQ(permille_from_nm(1000.0, 1000), 32767);
  EXPECT_EQ(permille_from_nm(-1000.0, 1000), -32768);
  EXPECT_EQ((to_counts<std::uint8_t>(-0.6, 1.0)), 0);
  EXPECT_EQ((to_counts<std::uint8_t>(254.6, 1.0)), 255);
}

TEST(Units, rounds_to_the_nearest_count) {
  EXPECT_EQ(urad_from_rad(1.0), 1000000);
  EXPECT_EQ(urad_from_rad(1.4e-6), 1);
  EXPECT_EQ(urad_from_rad(1.6e-6), 2);
  EXPECT_EQ(urad_from_rad(-1.6e-6), -2);
  EXPECT_EQ(permille_from_nm(23.5, 47000), 500);
  EXPECT_DOUBLE_EQ(nm_from_permille(500, 47000), 23.5);
  EXPECT_EQ(mrad_s2_from_rad_s2(-3.25), -3250);
  EXPECT_DOUBLE_EQ(rad_s2_from_mrad_s2(-3250), -3.25);
}

TEST(Units, every_count_survives_the_way_there_and_back) {
  Random random(1);
  for (int i = 0; i < 100000; ++i) {
    const auto count = static_cast<std::int32_t>(random.next());
    ASSERT_EQ(urad_from_rad(rad_from_urad(count)), count);
    ASSERT_EQ(urad_s_from_rad_s(rad_s_from_urad_s(count)), count);
    const auto torque = static_cast<std::int16_t>(random.next());
    ASSERT_EQ(permille_from_nm(nm_from_permille(torque, 47000), 47000), torque);
  }
}

TEST(Pdos, what_is_packed_is_unpacked) {
  Random random(2);
  for (int i = 0; i < 1000; ++i) {
    const Rpdo2 knot{static_cast<std::int32_t>(random.next()), static_cast<std::int32_t>(random.next())};
    const Frame f = pack_rpdo2(7, knot);
    EXPECT_EQ(f.id, 0x307U);
    EXPECT_EQ(unpack_rpdo2(f), knot);
    const Tpdo3 condition{static_cast<std::int16_t>(random.next()), static_cast<std::int16_t>(random.next()),
                          static_cast<std::int8_t>(random.next()), static_cast<std::uint16_t>(random.next()),
                          static_cast<std::uint8_t>(random.next())};
    EXPECT_EQ(unpack_tpdo3(pack_tpdo3(7, condition)), condition);
  }
}

TEST(Pdos, short_remote_and_extended_frames_are_not_unpacked) {
  Frame f = pack_tpdo1(7, {});
  EXPECT_TRUE(unpack_tpdo1(f));
  f.length = 7;
  EXPECT_FALSE(unpack_tpdo1(f));
  f.length = 8;
  f.remote = true;
  EXPECT_FALSE(unpack_tpdo1(f));
  f.remote = false;
  f.extended = true;
  EXPECT_FALSE(unpack_tpdo1(f));
}

TEST(Messages, only_well_formed_ones_are_read) {
  EXPECT_EQ(parse_heartbeat(heartbeat_frame(9, NmtState::operational))->state, NmtState::operational);
  Frame f = heartbeat_frame(9, NmtState::operational);
  f.data[0] = 6;
  EXPECT_FALSE(parse_heartbeat(f));
  f = heartbeat_frame(9, NmtState::operational);
  f.length = 2;
  EXPECT_FALSE(parse_heartbeat(f));
  f = heartbeat_frame(0, NmtState::operational);
  EXPECT_FALSE(parse_heartbeat(f));
  EXPECT_FALSE(parse_emergency(sync_frame(1)));
}

TEST(Dictionary, table_is_sorted_inside_the_struct_and_overlaps_nowhere) {
  std::array<int, sizeof(ObjectDictionary)> used{};
  for (std::size_t i = 0; i < kEntryCount; ++i) {
    const Entry& e = kEntries[i];
    if (i > 0) {
      EXPECT_LT(kEntries[i - 1].index << 8 | kEntries[i - 1].sub, e.index << 8 | e.sub);
    }
    ASSERT_LE(static_cast<std::size_t>(e.offset + e.size), sizeof(ObjectDictionary));
    ASSERT_LE(e.size, kMaxObjectSize);
    for (std::size_t b = e.offset; b < static_cast<std::size_t>(e.offset + e.size); ++b) {
      EXPECT_EQ(used[b]++, 0) << std::hex << e.index;
    }
    EXPECT_EQ(find_entry(e.index, e.sub), &e);
    EXPECT_EQ(&entry_of(id_of(e)), &e);
  }
  EXPECT_EQ(&entry_of(ObjectId::statusword), find_entry(0x6041, 0));
  EXPECT_EQ(find_entry(0xFFFF, 0xFF), nullptr);
}

TEST(Dictionary, every_default_is_within_its_own_limits) {
  const ObjectDictionary od;
  for (const Entry& e : kEntries) {
    EXPECT_EQ(check_value(e, read_value(od, e)), Abort::none) << std::hex << e.index << ":" << int{e.sub};
  }
  EXPECT_EQ(od.protocol_hash, kProtocolHash);
}

TEST(Dictionary, codes_have_names) {
  EXPECT_STREQ(name_of_code(0x8611), "following_error");
  EXPECT_STREQ(name_of_code(7), "thermal");
  EXPECT_STREQ(name_of_code(0), "none");
  EXPECT_STREQ(name_of_code(0x7777), "unknown");
}

}  // namespace
}  // namespace mrr::can
