// The token's file is a stranger's until it is read.
#include "app/http_token.h"

#include <filesystem>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/support/temporary_folder.h"

namespace lcdm {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;
using testing::Not;

class HttpToken : public testing::Test {
 protected:
  std::string write(const std::string& text, fs::perms perms = fs::perms(0640)) const {
    const std::string file = folder_.write("token", text);
    fs::permissions(file, perms);
    return file;
  }

  // The error, which must not give away what the file holds.
  static std::string refusal(const std::string& file, const std::string& secret) {
    const Result<std::string> token = read_token(file);
    if (token) return "taken";
    EXPECT_THAT(token.status().text(), HasSubstr(file));
    EXPECT_THAT(token.status().text(), Not(HasSubstr(secret)));
    return token.status().text();
  }

  test::TemporaryFolder folder_;
};

TEST_F(HttpToken, IsTheFirstLine) {
  for (const char* ending : {"", "\n", "\nmore\n"}) {
    const Result<std::string> token = read_token(write(std::string("0123456789abcdef") + ending));
    ASSERT_TRUE(token) << token.status().text();
    EXPECT_EQ(*token, "0123456789abcdef");
  }
  EXPECT_TRUE(read_token(write(std::string(256, 'x') + "\n")));
}

TEST_F(HttpToken, MustBeHardToGuess) {
  EXPECT_THAT(refusal(write("short-secret\n"), "short-secret"), HasSubstr("openssl rand"));
  EXPECT_THAT(refusal(write("has spaces in the middle\n"), "spaces in the"),
              HasSubstr("16 to 256"));
  EXPECT_THAT(refusal(write(std::string(257, 'x')), "xxxx"), HasSubstr("16 to 256"));
  EXPECT_THAT(refusal(write(""), "?"), HasSubstr("16 to 256"));
}

TEST_F(HttpToken, MustNotBeReadableByOthers) {
  for (const int mode : {0644, 0602, 0641}) {
    EXPECT_THAT(refusal(write("0123456789abcdef\n", fs::perms(mode)), "0123456789abcdef"),
                HasSubstr("chmod"));
  }
}

TEST_F(HttpToken, MustBeAFile) {
  EXPECT_THAT(refusal("/nowhere/token", "?"), HasSubstr("cannot read"));
  EXPECT_NE(refusal(folder_.path(), "?"), "taken");
  EXPECT_NE(refusal("/dev/zero", "?"), "taken");
}

}  // namespace
}  // namespace lcdm
