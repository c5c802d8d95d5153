// What decides what a training becomes, in words: kept beside it, to tell whether it goes on as it
// began.
#pragma once

#include <string>
#include <vector>

#include "model/pack.h"
#include "model/recipe.h"

namespace lcdm::model {

// The recipe, how each pack is used, and what medleys are painted with; a line each.
std::string training_text(const Recipe& recipe, const std::vector<Pack>& packs);

// The same as metadata may have it: printable ASCII, a semicolon for each line's end.
std::string on_one_line(std::string text);

// What of two texts on one line the other lacks, in lines, those of `then` first, marked as such.
std::string changed_lines(const std::string& then, const std::string& now);

}  // namespace lcdm::model
