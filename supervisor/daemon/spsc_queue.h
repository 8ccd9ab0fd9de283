// Room: supervisor/daemon. A queue of fixed size between one writing and one reading thread: no lock, no heap, no wait.
// May touch the standard library only.
#pragma once

#include <array>
#include <atomic>
#include <cstddef>

namespace mrr::sup {

template <typename T, std::size_t N>
class SpscQueue {
 public:
  /// Writer. False: full, nothing was written.
  bool push(const T& value) noexcept {
    const std::size_t tail = tail_.load(std::memory_order_relaxed);
    if (tail - head_.load(std::memory_order_acquire) == N) return false;
    items_[tail % N] = value;
    tail_.store(tail + 1, std::memory_order_release);
    return true;
  }
  /// Reader. False: empty.
  bool pop(T& value) noexcept {
    const std::size_t head = head_.load(std::memory_order_relaxed);
    if (head == tail_.load(std::memory_order_acquire)) return false;
    value = items_[head % N];
    head_.store(head + 1, std::memory_order_release);
    return true;
  }

 private:
  std::array<T, N> items_{};
  alignas(64) std::atomic<std::size_t> head_{0};
  alignas(64) std::atomic<std::size_t> tail_{0};
};

/// One question at a time from one thread to another, which looks when it likes.
template <typename Question, typename Reply>
class Mailbox {
 public:
  // The asking side.
  void ask(const Question& question) noexcept {
    question_ = question;
    state_.store(State::asked, std::memory_order_release);
  }
  /// True once; then the next may be asked.
  [[nodiscard]] bool replied(Reply& reply) noexcept {
    if (state_.load(std::memory_order_acquire) != State::replied) return false;
    reply = reply_;
    state_.store(State::empty, std::memory_order_relaxed);
    return true;
  }
  /// Takes the question back. False: it is being answered, replied() will be true in a moment.
  [[nodiscard]] bool withdraw() noexcept {
    State asked = State::asked;
    return state_.compare_exchange_strong(asked, State::empty, std::memory_order_acq_rel);
  }

  // The answering side: take(), then reply().
  [[nodiscard]] bool take(Question& question) noexcept {
    State asked = State::asked;
    if (!state_.compare_exchange_strong(asked, State::taken, std::memory_order_acq_rel)) return false;
    question = question_;
    return true;
  }
  void reply(const Reply& reply) noexcept {
    reply_ = reply;
    state_.store(State::replied, std::memory_order_release);
  }

 private:
  enum class State : unsigned char { empty, asked, taken, replied };
  Question question_{};
  Reply reply_{};
  std::atomic<State> state_{State::empty};
};

/// The newest value, from one writing to one reading thread. The writer never waits; the reader never sees half of one.
template <typename T>
class Latest {
 public:
  /// Writer: fill what this returns, then publish().
  [[nodiscard]] T& back() noexcept { return slots_[back_]; }
  void publish() noexcept { back_ = shared_.exchange(back_ | kFresh, std::memory_order_acq_rel) & kSlot; }
  /// Reader: the newest published value; stays as it is until the next call.
  [[nodiscard]] const T& read() noexcept {
    if ((shared_.load(std::memory_order_relaxed) & kFresh) != 0) {
      front_ = shared_.exchange(front_, std::memory_order_acq_rel) & kSlot;
    }
    return slots_[front_];
  }

 private:
  static constexpr unsigned kSlot = 3U;
  static constexpr unsigned kFresh = 4U;
  std::array<T, 3> slots_{};
  unsigned back_ = 0;
  std::atomic<unsigned> shared_{1};
  unsigned front_ = 2;
};

}  // namespace mrr::sup
