#include "model/recipe_options.h"

#include "model/choice_option.h"

namespace lcdm::model {
namespace {

void add_network_options(CLI::App& command, Recipe& recipe) {
  const std::map<std::string, EncoderKind> encoders = {
      {"xxs", EncoderKind::kXxs}, {"xs", EncoderKind::kXs}, {"s", EncoderKind::kS}};
  const std::map<std::string, PresetKind> presets = {{"lcdm", PresetKind::kLcdm},
                                                     {"paper", PresetKind::kPaper}};
  const std::map<std::string, StartKind> starts = {{"noise", StartKind::kNoise},
                                                   {"zeros", StartKind::kZeros}};
  add_choice(command, "--encoder", recipe.encoder, encoders, "Its size");
  add_choice(command, "--preset", recipe.preset, presets, "lcdm, or the paper's own");
  add_choice(command, "--start", recipe.start, starts,
             "Where the sampler starts (as the weights of --from do, or noise)");
}

void add_schedule_options(CLI::App& command, RecipeOptions& options) {
  Recipe& recipe = options.recipe;
  command.add_option("--steps", recipe.steps, "Optimiser steps in all")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command.add_option(
      "--stage", options.stages,
      "SHARE:IMAGES:UNTIL[:RATE], in order: size of the pictures as a share of the deployed one, "
      "pictures in a wide batch (4:3: twice as many), and up to which share of the steps; with "
      "RATE warm-up and cosine begin again there, from that learning rate (0.5:8:0.8 1:4:1:5e-4)");
  command
      .add_option(
          "--head-from", recipe.head_from,
          "Share of the steps before which only encoder, decoder and the 0-step answer train")
      ->check(CLI::Range(0.0, 1.0))
      ->capture_default_str();
  command
      .add_option("--freeze-from", recipe.freeze_from,
                  "Share of the steps after which batch-norm statistics are frozen")
      ->check(CLI::Range(0.0, 1.0))
      ->capture_default_str();
  command.add_option("--accumulate", recipe.accumulate, "Batches of an optimiser step")
      ->check(CLI::Range(1, 1024))
      ->capture_default_str();
  command
      .add_option("--workers", recipe.workers,
                  "Threads that train on a part of each batch (the weights depend on their number)")
      ->check(CLI::Range(1, 256))
      ->capture_default_str();
  command.add_flag("--bf16", recipe.bf16, "Encoder and decoder in bfloat16");
}

void add_optimiser_options(CLI::App& command, Recipe& recipe) {
  const std::map<std::string, OptimizerKind> optimizers = {{"adamw", OptimizerKind::kAdamW},
                                                           {"muon", OptimizerKind::kMuon}};
  add_choice(command, "--optimizer", recipe.optimizer, optimizers,
             "adamw, or muon for the depth network's matrices (adamw)");
  command.add_option("--learning-rate", recipe.learning_rate, "At its highest")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command.add_option("--final-rate", recipe.final_rate, "At the end of the cosine")
      ->check(CLI::NonNegativeNumber)
      ->capture_default_str();
  command.add_option("--warm-up", recipe.warm_up, "Steps to the highest rate")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command.add_option("--weight-decay", recipe.weight_decay, "Of matrices")
      ->check(CLI::NonNegativeNumber)
      ->capture_default_str();
  command.add_option("--clip", recipe.clip, "Largest norm of the gradient")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command.add_option("--average", recipe.average, "Of the moving average of the weights")
      ->check(CLI::Range(0.0, 1.0))
      ->capture_default_str();
}

void add_weight(CLI::App& command, const char* name, double& weight, const char* what) {
  command.add_option(name, weight, what)->check(CLI::NonNegativeNumber)->capture_default_str();
}

// Those whose size the ablation's rows leave as it is.
void add_our_losses(CLI::App& command, LossWeights& weights) {
  add_weight(command, "--gradient", weights.gradient, "Weight of the gradient loss");
  add_weight(command, "--direct", weights.direct, "Weight of the 0-step answer's losses");
}

void add_paper_losses(CLI::App& command, LossWeights& weights) {
  add_weight(command, "--distillation", weights.distillation, "Weight of the depth distillation");
  add_weight(command, "--denoising", weights.denoising, "Weight of the denoising loss");
  add_weight(command, "--normals", weights.normals, "Weight of the surface-normal distillation");
  add_weight(command, "--photometric", weights.photometric, "Weight of the photometric loss");
  add_weight(command, "--smoothness", weights.smoothness, "Weight of the edge-aware smoothness");
}

}  // namespace

void add_row_options(CLI::App& command, RecipeOptions& options) {
  add_network_options(command, options.recipe);
  add_schedule_options(command, options);
  add_optimiser_options(command, options.recipe);
  add_our_losses(command, options.recipe.losses);
}

void add_recipe_options(CLI::App& command, RecipeOptions& options) {
  add_row_options(command, options);
  command.add_option("--seed", options.recipe.seed, "Of weights, batches and noise")
      ->capture_default_str();
  add_paper_losses(command, options.recipe.losses);
}

Result<Recipe> recipe_of(const RecipeOptions& options) {
  Recipe recipe = options.recipe;
  if (options.stages.empty()) return recipe;
  recipe.stages.clear();
  double begin = 0;
  for (const std::string& text : options.stages) {
    const Result<Stage> stage = parse_stage(text);
    if (!stage) return stage.status();
    if (stage->until <= begin) {
      return Status::error(StatusCode::kUsage,
                           "--stage %s: ends before it begins, at %g of the steps", text.c_str(),
                           begin);
    }
    begin = stage->until;
    recipe.stages.push_back(*stage);
  }
  return recipe;
}

void add_compute_options(CLI::App& command, ComputeOptions& options) {
  command.add_option("--device", options.device, "cpu or cuda")
      ->check(CLI::IsMember({"cpu", "cuda"}))
      ->capture_default_str();
  command.add_option("--loaders", options.loaders, "Batches made at once, a thread each")
      ->check(CLI::Range(1, 64))
      ->capture_default_str();
}

Result<Compute> compute_of(const ComputeOptions& options) {
  Compute compute;
  compute.loaders = options.loaders;
  if (options.device == "cuda") {
    if (!torch::cuda::is_available()) {
      return Status::error(StatusCode::kUsage,
                           "--device cuda: this LibTorch sees no CUDA device; use cpu, or build "
                           "against a LibTorch with CUDA (CMAKE_PREFIX_PATH)");
    }
    const Result<int> index = local_rank();
    if (!index) return index.status();
    compute.device = torch::Device(torch::kCUDA, static_cast<c10::DeviceIndex>(*index));
  }
  auto processes = Processes::join(compute.device);
  if (!processes) return processes.status();
  compute.processes = *processes;
  return compute;
}

}  // namespace lcdm::model
