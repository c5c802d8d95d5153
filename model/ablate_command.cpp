#include <cstdio>
#include <filesystem>

#include "model/ablation.h"
#include "model/commands.h"
#include "model/recipe_options.h"
#include "model/stop_request.h"

namespace lcdm::model {
namespace {

struct Options {
  RecipeOptions recipe;
  ComputeOptions compute;
  DataOptions data;
  AblationOptions ablation;
};

Status run(const Options& options) {
  const Result<Recipe> recipe = recipe_of(options.recipe);
  if (!recipe) return recipe.status();
  const Result<Compute> compute = compute_of(options.compute);
  if (!compute) return compute.status();
  if (compute->processes->size() > 1) {
    return Status::error(StatusCode::kUsage,
                         "ablate trains in one process, and its tables would be written by each: "
                         "start it without torchrun");
  }
  const Result<Data> data = load_training_data(options.data);
  if (!data) return data.status();
  stop_on_signals();
  return ablate(*recipe, *data, *compute, options.ablation);
}

}  // namespace

void add_ablate(CLI::App& app, Status& status) {
  auto* command = app.add_subcommand("ablate",
                                     "Trains the rows of the paper's tables 7, 8 and 9, and of its "
                                     "sampler beside ours, and writes "
                                     "ablation.csv and ablation.html; goes on where it stopped");
  auto options = std::make_shared<Options>();
  add_data_options(*command, options->data);
  add_row_options(*command, options->recipe);
  add_compute_options(*command, options->compute);
  command->add_option("--output", options->ablation.folder, "Folder of the runs and tables")
      ->capture_default_str();
  command
      ->add_option("--tables", options->ablation.tables,
                   "losses (table 7), steps (table 8), normals (table 9), sampler")
      ->check(CLI::IsMember({"losses", "steps", "normals", "sampler"}));
  command->add_option("--seeds", options->ablation.seeds, "Runs of each row, with seeds 1, 2, ...")
      ->check(CLI::Range(1, 100))
      ->capture_default_str();
  command->callback([options, &status] { status = run(*options); });
}

}  // namespace lcdm::model
