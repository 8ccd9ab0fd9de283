#include "module_fw/targets/linux/heap_watch.h"

#include <atomic>
#include <cstdlib>
#include <new>

namespace {

std::atomic<bool> forbidden{false};
std::atomic<std::int64_t> count{0};

void* allocate(std::size_t size) {
  if (forbidden.load(std::memory_order_relaxed)) {
    count.fetch_add(1, std::memory_order_relaxed);
#ifndef NDEBUG
    std::abort();
#endif
  }
  void* p = std::malloc(size == 0 ? 1 : size);
  if (p == nullptr) throw std::bad_alloc();
  return p;
}

}  // namespace

// The array forms call these.
void* operator new(std::size_t size) { return allocate(size); }
void operator delete(void* p) noexcept { std::free(p); }
void operator delete(void* p, std::size_t) noexcept { std::free(p); }

namespace mrr::fw {

void forbid_heap() noexcept { forbidden = true; }
void allow_heap() noexcept { forbidden = false; }
std::int64_t forbidden_allocations() noexcept { return count; }

}  // namespace mrr::fw
