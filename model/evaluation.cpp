#include "model/evaluation.h"

#include <cmath>
#include <filesystem>
#include <map>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "firmware/nn/engine.h"
#include "model/batch.h"
#include "model/depth_code.h"
#include "model/folded_net.h"
#include "model/recipe.h"

namespace lcdm::model {
namespace {

namespace fs = std::filesystem;

// The frame as the network's input, [1, 3, h, w].
torch::Tensor input_of(const PackFrame& frame, const ModelConfig& model, double share) {
  const cv::Size size = deployed_size(model, frame.rgb.size(), share);
  cv::Mat resized;
  cv::resize(frame.rgb, resized, size, 0, 0,
             frame.rgb.cols > size.width ? cv::INTER_AREA : cv::INTER_LINEAR);
  return normalised(resized).permute({2, 0, 1}).unsqueeze(0);
}

cv::Mat to_mat(const torch::Tensor& depth) {
  const torch::Tensor packed = depth.squeeze().contiguous();
  return cv::Mat(static_cast<int>(packed.size(0)), static_cast<int>(packed.size(1)), CV_32F,
                 packed.data_ptr())
      .clone();
}

// Inverse depth as colours between its own 2nd and 98th percentile over `valid`.
cv::Mat colour_of(const cv::Mat& depth) {
  std::vector<float> values;
  for (int y = 0; y < depth.rows; ++y) {
    for (int x = 0; x < depth.cols; ++x) {
      if (depth.at<float>(y, x) > 0) values.push_back(1 / depth.at<float>(y, x));
    }
  }
  cv::Mat colour = cv::Mat::zeros(depth.size(), CV_8UC3);
  if (values.empty()) return colour;
  std::sort(values.begin(), values.end());
  const float low = values[values.size() / 50];
  const float high = values[values.size() - 1 - values.size() / 50];
  cv::Mat inverse = 1 / cv::max(depth, 1e-6);
  cv::Mat grey;
  inverse.convertTo(grey, CV_8U, 255.0 / std::max(high - low, 1e-6F),
                    -255.0 * low / std::max(high - low, 1e-6F));
  cv::applyColorMap(grey, colour, cv::COLORMAP_MAGMA);
  colour.setTo(cv::Scalar::all(0), depth <= 0);
  return colour;
}

}  // namespace

cv::Size deployed_size(const ModelConfig& model, cv::Size picture, double share) {
  const NetworkSize whole =
      choose_network_size(model, {.width = picture.width, .height = picture.height});
  return {scaled_side(whole.width, share), scaled_side(whole.height, share)};
}

namespace {

// Canonical depth of the whole frame at the input's width -> metres along the frame's axis.
cv::Mat metres_of(const torch::Tensor& canonical, const PackFrame& frame,
                  const ModelConfig& config) {
  cv::Mat depth = to_mat(canonical.cpu());
  const double deployed = deployed_size(config, frame.rgb.size()).width;
  const double focal = frame.camera.fx * deployed / std::max(1, frame.camera.width);
  return depth * (focal / config.canonical_focal);
}

}  // namespace

Estimator network_estimator(DepthNetwork& network, int steps, double share) {
  return [&network, steps, share](const PackFrame& frame) {
    const torch::NoGradGuard no_grad;
    const torch::Device device = network->direct->weight.device();
    const torch::Tensor condition =
        network->condition_of(input_of(frame, network->config, share).to(device));
    const torch::Tensor variable = network->sample(condition, steps);
    return metres_of(depth_of_variable(variable, network->config), frame, network->config);
  };
}

Estimator both_ways(Estimator estimator) {
  return [estimator = std::move(estimator)](const PackFrame& frame) -> cv::Mat {
    PackFrame mirror = frame;
    mirror.rgb = cv::Mat();  // pixels of its own
    cv::flip(frame.rgb, mirror.rgb, 1);
    mirror.camera.cx = static_cast<float>(frame.rgb.cols - 1) - frame.camera.cx;
    const cv::Mat depth = estimator(frame);
    cv::Mat other = estimator(mirror);
    if (depth.empty() || depth.size() != other.size()) return {};
    cv::flip(other, other, 1);
    cv::Mat mean = 2 * depth.mul(other) / (depth + other);
    mean.setTo(0, (depth <= 0) | (other <= 0));
    return mean;
  };
}

Result<Estimator> file_estimator(const std::string& path, double share) {
  const Result<ModelFile> file = ModelFile::load(path);
  if (!file) return file.status();
  const Result<Network> layers = Network::build(file->config(), kDeployed[0][0], kDeployed[0][1]);
  if (!layers) return layers.status();
  LCDM_RETURN_IF_ERROR(layers->check_weights(*file));
  auto net = std::make_shared<FoldedNet>(*file);
  return Estimator([net, share, config = file->config()](const PackFrame& frame) {
    const torch::NoGradGuard no_grad;
    return metres_of(net->forward(input_of(frame, config, share).contiguous()), frame, config);
  });
}

namespace {

// The device's engine for each size that frames ask for, made when first asked for.
class Engines {
 public:
  Engines(ModelFile file, Precision precision, int threads)
      : file_(std::move(file)), precision_(precision), threads_(threads) {}

  const ModelConfig& config() const { return file_.config(); }

  Result<Engine*> of_size(cv::Size size) {
    std::unique_ptr<Engine>& engine = engines_[{size.width, size.height}];
    if (engine) return engine.get();
    CameraModel camera = CameraModel::from_field_of_view(size.width, size.height, 65);
    camera.fx = static_cast<float>(config().canonical_focal);  // metres are canonical ones
    EngineOptions options;
    options.width = size.width;
    options.height = size.height;
    options.threads = threads_;
    options.precision = precision_;
    auto made = Engine::prepare(
        file_, options, {PixelFormat::kRgb24, size.width, size.height, 3 * size.width}, camera);
    if (!made) return made.status();
    engine = std::move(*made);
    return engine.get();
  }

 private:
  ModelFile file_;
  Precision precision_;
  int threads_;
  std::map<std::pair<int, int>, std::unique_ptr<Engine>> engines_;
};

}  // namespace

Result<Estimator> engine_estimator(const std::string& path, Precision precision, int threads,
                                   double share) {
  Result<ModelFile> file = ModelFile::load(path);
  if (!file) return file.status();
  const auto engines = std::make_shared<Engines>(std::move(*file), precision, threads);
  // Now, so that what the file or the processor cannot do is said before any frame.
  for (const auto& [width, height] : engines->config().trained_sizes) {
    const cv::Size size = deployed_size(engines->config(), {width, height}, share);
    const Result<Engine*> engine = engines->of_size(size);
    if (!engine) return engine.status();
    if ((*engine)->stats().precision != precision) {
      return Status::error(StatusCode::kUnsupported,
                           "--precision %s: this processor has no instructions for it",
                           to_string(precision));
    }
  }
  return Estimator([engines, share](const PackFrame& frame) -> cv::Mat {
    const torch::Tensor input =
        input_of(frame, engines->config(), share).permute({0, 2, 3, 1}).contiguous();
    const cv::Size size(static_cast<int>(input.size(2)), static_cast<int>(input.size(1)));
    const Result<Engine*> engine = engines->of_size(size);
    if (!engine) return {};
    const auto depth =
        (*engine)->run_network({input.data_ptr<float>(), static_cast<std::size_t>(input.numel())});
    if (!depth) return {};
    const torch::Tensor canonical =
        torch::from_blob(const_cast<float*>(depth->data()), {size.height, size.width});
    return metres_of(canonical, frame, engines->config());
  });
}

double log_distance(const cv::Mat& a, const cv::Mat& b) {
  cv::Mat logs[2];
  cv::log(a, logs[0]);
  cv::log(b, logs[1]);
  return cv::norm(logs[0], logs[1], cv::NORM_L1) / static_cast<double>(a.total());
}

Estimator maps_estimator(const std::string& folder) {
  return [root = fs::path(folder)](const PackFrame& frame) {
    const fs::path path = root / (frame.name + ".png");
    cv::Mat depth;
    if (!fs::exists(path)) return depth;
    const cv::Mat raw = cv::imread(path.string(), cv::IMREAD_UNCHANGED);
    if (raw.type() == CV_16UC1 && !raw.empty()) raw.convertTo(depth, CV_32F, 1.0 / 256);
    return depth;
  };
}

Estimator folder_estimator(const std::string& folder) {
  return [root = fs::path(folder)](const PackFrame& frame) {
    const auto read = [&](const char* extension) {
      const fs::path path = root / (frame.name + extension);
      return fs::exists(path) ? cv::imread(path.string(), cv::IMREAD_UNCHANGED) : cv::Mat();
    };
    cv::Mat depth = read(".tiff");
    if (depth.type() == CV_32FC1 && !depth.empty()) return depth;
    const cv::Mat raw = read(".png");
    depth = cv::Mat();
    if (raw.type() == CV_16UC1 && !raw.empty()) raw.convertTo(depth, CV_32F, 0.001);
    return depth;
  };
}

Estimator constant_estimator() {
  return [](const PackFrame& frame) { return cv::Mat(frame.depth.size(), CV_32F, cv::Scalar(1)); };
}

cv::Mat motion_blurred(const cv::Mat& rgb, double length, std::size_t index) {
  constexpr double kGoldenAngle = 2.39996323;  // radians
  const double pixels = length * rgb.cols / 640;
  const int side = 2 * static_cast<int>(std::ceil(pixels / 2)) + 1;
  const double angle = kGoldenAngle * static_cast<double>(index);
  cv::Mat kernel = cv::Mat::zeros(side, side, CV_32F);
  constexpr int kTaps = 256;  // points of the path
  for (int i = 0; i < kTaps; ++i) {
    const double along = pixels * ((i + 0.5) / kTaps - 0.5);
    const int x = cvRound(side / 2 + along * std::cos(angle));
    const int y = cvRound(side / 2 + along * std::sin(angle));
    kernel.at<float>(y, x) += 1.0F / kTaps;
  }
  cv::Mat blurred;
  cv::filter2D(rgb, blurred, -1, kernel, {-1, -1}, 0, cv::BORDER_REPLICATE);
  return blurred;
}

namespace {

Result<FrameResult> evaluate_frame(const Frames& set, std::size_t index, const Protocol& protocol,
                                   const Estimator& estimator, double blur) {
  Result<PackFrame> frame = set.read(index);
  if (!frame) return frame.status();
  if (blur > 0) frame->rgb = motion_blurred(frame->rgb, blur, index);
  const cv::Mat estimate = estimator(*frame);
  if (estimate.empty()) {
    return Status::error(StatusCode::kNotFound, "%s: no estimate", frame->name.c_str());
  }
  FrameResult result{frame->name, {}};
  if (measure(estimate, frame->depth, protocol, result.metrics)) return result;
  return Status::error(StatusCode::kCorrupt,
                       "%s: no ground truth where it counts, or an estimate without depth there",
                       frame->name.c_str());
}

}  // namespace

SetResult evaluate(const Frames& set, const std::vector<std::size_t>& frames,
                   const Protocol& protocol, const Estimator& estimator, double blur) {
  SetResult result;
  std::vector<Metrics> all;
  for (const std::size_t index : frames) {
    const Result<FrameResult> frame = evaluate_frame(set, index, protocol, estimator, blur);
    if (!frame) {
      ++result.missing;
      result.why_missing = frame.status();
      continue;
    }
    all.push_back(frame->metrics);
    result.frames.push_back(*frame);
  }
  result.mean = mean_of(all);
  return result;
}

namespace {

// Widens the interval to that of 10,000 means of runs of `block` neighbours, drawn anew with
// replacement; the last one has the first for its neighbour.
void widen(const std::vector<double>& differences, std::size_t block, Difference& out) {
  constexpr int kDraws = 10000;
  const std::size_t count = differences.size();
  SampleRandom random(1, count, 0);
  std::vector<double> means(kDraws);
  for (double& mean : means) {
    std::size_t at = 0;
    for (std::size_t i = 0; i < count; ++i, ++at) {
      if (i % block == 0) at = random.below(count);
      mean += differences[at % count] / static_cast<double>(count);
    }
  }
  std::sort(means.begin(), means.end());
  out.low = std::min(out.low, means[kDraws / 40]);
  out.high = std::max(out.high, means[kDraws - 1 - kDraws / 40]);
}

}  // namespace

Difference paired_difference(const SetResult& a, const SetResult& b, double Metrics::*metric) {
  std::map<std::string, double> others;
  for (const FrameResult& frame : b.frames) others[frame.name] = frame.metrics.*metric;
  std::vector<double> differences;
  for (const FrameResult& frame : a.frames) {
    const auto other = others.find(frame.name);
    if (other != others.end()) differences.push_back(frame.metrics.*metric - other->second);
  }
  Difference out;
  out.frames = differences.size();
  if (differences.empty()) return out;
  const auto n = static_cast<double>(differences.size());
  for (const double difference : differences) out.mean += difference / n;
  out.low = out.high = out.mean;
  widen(differences, 1, out);
  widen(differences, static_cast<std::size_t>(std::ceil(std::sqrt(n))), out);
  return out;
}

cv::Mat comparison_picture(const PackFrame& frame, const std::vector<cv::Mat>& estimates) {
  cv::Mat bgr;
  cv::cvtColor(frame.rgb, bgr, cv::COLOR_RGB2BGR);
  cv::Mat truth = frame.depth.clone();
  truth.setTo(0, truth > 100);
  std::vector<cv::Mat> parts = {bgr, colour_of(truth)};
  for (const cv::Mat& estimate : estimates) {
    cv::Mat resized;
    cv::resize(estimate, resized, frame.rgb.size(), 0, 0, cv::INTER_NEAREST);
    parts.push_back(colour_of(resized));
  }
  cv::Mat row;
  cv::hconcat(parts, row);
  return row;
}

}  // namespace lcdm::model
