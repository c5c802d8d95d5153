// Tables of comma-separated text that the trainer wrote: its curve, its results.
#pragma once

#include <string>
#include <vector>

#include "firmware/base/status.h"

namespace lcdm::model {

// Lines of cells under a line of names; neither quotes nor commas within a cell.
struct CsvTable {
  std::string path;
  std::vector<std::string> header;
  std::vector<std::vector<std::string>> rows;  // each as long as the header; row i is line i + 2

  // A column by name. kNotFound: no such column.
  Result<std::vector<std::string>> texts(const std::string& column) const;
  // An empty cell is NaN, `nan` and `inf` are read as such. kCorrupt: a cell is no number.
  Result<std::vector<double>> numbers(const std::string& column) const;
};

// A last line without its end is left out: its writer was stopped within it, and a number cut short
// is still a number. kNotFound, kIoError; kCorrupt: no header, or a row of another length.
Result<CsvTable> read_csv(const std::string& path);

}  // namespace lcdm::model
