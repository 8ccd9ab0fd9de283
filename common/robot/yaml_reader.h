// Room: common/robot. Reads YAML files key by key and checks every value: presence, type, unit, range. Host only.
// Used by every YAML file of the product; may touch yaml-cpp (hidden in the .cpp) and nothing else.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "common/robot/errors.h"

namespace mrr {

/// What a value measures. A file writes the unit after the number ("16 Nm", "1 kHz"); the reader returns SI.
/// The accepted spellings of each are in unit_spellings(); the first one is SI.
enum class Unit : std::uint8_t {
  none,                  ///< a plain number
  length,                ///< m mm cm um
  angle,                 ///< rad mrad deg
  time,                  ///< s ms us min h
  mass,                  ///< kg g
  velocity,              ///< m/s mm/s
  angular_velocity,      ///< rad/s mrad/s deg/s rpm
  acceleration,          ///< m/s^2
  angular_acceleration,  ///< rad/s^2 deg/s^2
  angular_jerk,          ///< rad/s^3 deg/s^3
  force,                 ///< N mN kN
  torque,                ///< Nm mNm
  torque_rate,           ///< Nm/s
  impulse,               ///< N s
  inertia,               ///< kg m^2, kg cm^2, g cm^2
  stiffness,             ///< N/m, N/mm
  torsional_stiffness,   ///< Nm/rad
  damping,               ///< N s/m
  torsional_damping,     ///< Nm s/rad
  contact_damping,       ///< s/m (damping per elastic force, F = k d (1 + c d'))
  stribeck_decay,        ///< s^2/rad^2
  torque_constant,       ///< Nm/A, mNm/A
  current,               ///< A mA
  voltage,               ///< V mV
  resistance,            ///< Ohm mOhm
  inductance,            ///< H mH uH
  power,                 ///< W mW
  temperature,           ///< degC
  temperature_rise,      ///< K
  thermal_resistance,    ///< K/W
  frequency,             ///< Hz kHz MHz
  rate,                  ///< 1/s
  bit_rate,              ///< bit/s kbit/s Mbit/s
};

/// One way to write a unit and the factor that takes a number written with it to SI.
struct UnitSpelling {
  std::string_view text;
  double to_si;
};

/// Every accepted spelling of `unit`, the SI one first; empty for Unit::none.
[[nodiscard]] std::vector<UnitSpelling> unit_spellings(Unit unit);
/// Plain words: "a torque", "an angle", ...
[[nodiscard]] std::string_view unit_meaning(Unit unit);

/// The values allowed, in SI. NaN is never inside.
struct Range {
  double lo = -std::numeric_limits<double>::infinity();
  double hi = std::numeric_limits<double>::infinity();
  bool lo_open = false;  ///< lo itself is not allowed
  bool hi_open = false;

  static constexpr Range any() { return {}; }
  static constexpr Range at_least(double lo) { return {lo, std::numeric_limits<double>::infinity(), false, false}; }
  static constexpr Range above(double lo) { return {lo, std::numeric_limits<double>::infinity(), true, false}; }
  /// Above 0 up to and including hi.
  static constexpr Range positive(double hi = std::numeric_limits<double>::infinity()) {
    return {0.0, hi, true, false};
  }
  [[nodiscard]] constexpr bool contains(double x) const {
    return (lo_open ? x > lo : x >= lo) && (hi_open ? x < hi : x <= hi);
  }
};

/// One section (a YAML mapping) of a file. Copies are cheap handles onto the same section.
///
/// Every error is a DescriptionError of one sentence naming file, line, full key, value, what is allowed and what to
/// do. Keys which nobody asked for are errors too: call finish() on the top section after the last read.
///
///     YamlReader file = YamlReader::from_file("robot.yaml");
///     YamlReader motor = file.section("motor");
///     double current_a = motor.number("peak_current", Unit::current, Range::positive(100.0));
///     double delay_s = motor.number("delay", Unit::time, Range::at_least(0.0), 0.0);   // optional, with its default
///     file.finish();
class YamlReader {
 public:
  /// Reads and parses the file. Errors: missing, unreadable, not YAML, several documents, duplicate keys.
  static YamlReader from_file(const std::filesystem::path& file);
  /// Parses `content`; `name` stands for the file in error sentences.
  static YamlReader from_text(const std::string& content, const std::string& name);

  [[nodiscard]] bool has(std::string_view key) const;
  /// Keys of this section in file order; for sections whose keys are names (joints by name).
  [[nodiscard]] std::vector<std::string> keys() const;

  /// A required sub-section.
  [[nodiscard]] YamlReader section(std::string_view key) const;
  /// An optional sub-section.
  [[nodiscard]] std::optional<YamlReader> optional_section(std::string_view key) const;
  /// A list of sub-sections; at least `min_count` of them. A missing key is an empty list if min_count is 0.
  [[nodiscard]] std::vector<YamlReader> sections(std::string_view key, std::size_t min_count = 0) const;

  /// A number with its unit, returned in SI.
  [[nodiscard]] double number(std::string_view key, Unit unit, Range range) const;
  [[nodiscard]] double number(std::string_view key, Unit unit, Range range, double fallback) const;
  /// Numbers that share one unit, written "1 2 3 Nm", or as a list "[1 Nm, 2 Nm, 3 Nm]"; returned in SI.
  [[nodiscard]] std::vector<double> numbers(std::string_view key, Unit unit, Range range, std::size_t min_count,
                                            std::size_t max_count) const;
  template <std::size_t N>
  [[nodiscard]] std::array<double, N> numbers(std::string_view key, Unit unit, Range range) const {
    const std::vector<double> values = numbers(key, unit, range, N, N);
    std::array<double, N> result{};
    for (std::size_t i = 0; i < N; ++i) result[i] = values[i];
    return result;
  }
  template <std::size_t N>
  [[nodiscard]] std::array<double, N> numbers(std::string_view key, Unit unit, Range range,
                                              const std::array<double, N>& fallback) const {
    return has(key) ? numbers<N>(key, unit, range) : (mark_known(key), fallback);
  }

  [[nodiscard]] std::int64_t integer(std::string_view key, std::int64_t lo, std::int64_t hi) const;
  [[nodiscard]] std::int64_t integer(std::string_view key, std::int64_t lo, std::int64_t hi,
                                     std::int64_t fallback) const;
  [[nodiscard]] bool boolean(std::string_view key) const;
  [[nodiscard]] bool boolean(std::string_view key, bool fallback) const;
  /// Text that is not empty.
  [[nodiscard]] std::string text(std::string_view key) const;
  [[nodiscard]] std::string text(std::string_view key, std::string_view fallback) const;
  [[nodiscard]] std::vector<std::string> texts(std::string_view key, std::size_t min_count) const;

  /// One of the named values.
  template <typename T>
  [[nodiscard]] T choice(std::string_view key, const std::vector<std::pair<std::string, T>>& options) const {
    std::vector<std::string> names;
    for (const auto& option : options) names.push_back(option.first);
    return options[choice_index(key, names)].second;
  }
  template <typename T>
  [[nodiscard]] T choice(std::string_view key, const std::vector<std::pair<std::string, T>>& options,
                         T fallback) const {
    return has(key) ? choice(key, options) : (mark_known(key), fallback);
  }

  /// For checks across keys: throws "FILE, line N: PATH.key is 'VALUE', but PROBLEM.", or, for a section or list,
  /// "PATH.key: PROBLEM."; `problem` says what to do instead.
  [[noreturn]] void fail(std::string_view key, const std::string& problem) const;
  /// For checks of the whole section: throws "FILE, line N: PATH: PROBLEM."
  [[noreturn]] void fail(const std::string& problem) const;

  /// Throws if this section, or one read through it, holds a key that nobody asked for; suggests the nearest known one.
  void finish() const;

  /// Full path of this section, "joints.joint_2.motor"; empty at the top.
  [[nodiscard]] const std::string& path() const;
  [[nodiscard]] const std::string& file() const;

 private:
  struct Section;
  explicit YamlReader(std::shared_ptr<Section> section);
  void mark_known(std::string_view key) const;
  [[nodiscard]] std::size_t choice_index(std::string_view key, const std::vector<std::string>& names) const;

  std::shared_ptr<Section> section_;
};

}  // namespace mrr
