#include "app/http_token.h"

#include <algorithm>
#include <cerrno>
#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include "firmware/base/file.h"

namespace lcdm {
namespace {

constexpr std::size_t kLeast = 16;
constexpr std::size_t kMost = 256;
constexpr std::string_view kScheme = "Bearer ";

// At most one byte more than a token and its line's end.
Result<std::string> read_start(const std::string& file) {
  const int descriptor = open(file.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);
  if (descriptor < 0) return unreadable_file("http.token_file", file, errno);
  struct stat facts {};
  const bool known = fstat(descriptor, &facts) == 0;
  std::string text(kMost + 2, '\0');
  const ssize_t got = known ? read(descriptor, text.data(), text.size()) : -1;
  const int error = errno;
  close(descriptor);
  if (got < 0) return unreadable_file("http.token_file", file, error);
  if (!S_ISREG(facts.st_mode)) {
    return Status::error(StatusCode::kInvalidInput, "http.token_file: %s is no regular file",
                         file.c_str());
  }
  if ((facts.st_mode & S_IRWXO) != 0) {
    return Status::error(StatusCode::kInvalidInput,
                         "http.token_file: everybody may read or write %s: chmod o= it",
                         file.c_str());
  }
  text.resize(static_cast<std::size_t>(got));
  return text;
}

}  // namespace

Result<std::string> read_token(const std::string& file) {
  Result<std::string> text = read_start(file);
  if (!text) return text;
  std::string token = text->substr(0, text->find('\n'));
  const bool printable =
      std::all_of(token.begin(), token.end(), [](char c) { return c > ' ' && c <= '~'; });
  if (!printable || token.size() < kLeast || token.size() > kMost) {
    return Status::error(StatusCode::kInvalidInput,
                         "http.token_file: the first line of %s is no token: 16 to 256 printable "
                         "characters without spaces (openssl rand -hex 16 makes one)",
                         file.c_str());
  }
  return token;
}

bool carries_token(std::string_view authorization, std::string_view token) {
  if (token.empty() || authorization.substr(0, kScheme.size()) != kScheme) return false;
  const std::string_view given = authorization.substr(kScheme.size());
  // Every byte is looked at, whichever differs. Volatile: no early end by the compiler either.
  volatile unsigned char difference = given.size() == token.size() ? 0 : 1;
  for (std::size_t i = 0; i < token.size(); ++i) {
    const char other = i < given.size() ? given[i] : '\0';
    difference = static_cast<unsigned char>(difference | (token[i] ^ other));
  }
  return difference == 0;
}

}  // namespace lcdm
