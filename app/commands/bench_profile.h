// lcdm bench --profile: where a frame's time goes.
#pragma once

#include "firmware/nn/engine.h"

namespace lcdm {

// One line for the stages before and after the network and for each layer that takes a hundredth of
// the frame: time, share, arithmetic rate and its share of what the processor could do. `profile`
// is of `frames` frames of `engine`.
void print_profile(const Engine& engine, const EngineProfile& profile, int frames);

}  // namespace lcdm
