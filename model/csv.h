// Tables of comma-separated text that the trainer wrote: its curve, its results.
#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "firmware/base/status.h"

namespace lcdm::model {

// Lines of cells under a line of names, as RFC 4180 has them: what a cell holds of commas, quotes
// and lines' ends stands in quotes.
struct CsvTable {
  std::string path;
  std::vector<std::string> header;
  // Each as long as the header; row i is line i + 2 where no cell before it has a line's end.
  std::vector<std::vector<std::string>> rows;

  // A column by name. kNotFound: no such column.
  Result<std::vector<std::string>> texts(const std::string& column) const;
  // An empty cell is NaN, `nan` and `inf` are read as such. kCorrupt: a cell is no number.
  Result<std::vector<double>> numbers(const std::string& column) const;
};

// A last line without its end is left out: its writer was stopped within it, and a number cut short
// is still a number. kNotFound, kIoError; kCorrupt: no header, or a row of another length.
Result<CsvTable> read_csv(const std::string& path);

// The cells of the first line of `text`, which is taken off it; nullopt: it has no end.
std::optional<std::vector<std::string>> take_csv_line(std::string_view& text);

// `text` as a cell to write: in quotes where it needs them.
std::string csv_cell(const std::string& text);

}  // namespace lcdm::model
