// Room: common/robot. See yaml_reader.h.
#include "common/robot/yaml_reader.h"

#include <yaml-cpp/yaml.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <map>
#include <numbers>
#include <sstream>

namespace mrr {
namespace {

constexpr std::uintmax_t kMaxFileBytes = 1U << 20U;
constexpr double kDegree = std::numbers::pi / 180.0;
constexpr double kRpm = 2.0 * std::numbers::pi / 60.0;

struct UnitEntry {
  Unit unit;
  UnitSpelling spelling;
};

// The SI spelling of each unit comes first.
constexpr UnitEntry kUnits[] = {
    {Unit::length, {"m", 1.0}},
    {Unit::length, {"mm", 1e-3}},
    {Unit::length, {"cm", 1e-2}},
    {Unit::length, {"um", 1e-6}},
    {Unit::angle, {"rad", 1.0}},
    {Unit::angle, {"mrad", 1e-3}},
    {Unit::angle, {"deg", kDegree}},
    {Unit::time, {"s", 1.0}},
    {Unit::time, {"ms", 1e-3}},
    {Unit::time, {"us", 1e-6}},
    {Unit::time, {"min", 60.0}},
    {Unit::time, {"h", 3600.0}},
    {Unit::mass, {"kg", 1.0}},
    {Unit::mass, {"g", 1e-3}},
    {Unit::velocity, {"m/s", 1.0}},
    {Unit::velocity, {"mm/s", 1e-3}},
    {Unit::angular_velocity, {"rad/s", 1.0}},
    {Unit::angular_velocity, {"mrad/s", 1e-3}},
    {Unit::angular_velocity, {"deg/s", kDegree}},
    {Unit::angular_velocity, {"rpm", kRpm}},
    {Unit::acceleration, {"m/s^2", 1.0}},
    {Unit::angular_acceleration, {"rad/s^2", 1.0}},
    {Unit::angular_acceleration, {"deg/s^2", kDegree}},
    {Unit::angular_jerk, {"rad/s^3", 1.0}},
    {Unit::angular_jerk, {"deg/s^3", kDegree}},
    {Unit::force, {"N", 1.0}},
    {Unit::force, {"mN", 1e-3}},
    {Unit::force, {"kN", 1e3}},
    {Unit::torque, {"Nm", 1.0}},
    {Unit::torque, {"mNm", 1e-3}},
    {Unit::torque_rate, {"Nm/s", 1.0}},
    {Unit::impulse, {"N s", 1.0}},
    {Unit::impulse, {"Ns", 1.0}},
    {Unit::inertia, {"kg m^2", 1.0}},
    {Unit::inertia, {"kg cm^2", 1e-4}},
    {Unit::inertia, {"g cm^2", 1e-7}},
    {Unit::stiffness, {"N/m", 1.0}},
    {Unit::stiffness, {"N/mm", 1e3}},
    {Unit::torsional_stiffness, {"Nm/rad", 1.0}},
    {Unit::damping, {"N s/m", 1.0}},
    {Unit::damping, {"Ns/m", 1.0}},
    {Unit::torsional_damping, {"Nm s/rad", 1.0}},
    {Unit::torsional_damping, {"Nms/rad", 1.0}},
    {Unit::contact_damping, {"s/m", 1.0}},
    {Unit::stribeck_decay, {"s^2/rad^2", 1.0}},
    {Unit::torque_constant, {"Nm/A", 1.0}},
    {Unit::torque_constant, {"mNm/A", 1e-3}},
    {Unit::current, {"A", 1.0}},
    {Unit::current, {"mA", 1e-3}},
    {Unit::voltage, {"V", 1.0}},
    {Unit::voltage, {"mV", 1e-3}},
    {Unit::resistance, {"Ohm", 1.0}},
    {Unit::resistance, {"mOhm", 1e-3}},
    {Unit::inductance, {"H", 1.0}},
    {Unit::inductance, {"mH", 1e-3}},
    {Unit::inductance, {"uH", 1e-6}},
    {Unit::power, {"W", 1.0}},
    {Unit::power, {"mW", 1e-3}},
    {Unit::temperature, {"degC", 1.0}},
    {Unit::temperature_rise, {"K", 1.0}},
    {Unit::thermal_resistance, {"K/W", 1.0}},
    {Unit::frequency, {"Hz", 1.0}},
    {Unit::frequency, {"kHz", 1e3}},
    {Unit::frequency, {"MHz", 1e6}},
    {Unit::rate, {"1/s", 1.0}},
    {Unit::bit_rate, {"bit/s", 1.0}},
    {Unit::bit_rate, {"kbit/s", 1e3}},
    {Unit::bit_rate, {"Mbit/s", 1e6}},
};

std::string format_number(double x) {
  char buffer[32];
  std::snprintf(buffer, sizeof buffer, "%.6g", x);
  return buffer;
}

std::string with_unit(double x, Unit unit) {
  const auto spellings = unit_spellings(unit);
  return spellings.empty() ? format_number(x) : format_number(x) + " " + std::string(spellings.front().text);
}

std::string join(const std::vector<std::string>& words, const std::string& last_separator) {
  std::string result;
  for (std::size_t i = 0; i < words.size(); ++i) {
    if (i > 0) result += i + 1 == words.size() ? last_separator : ", ";
    result += words[i];
  }
  return result;
}

std::string accepted_units(Unit unit) {
  std::vector<std::string> names;
  for (const auto& s : unit_spellings(unit)) names.emplace_back(s.text);
  return join(names, " or ");
}

/// "above 0 Nm and at most 5 Nm"; empty when everything is allowed.
std::string describe_range(const Range& range, Unit unit) {
  std::string result;
  if (std::isfinite(range.lo)) result = (range.lo_open ? "above " : "at least ") + with_unit(range.lo, unit);
  if (std::isfinite(range.hi)) {
    if (!result.empty()) result += " and ";
    result += (range.hi_open ? "below " : "at most ") + with_unit(range.hi, unit);
  }
  return result;
}

/// "a torque (Nm or mNm) above 0 Nm"
std::string describe_quantity(Unit unit, const Range& range) {
  std::string result(unit_meaning(unit));
  if (unit != Unit::none) result += " (" + accepted_units(unit) + ")";
  const std::string allowed = describe_range(range, unit);
  return allowed.empty() ? result : result + " " + allowed;
}

std::size_t edit_distance(std::string_view a, std::string_view b) {
  std::vector<std::size_t> row(b.size() + 1);
  for (std::size_t j = 0; j <= b.size(); ++j) row[j] = j;
  for (std::size_t i = 1; i <= a.size(); ++i) {
    std::size_t diagonal = row[0];
    row[0] = i;
    for (std::size_t j = 1; j <= b.size(); ++j) {
      const std::size_t above = row[j];
      row[j] = std::min({row[j] + 1, row[j - 1] + 1, diagonal + (a[i - 1] == b[j - 1] ? 0U : 1U)});
      diagonal = above;
    }
  }
  return row[b.size()];
}

/// The nearest of `candidates` if it is near enough to be a misspelling; empty otherwise.
std::string nearest(std::string_view word, const std::vector<std::string>& candidates) {
  std::string best;
  std::size_t best_distance = std::max<std::size_t>(2, word.size() / 3) + 1;
  for (const auto& candidate : candidates) {
    const std::size_t distance = edit_distance(word, candidate);
    if (distance < best_distance) {
      best = candidate;
      best_distance = distance;
    }
  }
  return best;
}

/// Text with its spaces made single, '*' read as a space, and none around '/'.
std::string normalise_unit(std::string_view text) {
  std::string result;
  for (char c : text) {
    if (c == '*' || c == '\t') c = ' ';
    const bool after_break = result.empty() || result.back() == ' ' || result.back() == '/';
    if (c == ' ' && after_break) continue;
    if (c == '/' && !result.empty() && result.back() == ' ') result.pop_back();
    result += c;
  }
  while (!result.empty() && result.back() == ' ') result.pop_back();
  return result;
}

enum class NumberParse { ok, not_a_number, not_finite };

/// Parses a number at the start of `text`; `rest` gets what follows it.
NumberParse parse_number(std::string_view text, double& value, std::string_view& rest) {
  if (!text.empty() && text.front() == '+') text.remove_prefix(1);
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error == std::errc::invalid_argument) return NumberParse::not_a_number;
  rest = text.substr(static_cast<std::size_t>(end - text.data()));
  if (error != std::errc{} || !std::isfinite(value)) return NumberParse::not_finite;
  return NumberParse::ok;
}

/// A value split into its numbers and the unit text behind them.
struct Quantity {
  std::vector<double> numbers;
  std::string unit;
  NumberParse status = NumberParse::ok;
};

Quantity split_quantity(std::string_view text) {
  Quantity result;
  std::size_t at = 0;
  while (true) {
    at = text.find_first_not_of(" \t,", at);
    if (at == std::string_view::npos) return result;
    const std::size_t end = std::min(text.find_first_of(" \t,", at), text.size());
    const std::string_view token = text.substr(at, end - at);
    double value = 0.0;
    std::string_view rest;
    const NumberParse status = parse_number(token, value, rest);
    // "1/s" and "16Nm" start with digits too: a later token is a number only as a whole, the first may carry its unit.
    const bool is_number = status != NumberParse::not_a_number && (rest.empty() || result.numbers.empty());
    if (!is_number) {
      if (result.numbers.empty()) result.status = NumberParse::not_a_number;
      result.unit = normalise_unit(text.substr(at));
      return result;
    }
    if (status == NumberParse::not_finite) {
      result.status = status;
      return result;
    }
    result.numbers.push_back(value);
    if (!rest.empty()) {
      result.unit = normalise_unit(text.substr(end - rest.size()));
      return result;
    }
    at = end;
  }
}

bool is_plain_scalar(const YAML::Node& node) { return node.IsScalar(); }

}  // namespace

std::vector<UnitSpelling> unit_spellings(Unit unit) {
  std::vector<UnitSpelling> result;
  for (const auto& entry : kUnits) {
    if (entry.unit == unit) result.push_back(entry.spelling);
  }
  return result;
}

std::string_view unit_meaning(Unit unit) {
  switch (unit) {
    case Unit::none:
      return "a plain number";
    case Unit::length:
      return "a length";
    case Unit::angle:
      return "an angle";
    case Unit::time:
      return "a time";
    case Unit::mass:
      return "a mass";
    case Unit::velocity:
      return "a velocity";
    case Unit::angular_velocity:
      return "an angular velocity";
    case Unit::acceleration:
      return "an acceleration";
    case Unit::angular_acceleration:
      return "an angular acceleration";
    case Unit::angular_jerk:
      return "an angular jerk";
    case Unit::force:
      return "a force";
    case Unit::torque:
      return "a torque";
    case Unit::torque_rate:
      return "a torque rate";
    case Unit::impulse:
      return "an impulse";
    case Unit::inertia:
      return "a moment of inertia";
    case Unit::stiffness:
      return "a stiffness";
    case Unit::torsional_stiffness:
      return "a torsional stiffness";
    case Unit::damping:
      return "a damping";
    case Unit::torsional_damping:
      return "a torsional damping";
    case Unit::contact_damping:
      return "a contact damping";
    case Unit::stribeck_decay:
      return "a Stribeck decay";
    case Unit::torque_constant:
      return "a torque constant";
    case Unit::current:
      return "a current";
    case Unit::voltage:
      return "a voltage";
    case Unit::resistance:
      return "a resistance";
    case Unit::inductance:
      return "an inductance";
    case Unit::power:
      return "a power";
    case Unit::temperature:
      return "a temperature";
    case Unit::temperature_rise:
      return "a temperature difference";
    case Unit::thermal_resistance:
      return "a thermal resistance";
    case Unit::frequency:
      return "a frequency";
    case Unit::rate:
      return "a rate";
    case Unit::bit_rate:
      return "a bit rate";
  }
  return "a value";
}

/// A mapping, what was asked of it, and the sections read from it.
struct YamlReader::Section {
  std::string file;
  std::string path;
  int line = 0;  ///< 1-based, 0 unknown
  std::vector<std::pair<std::string, YAML::Node>> entries;
  std::vector<std::string> known;
  std::map<std::string, std::shared_ptr<Section>, std::less<>> children;
  std::map<std::string, std::vector<std::shared_ptr<Section>>, std::less<>> lists;

  [[nodiscard]] std::string full_key(std::string_view key) const {
    return path.empty() ? std::string(key) : path + "." + std::string(key);
  }
  [[nodiscard]] const YAML::Node* find(std::string_view key) const {
    for (const auto& [name, node] : entries) {
      if (name == key) return &node;
    }
    return nullptr;
  }
  void know(std::string_view key) {
    if (std::find(known.begin(), known.end(), key) == known.end()) known.emplace_back(key);
  }
  [[nodiscard]] bool is_known(std::string_view key) const {
    return std::find(known.begin(), known.end(), key) != known.end();
  }
  static int line_of(const YAML::Node& node) { return node.Mark().is_null() ? 0 : node.Mark().line + 1; }
  static std::string place(const std::string& file, int line) {
    return line > 0 ? file + ", line " + std::to_string(line) : file;
  }

  [[noreturn]] void error(int at_line, const std::string& sentence) const {
    throw description_error(place(file, at_line), sentence);
  }
  /// "KEY is 'VALUE', but PROBLEM."
  [[noreturn]] void value_error(std::string_view key, const YAML::Node& node, const std::string& problem) const {
    error(line_of(node), full_key(key) + " is " + shown(node) + ", but " + problem);
  }
  [[noreturn]] void missing(std::string_view key, const std::string& what) const {
    std::vector<std::string> strangers;
    for (const auto& [name, node] : entries) {
      if (!is_known(name)) strangers.push_back(name);
    }
    const std::string hint = nearest(key, strangers);
    error(line, full_key(key) + " is missing; " +
                    (hint.empty() ? "add it as " + what : "is '" + hint + "' a misspelling of it?"));
  }
  static std::string shown(const YAML::Node& node) {
    if (node.IsNull()) return "empty";
    if (node.IsSequence()) return "a list";
    if (node.IsMap()) return "a section";
    std::string text = node.Scalar();
    if (text.size() > 60) text = text.substr(0, 57) + "...";
    return "'" + text + "'";
  }

  static std::shared_ptr<Section> make(const std::string& file, const std::string& path, const YAML::Node& node,
                                       int line) {
    auto section = std::make_shared<Section>();
    section->file = file;
    section->path = path;
    section->line = line;
    for (const auto& pair : node) {
      if (!pair.first.IsScalar()) section->error(line_of(pair.first), "a key must be plain text; rewrite it");
      const std::string key = pair.first.Scalar();
      if (section->find(key) != nullptr) {
        section->error(line_of(pair.first), section->full_key(key) + " is given twice; remove one of the two");
      }
      section->entries.emplace_back(key, pair.second);
    }
    return section;
  }

  /// One value text -> SI numbers; names every way in which it can be wrong.
  std::vector<double> quantity(std::string_view key, const YAML::Node& node, Unit unit, const Range& range) const {
    if (!is_plain_scalar(node)) value_error(key, node, "must be " + describe_quantity(unit, range));
    Quantity q = split_quantity(node.Scalar());
    switch (q.status) {
      case NumberParse::ok:
        break;
      case NumberParse::not_a_number:
        value_error(key, node, "must be " + describe_quantity(unit, range));
      case NumberParse::not_finite:
        value_error(key, node, "must be finite: " + describe_quantity(unit, range));
    }
    double factor = 1.0;
    if (unit == Unit::none) {
      if (!q.unit.empty()) value_error(key, node, "must be a plain number without a unit");
    } else {
      if (q.unit.empty()) value_error(key, node, "needs a unit: write " + accepted_units(unit) + " after the number");
      const auto spelling = std::find_if(std::begin(kUnits), std::end(kUnits), [&](const UnitEntry& entry) {
        return entry.unit == unit && entry.spelling.text == q.unit;
      });
      if (spelling == std::end(kUnits)) {
        const auto other = std::find_if(std::begin(kUnits), std::end(kUnits),
                                        [&](const UnitEntry& entry) { return entry.spelling.text == q.unit; });
        const std::string problem = other == std::end(kUnits)
                                        ? "'" + q.unit + "' is not a known unit"
                                        : "'" + q.unit + "' is the unit of " + std::string(unit_meaning(other->unit));
        value_error(key, node, problem + "; give " + std::string(unit_meaning(unit)) + " in " + accepted_units(unit));
      }
      factor = spelling->spelling.to_si;
    }
    for (double& x : q.numbers) {
      x *= factor;
      if (!range.contains(x)) {
        const std::string which = q.numbers.size() > 1 ? "every number must be " : "must be ";
        value_error(key, node, which + describe_range(range, unit));
      }
    }
    return q.numbers;
  }

  void finish() const {
    for (const auto& [name, node] : entries) {
      if (!is_known(name)) {
        std::vector<std::string> absent;
        for (const auto& k : known) {
          if (find(k) == nullptr) absent.push_back(k);
        }
        // A key that is not there yet is the likelier meaning; else any known one.
        std::string hint = nearest(name, absent);
        if (hint.empty()) hint = nearest(name, known);
        error(line_of(node),
              full_key(name) + " is not a known key; " +
                  (hint.empty() ? "remove it, or use one of: " + join(known, ", ") : "did you mean '" + hint + "'?"));
      }
      if (const auto child = children.find(name); child != children.end()) child->second->finish();
      if (const auto list = lists.find(name); list != lists.end()) {
        for (const auto& item : list->second) item->finish();
      }
    }
  }
};

YamlReader::YamlReader(std::shared_ptr<Section> section) : section_(std::move(section)) {}

YamlReader YamlReader::from_file(const std::filesystem::path& file) {
  const std::string name = file.string();
  std::error_code ec;
  if (!std::filesystem::is_regular_file(file, ec)) {
    throw description_error(name, "there is no such file; check the path");
  }
  if (const auto size = std::filesystem::file_size(file, ec); ec || size > kMaxFileBytes) {
    throw description_error(name, "the file is larger than 1 MiB or its size is unknown; check the path");
  }
  std::ifstream stream(file, std::ios::binary);
  std::ostringstream content;
  // An empty file leaves nothing to insert, which alone would count as a failure.
  if (stream && stream.peek() != std::ifstream::traits_type::eof()) content << stream.rdbuf();
  if (!stream.is_open() || stream.bad() || !content)
    throw description_error(name, "the file cannot be read; check its permissions");
  return from_text(content.str(), name);
}

YamlReader YamlReader::from_text(const std::string& content, const std::string& name) {
  try {
    const std::vector<YAML::Node> documents = YAML::LoadAll(content);
    if (documents.empty() || documents.front().IsNull()) {
      throw description_error(name, "the file is empty; fill in its keys");
    }
    if (documents.size() > 1) {
      throw description_error(name, "the file holds several YAML documents; keep one");
    }
    if (!documents.front().IsMap()) {
      throw description_error(name, "the file must be a mapping of keys to values; write 'key: value' lines");
    }
    return YamlReader(Section::make(name, "", documents.front(), 0));
  } catch (const YAML::Exception& e) {
    const int line = e.mark.is_null() ? 0 : e.mark.line + 1;
    throw description_error(Section::place(name, line), "this is not valid YAML (" + e.msg + "); correct the line");
  }
}

bool YamlReader::has(std::string_view key) const { return section_->find(key) != nullptr; }

std::vector<std::string> YamlReader::keys() const {
  std::vector<std::string> result;
  for (const auto& [name, node] : section_->entries) result.push_back(name);
  return result;
}

YamlReader YamlReader::section(std::string_view key) const {
  section_->know(key);
  if (const auto it = section_->children.find(key); it != section_->children.end()) return YamlReader(it->second);
  const YAML::Node* node = section_->find(key);
  if (node == nullptr) section_->missing(key, "a section with keys of its own");
  if (!node->IsMap()) section_->value_error(key, *node, "must be a section with keys of its own");
  auto child = Section::make(section_->file, section_->full_key(key), *node, Section::line_of(*node));
  section_->children.emplace(std::string(key), child);
  return YamlReader(child);
}

std::optional<YamlReader> YamlReader::optional_section(std::string_view key) const {
  section_->know(key);
  if (!has(key)) return std::nullopt;
  return section(key);
}

std::vector<YamlReader> YamlReader::sections(std::string_view key, std::size_t min_count) const {
  section_->know(key);
  const YAML::Node* node = section_->find(key);
  if (node == nullptr) {
    if (min_count == 0) return {};
    section_->missing(key, "a list");
  }
  if (!node->IsSequence()) section_->value_error(key, *node, "must be a list of sections");
  if (node->size() < min_count) {
    section_->value_error(key, *node, "needs at least " + std::to_string(min_count) + " entries");
  }
  auto& list = section_->lists[std::string(key)];
  std::vector<YamlReader> result;
  if (list.empty()) {
    std::size_t index = 0;
    for (const auto& item : *node) {
      const std::string item_key = std::string(key) + "[" + std::to_string(index++) + "]";
      if (!item.IsMap()) section_->value_error(item_key, item, "must be a section with keys of its own");
      list.push_back(Section::make(section_->file, section_->full_key(item_key), item, Section::line_of(item)));
    }
  }
  for (const auto& item : list) result.push_back(YamlReader(item));
  return result;
}

double YamlReader::number(std::string_view key, Unit unit, Range range) const {
  section_->know(key);
  const YAML::Node* node = section_->find(key);
  if (node == nullptr) section_->missing(key, describe_quantity(unit, range));
  const std::vector<double> values = section_->quantity(key, *node, unit, range);
  if (values.size() != 1) section_->value_error(key, *node, "must be one number: " + describe_quantity(unit, range));
  return values.front();
}

double YamlReader::number(std::string_view key, Unit unit, Range range, double fallback) const {
  section_->know(key);
  return has(key) ? number(key, unit, range) : fallback;
}

std::vector<double> YamlReader::numbers(std::string_view key, Unit unit, Range range, std::size_t min_count,
                                        std::size_t max_count) const {
  section_->know(key);
  const std::string count = min_count == max_count
                                ? std::to_string(min_count)
                                : "between " + std::to_string(min_count) + " and " + std::to_string(max_count);
  const YAML::Node* node = section_->find(key);
  if (node == nullptr) section_->missing(key, count + " numbers, each " + describe_quantity(unit, range));
  std::vector<double> values;
  if (node->IsSequence()) {
    for (const auto& item : *node) {
      const std::vector<double> one = section_->quantity(key, item, unit, range);
      if (one.size() != 1) section_->value_error(key, item, "every entry of a list must be one number");
      values.push_back(one.front());
    }
  } else {
    values = section_->quantity(key, *node, unit, range);
  }
  if (!(values.size() >= min_count && values.size() <= max_count)) {
    section_->value_error(key, *node,
                          "must hold " + count + " numbers, each " + describe_quantity(unit, range) + ", not " +
                              std::to_string(values.size()));
  }
  return values;
}

std::int64_t YamlReader::integer(std::string_view key, std::int64_t lo, std::int64_t hi) const {
  section_->know(key);
  const std::string what = "a whole number from " + std::to_string(lo) + " to " + std::to_string(hi);
  const YAML::Node* node = section_->find(key);
  if (node == nullptr) section_->missing(key, what);
  if (!is_plain_scalar(*node)) section_->value_error(key, *node, "must be " + what);
  const std::string& text = node->Scalar();
  std::int64_t value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc{} || end != text.data() + text.size() || !(value >= lo && value <= hi)) {
    section_->value_error(key, *node, "must be " + what);
  }
  return value;
}

std::int64_t YamlReader::integer(std::string_view key, std::int64_t lo, std::int64_t hi, std::int64_t fallback) const {
  section_->know(key);
  return has(key) ? integer(key, lo, hi) : fallback;
}

bool YamlReader::boolean(std::string_view key) const {
  section_->know(key);
  const YAML::Node* node = section_->find(key);
  if (node == nullptr) section_->missing(key, "true or false");
  if (is_plain_scalar(*node) && node->Scalar() == "true") return true;
  if (is_plain_scalar(*node) && node->Scalar() == "false") return false;
  section_->value_error(key, *node, "must be true or false");
}

bool YamlReader::boolean(std::string_view key, bool fallback) const {
  section_->know(key);
  return has(key) ? boolean(key) : fallback;
}

std::string YamlReader::text(std::string_view key) const {
  section_->know(key);
  const YAML::Node* node = section_->find(key);
  if (node == nullptr) section_->missing(key, "text");
  if (!is_plain_scalar(*node) || node->Scalar().empty()) section_->value_error(key, *node, "must be text");
  return node->Scalar();
}

std::string YamlReader::text(std::string_view key, std::string_view fallback) const {
  section_->know(key);
  return has(key) ? text(key) : std::string(fallback);
}

std::vector<std::string> YamlReader::texts(std::string_view key, std::size_t min_count) const {
  section_->know(key);
  const YAML::Node* node = section_->find(key);
  if (node == nullptr) {
    if (min_count == 0) return {};
    section_->missing(key, "a list of texts");
  }
  if (!node->IsSequence()) section_->value_error(key, *node, "must be a list of texts");
  std::vector<std::string> result;
  for (const auto& item : *node) {
    if (!is_plain_scalar(item) || item.Scalar().empty()) section_->value_error(key, item, "every entry must be text");
    result.push_back(item.Scalar());
  }
  if (result.size() < min_count) {
    section_->value_error(key, *node, "needs at least " + std::to_string(min_count) + " entries");
  }
  return result;
}

std::size_t YamlReader::choice_index(std::string_view key, const std::vector<std::string>& names) const {
  section_->know(key);
  const std::string what = "one of: " + join(names, ", ");
  const YAML::Node* node = section_->find(key);
  if (node == nullptr) section_->missing(key, what);
  const auto it = is_plain_scalar(*node) ? std::find(names.begin(), names.end(), node->Scalar()) : names.end();
  if (it == names.end()) section_->value_error(key, *node, "must be " + what);
  return static_cast<std::size_t>(it - names.begin());
}

void YamlReader::fail(std::string_view key, const std::string& problem) const {
  if (const YAML::Node* node = section_->find(key); node != nullptr) {
    if (is_plain_scalar(*node)) section_->value_error(key, *node, problem);
    section_->error(Section::line_of(*node), section_->full_key(key) + ": " + problem);
  }
  section_->error(section_->line, section_->full_key(key) + " is left out, but " + problem);
}

void YamlReader::fail(const std::string& problem) const {
  section_->error(section_->line, section_->path.empty() ? problem : section_->path + ": " + problem);
}

void YamlReader::finish() const { section_->finish(); }
void YamlReader::mark_known(std::string_view key) const { section_->know(key); }
const std::string& YamlReader::path() const { return section_->path; }
const std::string& YamlReader::file() const { return section_->file; }

}  // namespace mrr
