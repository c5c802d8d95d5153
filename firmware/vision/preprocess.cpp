#include "firmware/vision/preprocess.h"

#include <algorithm>
#include <cstring>
#include <span>
#include <utility>

#include "firmware/base/check.h"
#include "firmware/vision/resample.h"
#include "firmware/vision/rgb_row.h"

namespace lcdm {
namespace {

// Three bytes a pixel, used as they are: their order is a matter of the end.
bool has_rgb_bytes(PixelFormat pixel) {
  return pixel == PixelFormat::kRgb24 || pixel == PixelFormat::kBgr24;
}

template <typename T>
std::size_t bytes_of(const std::vector<T>& values) {
  return values.size() * sizeof(T);
}

}  // namespace

Result<Preprocess> Preprocess::prepare(const FrameFormat& format, int width, int height,
                                       int workers, std::vector<CameraBox> lens_map) {
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
  if (lens_map.empty()) {
    out.columns_ = make_axis_table(format.width, width);
    out.rows_ = make_axis_table(format.height, height);
  } else {
    out.take_map(std::move(lens_map), height);
  }
  out.make_scratch(workers);
  return out;
}

void Preprocess::take_map(std::vector<CameraBox> lens_map, int height) {
  const auto width = static_cast<std::size_t>(width_);
  LCDM_CHECK(lens_map.size() == width * static_cast<std::size_t>(height));
  lens_map_ = std::move(lens_map);
  for (std::size_t first = 0; first < lens_map_.size(); first += width) {
    Rows rows = {format_.height, 0};
    for (const CameraBox& box : std::span(lens_map_).subspan(first, width)) {
      LCDM_CHECK(box.columns.first() >= 0 && box.columns.first() < format_.width);
      LCDM_CHECK(box.rows.first() >= 0 && box.rows.first() < format_.height);
      rows.begin = std::min(rows.begin, box.rows.first());
      rows.end = std::max(rows.end, box.rows.last(format_.height));
      most_columns_ =
          std::max(most_columns_,
                   static_cast<std::size_t>(box.columns.last(format_.width) - box.columns.first()));
    }
    lens_rows_.push_back(rows);
  }
}

void Preprocess::make_scratch(int workers) {
  const auto values = static_cast<std::size_t>(format_.width) * 3;
  auto slots = static_cast<std::size_t>(rows_.taps);
  for (const Rows& rows : lens_rows_) {
    slots = std::max(slots, static_cast<std::size_t>(rows.end - rows.begin));
  }
  Scratch scratch;
  if (uses_own_rows()) scratch.pixels.resize(slots * values + 1);
  scratch.held.resize(slots);
  scratch.rows.resize(slots);
  scratch.weights.resize(std::max(slots, most_columns_));
  scratch.blended.resize(values + 1);
  scratch_.assign(static_cast<std::size_t>(workers), scratch);
}

// Whether rows are copied before they are used: converted, or with a byte behind them.
bool Preprocess::uses_own_rows() const {
  return !has_rgb_bytes(format_.pixel) || !lens_map_.empty();
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
  const std::uint8_t* bytes =
      frame.data + static_cast<std::size_t>(y) * static_cast<std::size_t>(format_.stride);
  if (!uses_own_rows()) return bytes;
  const std::size_t values = static_cast<std::size_t>(format_.width) * 3;
  const std::size_t slot = static_cast<std::size_t>(y) % scratch.held.size();
  std::uint8_t* row = scratch.pixels.data() + slot * values;
  if (scratch.held[slot] == y) return row;
  scratch.held[slot] = y;
  if (has_rgb_bytes(format_.pixel)) {
    std::memcpy(row, bytes, values);
  } else {
    rgb_row(frame, y, row);
  }
  return row;
}

void Preprocess::resize_row(const FrameView& frame, int y, Scratch& scratch,
                            float* out) const noexcept {
  const auto row = static_cast<std::size_t>(y);
  const auto all_taps = static_cast<std::size_t>(rows_.taps);
  std::size_t taps = 0;
  for (std::size_t t = 0; t < all_taps; ++t) {
    const float weight = rows_.weights[row * all_taps + t];
    if (weight == 0.0F) continue;
    scratch.rows[taps] = camera_row(frame, rows_.first[row] + static_cast<int>(t), scratch);
    scratch.weights[taps++] = weight;
  }
  blend_rows(std::span(scratch.rows).first(taps), std::span(scratch.weights).first(taps),
             std::span(scratch.blended).first(scratch.blended.size() - 1));
  blend_columns(columns_, scratch.blended.data(), format_.pixel == PixelFormat::kBgr24,
                {out, static_cast<std::size_t>(width_) * 3});
}

void Preprocess::undistort_row(const FrameView& frame, int y, Scratch& scratch,
                               float* out) const noexcept {
  const auto [begin, end] = lens_rows_[static_cast<std::size_t>(y)];
  const auto count = static_cast<std::size_t>(end - begin);
  for (std::size_t i = 0; i < count; ++i) {
    scratch.rows[i] = camera_row(frame, begin + static_cast<int>(i), scratch);
  }
  const auto width = static_cast<std::size_t>(width_);
  average_boxes({std::span(scratch.rows).first(count), begin, format_.width},
                std::span(lens_map_).subspan(static_cast<std::size_t>(y) * width, width),
                format_.pixel == PixelFormat::kBgr24, scratch.weights, out);
}

void Preprocess::run_rows(const FrameView& frame, int worker, int begin, int end,
                          float* out) noexcept {
  Scratch& scratch = scratch_[static_cast<std::size_t>(worker)];
  std::fill(scratch.held.begin(), scratch.held.end(), -1);  // those of another frame
  for (int y = begin; y < end; ++y) {
    float* row = out + static_cast<std::size_t>(y) * static_cast<std::size_t>(width_) * 3;
    if (lens_map_.empty()) {
      resize_row(frame, y, scratch, row);
    } else {
      undistort_row(frame, y, scratch, row);
    }
  }
}

std::size_t Preprocess::bytes() const {
  const Scratch& one = scratch_.front();
  const std::size_t scratch = bytes_of(one.pixels) + bytes_of(one.held) + bytes_of(one.rows) +
                              bytes_of(one.weights) + bytes_of(one.blended);
  return scratch_.size() * scratch + bytes_of(lens_map_) + bytes_of(lens_rows_) +
         bytes_of(columns_.first) + bytes_of(columns_.weights) + bytes_of(rows_.first) +
         bytes_of(rows_.weights);
}

}  // namespace lcdm
