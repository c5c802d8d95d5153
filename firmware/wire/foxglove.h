// Foxglove's message schemas (github.com/foxglove/schemas), encoded as protobuf: what the recorder
// writes into MCAP files and what a Foxglove panel reads.
#pragma once

#include <cstdint>
#include <span>
#include <string_view>

#include "firmware/base/status.h"
#include "firmware/vision/camera_model.h"
#include "firmware/wire/bytes.h"

namespace lcdm::wire {

inline constexpr std::string_view kCompressedImageSchema = "foxglove.CompressedImage";
inline constexpr std::string_view kCameraCalibrationSchema = "foxglove.CameraCalibration";
inline constexpr std::string_view kOpticalFrame = "camera_optical_frame";  // REP 103 naming

// The schema's FileDescriptorSet, binary, as MCAP and Foxglove want it. The bytes live for the
// whole program. Empty for a schema not listed above.
std::span<const std::byte> foxglove_descriptor(std::string_view schema);

struct CompressedImage {
  std::int64_t unix_ns = 0;
  std::string_view format;           // "jpeg"
  std::span<const std::byte> bytes;  // one whole image
};

void encode(const CompressedImage& image, ByteWriter& out);
// The result borrows from `message`.
Result<CompressedImage> decode_compressed_image(std::span<const std::byte> message);

struct CameraCalibration {
  std::int64_t unix_ns = 0;
  CameraModel model;  // K[0] = 0 on the wire means: not calibrated
};

// An uncalibrated model keeps its assumed focal length in P and leaves K zero.
void encode(const CameraCalibration& calibration, ByteWriter& out);
Result<CameraCalibration> decode_camera_calibration(std::span<const std::byte> message);

}  // namespace lcdm::wire
