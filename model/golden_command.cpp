#include <cstdio>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "model/batch.h"
#include "model/commands.h"
#include "model/config_json.h"
#include "model/folded_net.h"
#include "model/safetensors.h"

namespace lcdm::model {
namespace {

// A layer larger than this is kept as about so many evenly spaced samples of it, so that fixtures
// stay small.
constexpr int64_t kSamples = 512;

struct Options {
  std::string model;
  std::string image;
  std::string output;
  int width = 96;
  int height = 64;
};

// Every n-th value of the tensor laid out as the engine keeps it: [height, width, channels]. n is
// odd: channels are mostly even in number, and every one of them must have its turn.
torch::Tensor sampled(const torch::Tensor& nchw) {
  const torch::Tensor flat = nchw.permute({0, 2, 3, 1}).reshape({-1});
  const int64_t stride = (flat.numel() / kSamples) | 1;
  return flat.slice(0, 0, flat.numel(), stride).contiguous();
}

// The fixture is itself of the model file's form: metadata of the model, tensors `input`
// [height, width, 3], `depth` [height, width] whole, and the samples of every layer.
Status run(const Options& options) {
  const Result<ModelFile> file = ModelFile::load(options.model);
  if (!file) return file.status();
  cv::Mat picture = cv::imread(options.image, cv::IMREAD_COLOR);
  if (picture.empty()) {
    return Status::error(StatusCode::kNotFound, "%s: cannot read this picture",
                         options.image.c_str());
  }
  cv::cvtColor(picture, picture, cv::COLOR_BGR2RGB);
  cv::resize(picture, picture, {options.width, options.height}, 0, 0, cv::INTER_AREA);
  const torch::Tensor input = normalised(picture);

  FoldedNet net(*file);
  net.forward(input.permute({2, 0, 1}).unsqueeze(0).contiguous());
  const Result<std::string> config = config_json(file->config());
  if (!config) return config.status();
  TensorFile fixture;
  fixture.metadata["lcdm"] = *config;
  fixture.tensors["input"] = input.contiguous();
  for (const auto& [layer, value] : net.outputs()) fixture.tensors[layer] = sampled(value);
  fixture.tensors["depth"] =
      net.outputs().at("depth").reshape({options.height, options.width}).contiguous();
  LCDM_RETURN_IF_ERROR(write_tensors(options.output, fixture));
  std::printf("%s: %zu tensors\n", options.output.c_str(), fixture.tensors.size());
  return Status::ok();
}

}  // namespace

void add_golden(CLI::App& app, Status& status) {
  auto* command =
      app.add_subcommand("golden", "Writes what LibTorch computes for a model file, for tests");
  auto options = std::make_shared<Options>();
  command->add_option("--model", options->model, "Model file")->required();
  command->add_option("--image", options->image, "Picture to compute on")->required();
  command->add_option("--output", options->output, "The fixture, .safetensors")->required();
  command->add_option("--width", options->width, "Of the network's input")->capture_default_str();
  command->add_option("--height", options->height, "Of the network's input")->capture_default_str();
  command->callback([options, &status] { status = run(*options); });
}

}  // namespace lcdm::model
