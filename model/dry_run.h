// What a training would take, measured on two steps of each of its parts.
#pragma once

#include <vector>

#include "firmware/base/status.h"
#include "model/pack.h"
#include "model/trainer.h"

namespace lcdm::model {

// Prints parameters, MACs, the host memory in use and the expected time. Errors as
// Trainer::advance.
Status dry_run(const Recipe& recipe, const std::vector<Pack>& packs, const Compute& compute);

}  // namespace lcdm::model
