// The paper's ablations on the data at hand: its loss rows (table 7), its sampling steps (table 8)
// and the weight of the normal distillation (table 9); and what the second of two steps adds, with
// the paper's sampler and with ours (MODEL.md, section 3).
#pragma once

#include <string>
#include <vector>

#include "firmware/base/status.h"
#include "model/data_sets.h"
#include "model/trainer.h"

namespace lcdm::model {

struct AblationOptions {
  std::string folder = "build/ablation";
  std::vector<std::string> tables = {"losses", "steps", "normals", "sampler"};
  int seeds = 1;
};

// One network to train, the recipe with these losses and this preset, and how it is measured.
struct AblationRow {
  std::string table;  // "losses", "steps", "normals" or "sampler"
  std::string name;   // of the network, as in the paper: "ID1", "lambda5 0.1"
  LossWeights losses;
  PresetKind preset = PresetKind::kLcdm;
  std::vector<int> steps;    // sampling steps it is measured with
  bool first_alone = false;  // one step, at the first time of its own two: what its second adds
};
// The rows of `tables`, on top of the recipe's own weights.
std::vector<AblationRow> ablation_rows(const Recipe& recipe,
                                       const std::vector<std::string>& tables);

// Trains each row with each seed in a folder of its own (finished ones are only measured, one that
// was stopped goes on; its recipe.txt says by what, and nothing else goes on there), then writes
// ablation.csv and ablation.html: AbsRel and d1 on the validation part of every pack, mean and
// spread over the seeds, and what a frame costs at each number of sampling steps (multiply-adds;
// milliseconds of LibTorch, taken anew each time). Ends early, the network in work saved, where it
// must stop (stop_request.h). Errors as Trainer::advance; kInvalidInput: a
// folder is of another recipe.
Status ablate(const Recipe& recipe, const Data& data, const Compute& compute,
              const AblationOptions& options);

}  // namespace lcdm::model
