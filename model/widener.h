// A larger network that starts as what a smaller one has learnt (Net2Net: Chen, Goodfellow, Shlens,
// ICLR 2016).
#pragma once

#include "firmware/base/status.h"
#include "model/network.h"

namespace lcdm::model {

// Makes `wide`, freshly initialised and of the same preset, compute what `narrow` computes, but for
// the little that a shortcut loses which has to go through two SiLUs (carry_shortcut). What
// `narrow` has stands first in every layer and reads nothing else; what is new reads everything, by
// the random weights it had, except in the transformers' sums, where it starts at 0. kInvalidInput:
// a layer of `wide` is smaller, or other widths than the encoder's differ.
Status widen(const DepthNetwork& narrow, DepthNetwork& wide);

}  // namespace lcdm::model
