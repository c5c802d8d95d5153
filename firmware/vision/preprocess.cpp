#include "firmware/vision/preprocess.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <span>

namespace lcdm {
namespace {

constexpr float kMean = 0.45F;
constexpr float kDeviation = 0.225F;

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

// blended += weight * bytes.
void add_bytes(const std::uint8_t* bytes, float weight, std::span<float> blended) {
  for (std::size_t i = 0; i < blended.size(); ++i) {
    blended[i] += weight * static_cast<float>(bytes[i]);
  }
}

float to_byte_range(float value) { return std::min(std::max(value, 0.0F), 255.0F); }

// blended += weight * RGB of a row of Y0 U Y1 V, by ITU-R BT.601 with limited range.
void add_yuyv(const std::uint8_t* bytes, float weight, std::span<float> blended) {
  constexpr float kLuma = 255.0F / 219.0F;
  constexpr float kRedV = 1.596027F;
  constexpr float kGreenU = -0.391762F;
  constexpr float kGreenV = -0.812968F;
  constexpr float kBlueU = 2.017232F;
  const std::size_t pairs = blended.size() / 6;
  for (std::size_t i = 0; i < pairs; ++i) {
    const std::uint8_t* p = bytes + i * 4;
    const float u = static_cast<float>(p[1]) - 128.0F;
    const float v = static_cast<float>(p[3]) - 128.0F;
    for (std::size_t k = 0; k < 2; ++k) {
      const float y = kLuma * (static_cast<float>(p[2 * k]) - 16.0F);
      float* rgb = blended.data() + i * 6 + k * 3;
      rgb[0] += weight * to_byte_range(y + kRedV * v);
      rgb[1] += weight * to_byte_range(y + kGreenU * u + kGreenV * v);
      rgb[2] += weight * to_byte_range(y + kBlueU * u);
    }
  }
}

}  // namespace

AxisTable make_axis_table(int in_size, int out_size) {
  return in_size > out_size ? make_area_table(in_size, out_size)
                            : make_bilinear_table(in_size, out_size);
}

Result<Preprocess> Preprocess::prepare(const FrameFormat& format, int width, int height,
                                       int workers) {
  if (format.pixel == PixelFormat::kMjpeg) {
    return Status::error(StatusCode::kUnsupported, "MJPEG frames must be decoded before inference");
  }
  const auto possible = [](int side) { return side > 0 && side <= kMaxSide; };
  const bool odd_yuyv = format.pixel == PixelFormat::kYuyv && format.width % 2 != 0;
  if (!possible(format.width) || !possible(format.height) || odd_yuyv ||
      format.stride < packed_stride(format.pixel, format.width)) {
    return Status::error(StatusCode::kInvalidInput,
                         "camera format %s %dx%d, stride %d, is not possible: check the camera",
                         to_string(format.pixel), format.width, format.height, format.stride);
  }
  LCDM_CHECK(width > 0 && height > 0 && workers > 0);
  Preprocess out;
  out.format_ = format;
  out.width_ = width;
  out.columns_ = make_axis_table(format.width, width);
  out.rows_ = make_axis_table(format.height, height);
  out.scratch_.resize(static_cast<std::size_t>(format.width) * 3 *
                      static_cast<std::size_t>(workers));
  return out;
}

Status Preprocess::check(const FrameView& frame) const noexcept {
  if (frame.format != format_) {
    return Status::error(StatusCode::kInvalidInput,
                         "frame is %s %dx%d stride %d, the engine was prepared for %s %dx%d stride "
                         "%d: prepare it again",
                         to_string(frame.format.pixel), frame.format.width, frame.format.height,
                         frame.format.stride, to_string(format_.pixel), format_.width,
                         format_.height, format_.stride);
  }
  const std::size_t needed =
      static_cast<std::size_t>(format_.stride) * (static_cast<std::size_t>(format_.height) - 1) +
      static_cast<std::size_t>(packed_stride(format_.pixel, format_.width));
  if (frame.data == nullptr || frame.bytes < needed) {
    return Status::error(StatusCode::kInvalidInput, "frame has %zu bytes of %zu: dropped",
                         frame.bytes, needed);
  }
  return Status::ok();
}

void Preprocess::run_rows(const FrameView& frame, int worker, int begin, int end,
                          float* out) noexcept {
  const std::size_t row_values = static_cast<std::size_t>(format_.width) * 3;
  const std::span<float> blended(scratch_.data() + static_cast<std::size_t>(worker) * row_values,
                                 row_values);
  const std::size_t red = format_.pixel == PixelFormat::kBgr24 ? 2 : 0;
  const std::size_t blue = 2 - red;
  constexpr float kGain = 1.0F / (255.0F * kDeviation);
  constexpr float kOffset = -kMean / kDeviation;

  for (int y = begin; y < end; ++y) {
    std::fill(blended.begin(), blended.end(), 0.0F);
    const int first = rows_.first[static_cast<std::size_t>(y)];
    for (int t = 0; t < rows_.taps; ++t) {
      const int tap = y * rows_.taps + t;
      const float weight = rows_.weights[static_cast<std::size_t>(tap)];
      if (weight == 0.0F) continue;
      const std::uint8_t* bytes = frame.data + static_cast<std::size_t>(first + t) *
                                                   static_cast<std::size_t>(format_.stride);
      if (format_.pixel == PixelFormat::kYuyv) {
        add_yuyv(bytes, weight, blended);
      } else {
        add_bytes(bytes, weight, blended);
      }
    }
    float* pixel = out + static_cast<std::size_t>(y) * static_cast<std::size_t>(width_) * 3;
    const float* weights = columns_.weights.data();
    for (int x = 0; x < width_; ++x, pixel += 3, weights += columns_.taps) {
      const float* from = blended.data() +
                          static_cast<std::size_t>(columns_.first[static_cast<std::size_t>(x)]) * 3;
      float sum[3] = {};
      for (int t = 0; t < columns_.taps; ++t, from += 3) {
        for (int c = 0; c < 3; ++c) sum[c] += weights[t] * from[c];
      }
      pixel[0] = sum[red] * kGain + kOffset;
      pixel[1] = sum[1] * kGain + kOffset;
      pixel[2] = sum[blue] * kGain + kOffset;
    }
  }
}

}  // namespace lcdm
