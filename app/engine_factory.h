// How the pipeline's engines are made from the configuration and the model file.
#pragma once

#include "app/config.h"
#include "firmware/nn/model_file.h"
#include "firmware/pipeline/pipeline.h"

namespace lcdm {

struct EngineFactories {
  Pipeline::EngineFactory full;
  // The same network at about half the pixels, for Effort::kSmallNetwork. Gives null where the full
  // one is as small as it can be.
  Pipeline::EngineFactory small;
};

// `first` was read and checked already and serves the first pair of engines; later ones, for a
// camera that came back different, read the file again, so that it need not stay in memory.
EngineFactories engine_factories(const Config& config, ModelFile first);

// About half the pixels, the same shape as nearly as multiples of 32 allow, at least 64x64.
NetworkSize smaller_size(NetworkSize full);

}  // namespace lcdm
