// What the operating system says of itself, from files as it writes them.
#include "firmware/base/os.h"

#include <filesystem>
#include <fstream>
#include <gtest/gtest.h>

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

}  // namespace
}  // namespace lcdm
