#include "model/svg_axis.h"

#include <algorithm>

#include "model/html_text.h"

namespace lcdm::model::svg {
namespace {

// Sums of numbers beyond that could overflow; nothing measured is so large.
bool drawable(double value, bool log) {
  return std::isfinite(value) && std::abs(value) < 1e100 && (!log || value > 1e-100);
}

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

// Fewer ticks until their texts have room beside each other.
void fit_ticks(Axis& axis) {
  for (int count = 6; count > 1 && !axis.log; count /= 2) {
    double width = 0;
    for (const std::string& text : axis.texts) width += text_width(text) + 2 * kLetter;
    if (width <= axis.to - axis.from) return;
    set_linear_ticks(axis, nice_step(axis.high - axis.low, count / 2));
  }
}

}  // namespace

double text_width(const std::string& text, double letter) {
  const auto continued = std::count_if(text.begin(), text.end(), is_continuation);
  return letter * static_cast<double>(static_cast<std::ptrdiff_t>(text.size()) - continued);
}

bool drawable(const Chart& chart, const Series& series, std::size_t i) {
  return drawable(series.x[i], chart.log_x) && drawable(series.y[i], chart.log_y);
}

std::size_t count_of(const Series& series) { return std::min(series.x.size(), series.y.size()); }

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

}  // namespace lcdm::model::svg
