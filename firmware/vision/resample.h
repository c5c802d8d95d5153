// The two halves of a separable resize: rows into one row, then its columns into pixels.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

#include "firmware/vision/axis_table.h"

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

}  // namespace lcdm
