// Room: common/core. Containers with a fixed capacity: no heap, no exceptions. Freestanding.
#pragma once

#include <array>
#include <cstddef>

namespace mrr {

/// A vector of at most N elements stored in place. Appending to a full one is refused and reported.
template <typename T, std::size_t N>
class StaticVector {
 public:
  using value_type = T;
  [[nodiscard]] constexpr bool push_back(const T& value) noexcept {
    if (size_ == N) return false;
    items_[size_++] = value;
    return true;
  }
  constexpr void clear() noexcept { size_ = 0; }
  /// Keeps the first n elements, n <= size().
  constexpr void truncate(std::size_t n) noexcept {
    if (n < size_) size_ = n;
  }
  [[nodiscard]] constexpr std::size_t size() const noexcept { return size_; }
  [[nodiscard]] constexpr bool empty() const noexcept { return size_ == 0; }
  [[nodiscard]] constexpr bool full() const noexcept { return size_ == N; }
  static constexpr std::size_t capacity() noexcept { return N; }
  constexpr T& operator[](std::size_t i) noexcept { return items_[i]; }
  constexpr const T& operator[](std::size_t i) const noexcept { return items_[i]; }
  constexpr T& back() noexcept { return items_[size_ - 1]; }
  constexpr const T& back() const noexcept { return items_[size_ - 1]; }
  constexpr T* begin() noexcept { return items_.data(); }
  constexpr T* end() noexcept { return items_.data() + size_; }
  constexpr const T* begin() const noexcept { return items_.data(); }
  constexpr const T* end() const noexcept { return items_.data() + size_; }
  constexpr T* data() noexcept { return items_.data(); }
  constexpr const T* data() const noexcept { return items_.data(); }

 private:
  std::array<T, N> items_{};
  std::size_t size_ = 0;
};

/// A first-in first-out queue of at most N elements stored in place.
template <typename T, std::size_t N>
class RingBuffer {
 public:
  [[nodiscard]] constexpr bool push(const T& value) noexcept {
    if (size_ == N) return false;
    items_[(head_ + size_) % N] = value;
    ++size_;
    return true;
  }
  /// Precondition of front() and pop(): not empty.
  [[nodiscard]] constexpr const T& front() const noexcept { return items_[head_]; }
  constexpr void pop() noexcept {
    head_ = (head_ + 1) % N;
    --size_;
  }
  /// i-th oldest element, i < size().
  [[nodiscard]] constexpr const T& operator[](std::size_t i) const noexcept { return items_[(head_ + i) % N]; }
  constexpr void clear() noexcept { head_ = size_ = 0; }
  [[nodiscard]] constexpr std::size_t size() const noexcept { return size_; }
  [[nodiscard]] constexpr bool empty() const noexcept { return size_ == 0; }
  [[nodiscard]] constexpr bool full() const noexcept { return size_ == N; }
  static constexpr std::size_t capacity() noexcept { return N; }

 private:
  std::array<T, N> items_{};
  std::size_t head_ = 0;
  std::size_t size_ = 0;
};

}  // namespace mrr
