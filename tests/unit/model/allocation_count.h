// Test support: counts heap allocations of this program. Include in exactly one source file of a test.
// Eigen calls malloc itself, so malloc is what is counted (operator new ends there too).
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdlib>

namespace mrr::test {
inline std::atomic<long> allocations{0};
#if defined(__SANITIZE_ADDRESS__)
inline constexpr bool kCountsAllocations = false;  // the sanitizer owns malloc
#else
inline constexpr bool kCountsAllocations = true;
#endif
}  // namespace mrr::test

#if !defined(__SANITIZE_ADDRESS__)
extern "C" {
void* __libc_malloc(std::size_t size);                           // NOLINT: glibc's own name
void* __libc_calloc(std::size_t count, std::size_t size);        // NOLINT
void* __libc_realloc(void* old, std::size_t size);               // NOLINT
void* __libc_memalign(std::size_t alignment, std::size_t size);  // NOLINT
void* malloc(std::size_t size) noexcept {
  mrr::test::allocations.fetch_add(1, std::memory_order_relaxed);
  return __libc_malloc(size);
}
void* calloc(std::size_t count, std::size_t size) noexcept {
  mrr::test::allocations.fetch_add(1, std::memory_order_relaxed);
  return __libc_calloc(count, size);
}
void* realloc(void* old, std::size_t size) noexcept {
  mrr::test::allocations.fetch_add(1, std::memory_order_relaxed);
  return __libc_realloc(old, size);
}
void* aligned_alloc(std::size_t alignment, std::size_t size) noexcept {
  mrr::test::allocations.fetch_add(1, std::memory_order_relaxed);
  return __libc_memalign(alignment, size);
}
}
#endif
