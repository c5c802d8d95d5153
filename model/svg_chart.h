// Charts as inline SVG figures of a page; its style sheet gives them their colours.
#pragma once

#include <string>
#include <vector>

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

// At most about 500 points of a series are drawn; the extremes among them stay.
std::string line_chart_figure(const Chart& chart);
std::string scatter_chart_figure(const Chart& chart);

}  // namespace lcdm::model
