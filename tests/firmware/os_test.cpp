// What the operating system says of itself, from files as it writes them, and what it refuses.
#include "firmware/base/os.h"

#include <filesystem>
#include <fstream>
#include <gtest/gtest.h>
#include <unistd.h>

#include "tests/support/locked_memory_limit.h"
#include "tests/support/temporary_folder.h"

namespace lcdm {
namespace {

TEST(HugePages, AreGivenUnlessTheKernelNeverDoesOrHasNone) {
  const test::TemporaryFolder sysfs;
  EXPECT_FALSE(os::gives_huge_pages(sysfs.path()));
  const std::filesystem::path folder = sysfs.file("kernel/mm/transparent_hugepage");
  std::filesystem::create_directories(folder);
  const auto gives = [&](const char* choices) {
    std::ofstream(folder / "enabled") << choices << "\n";
    return os::gives_huge_pages(sysfs.path());
  };
  EXPECT_TRUE(gives("[always] madvise never"));
  EXPECT_TRUE(gives("always [madvise] never"));
  EXPECT_FALSE(gives("always madvise [never]"));
}

#ifndef LCDM_SANITIZED  // there nothing is locked
TEST(LockedMemoryDeathTest, EndsWhereTheLimitDoesAndSaysWhichOneToRaise) {
  constexpr std::size_t kLimit = 64 << 10;
  const auto lock_both = [] {
    const Result<std::byte*> memory = os::allocate_pages(2 * kLimit);
    test::limit_locked_memory(kLimit);
    const bool locked = os::lock_pages(*memory, kLimit).is_ok();
    std::fputs(os::lock_pages(*memory, 2 * kLimit).text(), stderr);
    _exit(locked ? 0 : 1);
  };
  EXPECT_EXIT(lock_both(), testing::ExitedWithCode(0), "cannot lock 131072 bytes.*LimitMEMLOCK=");
}
#endif

}  // namespace
}  // namespace lcdm
