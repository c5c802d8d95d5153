#include "model/dry_run.h"

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <set>
#include <sys/resource.h>

#include "firmware/nn/network.h"

namespace lcdm::model {
namespace {

double millions(const torch::nn::Module& network) {
  std::int64_t count = 0;
  for (const torch::Tensor& weight : network.parameters()) count += weight.numel();
  return static_cast<double>(count) * 1e-6;
}

// Of the host's memory: the program's so far, the packs included.
double peak_gigabytes() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return static_cast<double>(usage.ru_maxrss) / (1 << 20);
}

void print_networks(const ModelConfig& config, const Recipe& recipe) {
  const TrainedNetworks networks(config, recipe.losses.photometric > 0);
  std::printf("depth network  %.2f M parameters\n", millions(*networks->depth));
  if (!networks->pose.is_empty()) {
    std::printf("pose network   %.2f M parameters\n", millions(*networks->pose));
  }
  for (const auto& [width, height] : kDeployed) {
    const Result<Network> layers = Network::build(config, width, height);
    if (!layers) continue;
    std::printf("%dx%d        %.2f GMAC with %zu sampling steps\n", width, height,
                static_cast<double>(layers->macs()) * 1e-9, config.steps.size());
  }
}

struct StepCost {
  double seconds = 0;
  double pictures = 0;
};

// Of a step of `recipe`, both shapes alike: time of the second pair, when everything is there.
Result<StepCost> cost_of_step(const Recipe& recipe, const std::vector<Pack>& packs,
                              const Compute& compute) {
  const auto trainer = Trainer::make(recipe, packs, compute);
  if (!trainer) return trainer.status();
  constexpr int kSteps = 4;
  double seconds = 0;
  for (int i = 0; i < kSteps; ++i) {
    const auto begin = std::chrono::steady_clock::now();
    const Result<Losses> losses = (*trainer)->advance();
    if (!losses) return losses.status();
    if (i < 2) continue;
    seconds += std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count() / 2;
  }
  return StepCost{seconds, static_cast<double>((*trainer)->images()) / kSteps};
}

// The shares of the steps at which something changes, 0 and 1 included.
std::vector<double> borders_of(const Recipe& recipe) {
  std::set<double> borders = {0, 1, recipe.head_from};
  for (std::size_t i = 0; i + 1 < recipe.stages.size(); ++i) borders.insert(recipe.stages[i].until);
  return {borders.begin(), borders.end()};
}

}  // namespace

Status dry_run(const Recipe& recipe, const std::vector<Pack>& packs, const Compute& compute) {
  double hours = 0;
  double pictures = 0;
  const std::vector<double> borders = borders_of(recipe);
  for (std::size_t i = 0; i + 1 < borders.size(); ++i) {
    Recipe part = recipe;
    std::size_t stage = 0;
    while (stage + 1 < recipe.stages.size() && recipe.stages[stage].until <= borders[i]) ++stage;
    part.stages = {recipe.stages[stage]};
    part.head_from = borders[i] >= recipe.head_from ? 0 : 1;
    part.steps = 1000;  // not to be reached
    const Result<StepCost> cost = cost_of_step(part, packs, compute);
    if (!cost) return cost.status();
    const double steps = (borders[i + 1] - borders[i]) * static_cast<double>(recipe.steps);
    std::printf("%5.0f steps     %.2f s each: size x %.2f, %g pictures, %s\n", steps, cost->seconds,
                recipe.stages[stage].share, cost->pictures,
                part.head_from > 0 ? "without the head" : "with the head");
    hours += steps * cost->seconds / 3600;
    pictures += steps * cost->pictures;
  }
  print_networks(model_config_of(recipe), recipe);
  std::printf("host memory    %.2f GB at the most so far, the packs included%s\n", peak_gigabytes(),
              compute.device.is_cuda() ? "; the GPU's is not counted (nvidia-smi tells)" : "");
  std::printf("expected time  %.1f hours for %.0f pictures\n", hours, pictures);
  return Status::ok();
}

}  // namespace lcdm::model
