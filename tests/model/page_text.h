// A report's page as text, and what is found in it.
#pragma once

#include <regex>
#include <string>
#include <utility>
#include <vector>

#include "model/html_page.h"

namespace lcdm::model {

using Texts = std::vector<std::string>;

// What `page` holds after its style sheet.
inline std::string body_of(const HtmlPage& page) {
  const std::string html = page.html();
  return html.substr(html.find("<body>"));
}

// The first group of every match.
inline Texts all(const std::string& text, const std::string& pattern) {
  const std::regex regex(pattern);
  Texts found;
  for (std::sregex_iterator match(text.begin(), text.end(), regex), end; match != end; ++match) {
    found.push_back((*match)[1]);
  }
  return found;
}

// One line.
inline Chart chart_of(std::vector<double> x, std::vector<double> y) {
  Chart chart{.title = "Loss", .x_label = "step", .y_label = "loss", .series = {}};
  chart.series.push_back({"total", std::move(x), std::move(y)});
  return chart;
}

}  // namespace lcdm::model
