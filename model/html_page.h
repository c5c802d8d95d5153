// One self-contained HTML file for a person to read: text, tables, charts, pictures. No scripts,
// nothing fetched; light or dark as the reader's screen is, light on paper. Also well-formed XML.
#pragma once

#include <opencv2/core.hpp>
#include <string>
#include <vector>

#include "firmware/base/status.h"

namespace lcdm::model {

struct Series {
  std::string name;                      // empty: not in the legend
  std::vector<double> x;                 // what is not finite, in x or y, is a gap
  std::vector<double> y;                 // one per x
  std::vector<std::string> labels = {};  // of a scatter chart's points: one per x, or none
};

struct Chart {
  std::string title;
  std::string x_label;  // with the unit: "parameters, millions"
  std::string y_label;
  bool log_x = false;  // then what is not positive is a gap too
  bool log_y = false;
  std::vector<Series> series;
};

struct Picture {
  cv::Mat bgr;  // 8 bit, 1 or 3 channels; one that is not is named by its caption alone
  std::string caption;
};

// Grows from top to bottom. All text is plain: escaped, and bytes that are not UTF-8 replaced.
class HtmlPage {
 public:
  explicit HtmlPage(const std::string& title);

  void heading(const std::string& text);
  void paragraph(const std::string& text);
  void note(const std::string& text);  // small and quiet: conditions, sources
  // The first column is text, the others are numbers, aligned at the right. A row may be short.
  void table(const std::vector<std::string>& header,
             const std::vector<std::vector<std::string>>& rows);
  // At most about 500 points of a series are drawn; the extremes among them stay.
  void line_chart(const Chart& chart);
  void scatter_chart(const Chart& chart);
  // In rows as the screen is wide; a wide picture, or one alone, has a row of its own.
  void gallery(const std::vector<Picture>& pictures);

  std::string html() const;
  // Written beside `path` and renamed onto it. kIoError: a full disk, a folder that is not there.
  Status write(const std::string& path) const;

 private:
  void element(const char* opening, const std::string& text, const char* closing);

  std::string title_;  // both as HTML
  std::string body_;
};

// For tables: 0.3 of 0.30000000004, 12 300 of 12300.4, 2e-5, and a dash of what is not finite.
std::string number_text(double value, int significant_digits = 4);

}  // namespace lcdm::model
