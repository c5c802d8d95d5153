#include "model/svg_chart.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "model/html_text.h"

namespace lcdm::model {
namespace {

// --- Axes ----------------------------------------------------------------------------------------

// A drawing's units. A phone shows it at 4/5 of its size and scrolls.
constexpr double kWidth = 560;
constexpr double kHeight = 330;
constexpr double kTop = 32;
constexpr double kBottom = kHeight - 48;
constexpr double kRight = kWidth - 24;
constexpr double kLetter = 7.8;  // a wide font's mean at 13 px

double text_width(const std::string& text, double letter = kLetter) {
  const auto continued = std::count_if(text.begin(), text.end(), is_continuation);
  return letter * static_cast<double>(static_cast<std::ptrdiff_t>(text.size()) - continued);
}

struct Axis {
  bool log = false;
  double low = 0;  // values at the ends
  double high = 1;
  double from = 0;  // places of the ends
  double to = 1;
  std::vector<double> ticks;
  std::vector<std::string> texts;

  double at(double value) const {
    const double share =
        log ? std::log(value / low) / std::log(high / low) : (value - low) / (high - low);
    return from + share * (to - from);
  }
};

// Sums of numbers beyond that could overflow; nothing measured is so large.
bool drawable(double value, bool log) {
  return std::isfinite(value) && std::abs(value) < 1e100 && (!log || value > 1e-100);
}

bool drawable(const Chart& chart, const Series& series, std::size_t i) {
  return drawable(series.x[i], chart.log_x) && drawable(series.y[i], chart.log_y);
}

std::size_t count_of(const Series& series) { return std::min(series.x.size(), series.y.size()); }

// 1, 2 or 5 times a power of ten, at most `count` of them in `span`.
double nice_step(double span, int count) {
  const double least = span / count;
  const double power = std::pow(10, std::floor(std::log10(least)));
  for (const double factor : {1.0, 2.0, 5.0}) {
    if (least <= factor * power * (1 + 1e-9)) return factor * power;
  }
  return 10 * power;
}

void set_linear_ticks(Axis& axis, double step) {
  axis.ticks.clear();
  axis.texts.clear();
  const double magnitude = std::max(std::abs(axis.low), std::abs(axis.high));
  const int decimals = std::max(0, -exponent_of(step));
  const int digits = std::clamp(exponent_of(magnitude) - exponent_of(step) + 1, 1, 16);
  const double first = std::ceil(axis.low / step - 1e-9);
  const auto count = static_cast<int>(std::floor(axis.high / step + 1e-9) - first) + 1;
  for (int i = 0; i < count; ++i) {
    const double k = first + i;
    const double tick = k * step;
    axis.ticks.push_back(tick);
    axis.texts.push_back(k == 0                            ? "0"
                         : needs_exponent(magnitude, 1e-3) ? scientific(tick, digits)
                                                           : fixed(tick, decimals));
  }
}

// Powers of ten, and 2 and 5 between them where there is room. False: fewer than two.
bool set_log_ticks(Axis& axis) {
  const double decades = std::log10(axis.high / axis.low);
  const int stride = std::max(1, static_cast<int>(std::ceil(decades / 8)));
  const int last = exponent_of(axis.high);
  for (int e = exponent_of(axis.low); e <= last; e += stride) {
    for (const double factor : {1.0, 2.0, 5.0}) {
      if (factor > 1 && decades > 3) break;
      const double tick = factor * std::pow(10, e);
      if (tick < axis.low * (1 - 1e-9) || tick > axis.high * (1 + 1e-9)) continue;
      axis.ticks.push_back(tick);
      axis.texts.push_back(number_text(tick));
    }
  }
  return axis.ticks.size() >= 2;
}

// Ends a little beyond the values, so that none lies on the frame unless `tight`, and never both
// the same.
void widen(Axis& axis, bool tight) {
  const double magnitude = std::max(std::abs(axis.low), std::abs(axis.high));
  const bool same = axis.high - axis.low <= 1e-12 * magnitude;
  if (axis.log) {
    const double factor = same ? 1.5 : tight ? 1 : std::pow(axis.high / axis.low, 0.04);
    axis.low /= factor;
    axis.high *= factor;
  } else if (same) {
    const double margin = magnitude == 0 ? 1 : magnitude / 10;
    axis.low -= margin;
    axis.high += margin;
  }
}

// An axis over `values`' range; without a range it has no ticks. `tight`: it ends where they do.
Axis make_axis(const std::vector<double>& values, bool log, bool tight, int ticks) {
  Axis axis;
  if (values.empty()) return axis;
  const auto [low, high] = std::minmax_element(values.begin(), values.end());
  axis.log = log;
  axis.low = *low;
  axis.high = *high;
  widen(axis, tight);
  if (log && set_log_ticks(axis)) return axis;
  const double step = nice_step(axis.high - axis.low, ticks);
  if (!tight && !log) {
    axis.low = step * std::floor(axis.low / step + 1e-9);
    axis.high = step * std::ceil(axis.high / step - 1e-9);
  }
  set_linear_ticks(axis, step);
  return axis;
}

struct Axes {
  Axis x;
  Axis y;
};

// Fewer ticks until their texts have room beside each other.
void fit_ticks(Axis& axis) {
  for (int count = 6; count > 1 && !axis.log; count /= 2) {
    double width = 0;
    for (const std::string& text : axis.texts) width += text_width(text) + 2 * kLetter;
    if (width <= axis.to - axis.from) return;
    set_linear_ticks(axis, nice_step(axis.high - axis.low, count / 2));
  }
}

Axes make_axes(const Chart& chart, bool tight_x) {
  std::vector<double> x;
  std::vector<double> y;
  for (const Series& series : chart.series) {
    for (std::size_t i = 0; i < count_of(series); ++i) {
      if (!drawable(chart, series, i)) continue;
      x.push_back(series.x[i]);
      y.push_back(series.y[i]);
    }
  }
  Axes axes{make_axis(x, chart.log_x, tight_x, 8), make_axis(y, chart.log_y, false, 6)};
  double width = 0;
  for (const std::string& text : axes.y.texts) width = std::max(width, text_width(text));
  axes.x.from = width + 12;
  axes.x.to = kRight;
  axes.y.from = kBottom;
  axes.y.to = kTop;
  fit_ticks(axes.x);
  return axes;
}

// --- Drawing -------------------------------------------------------------------------------------

constexpr std::size_t kColours = 6;

std::string class_of(std::size_t series) { return "s" + std::to_string(series % kColours); }

// A place in a drawing, to a tenth.
std::string place(double value) {
  std::string text = format(value, std::chars_format::fixed, 1);
  trim_zeros(text);
  return text == "-0" ? "0" : text;
}

std::string attribute(const char* name, double value) {
  return std::string(" ") + name + "=\"" + place(value) + "\"";
}

std::string text_at(const char* kind, double x, double y, const char* anchor,
                    const std::string& text) {
  return std::string("<text class=\"") + kind + "\"" + attribute("x", x) + attribute("y", y) +
         " text-anchor=\"" + anchor + "\">" + escaped(text) + "</text>\n";
}

std::string line_from(const char* kind, double x1, double y1, double x2, double y2) {
  return std::string("<path class=\"") + kind + "\" d=\"M" + place(x1) + " " + place(y1) + "L" +
         place(x2) + " " + place(y2) + "\"/>\n";
}

// Shapes differ too, for a printer without colours.
std::string mark_at(std::size_t series, double x, double y, const std::string& title) {
  static constexpr std::array<const char*, 4> kShapes = {
      "M-4 0a4 4 0 1 0 8 0a4 4 0 1 0-8 0z", "M-3.7-3.7h7.4v7.4h-7.4z", "M0-4.8L4.8 3.6H-4.8z",
      "M0-5L5 0L0 5L-5 0z"};
  return "<path class=\"mark " + class_of(series) + "\" transform=\"translate(" + place(x) + " " +
         place(y) + ")\" d=\"" + kShapes[series % kShapes.size()] + "\">" +
         (title.empty() ? "" : "<title>" + escaped(title) + "</title>") + "</path>\n";
}

std::string line_class(std::size_t series) {
  return "line " + class_of(series) + (series / kColours % 2 == 1 ? " again" : "");
}

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

// --- Labels of points ----------------------------------------------------------------------------

struct Box {
  double left;
  double top;
  double right;
  double bottom;

  double overlap(const Box& other) const {
    const double width = std::min(right, other.right) - std::max(left, other.left);
    const double height = std::min(bottom, other.bottom) - std::max(top, other.top);
    return width > 0 && height > 0 ? width * height : 0;
  }
  double area() const { return (right - left) * (bottom - top); }
  double centre_x() const { return (left + right) / 2; }
  double centre_y() const { return (top + bottom) / 2; }
};

struct Label {
  double point_x;
  double point_y;
  std::string text;
};

constexpr double kNameLetter = 7.2;  // at 12 px
constexpr double kNameHeight = 13;

struct LabelPlace {
  double x = 0;  // the text's baseline at its anchor
  double y = 0;
  int side = 0;  // -1: the text ends there, 0: its middle, 1: it starts there
  Box box{};
  std::vector<Box> leader;  // the line from a point to a label far from it, as steps
};

LabelPlace label_place(const Label& label, int right, int down, double distance) {
  const double width = text_width(label.text, kNameLetter);
  const double length = right != 0 && down != 0 ? distance * 0.75 : distance;
  LabelPlace place;
  place.side = right;
  place.x = label.point_x + right * length;
  const double middle = label.point_y + down * (length + (right == 0 ? kNameHeight / 2 : 0));
  place.y = middle + 4;
  const double left = place.x - (1 - right) * width / 2;
  place.box = {left, middle - kNameHeight / 2, left + width, middle + kNameHeight / 2};
  return place;
}

std::vector<Box> leader_to(const Label& label, const LabelPlace& place) {
  constexpr double kHalf = 3;
  std::vector<Box> steps;
  const double edge = std::clamp(label.point_y, place.box.top + 2, place.box.bottom - 2);
  for (const double share : {0.4, 0.6, 0.8, 1.0}) {
    const double x = label.point_x + share * (place.x - label.point_x);
    const double y = label.point_y + share * (edge - label.point_y);
    steps.push_back({x - kHalf, y - kHalf, x + kHalf, y + kHalf});
  }
  return steps;
}

// How much a label covers; what lies outside the frame counts most.
double cost_of(const LabelPlace& place, const std::vector<Box>& taken, const Box& frame_box) {
  double cost = 10 * (place.box.area() - place.box.overlap(frame_box));
  for (const Box& box : taken) {
    cost += place.box.overlap(box);
    for (const Box& step : place.leader) cost += 5 * step.overlap(box);
  }
  return cost;
}

// The first place around its point, near before far, where the label covers nothing; or the place
// where it covers least.
LabelPlace best_place(const Label& label, const std::vector<Box>& taken, const Box& frame_box) {
  static constexpr int kSides[][2] = {{1, 0},  {-1, 0},  {0, -1}, {0, 1},
                                      {1, -1}, {-1, -1}, {1, 1},  {-1, 1}};
  constexpr double kNear = 8;
  LabelPlace best;
  double least = INFINITY;
  for (const double distance : {kNear, 22.0, 38.0, 56.0}) {
    for (const auto& [right, down] : kSides) {
      LabelPlace place = label_place(label, right, down, distance);
      if (distance > kNear) place.leader = leader_to(label, place);
      const double cost = cost_of(place, taken, frame_box);
      if (cost >= least - 1e-6) continue;
      least = cost;
      best = std::move(place);
    }
    if (least <= 1e-6) break;
  }
  return best;
}

std::string draw_labels(const std::vector<Label>& labels, std::vector<Box> taken,
                        const Box& frame_box) {
  static constexpr const char* kAnchors[] = {"end", "middle", "start"};
  std::string leaders;
  std::string texts;
  for (const Label& label : labels) {
    const LabelPlace place = best_place(label, taken, frame_box);
    taken.push_back(place.box);
    taken.insert(taken.end(), place.leader.begin(), place.leader.end());
    if (!place.leader.empty()) {
      leaders += line_from("leader", label.point_x, label.point_y, place.leader.back().centre_x(),
                           place.leader.back().centre_y());
    }
    texts += text_at("name", place.x, place.y, kAnchors[place.side + 1], label.text);
  }
  return leaders + texts;
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
