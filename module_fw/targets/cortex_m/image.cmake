# Builds the Cortex-M4F image of the module and looks at what was linked. Run by the test and by the target mrr_cortex_m:
#   cmake -DSOURCE_DIR=. -DBINARY_DIR=build/x -DSOURCES=a.cpp|b.cpp -P image.cmake
# Fails, and says why, without a cross compiler, and when a heap, an exception or double arithmetic got in.
find_program(GXX arm-none-eabi-g++)
find_program(NM arm-none-eabi-nm)
find_program(SIZE arm-none-eabi-size)
if(NOT GXX OR NOT NM OR NOT SIZE)
  message(FATAL_ERROR "arm-none-eabi-g++ is missing: the firmware image cannot be built. "
    "Install gcc-arm-none-eabi, libnewlib-arm-none-eabi and libstdc++-arm-none-eabi-dev.")
endif()

string(REPLACE "|" ";" sources "${SOURCES}")
set(elf "${BINARY_DIR}/mrr_module.elf")
file(GLOB stale "${elf}-*.ci")
if(stale)
  file(REMOVE ${stale})
endif()
execute_process(
  COMMAND "${GXX}" -std=c++20 -O2 -mcpu=cortex-m4 -mthumb -mfpu=fpv4-sp-d16 -mfloat-abi=hard
    -ffreestanding -fno-exceptions -fno-rtti -fno-threadsafe-statics -fno-use-cxa-atexit -fno-math-errno
    -ffunction-sections -fdata-sections -ffp-contract=off -fno-tree-slp-vectorize
    -Wall -Wextra -Wconversion -Wdouble-promotion -Wshadow -Werror -DMRR_NO_TEST_OBJECTS -fcallgraph-info=su
    -I "${SOURCE_DIR}" -I "${PROJECT_BINARY_DIR}/generated" ${sources}
    -Wno-psabi -nostdlib -lc_nano -lgcc -Wl,--gc-sections -Wl,--fatal-warnings
    -Wl,-Map=${elf}.map -T "${SOURCE_DIR}/module_fw/targets/cortex_m/cortex_m4.ld" -o "${elf}"
  WORKING_DIRECTORY "${SOURCE_DIR}" RESULT_VARIABLE failed ERROR_VARIABLE log)
if(failed)
  message(FATAL_ERROR "The Cortex-M4F image does not build:\n${log}")
endif()

execute_process(COMMAND "${NM}" --demangle=none "${elf}" OUTPUT_VARIABLE symbols RESULT_VARIABLE failed)
if(failed OR NOT symbols MATCHES "_ZN3mrr2fw6Module4step")
  message(FATAL_ERROR "The image does not contain the module: nothing was checked.")
endif()
string(REPLACE "\n" ";" lines "${symbols}")
set(bad "")
foreach(line IN LISTS lines)
  string(REGEX REPLACE "^.* " "" name "${line}")
  if(name MATCHES "^(malloc|calloc|realloc|free|_malloc_r|_free_r|_calloc_r|_realloc_r|_sbrk|_sbrk_r)$"  # heap
     OR name MATCHES "^_Zn[wa]|^_Zd[la]"                                                # new, delete
     OR name MATCHES "^(__cxa_throw|__cxa_begin_catch|__cxa_allocate_exception|_Unwind_RaiseException)|__throw_"
     OR name MATCHES "^__aeabi_(d|cd|f2d|i2d|ui2d|l2d|ul2d)" OR name MATCHES "df[23]$|^__.*df$|^__fix.*df"  # double
     OR name MATCHES "^(exp|log|pow|sin|cos|tan|atan2|sqrt|floor|round|fmod)f?$")       # libm
    list(APPEND bad "${name}")
  endif()
endforeach()
if(bad)
  message(FATAL_ERROR "Symbols that a module must not need: ${bad}")
endif()
# The linker script keeps this much free for the stack.
file(STRINGS "${SOURCE_DIR}/module_fw/targets/cortex_m/cortex_m4.ld" line REGEX "^stack_size = [0-9]+K;")
string(REGEX MATCH "[0-9]+" kilobytes "${line}")
math(EXPR limit "${kilobytes} * 1024")
file(GLOB graphs "${elf}-*.ci")
execute_process(COMMAND "${PYTHON}" "${SOURCE_DIR}/module_fw/targets/cortex_m/stack_use.py" ${limit} ${graphs}
  OUTPUT_VARIABLE stack ERROR_VARIABLE stack_error RESULT_VARIABLE failed)
if(failed)
  message(FATAL_ERROR "The stack:\n${stack}${stack_error}")
endif()
execute_process(COMMAND "${SIZE}" "${elf}" OUTPUT_VARIABLE size)
message(STATUS "Cortex-M4F image: no heap, no exceptions, no double arithmetic\n${stack}${size}")
