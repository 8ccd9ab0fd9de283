// Room: module_fw/targets/cortex_m. From reset to main() on a Cortex-M4F: FPU on, .data and .bss set up, constructors
// run. Touches the CPU's own registers only; the linker script gives the addresses.
#include <cstdint>

extern "C" {

extern std::uint32_t stack_top;
extern std::uint32_t data_load;
extern std::uint32_t data_start;
extern std::uint32_t data_end;
extern std::uint32_t bss_start;
extern std::uint32_t bss_end;
using Function = void (*)();
extern const Function init_array_start[];
extern const Function init_array_end[];

int main();
void SysTick_Handler();

[[noreturn]] void reset_handler();
[[noreturn]] void fault_handler();

// An exception that nobody expects: the outputs are dead with the core halted, the brake's spring does the rest.
[[noreturn]] void fault_handler() {
  asm volatile("cpsid i" ::: "memory");
  for (;;) asm volatile("wfi");
}

[[noreturn]] void reset_handler() {
  constexpr std::uintptr_t kCoprocessorAccess = 0xE000ED88U;
  *reinterpret_cast<volatile std::uint32_t*>(kCoprocessorAccess) |= 0xFU << 20U;
  asm volatile("dsb\n isb" ::: "memory");
  const std::uint32_t* from = &data_load;
  for (std::uint32_t* to = &data_start; to < &data_end; ++to, ++from) *to = *from;
  for (std::uint32_t* to = &bss_start; to < &bss_end; ++to) *to = 0;
  for (const Function* f = init_array_start; f < init_array_end; ++f) (*f)();
  main();
  fault_handler();
}

}  // extern "C"

namespace {

struct VectorTable {
  std::uint32_t* initial_stack;
  Function exceptions[15];
};

}  // namespace

__attribute__((section(".vectors"), used)) const VectorTable kVectors = {
    &stack_top,
    {reset_handler, fault_handler, fault_handler, fault_handler, fault_handler, fault_handler, nullptr, nullptr,
     nullptr, nullptr, fault_handler, fault_handler, nullptr, fault_handler, SysTick_Handler},
};
