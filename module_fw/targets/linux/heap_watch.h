// Room: module_fw/targets/linux. Proof that nothing allocates while the loop runs: counts operator new after start.
// Touches nothing else.
#pragma once

#include <cstdint>

namespace mrr::fw {

/// From now on every allocation is counted; a build without NDEBUG stops at the first one.
void forbid_heap() noexcept;
void allow_heap() noexcept;
/// Allocations while they were forbidden.
[[nodiscard]] std::int64_t forbidden_allocations() noexcept;

}  // namespace mrr::fw
