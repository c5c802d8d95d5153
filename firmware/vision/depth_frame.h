// A finished depth image, and everything a consumer must know to use it rightly.
#pragma once

#include <cstdint>

#include "firmware/buffer/frame.h"
#include "firmware/vision/camera_model.h"

namespace lcdm {

// Whether the numbers are metres of the world, or metres up to one unknown factor.
enum class ScaleKind : std::uint8_t { kRelative, kMetric };

const char* to_string(ScaleKind scale);

// Where the engine writes a depth image: rows packed, width * height values, caller's memory.
struct DepthBuffer {
  int width = 0;
  int height = 0;
  std::uint16_t* millimetres = nullptr;  // 0 = invalid, 65535 = at or beyond 65.535 m
  float* metres = nullptr;               // may be null: not wanted
};

// Depth is Z along the optical axis. Borrowed: valid only during DepthSink::offer.
struct DepthFrame {
  FrameMeta meta;      // of the camera frame it was made from
  CameraModel camera;  // intrinsics of the depth image itself
  ScaleKind scale = ScaleKind::kRelative;
  const std::uint16_t* millimetres = nullptr;  // camera.width * camera.height, packed
  FrameView colour;                            // the camera frame, in the camera's own format
  FrameView pixels;                            // the same as pixels: decoded where it is MJPEG
  std::int64_t inference_ns = 0;               // time that decoding and the engine took
  std::int64_t done_ns = 0;                    // CLOCK_MONOTONIC when the depth was ready
};

}  // namespace lcdm
