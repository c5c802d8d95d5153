#include "model/trainer.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <future>

#include "model/checkpoint.h"
#include "model/config_json.h"
#include "model/direct_fit.h"
#include "model/safetensors.h"
#include "model/training_samples.h"
#include "model/training_text.h"
#include "model/widener.h"
#include "model/worker_thread.h"

namespace lcdm::model {
namespace {

// Steps until a head's statistics, which move by a tenth a step, hold nothing of how they were
// made.
constexpr std::int64_t kSettled = 50;
constexpr std::uint64_t kLossStream = 0x4C4F5353;  // keeps the losses' noise apart from the batches

// LibTorch's convolutions are several times faster when weights and pictures are channels-last.
void use_channels_last(torch::nn::Module& network) {
  for (torch::Tensor& parameter : network.parameters()) {
    if (parameter.dim() == 4) {
      parameter.set_data(parameter.detach().contiguous(torch::MemoryFormat::ChannelsLast));
    }
  }
}

std::int64_t count_learned_cameras(const std::vector<Pack>& packs) {
  return std::count_if(packs.begin(), packs.end(),
                       [](const Pack& pack) { return pack.use.learn_intrinsics; });
}

// Whether the head's norms are as they were made: neither moved by pictures nor trained.
bool is_new(const Head& head) {
  return !head->norm.empty() &&
         std::all_of(head->norm.begin(), head->norm.end(), [](const Norm& norm) {
           return (norm->running_mean == 0).all().item<bool>() &&
                  (norm->running_var == 1).all().item<bool>() &&
                  (norm->weight == 1).all().item<bool>();
         });
}

// Of the average, `steps` after its first: little as long as it is mostly how things began.
double kept_share(const Recipe& recipe, std::int64_t steps) {
  const auto n = static_cast<double>(steps);
  return std::min(recipe.average, (1 + n) / (10 + n));
}

// Many tensors that become kept * themselves + (1 - kept) * others.
struct Blend {
  double kept;
  std::vector<torch::Tensor> to = {};
  std::vector<torch::Tensor> from = {};

  void add(const torch::Tensor& into, const torch::Tensor& other) {
    to.push_back(into);
    from.push_back(other);
  }
  void run() const {
    at::_foreach_mul_(to, kept);
    at::_foreach_add_(to, from, 1 - kept);
  }
};

}  // namespace

Compute one_cpu() {
  Compute compute;
  compute.processes = alone();
  return compute;
}

Result<std::unique_ptr<Trainer>> Trainer::make(const Recipe& recipe, const std::vector<Pack>& packs,
                                               const Compute& compute) {
  for (const Stage& stage : recipe.stages) {
    if (recipe.losses.photometric > 0 &&
        stage.images < 2 * std::min(recipe.workers, stage.images)) {
      return Status::error(StatusCode::kInvalidInput,
                           "the pose network's batch norm needs two pictures for each of the %d "
                           "workers: give more pictures to a batch, or fewer workers",
                           recipe.workers);
    }
  }
  LCDM_RETURN_IF_ERROR(check_shares(packs));
  LCDM_RETURN_IF_ERROR(recipe.losses.photometric > 0 ? check_neighbours(packs)
                                                     : check_no_learned_cameras(packs));
  ModelConfig config = model_config_of(recipe);
  const auto samples = make_samples(recipe, recipe.stages.front(), packs);
  if (!samples) return samples.status();
  LCDM_RETURN_IF_ERROR(check_teachers(recipe, *samples));
  if (recipe.preset == PresetKind::kLcdm) measure_variable(config, *samples);
  return std::unique_ptr<Trainer>(new Trainer(recipe, packs, compute, config));
}

Trainer::Trainer(const Recipe& recipe, const std::vector<Pack>& packs, const Compute& compute,
                 const ModelConfig& config)
    : recipe_(recipe), packs_(packs), compute_(compute) {
  torch::manual_seed(recipe.seed);
  const bool with_pose = recipe.losses.photometric > 0;
  networks_ = TrainedNetworks(config, with_pose, with_pose ? count_learned_cameras(packs) : 0);
  networks_->depth->mixed_precision = recipe.bf16;
  networks_->to(compute.device);
  use_channels_last(*networks_);
  int workers = recipe.workers;
  for (const Stage& stage : recipe.stages) workers = std::min(workers, stage.images);
  replicas_ = std::make_unique<Replicas>(networks_, workers);
  average_ = DepthNetwork(config);
  average_->to(compute.device);
  use_channels_last(*average_);
  spread_weights();
  average_->eval();
  optimizer_ = std::make_unique<Optimizer>(recipe.optimizer, *networks_, recipe.weight_decay,
                                           recipe.workers);
}

void Trainer::spread_weights() {
  std::map<std::string, torch::Tensor> tensors;
  collect(*networks_->depth, "", tensors);
  restore(*average_, "", tensors);
  replicas_->broadcast_statistics();
}

Result<std::vector<torch::Tensor>> Trainer::sample_pictures() const {
  const auto batches = make_samples(recipe_, recipe_.stages[stage_at(recipe_, step_)], packs_);
  if (!batches) return batches.status();
  std::vector<torch::Tensor> pictures;
  for (const Batch& batch : *batches) pictures.push_back(batch.rgb.to(compute_.device));
  return pictures;
}

Status Trainer::measure(torch::nn::Module& part, Answers answers) {
  const auto pictures = sample_pictures();
  if (!pictures) return pictures.status();
  measure_statistics(networks_->depth, part, answers, *pictures);
  return Status::ok();
}

bool Trainer::freezes_a_young_head() const {
  const std::int64_t freeze = first_step(recipe_, recipe_.freeze_from);
  const std::int64_t trained = freeze - first_step(recipe_, recipe_.head_from);
  return step_ == freeze && trained > 0 && trained < kSettled;
}

Status Trainer::measure_new_head() {
  Head& head = networks_->depth->head;
  const bool frozen_new = phase_at(step_).head && past(recipe_.freeze_from) && is_new(head);
  if (!frozen_new && !freezes_a_young_head()) return Status::ok();
  LCDM_RETURN_IF_ERROR(measure(*head, Answers::kNormalise));
  const torch::NoGradGuard no_grad;
  const auto measured = head->named_buffers();
  for (auto& item : average_->head->named_buffers()) item.value().copy_(measured[item.key()]);
  return Status::ok();
}

Status Trainer::start_from(const DepthNetwork& trained, NormStatistics statistics) {
  ModelConfig& config = networks_->depth->config;
  if (!recipe_.start) config.start = trained->config.start;
  DepthNetwork source = trained;
  if (trained->config.encoder != config.encoder || trained->config.preset != config.preset) {
    source = DepthNetwork(config);  // beside `trained`, whatever device trains
    LCDM_RETURN_IF_ERROR(widen(trained, source));
    statistics = NormStatistics::kMissing;
  }
  std::map<std::string, torch::Tensor> tensors;
  collect(*source, "", tensors);
  if (!restore(*networks_->depth, "", tensors)) {
    return Status::error(StatusCode::kInvalidInput,
                         "the weights to start from have other widths or another number of "
                         "sampling steps than the recipe's network");
  }
  if (statistics == NormStatistics::kMissing) {
    LCDM_RETURN_IF_ERROR(measure(*networks_->depth, Answers::kKeep));
  }
  if ((trained->direct->weight == 0).all().item<bool>()) {
    const auto pictures = sample_pictures();
    if (!pictures) return pictures.status();
    fit_direct(networks_->depth, *pictures);
  }
  config.licence = trained->config.licence;
  config.variable_mean = trained->config.variable_mean;
  config.variable_std = trained->config.variable_std;
  average_->config = config;
  spread_weights();
  return Status::ok();
}

Result<ImportReport> Trainer::start_encoder_from(const TensorFile& file, ChannelOrder order) {
  MobileVit& encoder = networks_->depth->encoder;
  auto report = import_mobilevit(file, order, encoder);
  if (!report) return report;
  if (const auto licence = file.metadata.find("licence"); licence != file.metadata.end()) {
    std::string& all = networks_->depth->config.licence;
    all += (all.empty() ? "" : "; ") + licence->second;
  }
  LCDM_RETURN_IF_ERROR(measure(*encoder, Answers::kNormalise));
  spread_weights();
  return report;
}

Result<ImportReport> Trainer::start_pose_from(const TensorFile& file) {
  if (networks_->pose.is_empty()) {
    return Status::error(StatusCode::kUsage,
                         "there is no pose network to start: give --photometric a weight");
  }
  auto report = import_resnet18(file, networks_->pose->encoder);
  if (report) spread_weights();
  return report;
}

bool Trainer::past(double share) const {
  return static_cast<double>(step_) >= share * static_cast<double>(recipe_.steps);
}

Phase Trainer::phase_at(std::int64_t step) const {
  return {stage_at(recipe_, step), step >= first_step(recipe_, recipe_.head_from)};
}

void Trainer::prepare_loader() {
  const std::size_t stage = stage_at(recipe_, step_);
  if (loader_ != nullptr && stage == loader_stage_) return;
  loader_.reset();
  loader_ = std::make_unique<BatchLoader>(
      packs_, make_shapes(recipe_, recipe_.stages[stage], compute_.processes->rank(), packs_),
      recipe_.seed, static_cast<std::uint64_t>(step_ * recipe_.accumulate), compute_.loaders);
  loader_stage_ = stage;
}

// Frozen statistics are the averaged ones: those of the last few mixed batches are too noisy.
void Trainer::set_modes() {
  const torch::NoGradGuard no_grad;
  const auto averaged = average_->named_buffers();
  const auto set = [&](TrainedNetworks& networks) {
    networks->train();
    if (!past(recipe_.freeze_from)) return;
    DepthNetwork& depth = networks->depth;
    for (auto& buffer : depth->named_buffers()) buffer.value().copy_(averaged[buffer.key()]);
    for (const auto& module : depth->modules()) {
      if (auto* norm = module->as<Norm>()) norm->eval();
    }
  };
  for (TrainedNetworks& networks : replicas_->all()) set(networks);
}

std::vector<LearnedFocal> Trainer::learned_focals() const {
  std::vector<LearnedFocal> focals;
  if (networks_->cameras.is_empty()) return focals;
  const torch::Tensor factors = networks_->cameras->log_focal.detach().exp().cpu().reshape({-1, 2});
  for (const Pack& pack : packs_) {
    if (!pack.use.learn_intrinsics) continue;
    const torch::Tensor factor = factors[static_cast<std::int64_t>(focals.size())];
    focals.push_back({pack.use.name, factor[0].item<double>(), factor[1].item<double>()});
  }
  return focals;
}

Status Trainer::set_licence(const std::string& licence) {
  networks_->depth->config.licence = average_->config.licence = licence;
  return config_json(config()).status();
}

bool Trainer::update_best(double score) {
  if (!std::isfinite(score)) return false;  // not even of a new phase's first: nothing was measured
  if (newest_phase() == best_phase_ && !(static_cast<float>(score) < best_)) return false;
  best_ = static_cast<float>(score);
  best_phase_ = newest_phase();
  return true;
}

Losses Trainer::run_batch(const Batch& batch, int k) {
  const std::int64_t images = batch.rgb.size(0);
  const int workers = replicas_->size();
  const double batches = static_cast<double>(recipe_.accumulate) * compute_.processes->size();
  std::vector<std::future<Losses>> running;
  for (int i = 0; i < workers; ++i) {
    const std::int64_t first = i * images / workers;
    const std::int64_t count = (i + 1) * images / workers - first;
    const double share = static_cast<double>(count) / static_cast<double>(images) / batches;
    running.push_back(std::async(std::launch::async, [=, this, &batch] {
      return run_worker(i, k, batch.part(first, count).to(compute_.device), share);
    }));
  }
  Losses losses;
  for (std::future<Losses>& part : running) losses.add(part.get());
  return losses;
}

Losses Trainer::run_worker(int worker, int k, const Batch& part, double share) {
  begin_worker_thread();
  TrainedNetworks& networks = replicas_->of(worker);
  // Numbered over all processes: two of them with a worker each are one with two workers.
  const auto number =
      static_cast<std::uint64_t>(compute_.processes->rank() * replicas_->size() + worker);
  const auto batch = static_cast<std::uint64_t>(step_ * recipe_.accumulate + k);
  at::Generator generator = at::detail::createCPUGenerator(
      SampleRandom(recipe_.seed, batch, kLossStream + number).below(1U << 31));
  const Part what = phase_at(step_).head ? Part::kWhole : Part::kDirect;
  Losses losses = training_losses(networks, part, recipe_.losses, what, generator).times(share);
  losses.total.backward();
  return losses;
}

void Trainer::update_average() {
  const torch::NoGradGuard no_grad;
  // The head joins later: what it was before is nothing to keep.
  const auto joined = std::max<std::int64_t>(0, step_ - first_step(recipe_, recipe_.head_from));
  std::map<std::string, torch::Tensor> from;
  std::map<std::string, torch::Tensor> to;
  collect(*networks_->depth, "", from);
  collect(*average_, "", to);
  Blend others{kept_share(recipe_, step_)};
  Blend head{kept_share(recipe_, joined)};
  for (auto& [name, tensor] : to) {
    if (tensor.is_floating_point()) {
      (name.starts_with("head.") ? head : others).add(tensor, from[name]);
    } else {
      tensor.copy_(from[name]);
    }
  }
  others.run();
  head.run();
}

namespace {

Status not_finite(const Losses& losses, std::int64_t step) {
  std::string terms;
  for (std::size_t i = 0; i < kTermNames.size(); ++i) {
    terms +=
        (i > 0 ? ", " : "") + std::string(kTermNames[i]) + " " + std::to_string(losses.terms[i]);
  }
  return Status::error(StatusCode::kCorrupt,
                       "step %lld: the loss is not finite (%s); lower the learning rate or look at "
                       "the batch's depth",
                       static_cast<long long>(step), terms.c_str());
}

Status diverged(const Divergence& divergence, std::int64_t step) {
  return Status::error(StatusCode::kCorrupt,
                       "step %lld: the training diverges: %s; lower the learning rate and begin "
                       "again, or with --from best.safetensors",
                       static_cast<long long>(step), divergence.text().c_str());
}

}  // namespace

Result<Losses> Trainer::advance() {
  std::vector<torch::Tensor> before;
  for (const torch::Tensor& statistic : networks_->buffers()) before.push_back(statistic.clone());
  Result<Losses> losses = take_step();
  if (losses) return losses;
  const std::vector<torch::Tensor> now = networks_->buffers();
  for (std::size_t i = 0; i < now.size(); ++i) now[i].copy_(before[i]);
  replicas_->broadcast_statistics();
  return losses;
}

Result<Losses> Trainer::take_step() {
  prepare_loader();
  LCDM_RETURN_IF_ERROR(measure_new_head());
  set_modes();
  replicas_->clear_gradients();
  Losses losses;
  std::int64_t images = 0;
  for (int k = 0; k < recipe_.accumulate; ++k) {
    const Result<Batch> batch = loader_->next();
    if (!batch) return batch.status();
    frames_.add(*batch);
    LCDM_RETURN_IF_ERROR(frames_.check());
    images += batch->rgb.size(0);
    losses.add(run_batch(*batch, k));
  }
  replicas_->reduce();
  LCDM_RETURN_IF_ERROR(all_reduce(networks_, *compute_.processes, losses));
  replicas_->broadcast_statistics();
  if (!std::isfinite(losses.total.item<double>())) return not_finite(losses, step_);
  divergence_.add(losses.total.item<double>(), phase_at(step_));
  if (divergence_.found()) return diverged(divergence_, step_);
  if (const double norm = optimizer_->clip(recipe_.clip); !std::isfinite(norm)) {
    return Status::error(StatusCode::kCorrupt,
                         "step %lld: a gradient is not finite; lower the learning rate",
                         static_cast<long long>(step_));
  }
  optimizer_->step([&](const std::string& name) {
    return name.rfind("depth.head.", 0) == 0 ? head_rate_at(recipe_, step_) : learning_rate();
  });
  images_ += images * compute_.processes->size();
  ++step_;
  update_average();
  return losses;
}

Status Trainer::save(const std::string& path) const {
  TensorFile file;
  collect(*networks_, "network.", file.tensors);
  collect(*average_, "average.", file.tensors);
  optimizer_->save(file.tensors);
  file.tensors["trainer.step"] = torch::tensor({step_, images_}, torch::kLong);
  file.tensors["trainer.best"] = torch::tensor({best_, best_phase_.number()});
  file.tensors["trainer.divergence"] = divergence_.numbers();
  const Result<std::string> config = config_json(this->config());
  if (!config) return config.status();
  file.metadata["lcdm"] = *config;
  file.metadata["training"] = on_one_line(training_text(recipe_, packs_));
  return write_tensors(path, file);
}

Result<std::string> Trainer::resume(const std::string& path) {
  const Result<TensorFile> file = read_tensors(path);
  if (!file) return file.status();
  const auto& tensors = file->tensors;
  const auto step = tensors.find("trainer.step");
  const auto best = tensors.find("trainer.best");
  const auto text = file->metadata.find("lcdm");
  if (step == tensors.end() || best == tensors.end() || text == file->metadata.end()) {
    return Status::error(StatusCode::kInvalidInput, "%s is not a training checkpoint",
                         path.c_str());
  }
  Result<ModelConfig> config = parse_model_config(text->second);
  if (!config) return config.status();
  // Those of the batches to come: an older program may have trained at others.
  config->trained_sizes = networks_->depth->config.trained_sizes;
  if (recipe_.start) config->start = *recipe_.start;
  if (config->encoder != recipe_.encoder || config->preset != recipe_.preset ||
      !restore(*networks_, "network.", tensors) || !restore(*average_, "average.", tensors) ||
      !optimizer_->load(tensors)) {
    return Status::error(StatusCode::kInvalidInput,
                         "%s holds another network than the recipe's, or the state of another "
                         "--optimizer",
                         path.c_str());
  }
  networks_->depth->config = *config;
  average_->config = *config;
  replicas_->broadcast_statistics();
  step_ = step->second[0].item<std::int64_t>();
  images_ = step->second[1].item<std::int64_t>();
  best_ = best->second[0].item<float>();
  best_phase_ = Phase::from_number(best->second[1].item<float>());
  const auto divergence = tensors.find("trainer.divergence");
  if (divergence != tensors.end()) divergence_.restore(divergence->second);
  loader_.reset();
  const auto training = file->metadata.find("training");
  if (training == file->metadata.end()) return std::string();  // an older program's
  return changed_lines(training->second, on_one_line(training_text(recipe_, packs_)));
}

}  // namespace lcdm::model
