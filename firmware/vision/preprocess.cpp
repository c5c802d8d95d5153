#include "firmware/vision/preprocess.h"

#include <algorithm>
#include <span>

#include "firmware/base/check.h"
#include "firmware/vision/resample.h"
#include "firmware/vision/rgb_row.h"

namespace lcdm {
namespace {

// Three bytes a pixel, used as they are: in which order is a matter of the end.
bool has_rgb_bytes(PixelFormat pixel) {
  return pixel == PixelFormat::kRgb24 || pixel == PixelFormat::kBgr24;
}

}  // namespace

Result<Preprocess> Preprocess::prepare(const FrameFormat& format, int width, int height,
                                       int workers) {
  if (format.pixel == PixelFormat::kMjpeg) {
    return Status::error(StatusCode::kUnsupported, "MJPEG frames must be decoded before inference");
  }
  if (!is_picture(format) || format.width > kMaxSide || format.height > kMaxSide) {
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
  const auto values = static_cast<std::size_t>(format.width) * 3;
  const auto taps = static_cast<std::size_t>(out.rows_.taps);
  Scratch scratch;
  if (!has_rgb_bytes(format.pixel)) scratch.rgb.resize(taps * values);
  scratch.held.resize(taps);
  scratch.taps.resize(taps);
  scratch.weights.resize(taps);
  scratch.blended.resize(values + 1);
  out.scratch_.assign(static_cast<std::size_t>(workers), scratch);
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
  const std::size_t needed = picture_bytes(format_);
  if (frame.data == nullptr || frame.bytes < needed) {
    return Status::error(StatusCode::kInvalidInput, "frame has %zu bytes of %zu: dropped",
                         frame.bytes, needed);
  }
  return Status::ok();
}

// Row `y` of the camera's picture as three bytes a pixel.
const std::uint8_t* Preprocess::camera_row(const FrameView& frame, int y,
                                           Scratch& scratch) const noexcept {
  if (has_rgb_bytes(format_.pixel)) {
    return frame.data + static_cast<std::size_t>(y) * static_cast<std::size_t>(format_.stride);
  }
  const std::size_t slot = static_cast<std::size_t>(y) % scratch.held.size();
  std::uint8_t* row = scratch.rgb.data() + slot * static_cast<std::size_t>(format_.width) * 3;
  if (scratch.held[slot] != y) rgb_row(frame, y, row);
  scratch.held[slot] = y;
  return row;
}

void Preprocess::run_rows(const FrameView& frame, int worker, int begin, int end,
                          float* out) noexcept {
  Scratch& scratch = scratch_[static_cast<std::size_t>(worker)];
  std::fill(scratch.held.begin(), scratch.held.end(), -1);  // those of another frame
  const std::size_t out_values = static_cast<std::size_t>(width_) * 3;
  const std::size_t row_values = static_cast<std::size_t>(format_.width) * 3;
  for (auto y = static_cast<std::size_t>(begin); y < static_cast<std::size_t>(end); ++y) {
    std::size_t taps = 0;
    for (int t = 0; t < rows_.taps; ++t) {
      const float weight =
          rows_.weights[y * static_cast<std::size_t>(rows_.taps) + static_cast<std::size_t>(t)];
      if (weight == 0.0F) continue;
      scratch.taps[taps] = camera_row(frame, rows_.first[y] + t, scratch);
      scratch.weights[taps++] = weight;
    }
    blend_rows(std::span(scratch.taps).first(taps), std::span(scratch.weights).first(taps),
               std::span(scratch.blended).first(row_values));
    blend_columns(columns_, scratch.blended.data(), format_.pixel == PixelFormat::kBgr24,
                  {out + y * out_values, out_values});
  }
}

}  // namespace lcdm
