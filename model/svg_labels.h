// Names beside the points of a chart, where they cover least.
#pragma once

#include <algorithm>
#include <string>
#include <vector>

namespace lcdm::model::svg {

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

// Each near its point, within `frame_box`, clear of what is `taken` and of the others; with a line
// to its point where it is far from it.
std::string draw_labels(const std::vector<Label>& labels, std::vector<Box> taken,
                        const Box& frame_box);

}  // namespace lcdm::model::svg
