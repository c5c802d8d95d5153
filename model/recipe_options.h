// A recipe on the command line or in a file of model/recipes/.
#pragma once

#include <CLI/CLI.hpp>
#include <string>
#include <vector>

#include "model/trainer.h"

namespace lcdm::model {

// What the parser fills; recipe_of() makes the recipe of it.
struct RecipeOptions {
  Recipe recipe;
  std::vector<std::string> stages;
};
void add_recipe_options(CLI::App& command, RecipeOptions& options);
// Without the seed and the paper's losses, which each row of an ablation has of its own.
void add_row_options(CLI::App& command, RecipeOptions& options);

// kUsage: a stage that is none, or stages out of order.
Result<Recipe> recipe_of(const RecipeOptions& options);

// Which device, how many loaders.
struct ComputeOptions {
  std::string device = "cpu";
  std::size_t loaders = 2;
};
void add_compute_options(CLI::App& command, ComputeOptions& options);

// Joins the other processes, where there are some. kUsage: no such device here. Errors as
// Processes::join.
Result<Compute> compute_of(const ComputeOptions& options);

}  // namespace lcdm::model
