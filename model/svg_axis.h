// The axes of a chart: where on the drawing a value stands, and the round values that are named.
#pragma once

#include <cmath>
#include <cstddef>
#include <string>
#include <vector>

#include "model/svg_chart.h"

namespace lcdm::model::svg {

// A drawing's units. A phone shows it at 4/5 of its size and scrolls.
inline constexpr double kWidth = 560;
inline constexpr double kHeight = 330;
inline constexpr double kTop = 32;
inline constexpr double kBottom = kHeight - 48;
inline constexpr double kRight = kWidth - 24;
inline constexpr double kLetter = 7.8;  // a wide font's mean at 13 px

double text_width(const std::string& text, double letter = kLetter);

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

struct Axes {
  Axis x;
  Axis y;
};

std::size_t count_of(const Series& series);
// Whether a point can be drawn: it is finite, and positive on a logarithmic axis.
bool drawable(const Chart& chart, const Series& series, std::size_t i);

// Over the range of all points; without any they have no ticks. `tight_x`: x ends where they do.
Axes make_axes(const Chart& chart, bool tight_x);

}  // namespace lcdm::model::svg
