#include "app/toml_file.h"

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string_view>

#include "firmware/base/file.h"

namespace lcdm {
namespace {

constexpr std::uintmax_t kMaxFileBytes = 256U << 10;

// "[error] toml::parse_table: ... \n --> file" becomes its first line without the prefix.
std::string first_line(const std::string& what) {
  std::string line = what.substr(0, what.find('\n'));
  if (line.rfind("[error] ", 0) == 0) line.erase(0, 8);
  if (line.rfind("toml::", 0) == 0 && line.find(": ") != std::string::npos) {
    line.erase(0, line.find(": ") + 2);
  }
  return line;
}

constexpr int kDeepest = 16;  // lists and tables in each other: more than any configuration needs
// The parser copies a value's whole line for the error that it might have to tell: a long line of
// many values would take it the square of their number.
constexpr std::size_t kLongestLine = 4096;

// The most dots of one dotted key in `line`: a table in a table each. Those in quotes and in a
// comment are none, where `quotes` can be told.
int most_dots(const std::string& line, bool quotes) {
  int dots = 0;
  int most = 0;
  char quote = 0;
  for (std::size_t i = 0; i < line.size(); ++i) {
    const char c = line[i];
    if (quote != 0) {
      if (c == '\\' && quote == '"') ++i;
      if (c == quote) quote = 0;
    } else if (quotes && (c == '"' || c == '\'')) {
      quote = c;
    } else if (quotes && c == '#') {
      break;
    } else if (c == '.') {
      most = std::max(most, ++dots);
    } else if (std::string_view(",=[]{}").find(c) != std::string_view::npos) {
      dots = 0;
    }
  }
  return most;
}

// Whether lists or tables lie deeper in each other than kDeepest: the parser below would use the
// stack for each. Lines of comment do not count, unless there are strings of several lines, in
// which such a line may be something else.
bool nests_too_deep(const std::string& text) {
  const bool long_strings =
      text.find("\"\"\"") != std::string::npos || text.find("'''") != std::string::npos;
  std::istringstream lines(text);
  int depth = 0;
  for (std::string line; std::getline(lines, line);) {
    const std::size_t first = line.find_first_not_of(" \t");
    if (first == std::string::npos || (line[first] == '#' && !long_strings)) continue;
    if (most_dots(line, !long_strings) > kDeepest) return true;
    for (const char c : line) {
      if (c == '[' || c == '{') ++depth;
      if (c == ']' || c == '}') --depth;
      if (depth > kDeepest) return true;
    }
    depth = std::max(depth, 0);
  }
  return false;
}

// The first line longer than kLongestLine; 0: there is none.
int line_too_long(const std::string& text) {
  std::istringstream lines(text);
  int number = 1;
  for (std::string line; std::getline(lines, line); ++number) {
    if (line.size() > kLongestLine) return number;
  }
  return 0;
}

// What the parser below had better not see.
Status check_limits(const std::string& file, const std::string& text) {
  if (nests_too_deep(text)) return config_error(file, "brackets lie too deep in each other");
  if (const int line = line_too_long(text); line > 0) {
    return config_error(file + ":" + std::to_string(line),
                        "longer than " + std::to_string(kLongestLine) + " bytes: break the line");
  }
  return Status::ok();
}

}  // namespace

Status config_error(const std::string& place, const std::string& text) {
  return Status::error(StatusCode::kInvalidInput, "%s: %s", place.c_str(), text.c_str());
}

std::string place_of(const std::string& file, const toml::source_location& location) {
  return file + ":" + std::to_string(location.line()) + ":" + std::to_string(location.column());
}

Status read_toml(const std::string& file, const std::string& what,
                 const std::function<Status(const toml::value&)>& use) {
  std::error_code error;
  const std::uintmax_t bytes = std::filesystem::file_size(file, error);
  if (error) return unreadable_file(("the " + what).c_str(), file, error.value());
  if (bytes > kMaxFileBytes) return config_error(file, "larger than 256 KiB: not a " + what);
  try {
    std::ifstream stream(file, std::ios::binary);
    const std::string text{std::istreambuf_iterator<char>(stream), {}};
    LCDM_RETURN_IF_ERROR(check_limits(file, text));
    stream.clear();
    stream.seekg(0);
    return use(toml::parse(stream, file));
  } catch (const toml::exception& syntax) {
    return config_error(place_of(file, syntax.location()), first_line(syntax.what()));
  } catch (const std::exception& other) {  // the disk, or no memory: it may pass
    return Status::error(StatusCode::kIoError, "%s: %s", file.c_str(),
                         first_line(other.what()).c_str());
  }
}

}  // namespace lcdm
