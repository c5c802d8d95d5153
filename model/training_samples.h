// Which batches a training asks for, and what it measures on some of them before it begins.
#pragma once

#include <vector>

#include "firmware/base/status.h"
#include "model/batch.h"
#include "model/pack.h"
#include "model/recipe.h"

namespace lcdm::model {

// Of the images that process `rank` has of each batch; of the shapes that `packs` are drawn for.
std::vector<BatchShape> make_shapes(const Recipe& recipe, const Stage& stage, int rank,
                                    const std::vector<Pack>& packs);

// To measure on: 16 batches of 8 samples of a stage's size, the same whatever its batch, both
// shapes in turn. Errors as make_batch.
Result<std::vector<Batch>> make_samples(const Recipe& recipe, Stage stage,
                                        const std::vector<Pack>& packs);

// Mean and deviation of the teacher's logit (`lcdm` only); left alone where no sample has depth.
void measure_variable(ModelConfig& config, const std::vector<Batch>& samples);

// Whether any pictures are drawn for batches of the wide or of the 4:3 shape.
bool is_drawn(const std::vector<Pack>& packs, bool wide);

// kInvalidInput: nothing is ever drawn of any pack.
Status check_shares(const std::vector<Pack>& packs);
// kInvalidInput: no sample has depth, and no loss does without.
Status check_teachers(const Recipe& recipe, const std::vector<Batch>& samples);
// kInvalidInput: of nothing that is drawn a frame's neighbours in time can be had.
Status check_neighbours(const std::vector<Pack>& packs);
// kInvalidInput: a set is to learn its focal lengths, which without the photometric loss none does.
Status check_no_learned_cameras(const std::vector<Pack>& packs);

}  // namespace lcdm::model
