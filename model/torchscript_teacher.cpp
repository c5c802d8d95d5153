#include "model/torchscript_teacher.h"

#include <algorithm>
#include <opencv2/imgproc.hpp>
#include <torch/script.h>

namespace lcdm::model {
namespace {

using Gives = TorchscriptOptions::Gives;

constexpr double kNearest = 1;  // metres, of stored affine-invariant maps
constexpr double kFarthest = 100;

torch::Tensor input_of(const cv::Mat& rgb, const TorchscriptOptions& options) {
  cv::Mat resized;
  cv::resize(rgb, resized, options.input, 0, 0,
             rgb.cols > options.input.width ? cv::INTER_AREA : cv::INTER_LINEAR);
  const torch::Tensor picture =
      torch::from_blob(resized.data, {1, resized.rows, resized.cols, 3}, torch::kUInt8)
          .to(torch::kFloat32)
          .div(255)
          .permute({0, 3, 1, 2});
  return scale_pixels(picture, options.pixels).contiguous();
}

// The first tensor of what a module gives; undefined where there is none.
torch::Tensor first_tensor(const c10::IValue& value) {
  if (value.isTensor()) return value.toTensor();
  if (value.isTuple() && !value.toTupleRef().elements().empty()) {
    return first_tensor(value.toTupleRef().elements()[0]);
  }
  if (value.isList() && !value.toListRef().empty()) return first_tensor(value.toListRef()[0]);
  return {};
}

cv::Mat metres_of(torch::Tensor map, Gives gives) {
  map = map.to(torch::kFloat32).contiguous();
  if (gives == Gives::kAffineInverse) {
    const torch::Tensor low = map.min();
    const torch::Tensor share = (map - low) / (map.max() - low).clamp_min(1e-12);
    map = 1 / kFarthest + (1 / kNearest - 1 / kFarthest) * share;
  }
  if (gives != Gives::kDepth) map = 1 / map.clamp_min(1e-6);
  map = torch::where(torch::isfinite(map), map, torch::zeros_like(map));
  return cv::Mat(static_cast<int>(map.size(-2)), static_cast<int>(map.size(-1)), CV_32F,
                 map.data_ptr())
      .clone();
}

bool is_a_map(const torch::Tensor& out) {
  return out.defined() && out.dim() >= 2 && out.dim() <= 4 &&
         out.numel() == out.size(-1) * out.size(-2) && out.numel() > 0;
}

}  // namespace

cv::Mat at_ten_metres(const cv::Mat& map) {
  constexpr float kMedian = 10;
  std::vector<float> known;
  for (const float depth : cv::Mat_<float>(map)) {
    if (depth > 0) known.push_back(depth);
  }
  if (known.empty()) return map;
  const auto middle = known.begin() + static_cast<std::ptrdiff_t>(known.size() / 2);
  std::nth_element(known.begin(), middle, known.end());
  return map * (kMedian / *middle);
}

Result<Estimator> torchscript_estimator(const TorchscriptOptions& options) {
  auto module = std::make_shared<torch::jit::Module>();
  const auto run = [module, options](const cv::Mat& rgb) {
    const torch::NoGradGuard no_grad;
    return first_tensor(module->forward({input_of(rgb, options)}));
  };
  try {
    *module = torch::jit::load(options.file, torch::kCPU);
    module->eval();
    if (!is_a_map(run(cv::Mat(options.input, CV_8UC3, cv::Scalar::all(0))))) {
      return Status::error(StatusCode::kCorrupt,
                           "%s: gives no depth map [1, 1, H, W] for a picture [1, 3, %d, %d]",
                           options.file.c_str(), options.input.height, options.input.width);
    }
  } catch (const std::exception& error) {
    const std::string what = error.what();
    return Status::error(StatusCode::kInvalidInput,
                         "%s: no TorchScript module for pictures of %dx%d: %s",
                         options.file.c_str(), options.input.width, options.input.height,
                         what.substr(0, what.find('\n')).c_str());
  }
  return Estimator([run, gives = options.gives](const PackFrame& frame) {
    try {
      const torch::Tensor out = run(frame.rgb);
      return is_a_map(out) ? metres_of(out, gives) : cv::Mat();
    } catch (const std::exception&) {
      return cv::Mat();
    }
  });
}

}  // namespace lcdm::model
