// Cuttings of real pictures as paint for medleys: what surfaces really look like.
#pragma once

#include <vector>

#include "drivers/scene/textures.h"
#include "model/pack.h"

namespace lcdm::model {

// `count` squares from the packs' training pictures: of any pack that is trained on, any picture
// of it, a quarter to all of its shorter side; grey, all of the same mean and deviation. The same
// ones for the same packs. Fewer where pictures are hard to find that are not all of one grey.
std::vector<scene::Photograph> cut_photographs(const std::vector<Pack>& packs, int count);

// Gives them to the renderer. Returns how many there are.
int use_photographs_of(const std::vector<Pack>& packs, int count);

}  // namespace lcdm::model
