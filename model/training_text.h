// What decides what a training becomes, in words: kept beside it, to tell whether it goes on as it
// began.
#pragma once

#include <string>
#include <vector>

#include "model/pack.h"
#include "model/recipe.h"

namespace lcdm::model {

// The recipe, and how each pack is used; a line each.
std::string training_text(const Recipe& recipe, const std::vector<Pack>& packs);

// As metadata has it, where nothing may control a terminal; and back.
std::string on_one_line(std::string text);
std::string in_lines(std::string text);

// The lines of two such texts that the other lacks, those of `then` first, marked as such.
std::string changed_lines(const std::string& then, const std::string& now);

}  // namespace lcdm::model
