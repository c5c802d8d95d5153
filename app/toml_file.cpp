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

// Behind the string that begins at `at`. One of a single line ends with that at the latest: then it
// is a fault, which the parser finds.
std::size_t end_of_string(const std::string& text, std::size_t at) {
  const char quote = text[at];
  const std::string three(3, quote);
  const bool several_lines = text.compare(at, 3, three) == 0;
  at += several_lines ? 3 : 1;
  while (at < text.size()) {
    if (text[at] == '\\' && quote == '"') {
      at += 2;
    } else if (several_lines && text.compare(at, 3, three) == 0) {
      at += 3;
      for (int more = 0; more < 2 && at < text.size() && text[at] == quote; ++more) ++at;
      return at;
    } else if (!several_lines && (text[at] == quote || text[at] == '\n')) {
      return text[at] == quote ? at + 1 : at;
    } else {
      ++at;
    }
  }
  return text.size();
}

// What is neither in quotes nor comment: what the parser takes for structure.
std::string structure_of(const std::string& text) {
  std::string structure;
  for (std::size_t at = 0; at < text.size();) {
    if (text[at] == '"' || text[at] == '\'') {
      at = end_of_string(text, at);
    } else if (text[at] == '#') {
      at = std::min(text.find('\n', at), text.size());
    } else {
      structure += text[at++];
    }
  }
  return structure;
}

// Whether lists or tables lie deeper in each other than kDeepest, or a dotted key, which is a table
// in a table for each dot, has more dots: the parser below would use the stack for each.
bool nests_too_deep(const std::string& text) {
  int depth = 0;
  int dots = 0;
  for (const char c : structure_of(text)) {
    if (c == '[' || c == '{') ++depth;
    if (c == ']' || c == '}') depth = std::max(depth - 1, 0);
    if (c == '.') ++dots;
    if (std::string_view(",=[]{}\n").find(c) != std::string_view::npos) dots = 0;
    if (depth > kDeepest || dots > kDeepest) return true;
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
