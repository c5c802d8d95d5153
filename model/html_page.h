// One self-contained HTML file for a person to read: text, tables, charts, pictures. No scripts,
// nothing fetched; light or dark as the reader's screen is, light on paper. Also well-formed XML.
#pragma once

#include <opencv2/core.hpp>
#include <string>
#include <vector>

#include "firmware/base/status.h"
#include "model/html_text.h"
#include "model/svg_chart.h"

namespace lcdm::model {

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

}  // namespace lcdm::model
