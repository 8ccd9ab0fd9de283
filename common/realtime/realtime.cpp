#include "common/realtime/realtime.h"

#include <fmt/format.h>
#include <pthread.h>
#include <sched.h>
#include <sys/mman.h>

#include <cerrno>
#include <cstring>
#include <ctime>

namespace mrr::realtime {

void sleep_until(Time t) noexcept {
  const timespec at{t.ns / 1'000'000'000, t.ns % 1'000'000'000};
  ::clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &at, nullptr);
}

std::string lock_memory() {
  if (::mlockall(MCL_CURRENT | MCL_FUTURE) == 0) return {};
  return fmt::format("memory is not locked ({})", std::strerror(errno));
}

int take_priority(int priority) noexcept {
  sched_param parameters{};
  parameters.sched_priority = priority;
  return ::pthread_setschedparam(::pthread_self(), SCHED_FIFO, &parameters);  // returns its error
}

std::string describe_priority(int error) {
  return error == 0 ? std::string() : fmt::format("no real-time priority ({})", std::strerror(error));
}

std::string joined(const std::string& memory, const std::string& priority) {
  return fmt::format("{}{}{}", memory, memory.empty() || priority.empty() ? "" : ", ", priority);
}

std::string ask(int priority) {
  const std::string memory = lock_memory();
  return joined(memory, describe_priority(take_priority(priority)));
}

}  // namespace mrr::realtime
