// Resampling of byte pixels, and the scale in which the network takes them. Per axis: rows into one
// row, then its columns into pixels. Through a lens: each pixel from its own box.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

#include "firmware/vision/axis_table.h"
#include "firmware/vision/lens_map.h"

namespace lcdm {

// What the network takes for a byte: (byte / 255 - 0.45) / 0.225.
inline constexpr float kInputGain = 1.0F / (255.0F * 0.225F);
inline constexpr float kInputOffset = -0.45F / 0.225F;

// out[i] = the sum over t of weights[t] * rows[t][i]. Every row has out.size() bytes.
void blend_rows(std::span<const std::uint8_t* const> rows, std::span<const float> weights,
                std::span<float> out) noexcept;

// Resamples a row of pixels of three values each and scales it as the network takes it; `reversed`
// turns BGR into RGB. One float behind the row's last is read, and does not matter.
void blend_columns(const AxisTable& columns, const float* row, bool reversed,
                   std::span<float> out) noexcept;

// Camera rows of three bytes a pixel: rows[i] is the camera's row first + i, and a byte behind its
// last may be read.
struct CameraRows {
  std::span<const std::uint8_t* const> rows;
  int first = 0;
  int width = 0;  // pixels
};

// The mean of each box, scaled and reversed as above. `weights`: room for a box's columns.
void average_boxes(const CameraRows& camera, std::span<const CameraBox> boxes, bool reversed,
                   std::span<float> weights, float* out) noexcept;

}  // namespace lcdm
