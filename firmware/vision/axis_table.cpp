#include "firmware/vision/axis_table.h"

#include <algorithm>
#include <cmath>

namespace lcdm {
namespace {

AxisTable make_area_table(int in_size, int out_size) {
  const double scale = static_cast<double>(in_size) / out_size;
  AxisTable table;
  table.taps = std::min(static_cast<int>(std::ceil(scale)) + 1, in_size);
  for (int i = 0; i < out_size; ++i) {
    const double begin = i * scale;
    const double end = begin + scale;
    const int first = std::min(static_cast<int>(begin), in_size - table.taps);
    table.first.push_back(first);
    for (int t = 0; t < table.taps; ++t) {
      const double covered =
          std::min<double>(end, first + t + 1) - std::max<double>(begin, first + t);
      table.weights.push_back(static_cast<float>(std::max(0.0, covered) / scale));
    }
  }
  return table;
}

AxisTable make_bilinear_table(int in_size, int out_size) {
  const double scale = static_cast<double>(in_size) / out_size;
  AxisTable table;
  table.taps = std::min(2, in_size);
  for (int i = 0; i < out_size; ++i) {
    const double at = std::clamp((i + 0.5) * scale - 0.5, 0.0, in_size - 1.0);
    const int first = std::min(static_cast<int>(at), in_size - table.taps);
    table.first.push_back(first);
    for (int t = 0; t < table.taps; ++t) {
      table.weights.push_back(static_cast<float>(std::max(0.0, 1 - std::fabs(at - (first + t)))));
    }
  }
  return table;
}

}  // namespace

AxisTable make_axis_table(int in_size, int out_size) {
  return in_size > out_size ? make_area_table(in_size, out_size)
                            : make_bilinear_table(in_size, out_size);
}

}  // namespace lcdm
