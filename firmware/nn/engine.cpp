#include "firmware/nn/engine.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <system_error>
#include <utility>

#include "firmware/base/check.h"
#include "firmware/base/os.h"
#include "firmware/nn/kernels/matrix.h"
#include "firmware/vision/depth_to_millimetres.h"
#include "firmware/vision/lens_map.h"

namespace lcdm {
namespace {

// Pixels at the border whose depth is taken from inside: the convolutions' zero padding spoils
// them, and depth bends two to twelve times as much there as further in (lcdm-xs,
// HoloLens and 7-Scenes). AbsRel is the same as with four of them, within .0004.
constexpr int kSpoiltBorder = 7;

// Every pixel within kSpoiltBorder of the border becomes the nearest one further in. The sides are
// at least Network::kMinSide.
template <typename T>
void repeat_border(T* depth, int width, int height) noexcept {
  const auto row = [&](int y) { return depth + static_cast<std::ptrdiff_t>(y) * width; };
  const int right = width - kSpoiltBorder;
  for (int y = kSpoiltBorder; y < height - kSpoiltBorder; ++y) {
    std::fill_n(row(y), kSpoiltBorder, row(y)[kSpoiltBorder]);
    std::fill(row(y) + right, row(y) + width, row(y)[right - 1]);
  }
  for (int y = 0; y < kSpoiltBorder; ++y) {
    std::copy_n(row(kSpoiltBorder), width, row(y));
    std::copy_n(row(height - 1 - kSpoiltBorder), width, row(height - 1 - y));
  }
}

Status check_options(const EngineOptions& options, const CameraModel& camera) {
  if (options.threads < 1 || options.threads > EngineOptions::kMaxThreads) {
    return Status::error(StatusCode::kInvalidInput, "%d inference threads: choose 1 to %d",
                         options.threads, EngineOptions::kMaxThreads);
  }
  if ((options.width == 0) != (options.height == 0)) {
    return Status::error(StatusCode::kInvalidInput,
                         "network size %dx%d: give both sides, or neither", options.width,
                         options.height);
  }
  const bool usable =
      camera.width > 0 && camera.height > 0 && std::isfinite(camera.fx) && camera.fx > 0;
  if (!usable) {
    return Status::error(StatusCode::kInvalidInput,
                         "camera model %dx%d with fx %g: give its size and focal length",
                         camera.width, camera.height, static_cast<double>(camera.fx));
  }
  return Status::ok();
}

// Reads the frames of `camera` as `view` sees them.
Result<Preprocess> prepare_input(const FrameFormat& format, const CameraModel& camera,
                                 const CameraModel& view, int workers) {
  if (!camera.distorted()) return Preprocess::prepare(format, view.width, view.height, workers);
  if (camera.width != format.width || camera.height != format.height) {
    return Status::error(
        StatusCode::kInvalidInput,
        "camera model of %dx%d for frames of %dx%d: give the model of these frames", camera.width,
        camera.height, format.width, format.height);
  }
  Result<std::vector<CameraBox>> map = make_lens_map(camera, view);
  if (!map) return map.status();
  return Preprocess::prepare(format, view.width, view.height, workers, std::move(*map));
}

// How far the shape of width x height is from `aspect`.
double octaves_between(int width, int height, double aspect) {
  return std::fabs(std::log2(width / aspect / height));
}

// Pixels of the trained size that is nearest in shape.
double pixel_budget(const ModelConfig& model, double aspect) {
  const auto nearest = std::min_element(
      model.trained_sizes.begin(), model.trained_sizes.end(), [&](const auto& a, const auto& b) {
        return octaves_between(a[0], a[1], aspect) < octaves_between(b[0], b[1], aspect);
      });
  LCDM_CHECK(nearest != model.trained_sizes.end());
  const auto& [width, height] = *nearest;
  return static_cast<double>(width) * height;
}

}  // namespace

NetworkSize choose_network_size(const ModelConfig& model, const CameraModel& camera) {
  const double aspect = static_cast<double>(camera.width) / camera.height;
  const double budget = pixel_budget(model, aspect);
  NetworkSize best;
  double best_cost = 0;
  for (int height = Network::kMinSide; height <= Network::kMaxSide; height += Network::kSizeStep) {
    for (int width = Network::kMinSide; width <= Network::kMaxSide; width += Network::kSizeStep) {
      // Both in octaves; a wrong shape distorts the picture, a wrong budget only costs time.
      const double pixels = std::fabs(std::log2(static_cast<double>(width) * height / budget));
      const double shape = octaves_between(width, height, aspect);
      const double cost = shape + pixels / 2;
      if (best.width == 0 || cost < best_cost) {
        best = {width, height};
        best_cost = cost;
      }
    }
  }
  return best;
}

Result<std::unique_ptr<Engine>> Engine::prepare(const ModelFile& model,
                                                const EngineOptions& options,
                                                const FrameFormat& format,
                                                const CameraModel& camera) {
  LCDM_RETURN_IF_ERROR(check_options(options, camera));
  const NetworkSize size = options.width != 0 ? NetworkSize{options.width, options.height}
                                              : choose_network_size(model.config(), camera);
  Result<Network> network = Network::build(model.config(), size.width, size.height);
  if (!network) return network.status();
  LCDM_RETURN_IF_ERROR(network->check_weights(model));
  const Result<CameraModel> depth_camera = pinhole_view(camera, size.width, size.height);
  if (!depth_camera) return depth_camera.status();
  Result<Preprocess> preprocess = prepare_input(format, camera, *depth_camera, options.threads);
  if (!preprocess) return preprocess.status();

  const float depth_scale = depth_camera->fx / static_cast<float>(model.config().canonical_focal);
  Result<Program> program = Program::build(
      *network, model, {options.threads, options.keep_tensors, {depth_scale, options.precision}});
  if (!program) return program.status();
  try {
    return std::unique_ptr<Engine>(new Engine(std::move(*network), std::move(*program),
                                              std::move(*preprocess), options, *depth_camera,
                                              model));
  } catch (const std::system_error& refused) {  // by the worker pool
    return Status::error(StatusCode::kOutOfMemory,
                         "cannot start the engine's %d threads: %s: fewer in model.threads, or a "
                         "higher limit (ulimit -u, TasksMax= of the service)",
                         options.threads, refused.what());
  }
}

Engine::Engine(Network network, Program program, Preprocess preprocess,
               const EngineOptions& options, const CameraModel& depth_camera,
               const ModelFile& model)
    : network_(std::move(network)),
      program_(std::move(program)),
      preprocess_(std::move(preprocess)),
      options_(options),
      depth_camera_(depth_camera),
      model_hash_(model.hash()),
      pool_(options.threads, options.pin_threads) {}

Status Engine::check_buffers(const FrameView& frame, const DepthBuffer& out) const noexcept {
  LCDM_RETURN_IF_ERROR(preprocess_.check(frame));
  if (out.width != network_.width() || out.height != network_.height() ||
      out.millimetres == nullptr) {
    return Status::error(StatusCode::kInvalidInput, "depth buffer %dx%d: the engine writes %dx%d",
                         out.width, out.height, network_.width(), network_.height());
  }
  return Status::ok();
}

void Engine::read_frame(const FrameView& frame) noexcept {
  pool_.run([&](int worker) {
    const Slice rows = slice_of(network_.height(), worker, pool_.workers());
    preprocess_.run_rows(frame, worker, rows.begin, rows.end, program_.input().data());
  });
}

void Engine::write_depth(const DepthBuffer& out) const noexcept {
  const std::span<const float> metres = program_.depth();
  depth_to_millimetres(metres, {out.millimetres, metres.size()});
  repeat_border(out.millimetres, out.width, out.height);
  if (out.metres == nullptr) return;
  std::copy(metres.begin(), metres.end(), out.metres);
  repeat_border(out.metres, out.width, out.height);
}

Status Engine::run(const FrameView& frame, const DepthBuffer& out) noexcept {
  LCDM_RETURN_IF_ERROR(check_buffers(frame, out));
  read_frame(frame);
  program_.run(pool_);
  write_depth(out);
  return Status::ok();
}

Status Engine::run_timed(const FrameView& frame, const DepthBuffer& out,
                         EngineProfile& profile) noexcept {
  LCDM_RETURN_IF_ERROR(check_buffers(frame, out));
  LCDM_CHECK(profile.layer_ns.size() == network_.layers().size());
  const std::int64_t begin = os::monotonic_ns();
  read_frame(frame);
  const std::int64_t read = os::monotonic_ns();
  program_.run_timed(pool_, profile.layer_ns);
  const std::int64_t computed = os::monotonic_ns();
  write_depth(out);
  profile.preprocess_ns += read - begin;
  profile.output_ns += os::monotonic_ns() - computed;
  return Status::ok();
}

Result<std::span<const float>> Engine::run_network(std::span<const float> rgb) noexcept {
  const std::span<float> input = program_.input();
  if (rgb.size() != input.size()) {
    return Status::error(StatusCode::kInvalidInput, "%zu input values, the network takes %zu",
                         rgb.size(), input.size());
  }
  std::copy(rgb.begin(), rgb.end(), input.begin());
  program_.run(pool_);
  return std::span<const float>(program_.depth());
}

Result<std::span<const float>> Engine::tensor(std::string_view name) const {
  if (!options_.keep_tensors) {
    return Status::error(StatusCode::kInvalidInput,
                         "tensors are not kept: prepare the engine with keep_tensors");
  }
  const int index = network_.find(name);
  if (index < 0) {
    return Status::error(StatusCode::kNotFound, "no layer is called `%.80s`",
                         std::string(name).c_str());
  }
  return std::span<const float>(program_.tensor(index));
}

EngineStats Engine::stats() const {
  const ModelConfig& config = network_.config();
  return {.arena_bytes = program_.arena_bytes(),
          .weight_bytes = program_.constant_bytes(),
          .preprocess_bytes = preprocess_.bytes(),
          .macs = network_.macs(),
          .width = network_.width(),
          .height = network_.height(),
          .threads = pool_.workers(),
          .precision = kernels::native_precision(options_.precision),
          .memory_locked = program_.memory_locked(),
          .model_name = config.name,
          .model_licence = config.licence,
          .model_hash = model_hash_};
}

}  // namespace lcdm
