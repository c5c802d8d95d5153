# How every target of the project is compiled: one place for warnings, sanitizers and includes.

find_package(Threads REQUIRED)

add_library(lcdm_options INTERFACE)
target_compile_options(lcdm_options INTERFACE
  -Wall -Wextra -Wpedantic -Wshadow -Wnon-virtual-dtor -Wold-style-cast -Woverloaded-virtual
  -Wunused -Werror)
target_include_directories(lcdm_options INTERFACE ${PROJECT_SOURCE_DIR})
target_link_libraries(lcdm_options INTERFACE Threads::Threads)
if(LCDM_SANITIZE)
  target_compile_options(lcdm_options INTERFACE
    -fsanitize=${LCDM_SANITIZE} -fno-sanitize-recover=all -fno-omit-frame-pointer)
  target_link_options(lcdm_options INTERFACE -fsanitize=${LCDM_SANITIZE})
endif()

# malloc counted (firmware/base/alloc_watch.h), for programs that promise not to allocate.
# Sanitizers bring their own malloc: there the library is empty.
add_library(lcdm_alloc_hooks INTERFACE)
if(NOT LCDM_SANITIZE)
  target_sources(lcdm_alloc_hooks INTERFACE ${PROJECT_SOURCE_DIR}/firmware/base/alloc_hooks.cpp)
endif()

# lcdm_library(NAME source...): a static library with the project's options.
function(lcdm_library name)
  add_library(${name} STATIC ${ARGN})
  target_link_libraries(${name} PUBLIC lcdm_options)
endfunction()

# lcdm_test(NAME source...): one GoogleTest program, its cases known to ctest one by one.
function(lcdm_test name)
  add_executable(${name} ${ARGN})
  target_link_libraries(${name} PRIVATE lcdm_options GTest::gtest GTest::gmock GTest::gtest_main)
  gtest_discover_tests(${name} DISCOVERY_TIMEOUT 60
    WORKING_DIRECTORY ${PROJECT_SOURCE_DIR} PROPERTIES TIMEOUT 300)
endfunction()
