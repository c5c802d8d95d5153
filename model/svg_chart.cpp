#include "model/svg_chart.h"

#include <algorithm>

#include "model/html_text.h"
#include "model/svg_axis.h"
#include "model/svg_elements.h"
#include "model/svg_labels.h"

namespace lcdm::model {
namespace {

using namespace svg;  // NOLINT(google-build-using-namespace): what a chart is made of

std::string frame(const Chart& chart, const Axes& axes) {
  const Axis& x = axes.x;
  const Axis& y = axes.y;
  std::string out;
  for (std::size_t i = 0; i < x.ticks.size(); ++i) {
    const double at = x.at(x.ticks[i]);
    out += line_from("grid", at, kTop, at, kBottom);
    out += text_at("tick", at, kBottom + 18, "middle", x.texts[i]);
  }
  for (std::size_t i = 0; i < y.ticks.size(); ++i) {
    const double at = y.at(y.ticks[i]);
    out += line_from("grid", x.from, at, x.to, at);
    out += text_at("tick", x.from - 7, at + 4.5, "end", y.texts[i]);
  }
  out += "<rect class=\"frame\"" + attribute("x", x.from) + attribute("y", kTop) +
         attribute("width", x.to - x.from) + attribute("height", kBottom - kTop) + "/>\n";
  out += text_at("axis", 0, 14, "start", chart.y_label);
  out += text_at("axis", (x.from + x.to) / 2, kHeight - 8, "middle", chart.x_label);
  if (x.ticks.empty()) {
    out += text_at("axis", (x.from + x.to) / 2, (kTop + kBottom) / 2, "middle", "no data");
  }
  return out;
}

std::string legend(const Chart& chart, bool lines) {
  std::string out;
  for (std::size_t s = 0; s < chart.series.size(); ++s) {
    if (chart.series[s].name.empty()) continue;
    out += "<span><svg viewBox=\"0 0 28 12\">";
    out += lines ? "<path class=\"" + line_class(s) + "\" d=\"M0 6H28\"/>" : mark_at(s, 14, 6, "");
    out += "</svg>" + escaped(chart.series[s].name) + "</span>\n";
  }
  return out.empty() ? out : "<div class=\"legend\">\n" + out + "</div>\n";
}

std::string chart_figure(const Chart& chart, const std::string& key, const std::string& drawing) {
  return "<figure class=\"chart\">\n<figcaption>" + escaped(chart.title) + "</figcaption>\n" + key +
         "<div class=\"scroll\"><svg role=\"img\" aria-label=\"" + escaped(chart.title) +
         "\" viewBox=\"0 0 " + place(kWidth) + " " + place(kHeight) + "\">\n" + drawing +
         "</svg></div>\n</figure>\n";
}

struct DrawnPoint {
  double x;
  double y;
  bool after_gap;
};

// Which points of a series are drawn: of each of 250 equal parts the lowest and the highest.
std::vector<bool> thinned(const Chart& chart, const Series& series) {
  constexpr std::size_t kParts = 250;
  const std::size_t n = count_of(series);
  const std::size_t part = std::max<std::size_t>(1, (n + kParts - 1) / kParts);
  std::vector<bool> kept(n, n <= 2 * kParts);
  std::size_t first = n;
  std::size_t last = n;
  for (std::size_t begin = 0; begin < n; begin += part) {
    std::size_t low = n;
    std::size_t high = n;
    for (std::size_t i = begin; i < std::min(begin + part, n); ++i) {
      if (!drawable(chart, series, i)) continue;
      if (low == n || series.y[i] < series.y[low]) low = i;
      if (high == n || series.y[i] > series.y[high]) high = i;
      if (first == n) first = i;
      last = i;
    }
    if (low < n) kept[low] = kept[high] = true;
  }
  if (first < n) kept[first] = kept[last] = true;  // the line ends where the data do
  return kept;
}

std::vector<DrawnPoint> drawn_points(const Chart& chart, const Series& series, const Axes& axes) {
  const std::vector<bool> kept = thinned(chart, series);
  std::vector<DrawnPoint> points;
  bool after_gap = true;
  for (std::size_t i = 0; i < kept.size(); ++i) {
    if (!drawable(chart, series, i)) {
      after_gap = true;
    } else if (kept[i]) {
      points.push_back({axes.x.at(series.x[i]), axes.y.at(series.y[i]), after_gap});
      after_gap = false;
    }
  }
  return points;
}

// One series: its line, and marks where there is no line to see or few points carry it.
std::string line(std::size_t number, const std::vector<DrawnPoint>& points) {
  constexpr std::size_t kFew = 25;
  std::string path;
  std::string marks;
  for (std::size_t i = 0; i < points.size(); ++i) {
    const DrawnPoint& point = points[i];
    path += (point.after_gap ? "M" : "L") + place(point.x) + " " + place(point.y);
    const bool last_of_run = i + 1 == points.size() || points[i + 1].after_gap;
    if (points.size() <= kFew || (point.after_gap && last_of_run)) {
      marks += mark_at(number, point.x, point.y, "");
    }
  }
  if (path.empty()) return path;
  return "<path class=\"" + line_class(number) + "\" d=\"" + path + "\"/>\n" + marks;
}

}  // namespace

std::string line_chart_figure(const Chart& chart) {
  const Axes axes = make_axes(chart, true);
  std::string drawing = frame(chart, axes);
  for (std::size_t s = 0; s < chart.series.size(); ++s) {
    drawing += line(s, drawn_points(chart, chart.series[s], axes));
  }
  return chart_figure(chart, legend(chart, true), drawing);
}

std::string scatter_chart_figure(const Chart& chart) {
  const Axes axes = make_axes(chart, false);
  std::string marks;
  std::vector<Box> taken;
  std::vector<Label> labels;
  for (std::size_t s = 0; s < chart.series.size(); ++s) {
    const Series& series = chart.series[s];
    for (std::size_t i = 0; i < count_of(series); ++i) {
      if (!drawable(chart, series, i)) continue;
      const double x = axes.x.at(series.x[i]);
      const double y = axes.y.at(series.y[i]);
      const std::string label = i < series.labels.size() ? series.labels[i] : "";
      marks += mark_at(s, x, y,
                       (label.empty() ? "" : label + ": ") + number_text(series.x[i]) + "; " +
                           number_text(series.y[i]));
      taken.push_back({x - 5, y - 5, x + 5, y + 5});
      if (!label.empty()) labels.push_back({x, y, label});
    }
  }
  const Box frame_box{axes.x.from, kTop, axes.x.to, kBottom};
  return chart_figure(chart, legend(chart, false),
                      frame(chart, axes) + marks + draw_labels(labels, taken, frame_box));
}

}  // namespace lcdm::model
