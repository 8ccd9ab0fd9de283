#include "common/rpc/runtime_dir.h"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <fstream>

#include "common/rpc/message.h"
#include "tests/unit/rpc/temporary_folder.h"

namespace mrr::rpc {
namespace {

using test::Environment;
using test::TemporaryFolder;
namespace fs = std::filesystem;

std::string refusal() {
  try {
    runtime_dir();
  } catch (const ConnectionError& error) {
    return error.what();
  }
  return "accepted";
}

TEST(RuntimeDir, OurVariableIsAskedFirstThenTheUsersThenTmp) {
  const TemporaryFolder folder;
  const Environment ours("MRR_RUNTIME_DIR", "/somewhere");
  const Environment users("XDG_RUNTIME_DIR", folder.path().c_str());
  EXPECT_EQ(runtime_dir_name(), "/somewhere");
  const Environment not_ours("MRR_RUNTIME_DIR", nullptr);
  EXPECT_EQ(runtime_dir_name(), folder / "mrr");
  const Environment gone("XDG_RUNTIME_DIR", "/nonexistent/run");
  EXPECT_EQ(runtime_dir_name(), fmt::format("/tmp/mrr-{}", geteuid()));
}

TEST(RuntimeDir, IsMadeForItsOwnerAlone) {
  const TemporaryFolder folder;
  const Environment ours("MRR_RUNTIME_DIR", (folder / "run").c_str());
  EXPECT_EQ(runtime_dir(), folder / "run");
  struct stat status {};
  ASSERT_EQ(stat((folder / "run").c_str(), &status), 0);
  EXPECT_EQ(status.st_mode & 07777, 0700U);
  EXPECT_EQ(runtime_dir(), folder / "run") << "found again";
}

TEST(RuntimeDir, OneThatOthersMayReadIsRefusedWithTheRemedy) {
  const TemporaryFolder folder;
  const Environment ours("MRR_RUNTIME_DIR", (folder / "run").c_str());
  runtime_dir();
  for (const mode_t mode : {0750U, 0701U, 0777U}) {
    chmod((folder / "run").c_str(), mode);
    EXPECT_THAT(refusal(), testing::HasSubstr("chmod 0700")) << std::oct << mode;
  }
}

TEST(RuntimeDir, AFileALinkAndAPlaceThatIsNotThereAreRefused) {
  const TemporaryFolder folder;
  std::ofstream(folder / "file") << "x";
  fs::create_directory_symlink(folder.path(), folder / "link");
  for (const char* name : {"file", "link"}) {
    const Environment ours("MRR_RUNTIME_DIR", (folder / name).c_str());
    EXPECT_THAT(refusal(), testing::HasSubstr("is not a folder")) << name;
  }
  const Environment ours("MRR_RUNTIME_DIR", (folder / "no/such/place").c_str());
  EXPECT_THAT(refusal(), testing::HasSubstr("cannot be made"));
}

TEST(RuntimeDir, AnotherUsersIsRefused) {
  if (geteuid() != 0) GTEST_SKIP() << "only root can make a folder for another user";
  const TemporaryFolder folder;
  const Environment ours("MRR_RUNTIME_DIR", (folder / "run").c_str());
  runtime_dir();
  ASSERT_EQ(chown((folder / "run").c_str(), 65534, 65534), 0);
  EXPECT_THAT(refusal(), testing::HasSubstr("belongs to user 65534"));
}

TEST(RuntimeDir, ASocketThatWasNamedIsTakenAsItIs) {
  const Environment ours("MRR_RUNTIME_DIR", "/run/ours");
  EXPECT_EQ(socket_path("", "plant.sock"), "/run/ours/plant.sock");
  EXPECT_EQ(socket_path("here.sock", "plant.sock"), "here.sock");
}

}  // namespace
}  // namespace mrr::rpc
