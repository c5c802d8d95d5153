#include "model/ablation.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <functional>
#include <map>
#include <string_view>

#include "firmware/base/file.h"
#include "firmware/nn/network.h"
#include "firmware/nn/sampler.h"
#include "model/checkpoint.h"
#include "model/csv.h"
#include "model/dataset_files.h"
#include "model/evaluation.h"
#include "model/html_page.h"
#include "model/stop_request.h"
#include "model/training_log.h"
#include "model/training_text.h"

namespace lcdm::model {
namespace {

namespace fs = std::filesystem;

constexpr std::int64_t kSaveEvery = 200;
constexpr const char* kWithoutNormals = "ID3 + depth";
constexpr const char* kAll = "ID5 all";
constexpr int kOwnSteps = 2;  // of both presets' samplers
constexpr std::size_t kMostRecipeBytes = 1U << 16;
constexpr int kTimedFrames = 30;

// What one network reached on one pack with one number of steps.
struct Score {
  std::string table;
  std::string row;
  PresetKind preset = PresetKind::kLcdm;
  int steps = 0;
  int seed = 0;
  std::string set;
  Metrics metrics;
};

// What a frame takes with one number of steps.
struct Cost {
  double gmac = 0;
  double milliseconds = 0;
};
using Costs = std::map<std::pair<PresetKind, int>, Cost>;  // by the network and that number

// The network's own: rows of several tables that name the same network share its training.
std::string folder_name(const AblationRow& row, int seed) {
  std::string name = row.name + " seed" + std::to_string(seed);
  std::replace(name.begin(), name.end(), ' ', '-');
  return name;
}

// Keeps in a new folder what its network is trained by; kInvalidInput: another one began there.
Status claim(const fs::path& folder, const std::string& recipe) {
  std::error_code error;
  fs::create_directories(folder, error);
  if (error) return Status::system(error.value(), "cannot make the folder %s", folder.c_str());
  const fs::path file = folder / "recipe.txt";
  if (!fs::exists(folder / "checkpoint.safetensors")) {
    return write_file(file.string(), recipe);
  }
  const Result<std::string> begun = dataset::read_bytes(file, kMostRecipeBytes);
  if (begun && *begun == recipe) return Status::ok();
  return Status::error(StatusCode::kInvalidInput,
                       "%s holds a network of another recipe or other data (recipe.txt): give the "
                       "same options as then, or another --output",
                       folder.c_str());
}

// Trains what `folder` has not finished, or until it must stop.
Status train_row(const Recipe& recipe, const Data& data, const Compute& compute,
                 const fs::path& folder) {
  LCDM_RETURN_IF_ERROR(claim(folder, training_text(recipe, data.packs)));
  const auto trainer = Trainer::make(recipe, data.packs, compute);
  if (!trainer) return trainer.status();
  const std::string checkpoint = (folder / "checkpoint.safetensors").string();
  if (fs::exists(checkpoint)) LCDM_RETURN_IF_ERROR((*trainer)->resume(checkpoint).status());
  if ((*trainer)->done()) return Status::ok();
  TrainingLog log(folder, (*trainer)->step(), recipe.steps);
  while (!(*trainer)->done() && !must_stop()) {
    const Result<Losses> losses = (*trainer)->advance();
    if (!losses) return losses.status();
    log.add(**trainer, *losses);
    const bool save = (*trainer)->step() % kSaveEvery == 0;
    if (save) LCDM_RETURN_IF_ERROR((*trainer)->save(checkpoint));
  }
  const std::string note = (*trainer)->frames().note();
  if (!note.empty()) std::fprintf(stderr, "%s\n", note.c_str());
  return (*trainer)->save(checkpoint);
}

std::string shown_name(const AblationRow& row) {
  return row.first_alone ? row.name + ", the first of its two" : row.name;
}

// Measured at the last stage's size: what the network was trained for.
Status measure_row(const AblationRow& row, int seed, double share, const Data& data,
                   const fs::path& folder, std::vector<Score>& scores) {
  const Result<DepthNetwork> loaded = load_checkpoint((folder / "checkpoint.safetensors").string());
  if (!loaded) return loaded.status();
  DepthNetwork network = *loaded;
  if (row.first_alone) network->config.steps.resize(1);
  for (const int steps : row.steps) {
    const Estimator estimator = network_estimator(network, steps, share);
    for (std::size_t i = 0; i < data.packs.size(); ++i) {
      const Pack& pack = data.packs[i];
      const SetResult result =
          evaluate(*pack.frames, pack.validation, data.protocols[i], estimator);
      if (result.missing > 0) {
        std::fprintf(stderr, "%s, %s: without %zu frames; the last: %s\n", row.name.c_str(),
                     pack.use.name.c_str(), result.missing, result.why_missing.text());
      }
      if (result.frames.empty()) continue;
      scores.push_back(
          {row.table, shown_name(row), row.preset, steps, seed, pack.use.name, result.mean});
    }
  }
  return Status::ok();
}

// Wide pictures of the size that the networks are measured at.
cv::Size wide_size(const Recipe& recipe) {
  const double share = recipe.stages.back().share;
  return {scaled_side(kDeployed[0][0], share), scaled_side(kDeployed[0][1], share)};
}

// NaN where there is no such network. Of the 0-step answer, which the device does not have: a 3x3
// convolution in the head's place.
double gmac_of(ModelConfig config, cv::Size size, int steps) {
  config.steps = sampler_times(config.preset, std::max(1, steps));
  const Result<Network> network = Network::build(config, size.width, size.height);
  if (!network) return std::nan("");
  if (steps > 0) return static_cast<double>(network->macs()) * 1e-9;
  std::int64_t macs = std::int64_t{9} * config.condition_channels * size.area();
  const int condition = network->find("decoder.condition");
  for (int i = 0; i <= condition; ++i) macs += network->layer(i).macs;
  return static_cast<double>(macs) * 1e-9;
}

// The median of several calls.
double milliseconds_of(const std::function<void()>& call) {
  std::vector<double> times;
  for (int i = 0; i < kTimedFrames; ++i) {
    const auto begin = std::chrono::steady_clock::now();
    call();
    times.push_back(
        std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - begin)
            .count());
  }
  std::sort(times.begin(), times.end());
  return times[times.size() / 2];
}

// Of one preset's network, for all numbers of steps in `rows`. Weights make no difference: nothing
// need be trained.
void add_costs(const Recipe& recipe, const std::vector<AblationRow>& rows, Costs& costs) {
  const torch::NoGradGuard no_grad;
  DepthNetwork network(model_config_of(recipe));
  network->eval();
  const cv::Size size = wide_size(recipe);
  const torch::Tensor picture = torch::full({1, 3, size.height, size.width}, 0.5F)
                                    .contiguous(torch::MemoryFormat::ChannelsLast);
  torch::Tensor condition;
  const double shared = milliseconds_of([&] { condition = network->condition_of(picture); });
  for (const AblationRow& row : rows) {
    for (const int steps : row.steps) {
      const std::pair key(recipe.preset, steps);
      if (row.preset != recipe.preset || costs.count(key) > 0) continue;
      const double sampler = milliseconds_of([&] { network->sample(condition, steps); });
      costs[key] = {gmac_of(network->config, size, steps), shared + sampler};
    }
  }
}

Costs costs_of(const Recipe& recipe, const std::vector<AblationRow>& rows) {
  Costs costs;
  for (const PresetKind preset : {PresetKind::kLcdm, PresetKind::kPaper}) {
    Recipe one = recipe;
    one.preset = preset;
    add_costs(one, rows, costs);
  }
  return costs;
}

Status write_csv(const fs::path& path, const std::vector<Score>& scores, const Costs& costs) {
  std::string text = "table,row,steps,seed,set,abs_rel,d1,gmac,milliseconds\n";
  for (const Score& s : scores) {
    const Cost& cost = costs.at({s.preset, s.steps});
    char figures[96];
    std::snprintf(figures, sizeof(figures), "%.5f,%.5f,%.5g,%.4g\n", s.metrics.abs_rel,
                  s.metrics.delta1, cost.gmac, cost.milliseconds);
    text += s.table + "," + csv_cell(s.row) + "," + std::to_string(s.steps) + "," +
            std::to_string(s.seed) + "," + csv_cell(s.set) + "," + figures;
  }
  return replace_file(path.string(), text);
}

// "0.213 ± 0.004" of the seeds' values; without a spread where there is one seed.
std::string mean_and_spread(const std::vector<double>& values) {
  if (values.empty()) return "";
  const auto n = static_cast<double>(values.size());
  double mean = 0;
  for (const double value : values) mean += value / n;
  if (values.size() == 1) return number_text(mean, 3);
  double square = 0;
  for (const double value : values) square += (value - mean) * (value - mean) / (n - 1);
  return number_text(mean, 3) + " ± " + number_text(std::sqrt(square), 2);
}

// One line per row and number of steps, one column per set; where steps are compared, their cost.
void add_table(HtmlPage& page, const std::string& table, PresetKind preset,
               const std::vector<Score>& scores, const Costs& costs) {
  std::vector<std::string> sets;
  std::vector<std::pair<std::string, int>> lines;
  for (const Score& s : scores) {
    if (s.table != table) continue;
    if (std::find(sets.begin(), sets.end(), s.set) == sets.end()) sets.push_back(s.set);
    const std::pair<std::string, int> line(s.row, s.steps);
    if (std::find(lines.begin(), lines.end(), line) == lines.end()) lines.push_back(line);
  }
  if (lines.empty()) return;
  std::vector<std::string> header = {"network, sampling steps"};
  for (const std::string& set : sets) header.push_back(set + ": AbsRel / d1");
  const bool with_costs = table == "steps";
  if (with_costs) header.insert(header.end(), {"GMAC", "LibTorch, ms"});
  std::vector<std::vector<std::string>> rows;
  for (const auto& [row, steps] : lines) {
    rows.push_back({row + ", " + std::to_string(steps)});
    for (const std::string& set : sets) {
      std::vector<double> abs_rel;
      std::vector<double> delta1;
      for (const Score& s : scores) {
        if (s.table != table || s.row != row || s.steps != steps || s.set != set) continue;
        abs_rel.push_back(s.metrics.abs_rel);
        delta1.push_back(s.metrics.delta1);
      }
      rows.back().push_back(mean_and_spread(abs_rel) + " / " + mean_and_spread(delta1));
    }
    if (!with_costs) continue;
    const Cost& cost = costs.at({preset, steps});
    rows.back().push_back(number_text(cost.gmac, 4));
    rows.back().push_back(number_text(cost.milliseconds, 3));
  }
  page.table(header, rows);
}

std::string cost_note(const Recipe& recipe) {
  const cv::Size size = wide_size(recipe);
  return "Cost of a frame of " + std::to_string(size.width) + "x" + std::to_string(size.height) +
         "; LibTorch on this machine's processor with --threads " +
         std::to_string(at::get_num_threads()) + ", median of " + std::to_string(kTimedFrames) +
         " frames.";
}

Status write_page(const fs::path& path, const Recipe& recipe, const AblationOptions& options,
                  const std::vector<Score>& scores, const Costs& costs) {
  HtmlPage page("Ablations");
  page.paragraph(
      "Networks trained alike but for the losses named; median-scaled, on the validation "
      "part of each pack. Mean and standard deviation over " +
      std::to_string(options.seeds) + " seeds.");
  page.note(std::to_string(recipe.steps) + " steps, last stage at " +
            number_text(recipe.stages.back().share) + " of the deployed size.");
  const std::pair<const char*, const char*> titles[] = {
      {"losses", "Losses (the paper's table 7)"},
      {"steps", "Sampling steps (table 8)"},
      {"normals", "Weight of the normal distillation (table 9; 0 is ID3, 1 is ID5)"},
      {"sampler", "What the second of two steps adds, with the paper's sampler and with ours"}};
  for (const auto& [table, title] : titles) {
    if (std::find(options.tables.begin(), options.tables.end(), table) == options.tables.end()) {
      continue;
    }
    page.heading(title);
    add_table(page, table, recipe.preset, scores, costs);
    if (std::string_view(table) == "steps") page.note(cost_note(recipe));
  }
  return page.write(path.string());
}

// Table 9. The weights 0 and 1 are networks of table 7.
void add_normal_rows(const Recipe& recipe, const LossWeights& all, std::vector<AblationRow>& rows) {
  for (const double weight : {0.0, 0.1, 0.5, 1.0, 2.0, 10.0}) {
    LossWeights weights = all;
    weights.normals = weight;
    const std::string name = weight == 0   ? kWithoutNormals
                             : weight == 1 ? kAll
                                           : "lambda5 " + number_text(weight);
    rows.push_back({"normals", name, weights, recipe.preset, {kOwnSteps}});
  }
}

// Both presets, stopped after the first of their two evaluations, and whole. The recipe's own is
// the network of the other tables.
void add_sampler_rows(const Recipe& recipe, const LossWeights& all,
                      std::vector<AblationRow>& rows) {
  for (const PresetKind preset : {PresetKind::kPaper, PresetKind::kLcdm}) {
    const char* other = preset == PresetKind::kPaper ? " paper" : " lcdm";
    const std::string name = preset == recipe.preset ? kAll : std::string(kAll) + other;
    rows.push_back({"sampler", name, all, preset, {1}, true});
    rows.push_back({"sampler", name, all, preset, {kOwnSteps}});
  }
}

}  // namespace

std::vector<AblationRow> ablation_rows(const Recipe& recipe,
                                       const std::vector<std::string>& tables) {
  const auto wanted = [&tables](const char* table) {
    return std::find(tables.begin(), tables.end(), table) != tables.end();
  };
  LossWeights all = recipe.losses;
  all.photometric = all.denoising = all.distillation = all.normals = 1;
  all.smoothness = 1e-3;
  std::vector<AblationRow> rows;
  const auto add = [&](const char* table, const std::string& name, const LossWeights& weights,
                       const std::vector<int>& steps) {
    rows.push_back({table, name, weights, recipe.preset, steps});
  };
  if (wanted("losses")) {
    LossWeights weights = all;
    // Gradient matching is ours and learns from the teacher's depth: only where that teaches.
    weights.denoising = weights.distillation = weights.normals = weights.gradient = 0;
    add("losses", "ID1 photometric", weights, {kOwnSteps});
    weights.denoising = 1;
    add("losses", "ID2 + denoising", weights, {kOwnSteps});
    weights.distillation = 1;
    weights.gradient = all.gradient;
    add("losses", kWithoutNormals, weights, {kOwnSteps});
    weights.distillation = weights.gradient = 0;
    weights.normals = 1;
    add("losses", "ID4 + normals instead", weights, {kOwnSteps});
    add("losses", kAll, all, {kOwnSteps});
  }
  if (wanted("steps")) add("steps", kAll, all, {0, 1, 2, 3, 5, 10});
  if (wanted("normals")) add_normal_rows(recipe, all, rows);
  if (wanted("sampler")) add_sampler_rows(recipe, all, rows);
  return rows;
}

Status ablate(const Recipe& recipe, const Data& data, const Compute& compute,
              const AblationOptions& options) {
  const std::vector<AblationRow> rows = ablation_rows(recipe, options.tables);
  Costs costs;
  std::vector<Score> scores;
  // Seed by seed: one that is stopped leaves whole tables.
  for (int seed = 1; seed <= options.seeds; ++seed) {
    for (const AblationRow& row : rows) {
      Recipe one = recipe;
      one.seed = static_cast<std::uint64_t>(seed);
      one.losses = row.losses;
      one.preset = row.preset;
      const fs::path folder = fs::path(options.folder) / folder_name(row, seed);
      std::printf("%s\n", folder.c_str());
      LCDM_RETURN_IF_ERROR(train_row(one, data, compute, folder));
      if (must_stop()) return Status::ok();
      LCDM_RETURN_IF_ERROR(
          measure_row(row, seed, recipe.stages.back().share, data, folder, scores));
      if (costs.empty()) costs = costs_of(recipe, rows);
      const fs::path root = options.folder;
      LCDM_RETURN_IF_ERROR(write_csv(root / "ablation.csv", scores, costs));
      LCDM_RETURN_IF_ERROR(write_page(root / "ablation.html", recipe, options, scores, costs));
    }
  }
  return Status::ok();
}

}  // namespace lcdm::model
