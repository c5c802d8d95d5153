#include "model/html_page.h"

#include <algorithm>
#include <array>
#include <cerrno>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <opencv2/imgcodecs.hpp>
#include <string_view>
#include <utility>

namespace lcdm::model {
namespace {

// Colours: Okabe and Ito's, told apart by readers who see no red, green or blue; darker on white
// and lighter on black. Text in the charts is drawn on the page's ground, so that lines do not
// cross it.
constexpr const char* kStyle = R"css(
:root { color-scheme: light dark; --ground: #fff; --raised: #f4f6f8; --line: #d8dee4;
  --text: #14191f; --quiet: #5b6774; --s0: #0072b2; --s1: #d55e00; --s2: #009e73; --s3: #b8578f;
  --s4: #c98a00; --s5: var(--text); }
@media screen and (prefers-color-scheme: dark) {
  :root { --ground: #0d1014; --raised: #171c22; --line: #2c343e; --text: #e9edf1; --quiet: #9aa6b3;
    --s0: #4fb0ec; --s1: #ff7f3f; --s2: #2cc295; --s3: #e08fbe; --s4: #f0b440; } }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 1.5rem 1rem 3rem; max-width: 60rem; background: var(--ground);
  color: var(--text); font: 16px/1.5 system-ui, "Segoe UI", Roboto, "DejaVu Sans", sans-serif; }
h1 { font-size: 1.6rem; line-height: 1.25; margin: 0 0 1rem; }
h2 { font-size: 1.2rem; margin: 2.2rem 0 .6rem; padding-top: .8rem;
  border-top: 1px solid var(--line); }
h1, h2, p, figcaption { overflow-wrap: anywhere; }
p { margin: .6rem 0; max-width: 44rem; }
.note { color: var(--quiet); font-size: .875rem; }
.scroll { overflow-x: auto; margin: 1rem 0; }
table { border-collapse: collapse; font-size: .9rem; font-variant-numeric: tabular-nums; }
th, td { padding: .3rem .7rem; text-align: right; white-space: nowrap;
  border-bottom: 1px solid var(--line); }
th { font-weight: 600; }
tbody th { font-weight: 400; }
th:first-child { text-align: left; padding-left: .3rem; }
thead th { border-bottom: 2px solid var(--quiet); vertical-align: bottom; }
tbody tr:hover { background: var(--raised); }
figure { margin: 1.2rem 0; }
figcaption { font-weight: 600; }
.legend { display: flex; flex-wrap: wrap; gap: .1rem 1.1rem; font-size: .875rem; }
.legend span { display: inline-flex; align-items: center; gap: .4rem; }
.legend svg { width: 28px; height: 12px; flex: none; }
.chart .scroll { margin: .2rem 0; }
.chart .scroll svg { display: block; width: 100%; min-width: 28rem; max-width: 44rem; }
svg text { font-size: 13px; fill: var(--text); }
svg .tick, svg .axis { fill: var(--quiet); }
svg .name { font-size: 12px; paint-order: stroke; stroke: var(--ground); stroke-width: 3px; }
.grid, .frame { fill: none; stroke: var(--line); }
.grid { stroke-dasharray: 2 3; }
.leader { stroke: var(--quiet); stroke-width: .8; }
.line { fill: none; stroke: var(--colour); stroke-width: 1.5; stroke-linejoin: round; }
.legend .line { stroke-width: 2.5; }
.again { stroke-dasharray: 6 3; }
.mark { fill: var(--colour); stroke: var(--ground); }
.s0 { --colour: var(--s0); } .s1 { --colour: var(--s1); } .s2 { --colour: var(--s2); }
.s3 { --colour: var(--s3); } .s4 { --colour: var(--s4); } .s5 { --colour: var(--s5); }
.gallery { display: grid; gap: 1rem; margin: 1rem 0;
  grid-template-columns: repeat(auto-fill, minmax(min(100%, 18rem), 1fr)); }
.gallery figure { margin: 0; }
.gallery figcaption { font-weight: 400; font-size: .875rem; color: var(--quiet); }
.gallery img { display: block; width: 100%; height: auto; border-radius: 3px; }
.gallery .wide { grid-column: 1 / -1; }
.gallery .wide img { width: auto; max-width: 100%; }
.gallery .small { image-rendering: pixelated; }
@media print {
  body { max-width: none; padding: 0; font-size: 10pt; }
  .scroll { overflow: visible; }
  .chart .scroll svg { min-width: 0; }
  h2 { break-after: avoid; }
  figure, tr { break-inside: avoid; } }
)css";

constexpr const char* kReplacement = "\xEF\xBF\xBD";
constexpr const char* kDash = "\xE2\x80\x93";
constexpr const char* kThinSpace = "\xE2\x80\xAF";  // between groups of digits; does not break

bool is_continuation(char byte) { return (static_cast<unsigned char>(byte) & 0xC0) == 0x80; }

// Bytes of the UTF-8 character at the start of `text`; 0 where it is none that a page may hold.
std::size_t character_length(std::string_view text) {
  const auto lead = static_cast<unsigned char>(text[0]);
  if (lead < 0x80) return lead >= 0x20 || lead == '\t' || lead == '\n' || lead == '\r' ? 1 : 0;
  const std::size_t length = lead < 0xC2   ? 0
                             : lead < 0xE0 ? 2
                             : lead < 0xF0 ? 3
                             : lead < 0xF5 ? 4
                                           : 0;
  if (length == 0 || text.size() < length) return 0;
  for (std::size_t i = 1; i < length; ++i) {
    if (!is_continuation(text[i])) return 0;
  }
  const auto second = static_cast<unsigned char>(text[1]);
  const bool overlong = (lead == 0xE0 && second < 0xA0) || (lead == 0xF0 && second < 0x90);
  const bool surrogate = lead == 0xED && second > 0x9F;
  const bool beyond = lead == 0xF4 && second > 0x8F;
  return overlong || surrogate || beyond ? 0 : length;
}

std::string escaped(std::string_view text) {
  std::string out;
  while (!text.empty()) {
    const std::size_t length = character_length(text);
    const std::string_view character = text.substr(0, std::max<std::size_t>(length, 1));
    if (length == 0) {
      out += kReplacement;
    } else if (character == "&") {
      out += "&amp;";
    } else if (character == "<") {
      out += "&lt;";
    } else if (character == ">") {
      out += "&gt;";
    } else if (character == "\"") {
      out += "&quot;";
    } else if (character == "'") {
      out += "&#39;";
    } else {
      out += character;
    }
    text.remove_prefix(character.size());
  }
  return out;
}

// --- Numbers -------------------------------------------------------------------------------------

std::string format(double value, std::chars_format how, int precision) {
  char buffer[512];  // the longest double in fixed notation has 309 digits
  const auto end = std::to_chars(buffer, buffer + sizeof(buffer), value, how, precision).ptr;
  return {buffer, end};
}

void trim_zeros(std::string& text) {
  if (text.find('.') == std::string::npos) return;
  text.erase(text.find_last_not_of('0') + 1);
  if (text.back() == '.') text.pop_back();
}

// 2e-5
std::string scientific(double value, int digits) {
  const std::string text = format(value, std::chars_format::scientific, digits - 1);
  const std::size_t e = text.find('e');
  std::string mantissa = text.substr(0, e);
  trim_zeros(mantissa);
  const std::size_t exponent = text.find_first_not_of('0', e + 2);
  if (exponent == std::string::npos) return mantissa;
  return mantissa + (text[e + 1] == '-' ? "e-" : "e") + text.substr(exponent);
}

// 12 300.50
std::string fixed(double value, int decimals) {
  std::string text = format(value, std::chars_format::fixed, decimals);
  const std::size_t first = text[0] == '-' ? 1 : 0;
  if (text.find_first_not_of("0.", first) == std::string::npos) return text.substr(first);  // no -0
  const std::size_t point = std::min(text.find('.'), text.size());
  for (std::size_t i = point; i > first + 3; i -= 3) text.insert(i - 3, kThinSpace);
  return text;
}

int exponent_of(double value) { return static_cast<int>(std::floor(std::log10(value) + 1e-9)); }

bool needs_exponent(double magnitude, double smallest) {
  return magnitude >= 1e7 || magnitude < smallest;
}

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

// --- Pictures ------------------------------------------------------------------------------------

std::string base64(const std::vector<std::uint8_t>& bytes) {
  static constexpr char kDigits[] =
      "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string out;
  out.reserve((bytes.size() + 2) / 3 * 4);
  for (std::size_t i = 0; i < bytes.size(); i += 3) {
    const std::size_t n = std::min<std::size_t>(3, bytes.size() - i);
    std::uint32_t group = 0;
    for (std::size_t k = 0; k < 3; ++k) group = group << 8 | (k < n ? bytes[i + k] : 0U);
    for (std::size_t k = 0; k < 4; ++k) {
      out += k <= n ? kDigits[group >> (18 - 6 * k) & 63U] : '=';
    }
  }
  return out;
}

std::string image(const Picture& picture) {
  const cv::Mat& bgr = picture.bgr;
  if (bgr.empty() || (bgr.type() != CV_8UC3 && bgr.type() != CV_8UC1)) return {};
  const bool small = bgr.cols <= 128 && bgr.rows <= 128;  // single pixels are to be seen
  std::vector<std::uint8_t> bytes;
  if (!cv::imencode(small ? ".png" : ".jpg", bgr, bytes, {cv::IMWRITE_JPEG_QUALITY, 88})) return {};
  return std::string("<img") + (small ? " class=\"small\"" : "") + " width=\"" +
         std::to_string(bgr.cols) + "\" height=\"" + std::to_string(bgr.rows) + "\" alt=\"" +
         escaped(picture.caption) + "\" src=\"data:image/" + (small ? "png" : "jpeg") + ";base64," +
         base64(bytes) + "\"/>\n";
}

bool write_text(const std::string& path, const std::string& text) {
  std::FILE* out = std::fopen(path.c_str(), "wb");
  if (out == nullptr) return false;
  bool good = std::fwrite(text.data(), 1, text.size(), out) == text.size();
  good = std::fflush(out) == 0 && good;
  const int write_error = errno;
  const bool closed = std::fclose(out) == 0;
  if (!good) errno = write_error;
  return good && closed;
}

}  // namespace

std::string number_text(double value, int significant_digits) {
  if (!std::isfinite(value)) return kDash;
  if (value == 0) return "0";
  // Rounded first: 9.99996 is 10, whose first digit stands elsewhere.
  const std::string rounded =
      format(std::abs(value), std::chars_format::scientific, significant_digits - 1);
  double magnitude = 0;
  std::from_chars(rounded.data(), rounded.data() + rounded.size(), magnitude);
  if (needs_exponent(magnitude, 1e-4)) return scientific(value, significant_digits);
  std::string text = fixed(value, std::max(0, significant_digits - 1 - exponent_of(magnitude)));
  trim_zeros(text);
  return text;
}

HtmlPage::HtmlPage(const std::string& title) : title_(escaped(title)) {}

void HtmlPage::element(const char* opening, const std::string& text, const char* closing) {
  body_ += opening + escaped(text) + closing;
}

void HtmlPage::heading(const std::string& text) { element("<h2>", text, "</h2>\n"); }
void HtmlPage::paragraph(const std::string& text) { element("<p>", text, "</p>\n"); }
void HtmlPage::note(const std::string& text) { element("<p class=\"note\">", text, "</p>\n"); }

void HtmlPage::table(const std::vector<std::string>& header,
                     const std::vector<std::vector<std::string>>& rows) {
  body_ += "<div class=\"scroll\"><table>\n<thead><tr>";
  for (const std::string& cell : header) element("<th scope=\"col\">", cell, "</th>");
  body_ += "</tr></thead>\n<tbody>\n";
  for (const auto& row : rows) {
    body_ += "<tr>";
    for (std::size_t i = 0; i < std::max(header.size(), row.size()); ++i) {
      const std::string cell = i < row.size() ? row[i] : "";
      if (i == 0) {
        element("<th scope=\"row\">", cell, "</th>");
      } else {
        element("<td>", cell, "</td>");
      }
    }
    body_ += "</tr>\n";
  }
  body_ += "</tbody></table></div>\n";
}

void HtmlPage::line_chart(const Chart& chart) {
  const Axes axes = make_axes(chart, true);
  std::string drawing = frame(chart, axes);
  for (std::size_t s = 0; s < chart.series.size(); ++s) {
    drawing += line(s, drawn_points(chart, chart.series[s], axes));
  }
  body_ += chart_figure(chart, legend(chart, true), drawing);
}

void HtmlPage::scatter_chart(const Chart& chart) {
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
  body_ += chart_figure(chart, legend(chart, false),
                        frame(chart, axes) + marks + draw_labels(labels, taken, frame_box));
}

void HtmlPage::gallery(const std::vector<Picture>& pictures) {
  constexpr double kWide = 2.2;  // as one third of a row it would be too flat to see
  body_ += "<div class=\"gallery\">\n";
  for (const Picture& picture : pictures) {
    const bool wide = pictures.size() == 1 || picture.bgr.cols > kWide * picture.bgr.rows;
    body_ += wide ? "<figure class=\"wide\">" : "<figure>";
    body_ += image(picture);
    element("<figcaption>", picture.caption, "</figcaption></figure>\n");
  }
  body_ += "</div>\n";
}

std::string HtmlPage::html() const {
  // The policy makes a reader's program hold the page to its promise.
  return "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\"/>\n"
         "<meta http-equiv=\"Content-Security-Policy\" "
         "content=\"default-src 'none'; img-src data:; style-src 'unsafe-inline'\"/>\n"
         "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"/>\n<title>" +
         title_ + "</title>\n<style>" + kStyle + "</style>\n</head>\n<body>\n<h1>" + title_ +
         "</h1>\n" + body_ + "</body>\n</html>\n";
}

Status HtmlPage::write(const std::string& path) const {
  const std::string partial = path + ".partial";
  if (write_text(partial, html()) && std::rename(partial.c_str(), path.c_str()) == 0) {
    return Status::ok();
  }
  const int error = errno;
  std::remove(partial.c_str());
  return Status::system(error,
                        "%s could not be written; free space or choose another folder, the file "
                        "that was there is unharmed",
                        path.c_str());
}

}  // namespace lcdm::model
