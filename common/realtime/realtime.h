// Room: common/realtime. What a Linux process that keeps time asks of the system: an absolute sleep, memory that stays,
// a priority. Host only; may touch common/core.
#pragma once

#include <string>

#include "common/core/time.h"

namespace mrr::realtime {

/// Who goes first when several wake at once (SCHED_FIFO): what stands for hardware, then who sets the pace, then
/// joints.
inline constexpr int kPlantPriority = 80;
inline constexpr int kSupervisorPriority = 70;
inline constexpr int kModulePriority = 60;

/// Until CLOCK_MONOTONIC shows `t`; earlier when a signal comes.
void sleep_until(Time t) noexcept;

/// Keeps what the process has in memory, now and later. Empty: granted; else why not, as "memory is not locked (...)".
[[nodiscard]] std::string lock_memory();
/// SCHED_FIFO for the calling thread. 0: granted; else the error.
[[nodiscard]] int take_priority(int priority) noexcept;
/// Of an error of take_priority(): empty, or "no real-time priority (...)".
[[nodiscard]] std::string describe_priority(int error);
/// Both refusals in one line; empty: everything was granted.
[[nodiscard]] std::string joined(const std::string& memory, const std::string& priority);

/// Memory and priority for a process of one thread; what was refused, empty: nothing.
[[nodiscard]] std::string ask(int priority);

}  // namespace mrr::realtime
