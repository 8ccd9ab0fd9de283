#include "module_fw/targets/host/file_store.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/file.h>
#include <unistd.h>

#include <cerrno>
#include <system_error>

namespace mrr::fw {

namespace {

off_t place(std::uint8_t slot, std::size_t offset) noexcept {
  return static_cast<off_t>(slot * FileStore::kSlotDistance + offset);
}

}  // namespace

FileStore::FileStore(const std::string& path) : file_(::open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0600)) {
  if (file_ < 0) {
    throw std::system_error(errno, std::generic_category(),
                            fmt::format("{} cannot be opened as the memory of stored parameters", path));
  }
  if (::flock(file_, LOCK_EX | LOCK_NB) != 0) {
    const int error = errno;
    ::close(file_);
    throw std::system_error(error, std::generic_category(),
                            fmt::format("{} is in use by another module; give each its own --store", path));
  }
  thread_ = std::thread([this] { bring_to_disk(); });
}

FileStore::~FileStore() {
  sync_ = Sync::end;
  sync_.notify_one();
  thread_.join();
  ::close(file_);
}

void FileStore::bring_to_disk() noexcept {
  for (;;) {
    const Sync seen = sync_;
    if (seen == Sync::end) return;
    if (seen != Sync::wanted) {
      sync_.wait(seen);
      continue;
    }
    Sync expected = Sync::wanted;
    sync_.compare_exchange_strong(expected, ::fdatasync(file_) == 0 ? Sync::done : Sync::failed);
  }
}

can::StoragePort::Result FileStore::read(std::uint8_t slot, std::size_t offset, std::span<std::uint8_t> out) noexcept {
  const ssize_t n = ::pread(file_, out.data(), out.size(), place(slot, offset));
  if (n < 0) return Result::failed;
  // Beyond the end there is what was never written.
  for (std::size_t i = static_cast<std::size_t>(n); i < out.size(); ++i) out[i] = 0xFF;
  return Result::done;
}

can::StoragePort::Result FileStore::erase(std::uint8_t slot) noexcept {
  // The header gone, the slot is empty; the rest is written over.
  std::array<std::uint8_t, can::kStorageHeaderBytes> blank{};
  blank.fill(0xFF);
  return write(slot, 0, blank);
}

can::StoragePort::Result FileStore::write(std::uint8_t slot, std::size_t offset,
                                          std::span<const std::uint8_t> in) noexcept {
  const ssize_t n = ::pwrite(file_, in.data(), in.size(), place(slot, offset));
  return n == static_cast<ssize_t>(in.size()) ? Result::done : Result::failed;
}

can::StoragePort::Result FileStore::flush(std::uint8_t) noexcept {
  switch (sync_.load()) {
    case Sync::idle:
      sync_ = Sync::wanted;
      sync_.notify_one();
      return Result::busy;
    case Sync::wanted:
      return Result::busy;
    case Sync::done:
      sync_ = Sync::idle;
      return Result::done;
    case Sync::failed:
    case Sync::end:
      break;
  }
  sync_ = Sync::idle;
  return Result::failed;
}

}  // namespace mrr::fw
