// Depth as a picture for people: near is warm, far is cool, unknown is black.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>

namespace lcdm {

struct Rgb {
  std::uint8_t r = 0;
  std::uint8_t g = 0;
  std::uint8_t b = 0;
};

// The depths, in millimetres, that the ends of the colour map stand for: 0 < nearest < farthest.
struct DepthRange {
  float nearest = 500;
  float farthest = 20000;
};

// The range that holds all but the nearest and farthest 2 % of the valid values; empty when there
// are none. `depth` is uint16 millimetres, 0 = invalid.
std::optional<DepthRange> range_of(std::span<const std::uint16_t> depth);

// Moves `range` a step towards `target`, so that a live picture does not flicker.
DepthRange approach(const DepthRange& range, const DepthRange& target);

// Paints one colour per depth through a table of the 65536 possible values; set_range fills the
// table, paint only looks up. Values go logarithmically over the map, which is Google's Turbo (the
// polynomial approximation by Ruofei Du, 2019).
class DepthColour {
 public:
  DepthColour() { set_range({}); }

  void set_range(const DepthRange& range);
  const DepthRange& range() const { return range_; }

  Rgb operator()(std::uint16_t millimetres) const { return table_[millimetres]; }
  // `rgb` has three bytes for every value of `depth`.
  void paint(std::span<const std::uint16_t> depth, std::span<std::uint8_t> rgb) const;

 private:
  DepthRange range_;
  std::array<Rgb, 65536> table_{};
};

// Turbo at x in [0, 1]: 0 is dark blue, 1 is dark red.
Rgb turbo(float x);

}  // namespace lcdm
