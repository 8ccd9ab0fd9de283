// The memory of stored parameters as a file.
#include "module_fw/targets/host/file_store.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <system_error>
#include <thread>

namespace mrr::fw {
namespace {

using can::StorageState;

struct FileStoreTest : testing::Test {
  std::string path =
      std::filesystem::temp_directory_path() / ("mrr_file_store_test." + std::to_string(::getpid()) + ".bin");
  ~FileStoreTest() override { std::filesystem::remove(path); }

  void save(std::uint32_t deceleration) const {
    FileStore file(path);
    can::ParameterStore store;
    can::ObjectDictionary od;
    store.load(file, od, 2);
    od.quick_stop_deceleration_mrad_s2 = deceleration;
    ASSERT_TRUE(store.begin_write(&od, 2));
    for (int i = 0; i < 20'000 && store.state() == StorageState::writing; ++i) {
      store.tick();
      std::this_thread::sleep_for(std::chrono::microseconds(100));  // the disk's turn
    }
    ASSERT_EQ(store.state(), StorageState::good);
  }
};

TEST_F(FileStoreTest, ANewFileIsEmptyAndKeepsWhatIsStored) {
  {
    FileStore file(path);
    can::ParameterStore store;
    can::ObjectDictionary od;
    store.load(file, od, 2);
    EXPECT_EQ(store.state(), StorageState::empty);
  }
  for (const std::uint32_t value : {100U, 200U, 300U}) save(value);
  FileStore file(path);
  can::ParameterStore store;
  can::ObjectDictionary od;
  store.load(file, od, 2);
  EXPECT_EQ(store.state(), StorageState::good);
  EXPECT_EQ(store.version(), 3U);
  EXPECT_EQ(od.quick_stop_deceleration_mrad_s2, 300U);
}

TEST_F(FileStoreTest, ACutFileLosesTheLastChangeOnly) {
  save(100);
  save(200);
  std::filesystem::resize_file(path, FileStore::kSlotDistance + 200);
  FileStore file(path);
  can::ParameterStore store;
  can::ObjectDictionary od;
  store.load(file, od, 2);
  EXPECT_EQ(store.state(), StorageState::torn);
  EXPECT_EQ(od.quick_stop_deceleration_mrad_s2, 100U);
}

TEST_F(FileStoreTest, TwoModulesCannotShareIt) {
  FileStore file(path);
  EXPECT_THROW(FileStore second(path), std::system_error);
  EXPECT_THROW(FileStore("/no/such/folder/x"), std::system_error);
}

}  // namespace
}  // namespace mrr::fw
