// The real engine with random weights at the smallest size: milliseconds a frame.
#pragma once

#include "firmware/pipeline/pipeline.h"
#include "tests/support/random_model.h"

namespace lcdm::test {

inline Pipeline::EngineFactory tiny_engine(int width = 64) {
  return [width](const FrameFormat& format, const CameraModel& camera,
                 const Pipeline::Alive&) -> Result<std::unique_ptr<Engine>> {
    const auto config = make_config(EncoderKind::kXxs, PresetKind::kLcdm);
    const auto model = ModelFile::parse(make_random_model(config, 1));
    if (!model) return model.status();
    EngineOptions options;
    options.width = width;
    options.height = 64;
    return Engine::prepare(*model, options, format, camera);
  };
}

}  // namespace lcdm::test
