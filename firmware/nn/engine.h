// From camera pixels to depth: one prepared network for one camera format.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "firmware/base/status.h"
#include "firmware/buffer/frame.h"
#include "firmware/nn/model_file.h"
#include "firmware/nn/network.h"
#include "firmware/nn/program.h"
#include "firmware/nn/worker_pool.h"
#include "firmware/vision/camera_model.h"
#include "firmware/vision/depth_frame.h"
#include "firmware/vision/preprocess.h"

namespace lcdm {

struct EngineOptions {
  static constexpr int kMaxThreads = 64;

  int width =
      0;  // of the network's input, a multiple of 32; 0 (both): chosen by the camera's shape
  int height = 0;
  int threads = 1;            // the caller's included
  bool keep_tensors = false;  // for tests: every layer's output can be read after a run
  Precision precision = Precision::kFloat32;  // where the processor has instructions for it, else
                                              // the next more exact one
  bool pin_threads = false;                   // each but the caller's to a processor of its own
};

struct EngineStats {
  std::size_t arena_bytes = 0;       // activations and scratch
  std::size_t weight_bytes = 0;      // packed weights and constants
  std::size_t preprocess_bytes = 0;  // tables, lens map and camera rows in work
  std::int64_t macs = 0;
  int width = 0;
  int height = 0;
  int threads = 0;
  Precision precision = Precision::kFloat32;  // what is in use
  // Arena and weights, against swapping: the process was allowed to. Never what preprocess_bytes
  // counts.
  bool memory_locked = false;
  std::string model_name;
  std::string model_licence;
  std::uint64_t model_hash = 0;
};

// Where the time of some frames went.
struct EngineProfile {
  std::int64_t preprocess_ns = 0;      // camera pixels to the network's input
  std::vector<std::int64_t> layer_ns;  // one value for each layer of the network; sized by the user
  std::int64_t output_ns = 0;          // depth to millimetres
};

struct NetworkSize {
  int width = 0;
  int height = 0;
};

// Multiples of 32 with a shape near the camera's and about as many pixels as the model's trained
// size that is nearest in shape. Of a model for 640x192 and 256x192: 640x192 for KITTI's 1242x375,
// 256x192 for 640x480, 288x160 for 1280x720. The camera's sides are positive.
NetworkSize choose_network_size(const ModelConfig& model, const CameraModel& camera);

// Prepared once, run many times; may be moved between threads between calls, used by one at a time.
class Engine {
 public:
  // Everything that can fail or allocate happens here. kInvalidInput, kUnsupported: the options,
  // the format or the model cannot be used; kOutOfMemory. `model` may be dropped afterwards.
  static Result<std::unique_ptr<Engine>> prepare(const ModelFile& model,
                                                 const EngineOptions& options,
                                                 const FrameFormat& format,
                                                 const CameraModel& camera);

  // Depth of one frame, into `out` of the network's size; the outermost seven pixels repeat those
  // inside. The same bytes for the same frame, whatever the number of threads; nothing is
  // allocated. kInvalidInput: the frame is not of the prepared format, is short, or `out` has
  // another size; `out` is then untouched.
  Status run(const FrameView& frame, const DepthBuffer& out) noexcept;

  // As run, and adds the nanoseconds of its parts to `profile`.
  Status run_timed(const FrameView& frame, const DepthBuffer& out, EngineProfile& profile) noexcept;

  // Intrinsics of the depth image, a pinhole's: the camera's resized to the network's input, its
  // distortion taken away.
  const CameraModel& depth_camera() const { return depth_camera_; }
  ScaleKind scale() const { return network_.config().scale; }
  const FrameFormat& format() const { return preprocess_.format(); }
  const Network& network() const { return network_; }
  EngineStats stats() const;

  // The network alone: normalised RGB [height, width, 3] in, metres [height, width] out, which
  // stay valid until the next run.
  Result<std::span<const float>> run_network(std::span<const float> rgb) noexcept;

  // Output of the layer called `name` (NETWORK.md) in the last run, NHWC. kNotFound: no such
  // layer; kInvalidInput: the engine was not prepared with keep_tensors. Where the head's steps are
  // in halves, "head.conv1" holds words of two pixels (kernels/head.h).
  Result<std::span<const float>> tensor(std::string_view name) const;

 private:
  Status check_buffers(const FrameView& frame, const DepthBuffer& out) const noexcept;
  void read_frame(const FrameView& frame) noexcept;
  void write_depth(const DepthBuffer& out) const noexcept;

  Engine(Network network, Program program, Preprocess preprocess, const EngineOptions& options,
         const CameraModel& depth_camera, const ModelFile& model);

  Network network_;
  Program program_;
  Preprocess preprocess_;
  EngineOptions options_;
  CameraModel depth_camera_;
  std::uint64_t model_hash_;
  WorkerPool pool_;
};

}  // namespace lcdm
