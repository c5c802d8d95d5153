#include "app/engine_factory.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <optional>
#include <utility>

#include "app/common_options.h"

namespace lcdm {
namespace {

using EnginePtr = std::unique_ptr<Engine>;

// Both factories' file: that of the start, until the second of them has used it.
struct Model {
  Config config;
  ModelConfig network;  // the file's when it was last read
  std::optional<ModelFile> first;

  Result<EnginePtr> prepare(const EngineOptions& options, const FrameFormat& format,
                            const CameraModel& camera, const Pipeline::Alive& alive) {
    if (first) return Engine::prepare(*first, options, format, camera);
    const Result<ModelFile> file = load_model(config);
    if (!file) return file.status();
    network = file->config();
    alive();
    return Engine::prepare(*file, options, format, camera);
  }
};

int smaller_side(int side) {
  return std::max(64, 32 * static_cast<int>(std::lround(side * 0.7 / 32)));
}

}  // namespace

NetworkSize smaller_size(NetworkSize full) {
  return {smaller_side(full.width), smaller_side(full.height)};
}

EngineFactories engine_factories(const Config& config, ModelFile first) {
  const ModelConfig network = first.config();
  auto model = std::make_shared<Model>(Model{config, network, std::move(first)});
  EngineFactories factories;
  factories.full = [model](const FrameFormat& format, const CameraModel& camera,
                           const Pipeline::Alive& alive) {
    return model->prepare(engine_options(model->config), format, camera, alive);
  };
  factories.small = [model](const FrameFormat& format, const CameraModel& camera,
                            const Pipeline::Alive& alive) -> Result<EnginePtr> {
    EngineOptions options = engine_options(model->config);
    const NetworkSize full = options.width > 0 ? NetworkSize{options.width, options.height}
                                               : choose_network_size(model->network, camera);
    const NetworkSize small = smaller_size(full);
    options.width = small.width;
    options.height = small.height;
    const bool same = small.width >= full.width && small.height >= full.height;
    Result<EnginePtr> engine =
        same ? Result<EnginePtr>(EnginePtr()) : model->prepare(options, format, camera, alive);
    model->first.reset();
    return engine;
  };
  return factories;
}

}  // namespace lcdm
