#include "model/trainer.h"

#include <cmath>
#include <future>

#include "model/config_json.h"
#include "model/depth_code.h"
#include "model/safetensors.h"

namespace lcdm::model {
namespace {

constexpr float kCanonicalFocal = 320;             // pixels, at the deployed sizes
constexpr std::uint64_t kLossStream = 0x4C4F5353;  // keeps the losses' noise apart from the batches

ModelConfig make_model_config(const Recipe& recipe) {
  ModelConfig config;
  config.encoder = recipe.encoder;
  config.preset = recipe.preset;
  config.start = recipe.start;
  config.steps =
      recipe.preset == PresetKind::kLcdm ? std::vector<int>{149, 74} : std::vector<int>{75, 0};
  config.seed = 1;
  config.canonical_focal = kCanonicalFocal;
  config.trained_sizes = {{kDeployed[0][0], kDeployed[0][1]}, {kDeployed[1][0], kDeployed[1][1]}};
  return config;
}

int multiple_of_32(double size) {
  return std::max(64, static_cast<int>(std::lround(size / 32)) * 32);
}

std::vector<BatchShape> make_shapes(double share, int images) {
  std::vector<BatchShape> shapes;
  for (const auto& [width, height] : kDeployed) {
    BatchShape shape;
    shape.width = multiple_of_32(width * share);
    shape.height = multiple_of_32(height * share);
    shape.canonical_focal =
        kCanonicalFocal * static_cast<float>(shape.width) / static_cast<float>(width);
    shape.images = images;
    shape.wide = width > 2 * height;
    shapes.push_back(shape);
  }
  return shapes;
}

// LibTorch's convolutions are several times faster when weights and pictures are channels-last.
void use_channels_last(DepthNetwork& network) {
  for (torch::Tensor& parameter : network->parameters()) {
    if (parameter.dim() == 4) {
      parameter.set_data(parameter.detach().contiguous(torch::MemoryFormat::ChannelsLast));
    }
  }
}

DepthNetwork make_replica(DepthNetwork& network) {
  DepthNetwork replica(network->config);
  const auto weights = network->named_parameters();
  for (auto& item : replica->named_parameters()) {
    item.value().set_data(weights[item.key()].detach());
  }
  return replica;
}

// The samples [first, first + count) of a batch.
Batch part_of(const Batch& batch, std::int64_t first, std::int64_t count) {
  const Target& all = batch.target;
  return {batch.rgb.narrow(0, first, count),
          {all.depth.narrow(0, first, count), all.weight.narrow(0, first, count),
           all.sharp.narrow(0, first, count), all.reliable.narrow(0, first, count)}};
}

// Mean and deviation of the teacher's logit over a few batches (MODEL.md: `lcdm` only).
void measure_variable(ModelConfig& config, const std::vector<Pack>& packs,
                      const std::vector<BatchShape>& shapes, std::uint64_t seed) {
  constexpr std::uint64_t kBatches = 16;
  std::vector<torch::Tensor> logits;
  for (std::uint64_t i = 0; i < kBatches; ++i) {
    const Batch batch = make_batch(packs, shapes[i % shapes.size()], ~seed, i);
    const torch::Tensor depth = batch.target.depth.masked_select(batch.target.depth > 0);
    logits.push_back(variable_of_depth(depth, ModelConfig{}));
  }
  const torch::Tensor all = torch::cat(logits);
  config.variable_mean = std::round(all.mean().item<double>() * 1e4) / 1e4;
  config.variable_std = std::round(all.std().item<double>() * 1e4) / 1e4;
}

}  // namespace

void collect(const DepthNetwork& network, const std::string& prefix,
             std::map<std::string, torch::Tensor>& tensors) {
  for (const auto& item : network->named_parameters()) tensors[prefix + item.key()] = item.value();
  for (const auto& item : network->named_buffers()) tensors[prefix + item.key()] = item.value();
}

bool restore(DepthNetwork& network, const std::string& prefix,
             const std::map<std::string, torch::Tensor>& tensors) {
  const torch::NoGradGuard no_grad;
  std::map<std::string, torch::Tensor> mine;
  collect(network, prefix, mine);
  for (auto& [name, tensor] : mine) {
    const auto found = tensors.find(name);
    if (found == tensors.end() || found->second.numel() != tensor.numel()) return false;
    tensor.copy_(found->second.reshape(tensor.sizes()));
  }
  return true;
}

Trainer::Trainer(const Recipe& recipe, const std::vector<Pack>& packs)
    : recipe_(recipe), packs_(packs) {
  torch::manual_seed(recipe.seed);
  ModelConfig config = make_model_config(recipe);
  if (recipe.preset == PresetKind::kLcdm) measure_variable(config, packs, shapes(), recipe.seed);
  network_ = DepthNetwork(config);
  use_channels_last(network_);
  const int workers = std::min({recipe.workers, recipe.images, recipe.full_images});
  for (int i = 1; i < workers; ++i) replicas_.push_back(make_replica(network_));
  average_ = DepthNetwork(config);
  std::map<std::string, torch::Tensor> tensors;
  collect(network_, "", tensors);
  restore(average_, "", tensors);
  average_->eval();
  optimizer_ = std::make_unique<AdamW>(*network_, recipe.weight_decay);
}

bool Trainer::past(double share) const {
  return static_cast<double>(step_) >= share * static_cast<double>(recipe_.steps);
}

std::vector<BatchShape> Trainer::shapes() const {
  return past(recipe_.full_from) ? make_shapes(1, recipe_.full_images)
                                 : make_shapes(recipe_.reduced, recipe_.images);
}

double Trainer::learning_rate() const {
  if (step_ < recipe_.warm_up) {
    return recipe_.learning_rate * static_cast<double>(step_ + 1) /
           static_cast<double>(recipe_.warm_up);
  }
  const double progress =
      static_cast<double>(step_ - recipe_.warm_up) /
      static_cast<double>(std::max<std::int64_t>(1, recipe_.steps - recipe_.warm_up));
  return recipe_.final_rate + (recipe_.learning_rate - recipe_.final_rate) * 0.5 *
                                  (1 + std::cos(M_PI * std::min(1.0, progress)));
}

// Frozen statistics are the averaged ones: those of the last few mixed batches are too noisy.
void Trainer::set_modes() {
  const torch::NoGradGuard no_grad;
  const auto averaged = average_->named_buffers();
  const auto set = [&](DepthNetwork& network) {
    network->train();
    if (!past(recipe_.freeze_from)) return;
    for (auto& buffer : network->named_buffers()) buffer.value().copy_(averaged[buffer.key()]);
    for (const auto& module : network->modules()) {
      if (auto* norm = module->as<torch::nn::BatchNorm2d>()) norm->eval();
    }
  };
  set(network_);
  for (DepthNetwork& replica : replicas_) set(replica);
}

Losses Trainer::run_worker(std::size_t worker, const Batch& part, double share) {
  at::set_num_threads(1);  // of this thread: two whole passes side by side beat one on two threads
  DepthNetwork& network = worker == 0 ? network_ : replicas_[worker - 1];
  for (torch::Tensor& weight : network->parameters()) weight.mutable_grad() = torch::Tensor();
  at::Generator generator = at::detail::createCPUGenerator(
      SampleRandom(recipe_.seed, static_cast<std::uint64_t>(step_), kLossStream + worker)
          .below(1U << 31));
  const Part what = past(recipe_.head_from) ? Part::kWhole : Part::kDirect;
  Losses losses =
      training_losses(network, part.rgb, part.target, recipe_.losses, what, generator).times(share);
  losses.total.backward();
  return losses;
}

void Trainer::gather_workers() {
  const torch::NoGradGuard no_grad;
  auto weights = network_->named_parameters();
  auto statistics = network_->named_buffers();
  for (DepthNetwork& replica : replicas_) {
    for (const auto& item : replica->named_parameters()) {
      torch::Tensor& sum = weights[item.key()].mutable_grad();
      const torch::Tensor& grad = item.value().grad();
      if (!grad.defined()) continue;
      sum = sum.defined() ? sum.add_(grad) : grad;
    }
    for (const auto& item : replica->named_buffers()) statistics[item.key()].add_(item.value());
  }
  const auto workers = static_cast<std::int64_t>(replicas_.size()) + 1;
  for (auto& item : statistics) {
    if (item.value().is_floating_point()) {
      item.value().div_(workers);
    } else {
      item.value().floor_divide_(workers);
    }
    for (DepthNetwork& replica : replicas_)
      replica->named_buffers()[item.key()].copy_(item.value());
  }
}

void Trainer::update_average() {
  const torch::NoGradGuard no_grad;
  const double keep = std::min(
      recipe_.average, (1.0 + static_cast<double>(step_)) / (10.0 + static_cast<double>(step_)));
  std::map<std::string, torch::Tensor> from;
  std::map<std::string, torch::Tensor> to;
  collect(network_, "", from);
  collect(average_, "", to);
  for (auto& [name, tensor] : to) {
    if (tensor.is_floating_point()) {
      tensor.mul_(keep).add_(from[name], 1 - keep);
    } else {
      tensor.copy_(from[name]);
    }
  }
}

Result<Losses> Trainer::advance() {
  const std::vector<BatchShape> wanted = shapes();
  const bool full = wanted[0].width == kDeployed[0][0];
  if (loader_ == nullptr || full != full_size_) {
    loader_.reset();
    loader_ = std::make_unique<BatchLoader>(packs_, wanted, recipe_.seed,
                                            static_cast<std::uint64_t>(step_));
    full_size_ = full;
  }
  const Batch batch = loader_->next();
  set_modes();
  const std::int64_t images = batch.rgb.size(0);
  const auto workers = static_cast<std::int64_t>(replicas_.size()) + 1;
  std::vector<std::future<Losses>> running;
  for (std::int64_t i = 0; i < workers; ++i) {
    const std::int64_t first = i * images / workers;
    const std::int64_t count = (i + 1) * images / workers - first;
    running.push_back(std::async(std::launch::async, [this, i, count, images, first, &batch] {
      return run_worker(static_cast<std::size_t>(i), part_of(batch, first, count),
                        static_cast<double>(count) / static_cast<double>(images));
    }));
  }
  Losses losses;
  for (std::future<Losses>& part : running) losses.add(part.get());
  if (!std::isfinite(losses.total.item<double>())) {
    return Status::error(
        StatusCode::kCorrupt,
        "step %lld: the loss is not finite (distillation %g, denoising %g, gradient "
        "%g, direct %g); lower the learning rate or look at the batch's depth",
        static_cast<long long>(step_), losses.distillation, losses.denoising, losses.gradient,
        losses.direct);
  }
  gather_workers();
  if (const double norm = optimizer_->clip(recipe_.clip); !std::isfinite(norm)) {
    return Status::error(StatusCode::kCorrupt,
                         "step %lld: a gradient is not finite; lower the learning rate",
                         static_cast<long long>(step_));
  }
  optimizer_->step(learning_rate());
  images_ += images;
  ++step_;
  update_average();
  return losses;
}

Status Trainer::save(const std::string& path) const {
  TensorFile file;
  collect(network_, "network.", file.tensors);
  collect(average_, "average.", file.tensors);
  optimizer_->save(file.tensors);
  file.tensors["trainer.step"] = torch::tensor({step_, images_}, torch::kLong);
  file.metadata["lcdm"] = config_json(config());
  return write_tensors(path, file);
}

Status Trainer::resume(const std::string& path) {
  const Result<TensorFile> file = read_tensors(path);
  if (!file) return file.status();
  const auto& tensors = file->tensors;
  const auto step = tensors.find("trainer.step");
  const auto text = file->metadata.find("lcdm");
  if (step == tensors.end() || text == file->metadata.end()) {
    return Status::error(StatusCode::kInvalidInput, "%s is not a training checkpoint",
                         path.c_str());
  }
  const Result<ModelConfig> config = parse_model_config(text->second);
  if (!config) return config.status();
  if (config->encoder != recipe_.encoder || config->preset != recipe_.preset ||
      !restore(network_, "network.", tensors) || !restore(average_, "average.", tensors) ||
      !optimizer_->load(tensors)) {
    return Status::error(StatusCode::kInvalidInput, "%s holds another network than the recipe's",
                         path.c_str());
  }
  network_->config = *config;
  average_->config = *config;
  step_ = step->second[0].item<std::int64_t>();
  images_ = step->second[1].item<std::int64_t>();
  loader_.reset();
  return Status::ok();
}

Result<DepthNetwork> load_checkpoint(const std::string& path) {
  const Result<TensorFile> file = read_tensors(path);
  if (!file) return file.status();
  const auto text = file->metadata.find("lcdm");
  if (text == file->metadata.end()) {
    return Status::error(StatusCode::kInvalidInput, "%s is not a training checkpoint",
                         path.c_str());
  }
  const Result<ModelConfig> config = parse_model_config(text->second);
  if (!config) return config.status();
  DepthNetwork network(*config);
  if (!restore(network, "average.", file->tensors)) {
    return Status::error(StatusCode::kInvalidInput, "%s holds no averaged weights", path.c_str());
  }
  network->eval();
  return network;
}

}  // namespace lcdm::model
