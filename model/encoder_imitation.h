// An encoder that begins with what METER has seen: its filters where both networks have the same
// layer, then a few minutes of giving what METER gives.
#pragma once

#include <array>
#include <functional>

#include "model/batch.h"
#include "model/meter_encoder.h"
#include "model/network.h"

namespace lcdm::model {

// Gives `encoder` (XXS, freshly initialised) METER's filters. What it computes then is only alike:
// it has SiLU for ReLU, two to four transformers in a stage for one, wider heads, a part of METER's
// hidden channels.
void start_as(const MeterEncoder& meter, MobileVit& encoder);

// Squared error of each tap from METER's, in its variance, on pictures normalised as ours.
std::array<torch::Tensor, 5> imitation_errors(const MeterEncoder& meter, MobileVit& encoder,
                                              const torch::Tensor& rgb);

// Trains the encoder of `network` towards METER's taps on `steps` batches of `loader`, then
// measures its batch norms' statistics on more of them. `report` gets the errors of each step.
// Errors as BatchLoader::next.
Status imitate(const MeterEncoder& meter, DepthNetwork& network, BatchLoader& loader,
               std::int64_t steps,
               const std::function<void(std::int64_t step, const std::array<double, 5>&)>& report);

}  // namespace lcdm::model
