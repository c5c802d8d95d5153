#include "model/csv.h"

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <cstdio>
#include <limits>
#include <optional>
#include <string_view>
#include <utility>

namespace lcdm::model {
namespace {

Result<std::string> read_text(const std::string& path) {
  std::FILE* file = std::fopen(path.c_str(), "rb");
  if (file == nullptr && errno == ENOENT) {
    return Status::error(StatusCode::kNotFound, "%s is not there", path.c_str());
  }
  if (file == nullptr) return Status::system(errno, "%s cannot be opened", path.c_str());
  std::string text;
  char buffer[1 << 14];
  while (const std::size_t n = std::fread(buffer, 1, sizeof(buffer), file)) text.append(buffer, n);
  const int error = std::ferror(file) != 0 ? errno : 0;
  std::fclose(file);
  if (error != 0) return Status::system(error, "%s cannot be read", path.c_str());
  return text;
}

// The place of `column` in the header.
Result<std::size_t> find_column(const CsvTable& table, const std::string& column) {
  const auto found = std::find(table.header.begin(), table.header.end(), column);
  if (found == table.header.end()) {
    return Status::error(StatusCode::kNotFound, "%s has no column '%s'", table.path.c_str(),
                         column.c_str());
  }
  return static_cast<std::size_t>(found - table.header.begin());
}

std::optional<double> number_of(const std::string& cell) {
  if (cell.empty()) return std::numeric_limits<double>::quiet_NaN();
  double value = 0;
  const char* end = cell.data() + cell.size();
  const auto parsed = std::from_chars(cell.data(), end, value);
  if (parsed.ec != std::errc() || parsed.ptr != end) return std::nullopt;
  return value;
}

}  // namespace

Result<std::vector<std::string>> CsvTable::texts(const std::string& column) const {
  const auto place = find_column(*this, column);
  if (!place) return place.status();
  std::vector<std::string> values;
  values.reserve(rows.size());
  for (const auto& row : rows) values.push_back(row[*place]);
  return values;
}

Result<std::vector<double>> CsvTable::numbers(const std::string& column) const {
  const auto cells = texts(column);
  if (!cells) return cells.status();
  std::vector<double> values;
  values.reserve(rows.size());
  for (const std::string& cell : *cells) {
    const std::optional<double> value = number_of(cell);
    if (!value) {
      return Status::error(StatusCode::kCorrupt, "%s:%zu: '%.40s' in column '%s' is no number",
                           path.c_str(), values.size() + 2, cell.c_str(), column.c_str());
    }
    values.push_back(*value);
  }
  return values;
}

Result<CsvTable> read_csv(const std::string& path) {
  const Result<std::string> text = read_text(path);
  if (!text) return text.status();
  CsvTable table;
  table.path = path;
  std::string_view rest = *text;
  while (auto cells = take_csv_line(rest)) {
    if (table.header.empty()) {
      table.header = std::move(*cells);
    } else if (cells->size() == table.header.size()) {
      table.rows.push_back(std::move(*cells));
    } else {
      return Status::error(StatusCode::kCorrupt, "%s:%zu: %zu cells under a header of %zu",
                           path.c_str(), table.rows.size() + 2, cells->size(), table.header.size());
    }
  }
  if (table.header.empty()) {
    return Status::error(StatusCode::kCorrupt, "%s:1: no header line", path.c_str());
  }
  return table;
}

std::optional<std::vector<std::string>> take_csv_line(std::string_view& text) {
  std::vector<std::string> cells(1);
  bool quoted = false;
  for (std::size_t i = 0; i < text.size(); ++i) {
    const char c = text[i];
    const std::string_view rest = text.substr(i + 1);
    if (quoted && c == '"' && rest.starts_with('"')) {
      cells.back() += text[++i];
    } else if (c == '"' && (quoted || cells.back().empty())) {
      quoted = !quoted;
    } else if (quoted) {
      cells.back() += c;
    } else if (c == ',') {
      cells.emplace_back();
    } else if (c == '\n') {
      text.remove_prefix(i + 1);
      return cells;
    } else if (c != '\r' || !rest.starts_with('\n')) {
      cells.back() += c;
    }
  }
  return std::nullopt;
}

std::string csv_cell(const std::string& text) {
  if (text.find_first_of(",\"\r\n") == std::string::npos) return text;
  std::string cell = "\"";
  for (const char c : text) cell += c == '"' ? "\"\"" : std::string(1, c);
  return cell + '"';
}

}  // namespace lcdm::model
