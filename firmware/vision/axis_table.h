// How one axis of a picture is resampled.
#pragma once

#include <vector>

namespace lcdm {

// Output i is the sum over t of weights[i * taps + t] times input first[i] + t. Area average when
// shrinking, bilinear otherwise (OpenCV's INTER_AREA and INTER_LINEAR, pixel centres at half
// integers).
struct AxisTable {
  int taps = 0;
  std::vector<int> first;
  std::vector<float> weights;
};
AxisTable make_axis_table(int in_size, int out_size);

}  // namespace lcdm
