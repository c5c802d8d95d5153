// Files are written whole or not at all.
#include "firmware/base/file.h"

#include <cerrno>
#include <filesystem>
#include <fstream>
#include <gtest/gtest.h>
#include <iterator>
#include <vector>

#include "tests/support/file_size_limit.h"
#include "tests/support/temporary_folder.h"

namespace lcdm {
namespace {

namespace fs = std::filesystem;
using test::TemporaryFolder;

std::string text_of(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
}

// A program that ends with the first is not started again; with the second it is.
TEST(UnreadableFile, IsWrongForGoodOrJustNow) {
  const Status missing = unreadable_file("the token", "/nowhere", ENOENT);
  EXPECT_EQ(missing.code(), StatusCode::kInvalidInput);
  EXPECT_EQ(std::string(missing.text()),
            "cannot read the token /nowhere: No such file or directory: give an existing file");
  for (const int passing : {EIO, ENOMEM, EMFILE, ENFILE}) {
    EXPECT_EQ(unreadable_file("the token", "/card/token", passing).code(), StatusCode::kIoError);
  }
}

// Names of files and what recordings say are in it.
TEST(StatusText, DoesNotSteerTheTerminal) {
  const Status status =
      Status::error(StatusCode::kCorrupt, "lens \"%s\"", "\x1b]0;title\a\x1b[31mred");
  EXPECT_STREQ(status.text(), "lens \"?]0;title??[31mred\"");
  EXPECT_STREQ(Status::system(ENOENT, "a\nb").text(), "a?b: No such file or directory");
}

TEST(WriteFile, AFullDiskOrMissingFolderIsNamedAndLeavesNothing) {
  const std::vector<std::byte> bytes(1U << 16);
  const Status full = write_file("/dev/full", bytes);
  EXPECT_EQ(full.code(), StatusCode::kIoError);
  EXPECT_NE(std::string(full.text()).find("No space"), std::string::npos) << full.text();
  const TemporaryFolder folder;
  const Status missing = write_file(folder.file("no/such/folder.png"), bytes);
  EXPECT_EQ(missing.code(), StatusCode::kIoError);
  EXPECT_NE(std::string(missing.text()).find("no/such/folder.png"), std::string::npos);
  const test::FileSizeLimit limit(1000);
  EXPECT_FALSE(write_file(folder.file("cut"), bytes));
  EXPECT_FALSE(fs::exists(folder.file("cut")));
}

TEST(ReplaceFile, PutsTheNewOneInTheOldOnesPlaceAndLeavesNothingBeside) {
  const TemporaryFolder folder;
  const std::string path = folder.write("a", "yesterday's");
  const Status replaced = replace_file(path, "today's");
  ASSERT_TRUE(replaced) << replaced.text();
  EXPECT_EQ(text_of(path), "today's");
  EXPECT_FALSE(fs::exists(path + ".new"));
}

TEST(ReplaceFile, OnAFullDiskLeavesTheOldOneAndSaysWhatToDo) {
  const TemporaryFolder folder;
  const std::string path = folder.write("a", "yesterday's");
  const test::FileSizeLimit limit(1000);
  for (const std::size_t size : {2000U, 100'000U}) {  // within the library's buffer and beyond it
    const Status full = replace_file(path, std::vector<std::byte>(size));
    EXPECT_EQ(full.code(), StatusCode::kIoError);
    EXPECT_EQ(full.sys_errno(), EFBIG);
    EXPECT_NE(std::string(full.text()).find(path + " could not be written; free space"),
              std::string::npos)
        << full.text();
    EXPECT_EQ(text_of(path), "yesterday's");
    EXPECT_FALSE(fs::exists(path + ".new"));
  }
}

TEST(ReplaceFile, InAFolderThatIsNotThereIsAnError) {
  const TemporaryFolder folder;
  EXPECT_EQ(replace_file(folder.file("none/a"), "text").sys_errno(), ENOENT);
}

TEST(ReplaceFile, FollowsNoLinkThatWasPlantedAtItsUnfinishedName) {
  const TemporaryFolder folder;
  const std::string target = folder.write("precious", "keep");
  fs::create_symlink(target, folder.file("a.new"));
  ASSERT_TRUE(replace_file(folder.file("a"), "text"));
  EXPECT_EQ(text_of(folder.file("a")), "text");
  EXPECT_FALSE(fs::is_symlink(folder.file("a")));
  EXPECT_EQ(text_of(target), "keep");
}

TEST(FileReplacement, GivenUpLeavesTheOldOne) {
  const TemporaryFolder folder;
  const std::string path = folder.write("a", "yesterday's");
  {
    FileReplacement file(path);
    file.append(std::vector<std::byte>(10));
  }
  EXPECT_EQ(text_of(path), "yesterday's");
  EXPECT_FALSE(fs::exists(path + ".new"));
}

}  // namespace
}  // namespace lcdm
