// Tests of common/robot: what every error sentence has to look like, and robots to spoil.
#pragma once

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <regex>
#include <sstream>
#include <string>

#include "common/robot/errors.h"

namespace mrr::test {

inline std::string read_text(const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  std::ostringstream content;
  content << stream.rdbuf();
  return content.str();
}

inline void write_text(const std::filesystem::path& file, const std::string& text) {
  std::ofstream(file, std::ios::binary) << text;
}

/// What `action` complains about; empty if it does not. Any other exception fails the test by escaping.
template <typename Action>
std::string complaint(Action action) {
  try {
    (void)action();
  } catch (const DescriptionError& e) {
    return e.what();
  }
  return "";
}

/// One line, one sentence, one full stop (or question mark) at its end.
inline void expect_one_sentence(const std::string& text) {
  ASSERT_FALSE(text.empty()) << "nothing was reported";
  EXPECT_EQ(text.find('\n'), std::string::npos) << text;
  EXPECT_TRUE(text.back() == '.' || text.back() == '?') << text;
  EXPECT_EQ(std::string(".?!,;: ").find(text[text.size() - 2]), std::string::npos) << text;
  EXPECT_FALSE(std::regex_search(text, std::regex("\\. [A-Z]"))) << text;
}

/// A copy of a good robot in a directory of its own, removed afterwards.
class SpoiledRobot {
 public:
  explicit SpoiledRobot(const std::string& robot = "mrr3") {
    static int count = 0;
    directory_ = std::filesystem::temp_directory_path() /
                 ("mrr_robot_" + std::to_string(::getpid()) + "_" + std::to_string(count++));
    std::filesystem::create_directories(directory_);
    for (const char* name : {"robot.urdf", "robot.yaml"}) {
      write_text(directory_ / name, read_text(std::filesystem::path(MRR_SOURCE_DIR) / "robots" / robot / name));
    }
  }
  ~SpoiledRobot() {
    std::error_code ec;
    std::filesystem::remove_all(directory_, ec);
  }
  SpoiledRobot(const SpoiledRobot&) = delete;
  SpoiledRobot& operator=(const SpoiledRobot&) = delete;

  [[nodiscard]] const std::filesystem::path& directory() const { return directory_; }
  [[nodiscard]] std::string text(const std::string& file) const { return read_text(directory_ / file); }
  void set_text(const std::string& file, const std::string& text) const { write_text(directory_ / file, text); }
  /// Replaces the first `from`, which must be there.
  void replace(const std::string& file, const std::string& from, const std::string& to) const {
    std::string content = text(file);
    const auto at = content.find(from);
    ASSERT_NE(at, std::string::npos) << file << " does not hold: " << from;
    set_text(file, content.replace(at, from.size(), to));
  }

 private:
  std::filesystem::path directory_;
};

}  // namespace mrr::test
