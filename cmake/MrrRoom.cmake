# Compiler settings shared by every room, and the two functions that rooms are made with.

find_program(MRR_CCACHE ccache)
if(MRR_CCACHE AND NOT CMAKE_CXX_COMPILER_LAUNCHER)
  set(CMAKE_CXX_COMPILER_LAUNCHER "${MRR_CCACHE}")
endif()

set(CMAKE_CXX_STANDARD 20)
set(CMAKE_CXX_STANDARD_REQUIRED ON)
set(CMAKE_CXX_EXTENSIONS OFF)
set(CMAKE_POSITION_INDEPENDENT_CODE ON)

add_library(mrr_flags INTERFACE)
target_compile_options(mrr_flags INTERFACE
  -Wall -Wextra -Wconversion -Wdouble-promotion -Wshadow
  # One seed, one bit-identical run: no contraction into fused multiply-add, no fast-math anywhere.
  -ffp-contract=off
  # Vectorising makes the small fixed-size matrices of a serial arm slower, not faster (scripts/bench measures it).
  -fno-tree-slp-vectorize
  $<$<BOOL:${MRR_WERROR}>:-Werror>)
target_compile_definitions(mrr_flags INTERFACE EIGEN_DONT_VECTORIZE)
if(MRR_SANITIZE)
  # "undefined" alone for programs that run inside User Mode Linux, where the address sanitizer does not start.
  set(sanitizers address,undefined)
  if(MRR_SANITIZE STREQUAL "undefined")
    set(sanitizers undefined)
  endif()
  # With sanitizers GCC believes <regex> and others to be uninitialized, and a replaced operator new to be mismatched;
  # the builds without see what really is.
  target_compile_options(mrr_flags INTERFACE -fsanitize=${sanitizers} -fno-sanitize-recover=all -fno-omit-frame-pointer
    -Wno-maybe-uninitialized -Wno-mismatched-new-delete)
  target_link_options(mrr_flags INTERFACE -fsanitize=${sanitizers})
endif()

# mrr_room(NAME SOURCES a.cpp ... PUBLIC dep ... PRIVATE dep ...): static library mrr_NAME, alias mrr::NAME.
# Includes are written from the root of the repository: #include "common/core/time.h".
function(mrr_room name)
  cmake_parse_arguments(ARG "" "" "SOURCES;PUBLIC;PRIVATE" ${ARGN})
  add_library(mrr_${name} STATIC ${ARG_SOURCES})
  add_library(mrr::${name} ALIAS mrr_${name})
  set_target_properties(mrr_${name} PROPERTIES EXPORT_NAME ${name})
  target_include_directories(mrr_${name} PUBLIC
    $<BUILD_INTERFACE:${PROJECT_SOURCE_DIR}> $<BUILD_INTERFACE:${PROJECT_BINARY_DIR}/generated>
    $<INSTALL_INTERFACE:${CMAKE_INSTALL_INCLUDEDIR}/mrr>)
  target_compile_features(mrr_${name} PUBLIC cxx_std_20)
  target_link_libraries(mrr_${name} PUBLIC ${ARG_PUBLIC} PRIVATE $<BUILD_INTERFACE:mrr_flags> ${ARG_PRIVATE})
  # Eigen's layout depends on this definition, so users of the library must have it too.
  target_compile_definitions(mrr_${name} PUBLIC EIGEN_DONT_VECTORIZE)
  set_property(GLOBAL APPEND PROPERTY MRR_LIBRARIES mrr_${name})
endfunction()

# mrr_test(NAME SOURCES a.cpp ... LIBS dep ... LABELS quick|slow ...): a GoogleTest program, each case its own ctest entry.
function(mrr_test name)
  cmake_parse_arguments(ARG "" "TIMEOUT" "SOURCES;LIBS;LABELS" ${ARGN})
  find_package(GTest REQUIRED)
  include(GoogleTest)
  add_executable(${name} ${ARG_SOURCES})
  target_link_libraries(${name} PRIVATE mrr_flags ${ARG_LIBS} GTest::gmock GTest::gtest_main)
  target_include_directories(${name} PRIVATE ${PROJECT_SOURCE_DIR} ${PROJECT_BINARY_DIR}/generated)
  target_compile_definitions(${name} PRIVATE MRR_SOURCE_DIR="${PROJECT_SOURCE_DIR}")
  if(NOT ARG_TIMEOUT)
    set(ARG_TIMEOUT 120)
  endif()
  if(NOT ARG_LABELS)
    set(ARG_LABELS quick)
  endif()
  gtest_discover_tests(${name} DISCOVERY_MODE PRE_TEST PROPERTIES TIMEOUT ${ARG_TIMEOUT} LABELS "${ARG_LABELS}")
endfunction()
