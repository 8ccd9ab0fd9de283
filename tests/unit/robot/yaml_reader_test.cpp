#include "common/robot/yaml_reader.h"

#include <gtest/gtest.h>

#include <numbers>

#include "tests/unit/robot/sentence.h"

namespace mrr {
namespace {

using test::complaint;
using test::expect_one_sentence;
using testing::HasSubstr;

YamlReader reader(const std::string& text) { return YamlReader::from_text(text, "file.yaml"); }

double torque(const std::string& text) { return reader("x: " + text).number("x", Unit::torque, Range::at_least(0.0)); }

TEST(YamlReader, ReadsNumbersInSi) {
  EXPECT_DOUBLE_EQ(torque("16 Nm"), 16.0);
  EXPECT_DOUBLE_EQ(torque("16Nm"), 16.0);
  EXPECT_DOUBLE_EQ(torque("\"16 Nm\""), 16.0);
  EXPECT_DOUBLE_EQ(torque("+1.6e1  Nm"), 16.0);
  EXPECT_DOUBLE_EQ(torque("16 mNm"), 0.016);
  const auto read = [](const std::string& text, Unit unit) {
    return reader("x: " + text).number("x", unit, Range::any());
  };
  EXPECT_DOUBLE_EQ(read("50 1/s", Unit::rate), 50.0);
  EXPECT_DOUBLE_EQ(read("180 deg", Unit::angle), std::numbers::pi);
  EXPECT_DOUBLE_EQ(read("60 rpm", Unit::angular_velocity), 2.0 * std::numbers::pi);
  EXPECT_DOUBLE_EQ(read("2 g cm^2", Unit::inertia), 2e-7);
  EXPECT_DOUBLE_EQ(read("2 g*cm^2", Unit::inertia), 2e-7);
  EXPECT_DOUBLE_EQ(read("3 Nm s / rad", Unit::torsional_damping), 3.0);
  EXPECT_DOUBLE_EQ(read("1 kHz", Unit::frequency), 1000.0);
  EXPECT_DOUBLE_EQ(read("-0.25", Unit::none), -0.25);
}

TEST(YamlReader, EveryUnitSpellingReadsBackWithItsFactor) {
  int spellings = 0;
  for (int u = 1; u <= static_cast<int>(Unit::bit_rate); ++u) {
    const auto unit = static_cast<Unit>(u);
    ASSERT_FALSE(unit_spellings(unit).empty()) << unit_meaning(unit);
    EXPECT_EQ(unit_spellings(unit).front().to_si, 1.0) << unit_meaning(unit);
    for (const auto& spelling : unit_spellings(unit)) {
      const std::string text = "x: 2 " + std::string(spelling.text);
      EXPECT_DOUBLE_EQ(reader(text).number("x", unit, Range::any()), 2.0 * spelling.to_si) << text;
      ++spellings;
    }
  }
  EXPECT_GT(spellings, 50);
}

TEST(YamlReader, NoTwoUnitsShareASpelling) {
  for (int a = 1; a <= static_cast<int>(Unit::bit_rate); ++a) {
    for (int b = 1; b < a; ++b) {
      for (const auto& x : unit_spellings(static_cast<Unit>(a))) {
        for (const auto& y : unit_spellings(static_cast<Unit>(b))) EXPECT_NE(x.text, y.text);
      }
    }
  }
}

TEST(YamlReader, ReadsListsAsTextOrSequence) {
  const auto as_text = reader("x: 1 2 3 mm").numbers<3>("x", Unit::length, Range::any());
  const auto as_commas = reader("x: 1, 2, 3 mm").numbers<3>("x", Unit::length, Range::any());
  const auto as_list = reader("x: [1 mm, 2 mm, 0.3 cm]").numbers<3>("x", Unit::length, Range::any());
  for (std::size_t i = 0; i < 3; ++i) {
    EXPECT_DOUBLE_EQ(as_text[i], 1e-3 * static_cast<double>(i + 1));
    EXPECT_DOUBLE_EQ(as_commas[i], as_text[i]);
    EXPECT_DOUBLE_EQ(as_list[i], as_text[i]);
  }
  EXPECT_EQ(reader("x: 1 2 50 1/s").numbers("x", Unit::rate, Range::any(), 1, 5).size(), 3U);
}

TEST(YamlReader, ReadsOtherTypesAndDefaults) {
  const YamlReader r = reader("a: 5\nb: true\nc: blue\nd: {e: 1}\nf: [{g: 1}, {g: 2}]\nh: [x, y]");
  EXPECT_EQ(r.integer("a", 0, 9), 5);
  EXPECT_TRUE(r.boolean("b"));
  EXPECT_EQ((r.choice<int>("c", {{"red", 1}, {"blue", 2}})), 2);
  EXPECT_EQ((r.choice<int>("c2", {{"red", 1}, {"blue", 2}}, 1)), 1);
  EXPECT_EQ(r.section("d").number("e", Unit::none, Range::any()), 1.0);
  EXPECT_EQ(r.section("d").path(), "d");
  ASSERT_EQ(r.sections("f").size(), 2U);
  EXPECT_EQ(r.sections("f")[1].number("g", Unit::none, Range::any()), 2.0);
  EXPECT_EQ(r.sections("f")[0].number("g", Unit::none, Range::any()), 1.0);
  EXPECT_EQ(r.texts("h", 1), (std::vector<std::string>{"x", "y"}));
  EXPECT_EQ(r.integer("n", 0, 9, 7), 7);
  EXPECT_FALSE(r.boolean("m", false));
  EXPECT_EQ(r.text("t", "dflt"), "dflt");
  EXPECT_EQ(r.number("q", Unit::torque, Range::any(), 2.5), 2.5);
  EXPECT_FALSE(r.optional_section("s").has_value());
  EXPECT_EQ((r.numbers<2>("v", Unit::none, Range::any(), {1.0, 2.0}))[1], 2.0);
  EXPECT_EQ(complaint([&] { return r.finish(), 0; }), "");
}

struct BadNumber {
  const char* value;
  const char* says;
};

class BadTorque : public testing::TestWithParam<BadNumber> {};

TEST_P(BadTorque, IsOneClearSentence) {
  const std::string text = complaint([] { return torque(GetParam().value); });
  expect_one_sentence(text);
  EXPECT_THAT(text, HasSubstr("file.yaml, line 1: x is "));
  EXPECT_THAT(text, HasSubstr(GetParam().says));
}

INSTANTIATE_TEST_SUITE_P(Table, BadTorque,
                         testing::Values(BadNumber{"16", "needs a unit: write Nm or mNm"},
                                         BadNumber{"16 A", "'A' is the unit of a current; give a torque in Nm or mNm"},
                                         BadNumber{"16 Nmm", "'Nmm' is not a known unit"},  //
                                         BadNumber{"Nm", "must be a torque"},               //
                                         BadNumber{"sixteen Nm", "must be a torque"},       //
                                         BadNumber{"nan Nm", "must be finite"},             //
                                         BadNumber{".nan", "must be a torque"},             //
                                         BadNumber{"inf Nm", "must be finite"},             //
                                         BadNumber{"-.inf", "must be a torque"},            //
                                         BadNumber{"1e999 Nm", "must be finite"},           //
                                         BadNumber{"0x10 Nm", "not a known unit"},          //
                                         BadNumber{"1,5 Nm", "must be one number"},         //
                                         BadNumber{"1 2 Nm", "must be one number"},         //
                                         BadNumber{"-1 Nm", "must be at least 0 Nm"},       //
                                         BadNumber{"[1 Nm]", "a list, but must be a torque"},
                                         BadNumber{"{a: 1}", "a section, but must be a torque"},  //
                                         BadNumber{"", "empty, but must be a torque"},            //
                                         BadNumber{"~", "empty, but must be a torque"},           //
                                         BadNumber{"\"1 Nm\\n2 Nm\"", "not a known unit"}));

TEST(YamlReader, RangesNameBothBoundsAndExcludeNan) {
  const auto read = [](const std::string& text) {
    return complaint([&] { return reader("x: " + text).number("x", Unit::none, {0.0, 1.0, true, false}); });
  };
  EXPECT_EQ(read("1"), "");
  EXPECT_EQ(read("0"), "file.yaml, line 1: x is '0', but must be above 0 and at most 1.");
  EXPECT_EQ(read("1.01"), "file.yaml, line 1: x is '1.01', but must be above 0 and at most 1.");
  EXPECT_FALSE(Range::any().contains(std::numeric_limits<double>::quiet_NaN()));
}

TEST(YamlReader, UnitOnAPlainNumberIsRefused) {
  expect_one_sentence(complaint([] { return reader("x: 1 Nm").number("x", Unit::none, Range::any()); }));
}

TEST(YamlReader, WrongTypesAreOneSentence) {
  const YamlReader r = reader("a: 1.5\nb: yes\nc: green\nd: 1\ne: 99999999999999999999\nf: [1]\ng: ''\nh: [1, {b: 1}]");
  for (const std::string& text : {
           complaint([&] { return r.integer("a", 0, 9); }),
           complaint([&] { return r.integer("e", 0, 9); }),
           complaint([&] { return r.integer("d", 2, 9); }),
           complaint([&] { return r.integer("f", 0, 9); }),
           complaint([&] { return r.boolean("b"); }),
           complaint([&] { return r.boolean("f"); }),
           complaint([&] {
             return r.choice<int>("c", {{"red", 1}, {"blue", 2}});
           }),
           complaint([&] { return r.section("d"); }),
           complaint([&] { return r.sections("d"); }),
           complaint([&] { return r.sections("f"); }),
           complaint([&] { return r.sections("f", 2); }),
           complaint([&] { return r.text("g"); }),
           complaint([&] { return r.text("f"); }),
           complaint([&] { return r.texts("h", 1); }),
           complaint([&] { return r.numbers<3>("f", Unit::none, Range::any()); }),
       }) {
    expect_one_sentence(text);
  }
}

TEST(YamlReader, MissingKeyIsNamedWithWhatToAdd) {
  EXPECT_EQ(
      complaint([] { return reader("a: {b: 1}").section("a").number("peak", Unit::current, Range::positive(9)); }),
      "file.yaml, line 1: a.peak is missing; add it as a current (A or mA) above 0 A and at most 9 A.");
}

TEST(YamlReader, MisspeltKeyIsSuggested) {
  EXPECT_THAT(complaint([] { return reader("raated: 1 Nm").number("rated", Unit::torque, Range::any()); }),
              HasSubstr("rated is missing; is 'raated' a misspelling of it?"));
  const YamlReader r = reader("s:\n  good: 1\n  dalay: 2 ms");
  (void)r.section("s").number("good", Unit::none, Range::any());
  (void)r.section("s").number("delay", Unit::time, Range::any(), 0.0);
  EXPECT_EQ(complaint([&] { return r.finish(), 0; }),
            "file.yaml, line 3: s.dalay is not a known key; did you mean 'delay'?");
}

TEST(YamlReader, UnknownKeysAreFoundInListsAndWholeSections) {
  const YamlReader r = reader("f: [{g: 1, zzzzzz: 2}]");
  (void)r.sections("f")[0].number("g", Unit::none, Range::any());
  EXPECT_THAT(complaint([&] { return r.finish(), 0; }), HasSubstr("f[0].zzzzzz is not a known key"));
  EXPECT_THAT(complaint([] { return reader("extra: {a: 1}").finish(), 0; }), HasSubstr("extra is not a known key"));
}

TEST(YamlReader, BrokenFilesAreOneSentence) {
  for (const char* text :
       {"", "# only a comment\n", "a: [1, 2", "a: 1\n b: 2", "- 1\n- 2", "just text", "a: 1\n---\nb: 2", "a: 1\na: 2",
        "{a: 1, a: 2}", "a: *nowhere", "? [1, 2]\n: 3", "a: \"unclosed", "\t- x"}) {
    SCOPED_TRACE(text);
    expect_one_sentence(complaint([&] { return reader(text); }));
  }
  EXPECT_THAT(complaint([] { return reader("a: {b: 1, c: 2}\nd:\n  b: 1\n  b: 2").section("d"); }),
              HasSubstr("line 4: d.b is given twice"));
  expect_one_sentence(complaint([] { return YamlReader::from_file("/nowhere/robot.yaml"); }));
  expect_one_sentence(complaint([] { return YamlReader::from_file("/"); }));
}

TEST(YamlReader, CrossChecksNameTheValue) {
  const YamlReader r = reader("a:\n  b: 3 Nm\n");
  const YamlReader a = r.section("a");
  EXPECT_EQ(complaint([&]() -> int { a.fail("b", "must be below c"); }),
            "file.yaml, line 2: a.b is '3 Nm', but must be below c.");
  EXPECT_THAT(complaint([&]() -> int { a.fail("c", "must be above b"); }),
              HasSubstr("a.c is left out, but must be above b."));
  EXPECT_THAT(complaint([&]() -> int { a.fail("something is off"); }), HasSubstr(": a: something is off."));
}

}  // namespace
}  // namespace mrr
