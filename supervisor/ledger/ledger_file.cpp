#include "supervisor/ledger/ledger_file.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <charconv>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <nlohmann/json.hpp>
#include <span>
#include <utility>

#include "can_protocol/storage.h"
#include "common/robot/errors.h"

namespace mrr::sup {
namespace {

using Json = nlohmann::ordered_json;
namespace fs = std::filesystem;

constexpr std::string_view kMagic = "mrr-ledger";
constexpr std::size_t kLargestFile = 1U << 20U;
constexpr const char* kKeep =
    "it is left as it is, because what a gear has borne is not zero when it is not known: restore a copy, or move it "
    "away to begin a new ledger";

std::uint32_t crc32(std::string_view text) {
  const std::span bytes(reinterpret_cast<const std::uint8_t*>(text.data()), text.size());
  return ~can::crc32_more(can::kCrc32Start, bytes);
}

[[noreturn]] void refuse(const std::string& place, const std::string& why) {
  throw description_error(place, fmt::format("{}; {}", why, kKeep));
}

/// What tells a gear from another one.
Json gear_json(const JointDescription& joint) {
  const TransmissionDescription& drive = joint.transmission;
  return {{"name", joint.name},
          {"type", drive.type},
          {"gear_ratio", drive.gear_ratio},
          {"rated_nm", drive.rated_nm},
          {"repeated_peak_nm", drive.repeated_peak_nm},
          {"momentary_peak_nm", drive.momentary_peak_nm}};
}

Json account_json(const JointLedger& j) {
  return {{"blows", j.blows},
          {"unknown", j.unknown},
          {"peaks_over", j.peaks_over},
          {"impulses_over_square", j.impulses_over[0]},
          {"impulses_over_half_sine", j.impulses_over[1]},
          {"largest_peak_nm", j.largest_peak_nm},
          {"largest_impulse_nm_s", j.largest_impulse_nm_s},
          {"largest_rated_use", j.largest_rated_use},
          {"momentary_life", j.momentary_life},
          {"wear_life", j.wear_life}};
}

std::string header_of(std::string_view body) {
  return fmt::format("{} {} {:08x} {}\n", kMagic, kLedgerVersion, crc32(body), body.size());
}

/// Counts must be counts and figures finite and not negative; throws nlohmann's errors or `false` figures.
JointLedger account_of(const Json& json, const std::string& place) {
  const auto count = [&](const Json& value) {
    if (!value.is_number_unsigned()) refuse(place, "a count in it is not a whole number");
    return value.get<std::uint64_t>();
  };
  const auto counts = [&](const char* key) {
    std::array<std::uint64_t, kLoadLimits> all{};
    const Json& list = json.at(key);
    if (!list.is_array() || list.size() != all.size()) refuse(place, fmt::format("{} is not a list of three", key));
    for (std::size_t k = 0; k < all.size(); ++k) all[k] = count(list[k]);
    return all;
  };
  const auto figure = [&](const char* key) {
    const Json& value = json.at(key);
    const double x = value.is_number() ? value.get<double>() : std::nan("");
    if (!(x >= 0.0 && std::isfinite(x))) refuse(place, fmt::format("{} is not a figure of at least 0", key));
    return x;
  };
  JointLedger j;
  j.blows = count(json.at("blows"));
  j.unknown = count(json.at("unknown"));
  j.peaks_over = counts("peaks_over");
  j.impulses_over = {counts("impulses_over_square"), counts("impulses_over_half_sine")};
  j.largest_peak_nm = figure("largest_peak_nm");
  j.largest_impulse_nm_s = figure("largest_impulse_nm_s");
  j.largest_rated_use = figure("largest_rated_use");
  j.momentary_life = figure("momentary_life");
  j.wear_life = figure("wear_life");
  return j;
}

/// Closes on the way out.
struct Handle {
  int fd = -1;
  ~Handle() {
    if (fd >= 0) ::close(fd);
  }
};

std::string why_not() { return std::strerror(errno); }

fs::path beside(const fs::path& file, const char* ending) { return file.string() + ending; }

}  // namespace

std::string ledger_text(const RobotDescription& robot, const Ledger& ledger) {
  Json joints = Json::array();
  for (std::size_t i = 0; i < robot.joints.size(); ++i) {
    Json joint = gear_json(robot.joints[i]);
    joint.update(account_json(ledger.joints.at(i)));
    joints.push_back(std::move(joint));
  }
  const Json all = {{"robot", robot.name}, {"since", ledger.since}, {"joints", joints}};
  const std::string body = all.dump(1) + "\n";
  return header_of(body) + body;
}

Ledger read_ledger(const RobotDescription& robot, std::string_view text, const std::string& place) {
  const std::size_t line = text.find('\n');
  const std::string_view head = text.substr(0, line);
  if (head.substr(0, kMagic.size() + 1) != fmt::format("{} ", kMagic)) {
    refuse(place, text.empty() ? "it is empty, a ledger is not" : "it is not a ledger, or its beginning is damaged");
  }
  int version = 0;
  const std::string_view rest = head.substr(kMagic.size() + 1);
  const auto [end, error] = std::from_chars(rest.data(), rest.data() + rest.size(), version);
  if (error != std::errc() || version < 1) refuse(place, "its first line is damaged");
  if (version > kLedgerVersion) {
    refuse(place, fmt::format("it is of format {}, written by a newer program or damaged; this one reads up to {}",
                              version, kLedgerVersion));
  }
  const std::string_view body = line == std::string_view::npos ? std::string_view{} : text.substr(line + 1);
  // Compared as a whole: whatever is torn, longer, shorter or changed shows in the first line or in its checksum.
  if (text.substr(0, text.size() - body.size()) != header_of(body)) {
    refuse(place, fmt::format("it is torn or damaged: its checksum is not that of its {} bytes", body.size()));
  }
  const Json json = Json::parse(body, nullptr, false);
  if (json.is_discarded() || !json.is_object()) refuse(place, "its checksum is right, its text is not JSON");
  try {
    const std::string name = json.at("robot").get<std::string>();
    if (name != robot.name) refuse(place, fmt::format("it is the ledger of robot {}, not of {}", name, robot.name));
    Ledger ledger;
    ledger.since = json.at("since").get<std::string>();
    const Json& joints = json.at("joints");
    if (joints.size() != robot.joints.size()) {
      refuse(place, fmt::format("it knows {} joints, the robot has {}", joints.size(), robot.joints.size()));
    }
    for (std::size_t i = 0; i < joints.size(); ++i) {
      const Json gear = gear_json(robot.joints[i]);
      for (const auto& [key, value] : gear.items()) {
        if (joints[i].at(key) == value) continue;
        refuse(place, fmt::format("{} of joint {} is {} in it, and {} in the robot's description", key,
                                  robot.joints[i].name, joints[i].at(key).dump(), value.dump()));
      }
      ledger.joints.push_back(account_of(joints[i], place));
    }
    return ledger;
  } catch (const Json::exception&) {
    refuse(place, "its checksum is right, but something that a ledger has is missing in it");
  }
}

LedgerFile::LedgerFile(const RobotDescription& robot, fs::path file, const std::string& today)
    : robot_(robot), file_(std::move(file)) {
  const std::string place = file_.string();
  const fs::path lock = beside(file_, ".lock");
  Handle locked{::open(lock.c_str(), O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0600)};
  if (locked.fd < 0) {
    throw description_error(place, fmt::format("{} cannot be made: {}; give a file in a folder you may write to",
                                               lock.string(), why_not()));
  }
  if (::flock(locked.fd, LOCK_EX | LOCK_NB) != 0) {
    throw description_error(place, "another program keeps this ledger; stop it first, or give another file");
  }
  Handle open{::open(file_.c_str(), O_RDONLY | O_CLOEXEC | O_NOFOLLOW | O_NONBLOCK)};
  if (open.fd < 0 && errno != ENOENT) {
    throw description_error(place, fmt::format("cannot be read: {}; give a plain file that you own", why_not()));
  }
  if (open.fd < 0) {
    begun_ = true;
    ledger_.since = today;
    ledger_.joints.resize(robot_.joints.size());
    write();
  } else {
    struct stat what {};
    if (::fstat(open.fd, &what) != 0 || !S_ISREG(what.st_mode) || what.st_uid != ::geteuid()) {
      throw description_error(place, "is not a plain file of yours; give one that is, or a name that is free");
    }
    if ((what.st_mode & 077U) != 0) {
      throw description_error(
          place, fmt::format("others may read or write it (mode {:o}); chmod 600 it", what.st_mode & 0777U));
    }
    std::string text;
    std::array<char, 4096> piece{};
    for (ssize_t got = 1; got > 0 && text.size() <= kLargestFile;) {
      got = ::read(open.fd, piece.data(), piece.size());
      if (got < 0) refuse(place, fmt::format("reading it failed: {}", why_not()));
      text.append(piece.data(), static_cast<std::size_t>(got));
    }
    ledger_ = read_ledger(robot_, text, place);
  }
  lock_ = std::exchange(locked.fd, -1);
}

LedgerFile::~LedgerFile() {
  if (lock_ >= 0) ::close(lock_);
}

void LedgerFile::enter(const SwingReport& swing) {
  if (ledger_.enter(robot_, swing)) write();
}

void LedgerFile::write() const {
  const fs::path fresh = beside(file_, ".new");
  const auto fail = [&](const char* what) {
    const std::string why = why_not();
    ::unlink(fresh.c_str());
    throw description_error(
        file_.string(),
        fmt::format("{} failed: {}; the file is as it was before this, make room or give another folder", what, why));
  };
  ::unlink(fresh.c_str());  // what a power cut left
  {
    Handle out{::open(fresh.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC | O_NOFOLLOW, 0600)};
    if (out.fd < 0) fail("making a file beside it");
    const std::string text = ledger_text(robot_, ledger_);
    for (std::size_t done = 0; done < text.size();) {
      const ssize_t wrote = ::write(out.fd, text.data() + done, text.size() - done);
      if (wrote < 0 && errno == EINTR) continue;
      if (wrote <= 0) fail("writing");
      done += static_cast<std::size_t>(wrote);
    }
    if (::fsync(out.fd) != 0) fail("flushing");
  }
  if (::rename(fresh.c_str(), file_.c_str()) != 0) fail("putting it in place");
  // The name, too, must survive.
  const fs::path folder = file_.has_parent_path() ? file_.parent_path() : fs::path(".");
  Handle at{::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC)};
  if (at.fd < 0 || ::fsync(at.fd) != 0) {
    throw description_error(file_.string(),
                            fmt::format("its folder could not be flushed: {}; a power cut now may bring "
                                        "back the ledger as it was before the last blow",
                                        why_not()));
  }
}

fs::path default_ledger(const RobotDescription& robot) {
  const auto variable = [](const char* name) {
    const char* const value = std::getenv(name);
    return fs::path(value != nullptr ? value : "");
  };
  fs::path folder = variable("MRR_STATE_DIR");
  if (folder.empty()) folder = variable("STATE_DIRECTORY");
  if (folder.empty() && !variable("XDG_STATE_HOME").empty()) folder = variable("XDG_STATE_HOME") / "mrr";
  if (folder.empty() && !variable("HOME").empty()) folder = variable("HOME") / ".local" / "state" / "mrr";
  if (folder.empty()) throw description_error("ledger", "there is no HOME to keep it in; give a file with --ledger");
  std::error_code error;
  if (fs::create_directories(folder, error)) fs::permissions(folder, fs::perms::owner_all, error);
  if (error) {
    throw description_error(folder.string(),
                            fmt::format("cannot be made: {}; give a file with --ledger", error.message()));
  }
  return folder / fmt::format("ledger-{}", robot.name);
}

std::string today_utc() {
  const std::time_t now = std::time(nullptr);
  std::tm day{};
  ::gmtime_r(&now, &day);
  return fmt::format("{:04}-{:02}-{:02}", day.tm_year + 1900, day.tm_mon + 1, day.tm_mday);
}

}  // namespace mrr::sup
