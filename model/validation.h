// One number that says how good a network is while it trains, on frames it does not train on.
#pragma once

#include <limits>
#include <string>
#include <vector>

#include "model/data_sets.h"
#include "model/metrics.h"
#include "model/network.h"

namespace lcdm::model {

struct Validation {
  struct Set {
    std::string name;
    Metrics network;
    Metrics constant;  // of a constant depth on the same frames
  };
  std::vector<Set> sets;
  std::size_t missing = 0;  // frames of these that could not be read, so have no part in a score
  // Mean over the sets of AbsRel as a share of a constant depth's: lower is better, 1 knows
  // nothing. Over the sets with a sensor's depth where there are some, or else the rendered ones:
  // renderings are not the world, and maps only say how alike the teacher is.
  // Infinite where no frame could be measured, and where one of the sets could not at all: without
  // it a score would be of another kind.
  double score = std::numeric_limits<double>::infinity();
  Status fault;  // why such a set could not
};

// At most `frames` frames of each pack's validation part, evenly spaced, at `share` of the deployed
// size. `steps` as network_estimator.
Validation validate(DepthNetwork& network, int steps, double share, const Data& data,
                    std::size_t frames);

}  // namespace lcdm::model
