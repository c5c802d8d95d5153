#include "firmware/vision/resample.h"

#include <cstring>

// clang-format off
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "firmware/vision/resample.cpp"
#include "firmware/base/simd.h"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"
// clang-format on

HWY_BEFORE_NAMESPACE();
namespace lcdm {
namespace HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;

void add_rows(const std::uint8_t* const* rows, const float* weights, std::size_t taps,
              std::size_t size, float* out) {
  const HWY_FULL(float) d;
  const hn::Rebind<std::int32_t, decltype(d)> di;
  const hn::Rebind<std::uint8_t, decltype(d)> bytes;
  const std::size_t lanes = hn::Lanes(d);
  constexpr std::size_t kVectors = 4;  // sums in flight
  std::size_t i = 0;
  for (; i + kVectors * lanes <= size; i += kVectors * lanes) {
    hn::Vec<decltype(d)> sum[kVectors] = {hn::Zero(d), hn::Zero(d), hn::Zero(d), hn::Zero(d)};
    for (std::size_t t = 0; t < taps; ++t) {
      const auto weight = hn::Set(d, weights[t]);
      LCDM_UNROLL for (std::size_t k = 0; k < kVectors; ++k) {
        const auto value = hn::PromoteTo(di, hn::LoadU(bytes, rows[t] + i + k * lanes));
        sum[k] = hn::MulAdd(weight, hn::ConvertTo(d, value), sum[k]);
      }
    }
    LCDM_UNROLL for (std::size_t k = 0; k < kVectors; ++k) {
      hn::StoreU(sum[k], d, out + i + k * lanes);
    }
  }
  for (; i < size; ++i) {
    float sum = 0;
    for (std::size_t t = 0; t < taps; ++t) sum += weights[t] * static_cast<float>(rows[t][i]);
    out[i] = sum;
  }
}

#if HWY_TARGET == HWY_SCALAR
void add_columns(const AxisTable& columns, const float* row, bool reversed, std::size_t width,
                 float* out) {
  const float* weights = columns.weights.data();
  for (std::size_t x = 0; x < width; ++x, weights += columns.taps, out += 3) {
    const float* from = row + static_cast<std::size_t>(columns.first[x]) * 3;
    float sum[3] = {};
    for (int t = 0; t < columns.taps; ++t, from += 3) {
      for (int c = 0; c < 3; ++c) sum[c] += weights[t] * from[c];
    }
    for (int c = 0; c < 3; ++c) out[c] = sum[reversed ? 2 - c : c] * kInputGain + kInputOffset;
  }
}

void add_boxes(const CameraRows& camera, std::span<const CameraBox> boxes, bool reversed,
               float* weights, float* out) {
  const int end_row = camera.first + static_cast<int>(camera.rows.size());
  for (const CameraBox& box : boxes) {
    const int left = box.columns.first();
    const int columns = box.columns.last(camera.width) - left;
    for (int t = 0; t < columns; ++t) weights[t] = box.columns.share(left + t);
    float sum[3] = {};
    for (int row = box.rows.first(); row < box.rows.last(end_row); ++row) {
      const std::uint8_t* from = camera.rows[static_cast<std::size_t>(row - camera.first)] +
                                 static_cast<std::size_t>(left) * 3;
      for (int t = 0; t < columns; ++t, from += 3) {
        const float weight = box.rows.share(row) * weights[t];
        for (int c = 0; c < 3; ++c) sum[c] += weight * static_cast<float>(from[c]);
      }
    }
    const float gain = kInputGain / (box.columns.length * box.rows.length);
    for (int c = 0; c < 3; ++c) *out++ = sum[reversed ? 2 - c : c] * gain + kInputOffset;
  }
}
#else
// A pixel is the first three lanes of a vector; the fourth is its neighbour's or nobody's.
using Pixel = HWY_CAPPED(float, 4);

// The fourth lane too, unless there is no pixel behind to overwrite it.
HWY_INLINE void store_pixel(hn::Vec<Pixel> pixel, bool reversed, bool last, float* out) {
  const Pixel d;
  if (reversed) pixel = hn::Shuffle0321(hn::Shuffle0123(pixel));
  if (!last) {
    hn::StoreU(pixel, d, out);
    return;
  }
  float lanes[4];
  hn::StoreU(pixel, d, lanes);
  std::memcpy(out, lanes, 3 * sizeof(float));
}

void add_columns(const AxisTable& columns, const float* row, bool reversed, std::size_t width,
                 float* out) {
  const Pixel d;
  const auto gain = hn::Set(d, kInputGain);
  const auto offset = hn::Set(d, kInputOffset);
  const float* weights = columns.weights.data();
  for (std::size_t x = 0; x < width; ++x, weights += columns.taps, out += 3) {
    const float* from = row + static_cast<std::size_t>(columns.first[x]) * 3;
    auto sum = hn::Zero(d);
    for (int t = 0; t < columns.taps; ++t, from += 3) {
      sum = hn::MulAdd(hn::Set(d, weights[t]), hn::LoadU(d, from), sum);
    }
    store_pixel(hn::MulAdd(sum, gain, offset), reversed, x + 1 == width, out);
  }
}

void add_boxes(const CameraRows& camera, std::span<const CameraBox> boxes, bool reversed,
               float* weights, float* out) {
  const Pixel d;
  const hn::Rebind<std::int32_t, Pixel> whole;
  const hn::Rebind<std::uint8_t, Pixel> bytes;
  const auto offset = hn::Set(d, kInputOffset);
  const int end_row = camera.first + static_cast<int>(camera.rows.size());
  for (std::size_t i = 0; i < boxes.size(); ++i, out += 3) {
    const CameraBox& box = boxes[i];
    const int left = box.columns.first();
    const int columns = box.columns.last(camera.width) - left;
    for (int t = 0; t < columns; ++t) weights[t] = box.columns.share(left + t);
    auto sum = hn::Zero(d);
    for (int row = box.rows.first(); row < box.rows.last(end_row); ++row) {
      const std::uint8_t* from = camera.rows[static_cast<std::size_t>(row - camera.first)] +
                                 static_cast<std::size_t>(left) * 3;
      auto along = hn::Zero(d);
      for (int t = 0; t < columns; ++t, from += 3) {
        const auto pixel = hn::ConvertTo(d, hn::PromoteTo(whole, hn::LoadU(bytes, from)));
        along = hn::MulAdd(hn::Set(d, weights[t]), pixel, along);
      }
      sum = hn::MulAdd(hn::Set(d, box.rows.share(row)), along, sum);
    }
    const auto gain = hn::Set(d, kInputGain / (box.columns.length * box.rows.length));
    store_pixel(hn::MulAdd(sum, gain, offset), reversed, i + 1 == boxes.size(), out);
  }
}
#endif

}  // namespace HWY_NAMESPACE
}  // namespace lcdm
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace lcdm {

HWY_EXPORT(add_rows);
HWY_EXPORT(add_columns);
HWY_EXPORT(add_boxes);

void blend_rows(std::span<const std::uint8_t* const> rows, std::span<const float> weights,
                std::span<float> out) noexcept {
  HWY_DYNAMIC_DISPATCH(add_rows)
  (rows.data(), weights.data(), rows.size(), out.size(), out.data());
}

void blend_columns(const AxisTable& columns, const float* row, bool reversed,
                   std::span<float> out) noexcept {
  HWY_DYNAMIC_DISPATCH(add_columns)(columns, row, reversed, out.size() / 3, out.data());
}

void average_boxes(const CameraRows& camera, std::span<const CameraBox> boxes, bool reversed,
                   std::span<float> weights, float* out) noexcept {
  HWY_DYNAMIC_DISPATCH(add_boxes)(camera, boxes, reversed, weights.data(), out);
}

}  // namespace lcdm
#endif  // HWY_ONCE
