// What a gear has borne: counted as the makers count, and never lost, whatever happens to the file.
#include "supervisor/ledger/ledger_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cmath>
#include <csignal>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <limits>
#include <numbers>

#include "common/core/random.h"
#include "common/robot/errors.h"

namespace mrr::sup {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;

RobotDescription example(const char* name) {
  return load_robot(std::filesystem::path(MRR_SOURCE_DIR) / "robots" / name);
}

/// A swing that touched, as the robot's sensors saw it.
SwingReport swing(double scale = 1.0) {
  SwingReport s;
  ContactReport& c = s.outcome.contact;
  c.phase = ContactPhase::over;
  c.start = Time{} + milliseconds(1000);
  c.end = Time{} + milliseconds(1080);
  c.qd_before = JointVector::Zero(3);
  c.qd_before[1] = -0.6;
  s.outcome.peak_torque_nm = {0.1, 20.5 * scale, 6.0 * scale};
  s.outcome.axis_impulse_nm_s = {0.0, -0.9 * scale, 0.2 * scale};
  return s;
}

class LedgerOnDisk : public testing::Test {
 protected:
  void SetUp() override {
    folder_ = fs::temp_directory_path() / ("mrr_ledger_test_" + std::to_string(::getpid()) + "_" +
                                           testing::UnitTest::GetInstance()->current_test_info()->name());
    fs::create_directory(folder_);
    file_ = folder_ / "ledger";
  }
  void TearDown() override { fs::remove_all(folder_); }

  [[nodiscard]] std::string text() const {
    std::ifstream in(file_, std::ios::binary);
    return {std::istreambuf_iterator<char>(in), {}};
  }
  void put(const std::string& content) const {
    {
      std::ofstream out(file_, std::ios::binary | std::ios::trunc);
      out << content;
    }
    fs::permissions(file_, fs::perms::owner_read | fs::perms::owner_write);
  }
  /// What opening it says; empty: it opened.
  [[nodiscard]] std::string refusal(const RobotDescription& robot) const {
    try {
      const LedgerFile ledger(robot, file_, "2026-01-31");
    } catch (const DescriptionError& error) {
      return error.what();
    }
    return "";
  }

  RobotDescription robot_ = example("mrr3");
  fs::path folder_, file_;
};

TEST(Ledger, CountsAsTheMakersCount) {
  const RobotDescription robot = example("mrr3");
  const TransmissionDescription& drive = robot.joints[1].transmission;  // 16, 37, 71 Nm, gamma 101
  JointLedger j;
  const double t = 0.05;
  j.enter(drive, {.contact_s = t, .peak_nm = 20.0, .impulse_nm_s = 0.6, .speed_rad_s = 0.5});
  EXPECT_EQ(j.peaks_over, (std::array<std::uint64_t, 3>{1, 0, 0}));
  // 0.6 Nm s in 50 ms: of 0.8 by a square pulse of 16 Nm, of 0.509 by a half-sine.
  EXPECT_EQ(j.impulses_over[0], (std::array<std::uint64_t, 3>{0, 0, 0}));
  EXPECT_EQ(j.impulses_over[1], (std::array<std::uint64_t, 3>{1, 0, 0}));
  EXPECT_NEAR(j.use(drive, LoadLimit::rated, PulseShape::square), 0.6 / 0.8, 1e-12);
  EXPECT_NEAR(j.use(drive, LoadLimit::rated, PulseShape::half_sine), 0.6 / (2.0 / std::numbers::pi * 0.8), 1e-12);
  EXPECT_NEAR(j.use(drive, LoadLimit::momentary_peak, PulseShape::square), 0.6 / (71.0 * t), 1e-12);
  EXPECT_EQ(j.momentary_events(), 0U);
  EXPECT_EQ(j.momentary_life, 0.0);
  EXPECT_GT(j.wear_life, 0.0);
  // A momentary-torque event. (56) at 600 rpm of the motor for 50 ms: N = 1e4, one of so many.
  const double speed = 600.0 / 60.0 * 2.0 * std::numbers::pi / drive.gear_ratio;
  j.enter(drive, {.contact_s = t, .peak_nm = 40.0, .impulse_nm_s = 0.1, .speed_rad_s = speed});
  EXPECT_EQ(j.momentary_events(), 1U);
  EXPECT_NEAR(j.momentary_life, 1e-4, 1e-12);
  // Twice as long a contact passes twice as many stress cycles; at rest there is one.
  j.enter(drive, {.contact_s = 2.0 * t, .peak_nm = 40.0, .impulse_nm_s = 0.1, .speed_rad_s = speed});
  EXPECT_NEAR(j.momentary_life, 3e-4, 1e-12);
  j.enter(drive, {.contact_s = t, .peak_nm = 80.0, .impulse_nm_s = 0.1, .speed_rad_s = 0.0});
  EXPECT_NEAR(j.momentary_life, 4e-4, 1e-12);
  EXPECT_EQ(j.peaks_over, (std::array<std::uint64_t, 3>{4, 3, 1}));
  EXPECT_EQ(j.blows, 4U);
  EXPECT_EQ(j.largest_peak_nm, 80.0);
}

TEST(Ledger, RatedTorqueForItsRatedLifeUsesAllOfIt) {
  const RobotDescription robot = example("mrr3");
  const TransmissionDescription& drive = robot.joints[1].transmission;
  // A peak whose cube has the rated torque's cube as its mean, at 2000 rpm for 7000 h, in one go.
  const double peak = drive.rated_nm * std::cbrt(0.75 * std::numbers::pi);
  const double speed = 2000.0 / 60.0 * 2.0 * std::numbers::pi / drive.gear_ratio;
  EXPECT_NEAR(
      wear_share(drive, {.contact_s = 7000.0 * 3600.0, .peak_nm = peak, .impulse_nm_s = 0.0, .speed_rad_s = speed}),
      1.0, 1e-9);
}

TEST(Ledger, WhatNobodySawIsUnknownNotZero) {
  RobotDescription robot = example("mrr3");
  robot.joints[1].sensors.torque_sensor = false;
  Ledger ledger;
  ledger.since = "2026-01-31";
  ledger.joints.resize(3);
  EXPECT_TRUE(ledger.enter(robot, swing()));
  EXPECT_EQ(ledger.joints[1].blows, 1U);
  EXPECT_EQ(ledger.joints[1].unknown, 1U);
  EXPECT_EQ(ledger.joints[2].unknown, 0U);
  EXPECT_THAT(report(robot, ledger), HasSubstr("1 of the blows were not seen"));
  SwingReport broken = swing();
  broken.outcome.peak_torque_nm[2] = std::nan("");
  EXPECT_TRUE(ledger.enter(robot, broken));
  EXPECT_EQ(ledger.joints[2].unknown, 1U);
  EXPECT_TRUE(std::isfinite(ledger.joints[2].life_share()));
  EXPECT_FALSE(ledger.enter(robot, SwingReport{}));  // touched nothing
  EXPECT_EQ(ledger.joints[1].blows, 2U);
}

TEST_F(LedgerOnDisk, GoesOnAfterARestart) {
  Ledger before;
  {
    LedgerFile ledger(robot_, file_, "2026-01-31");
    EXPECT_TRUE(ledger.begun());
    ledger.enter(swing());
    ledger.enter(swing(2.0));
    before = ledger.ledger();
  }
  LedgerFile again(robot_, file_, "2027-05-01");
  EXPECT_FALSE(again.begun());
  EXPECT_EQ(again.ledger().since, "2026-01-31");
  EXPECT_EQ(ledger_text(robot_, again.ledger()), ledger_text(robot_, before));  // to the last bit
  EXPECT_EQ(again.ledger().joints[1].momentary_events(), 1U);                   // 41 Nm
  again.enter(swing());
  EXPECT_EQ(again.ledger().joints[1].blows, 3U);
  EXPECT_FALSE(fs::exists(file_.string() + ".new"));
}

// The process dies with so many bytes written: by the limit on a file's size, at every byte.
TEST_F(LedgerOnDisk, APowerCutAtAnyByteLeavesOneOrTheOther) {
  {
    LedgerFile ledger(robot_, file_, "2026-01-31");
    ledger.enter(swing());
  }
  const std::string before = text();
  std::size_t size = 0;
  {
    Ledger after = read_ledger(robot_, before, "here");
    after.enter(robot_, swing());
    size = ledger_text(robot_, after).size();
  }
  int died = 0;
  for (std::size_t cut = 0; cut <= size; ++cut) {
    const pid_t child = ::fork();
    ASSERT_GE(child, 0);
    if (child == 0) {
      const rlimit core{0, 0};
      ::setrlimit(RLIMIT_CORE, &core);
      const rlimit limit{cut, cut};
      LedgerFile ledger(robot_, file_, "2026-01-31");
      ::setrlimit(RLIMIT_FSIZE, &limit);
      ledger.enter(swing());
      ::_exit(0);
    }
    int status = 0;
    ASSERT_EQ(::waitpid(child, &status, 0), child);
    const std::string now = text();
    if (WIFSIGNALED(status)) {
      ++died;
      ASSERT_EQ(now, before) << cut;
    } else {
      ASSERT_EQ(WEXITSTATUS(status), 0) << cut;
      ASSERT_EQ(cut, size);
      ASSERT_EQ(now.size(), size);
    }
  }
  EXPECT_EQ(died, static_cast<int>(size));
  EXPECT_EQ(LedgerFile(robot_, file_, "2026-01-31").ledger().joints[1].blows, 2U);
}

TEST_F(LedgerOnDisk, AFullDiskIsSaidAndCostsNothing) {
  LedgerFile ledger(robot_, file_, "2026-01-31");
  ledger.enter(swing());
  const std::string before = text();
  rlimit old{};
  ::getrlimit(RLIMIT_FSIZE, &old);
  const auto handler = ::signal(SIGXFSZ, SIG_IGN);
  const rlimit limit{100, old.rlim_max};
  ::setrlimit(RLIMIT_FSIZE, &limit);
  std::string said;
  try {
    ledger.enter(swing());
  } catch (const DescriptionError& error) {
    said = error.what();
  }
  ::setrlimit(RLIMIT_FSIZE, &old);
  ::signal(SIGXFSZ, handler);
  EXPECT_THAT(said, HasSubstr("writing failed"));
  EXPECT_EQ(text(), before);
  ledger.enter(swing());  // there is room again: nothing was forgotten meanwhile
  EXPECT_EQ(read_ledger(robot_, text(), "here").joints[1].blows, 3U);
}

TEST_F(LedgerOnDisk, ATornOrDamagedFileIsRefusedAndKept) {
  {
    LedgerFile ledger(robot_, file_, "2026-01-31");
    ledger.enter(swing());
  }
  const std::string whole = text();
  for (std::size_t length = 0; length < whole.size(); ++length) {
    EXPECT_THROW((void)read_ledger(robot_, whole.substr(0, length), "here"), DescriptionError) << length;
  }
  for (std::size_t k = 0; k < whole.size(); ++k) {
    for (const unsigned flip : {1U, 2U, 0x80U}) {
      std::string damaged = whole;
      damaged[k] = static_cast<char>(static_cast<unsigned char>(damaged[k]) ^ flip);
      EXPECT_THROW((void)read_ledger(robot_, damaged, "here"), DescriptionError) << k;
    }
  }
  EXPECT_THROW((void)read_ledger(robot_, whole + " ", "here"), DescriptionError);
  for (const std::string& damaged : {whole.substr(0, whole.size() / 2), std::string()}) {
    put(damaged);
    const std::string said = refusal(robot_);
    EXPECT_THAT(said, HasSubstr(file_.string() + ": it is "));
    EXPECT_THAT(said, HasSubstr("restore a copy, or move it away"));
    EXPECT_EQ(text(), damaged);  // never zeroed, never begun anew
  }
}

TEST_F(LedgerOnDisk, AFuzzedFileIsRefusedWithASentence) {
  Ledger full;
  full.since = "2026-01-31";
  full.joints.resize(3);
  for (int k = 0; k < 5; ++k) full.enter(robot_, swing(0.5 * k));
  const std::string whole = ledger_text(robot_, full);
  Random random(5);
  const auto below = [&](std::size_t n) { return static_cast<std::size_t>(random.below(n)); };
  int refused = 0;
  for (int k = 0; k < 5000; ++k) {
    std::string text = whole;
    for (std::size_t changes = 1 + below(6); changes > 0; --changes) {
      const std::size_t at = below(text.size());
      switch (random.below(4)) {
        case 0:
          text[at] = static_cast<char>(below(256));
          break;
        case 1:
          text.erase(at, 1 + below(40));
          break;
        case 2:
          text.insert(at, whole.substr(below(whole.size()), below(60)));
          break;
        default:
          std::swap(text[at], text[below(text.size())]);
      }
      if (text.empty()) text.push_back('m');
    }
    if (text == whole) continue;
    try {
      (void)read_ledger(robot_, text, "here");
      ADD_FAILURE() << text;
    } catch (const DescriptionError& error) {
      ++refused;
      EXPECT_THAT(error.what(), HasSubstr("here: "));
    }
  }
  EXPECT_GT(refused, 4900);
}

/// A first line that is right for `body`.
std::string sealed(const std::string& body, int version = kLedgerVersion) {
  std::uint32_t crc = 0xFFFFFFFFU;  // CRC-32 in its own words
  for (const char c : body) {
    crc ^= static_cast<unsigned char>(c);
    for (int k = 0; k < 8; ++k) crc = (crc >> 1U) ^ ((crc & 1U) != 0 ? 0xEDB88320U : 0U);
  }
  std::array<char, 64> line{};
  std::snprintf(line.data(), line.size(), "mrr-ledger %d %08x %zu\n", version, ~crc, body.size());
  return line.data() + body;
}

TEST_F(LedgerOnDisk, WhatIsWholeButWrongIsRefusedByName) {
  Ledger full;
  full.since = "2026-01-31";
  full.joints.resize(3);
  full.enter(robot_, swing());
  const std::string whole = ledger_text(robot_, full);
  const std::string body = whole.substr(whole.find('\n') + 1);
  ASSERT_EQ(sealed(body), whole);
  const auto said = [&](const std::string& text) -> std::string {
    try {
      (void)read_ledger(robot_, text, "here");
    } catch (const DescriptionError& error) {
      return error.what();
    }
    return "";
  };
  const auto with = [&](const std::string& old, const std::string& fresh) {
    std::string changed = body;
    const std::size_t at = changed.find(old);
    EXPECT_NE(at, std::string::npos) << old;
    changed.replace(at, old.size(), fresh);
    return said(sealed(changed));
  };
  EXPECT_THAT(said(sealed(body, 2)), HasSubstr("format 2"));
  EXPECT_THAT(with("\"mrr3\"", "\"arm7\""), HasSubstr("robot arm7, not of mrr3"));
  EXPECT_THAT(with("\"gear_ratio\": 101", "\"gear_ratio\": 100"), HasSubstr("gear_ratio of joint joint_2 is 100"));
  EXPECT_THAT(with("\"blows\": 1", "\"blows\": -1"), HasSubstr("whole number"));
  EXPECT_THAT(with("\"blows\": 1", "\"blows\": null"), HasSubstr("whole number"));
  EXPECT_THAT(with("\"momentary_life\": 0.0", "\"momentary_life\": -0.5"), HasSubstr("momentary_life"));
  EXPECT_THAT(with("\"wear_life\"", "\"were_life\""), HasSubstr("missing"));
  EXPECT_THAT(said(sealed("[]\n")), HasSubstr("JSON"));
  EXPECT_THAT(said("hello\n"), HasSubstr("not a ledger"));
}

TEST_F(LedgerOnDisk, IsItsOwnersAlone) {
  {
    const LedgerFile ledger(robot_, file_, "2026-01-31");
    struct stat what {};
    ASSERT_EQ(::stat(file_.c_str(), &what), 0);
    EXPECT_EQ(what.st_mode & 0777U, 0600U);
    EXPECT_THAT(refusal(robot_), HasSubstr("another program keeps this ledger"));
  }
  EXPECT_EQ(refusal(robot_), "");
  fs::permissions(file_, fs::perms::group_read, fs::perm_options::add);
  EXPECT_THAT(refusal(robot_), HasSubstr("mode 640"));
  fs::rename(file_, folder_ / "elsewhere");
  fs::create_symlink(folder_ / "elsewhere", file_);
  EXPECT_THAT(refusal(robot_), HasSubstr("cannot be read"));
  file_ = folder_ / "no" / "such" / "folder";
  EXPECT_THAT(refusal(robot_), HasSubstr("cannot be made"));
  file_ = folder_;
  EXPECT_NE(refusal(robot_), "");
}

}  // namespace
}  // namespace mrr::sup
