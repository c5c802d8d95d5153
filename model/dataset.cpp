#include "model/dataset.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

namespace lcdm::model {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

constexpr double kMeterUnit = 1.0 / 256;  // metres per step of teacher_meter/*.png
constexpr std::size_t kValidationGap = 20;
constexpr float kMean = 0.45F, kDeviation = 0.225F;  // NETWORK.md, "Input"

Status bad_pack(const fs::path& file, const char* what) {
  return Status::error(StatusCode::kInvalidInput, "%s: %s", file.c_str(), what);
}

Result<json> read_json(const fs::path& file) {
  std::ifstream in(file);
  if (!in) return bad_pack(file, "cannot read: a pack needs an intrinsics.json");
  json parsed = json::parse(in, nullptr, false);
  if (!parsed.is_object()) return bad_pack(file, "not a JSON object");
  return parsed;
}

CameraModel camera_of(const json& info, int width, int height, float field_of_view) {
  const auto number = [&](const char* key) {
    return info.contains(key) && info[key].is_number() ? info[key].get<float>() : 0.0F;
  };
  if (number("fx") <= 0 || number("width") <= 0) {
    return CameraModel::from_field_of_view(width, height, field_of_view);
  }
  CameraModel camera;
  camera.width = static_cast<int>(number("width"));
  camera.height = static_cast<int>(number("height"));
  camera.fx = number("fx");
  camera.fy = number("fy");
  camera.cx = number("cx");
  camera.cy = number("cy");
  camera.calibrated = true;
  return camera.resized(width, height);
}

// The depth that belongs to a picture, metres; empty when there is none. A METER map may cover
// only a band of the picture (band.json: rows [first, end) of a picture of size [w, h]).
struct DepthSource {
  fs::path folder;
  double unit = 0;
  bool sensor = false;
  double band_begin = 0, band_end = 1;  // share of the height
};

Result<DepthSource> find_depth(const fs::path& folder, const json& info) {
  DepthSource source;
  if (fs::is_directory(folder / "depth")) {
    source = {folder / "depth", info.value("depth_unit_m", 0.001), true, 0, 1};
  } else if (fs::is_directory(folder / "teacher_meter")) {
    source = {folder / "teacher_meter", kMeterUnit, false, 0, 1};
    if (fs::exists(source.folder / "band.json")) {
      const auto band = read_json(source.folder / "band.json");
      if (!band) return band.status();
      const auto rows = band->value("rows", std::vector<double>{});
      const auto size = band->value("size", std::vector<double>{});
      if (rows.size() != 2 || size.size() != 2 || size[1] <= 0 || rows[0] >= rows[1]) {
        return bad_pack(source.folder / "band.json", "needs rows [first, end] and size [w, h]");
      }
      source.band_begin = rows[0] / size[1];
      source.band_end = rows[1] / size[1];
    }
  } else {
    return bad_pack(folder, "has neither depth/ nor teacher_meter/");
  }
  return source;
}

cv::Mat read_depth(const DepthSource& source, const std::string& stem, int width, int height) {
  const cv::Mat raw = cv::imread((source.folder / (stem + ".png")).string(), cv::IMREAD_UNCHANGED);
  if (raw.empty() || raw.type() != CV_16UC1) return {};
  cv::Mat metres;
  raw.convertTo(metres, CV_32F, source.unit);
  if (source.band_begin <= 0 && source.band_end >= 1) return metres;
  cv::Mat whole = cv::Mat::zeros(height, width, CV_32F);
  const int begin = static_cast<int>(std::lround(source.band_begin * height));
  const int end = static_cast<int>(std::lround(source.band_end * height));
  cv::Mat band = whole.rowRange(std::clamp(begin, 0, height - 1), std::clamp(end, 1, height));
  cv::resize(metres, band, band.size(), 0, 0, cv::INTER_LINEAR);
  return whole;
}

cv::Mat shrink(const cv::Mat& picture, int max_width) {
  if (picture.cols <= max_width) return picture;
  cv::Mat small;
  const int height =
      static_cast<int>(std::lround(static_cast<double>(picture.rows) * max_width / picture.cols));
  cv::resize(picture, small, {max_width, height}, 0, 0, cv::INTER_AREA);
  return small;
}

float uniform(std::mt19937_64& random, float low, float high) {
  return std::uniform_real_distribution<float>(low, high)(random);
}

// The crop of the wanted shape: the largest, centred; with augmentation a smaller one anywhere.
cv::Rect2d choose_crop(const cv::Mat& picture, double shape, const AugmentOptions& augment,
                       std::mt19937_64& random) {
  double width = std::min<double>(picture.cols, picture.rows * shape);
  double height = width / shape;
  double x = (picture.cols - width) / 2, y = (picture.rows - height) / 2;
  if (augment.enabled) {
    const double scale = uniform(random, augment.min_crop, 1);
    width *= scale;
    height *= scale;
    x = uniform(random, 0, 1) * (picture.cols - width);
    y = uniform(random, 0, 1) * (picture.rows - height);
  }
  return {x, y, width, height};
}

// Brightness, contrast, saturation .2, hue .1 (monodepth2), on float RGB in [0, 1].
void jitter(cv::Mat& rgb, std::mt19937_64& random) {
  const float brightness = uniform(random, 0.8F, 1.2F), contrast = uniform(random, 0.8F, 1.2F);
  const float saturation = uniform(random, 0.8F, 1.2F), hue = uniform(random, -0.1F, 0.1F);
  cv::Mat hsv;
  cv::cvtColor(rgb, hsv, cv::COLOR_RGB2HSV);
  hsv.forEach<cv::Vec3f>([&](cv::Vec3f& pixel, const int*) {
    pixel[0] = std::fmod(pixel[0] + hue * 360 + 360, 360.0F);
    pixel[1] = std::min(1.0F, pixel[1] * saturation);
  });
  cv::cvtColor(hsv, rgb, cv::COLOR_HSV2RGB);
  const double mean = cv::mean(rgb)[0];
  rgb.convertTo(rgb, -1, contrast * brightness, mean * (1 - contrast) * brightness);
  cv::min(rgb, 1.0, rgb);
  cv::max(rgb, 0.0, rgb);
}

cv::Rect to_pixels(const cv::Rect2d& crop, const cv::Size& from, const cv::Size& to) {
  const double sx = static_cast<double>(to.width) / from.width;
  const double sy = static_cast<double>(to.height) / from.height;
  const cv::Rect whole(0, 0, to.width, to.height);
  const cv::Rect rect(static_cast<int>(std::lround(crop.x * sx)),
                      static_cast<int>(std::lround(crop.y * sy)),
                      std::max(1, static_cast<int>(std::lround(crop.width * sx))),
                      std::max(1, static_cast<int>(std::lround(crop.height * sy))));
  return rect & whole;
}

torch::Tensor to_tensor(const cv::Mat& image) {
  const cv::Mat packed = image.isContinuous() ? image : image.clone();
  return torch::from_blob(packed.data, {packed.rows, packed.cols, packed.channels()}, torch::kFloat)
      .permute({2, 0, 1})
      .contiguous()
      .clone();
}

}  // namespace

Result<Pack> load_pack(const std::string& folder, const PackOptions& options) {
  const auto info = read_json(fs::path(folder) / "intrinsics.json");
  if (!info) return info.status();
  const auto depth = find_depth(folder, *info);
  if (!depth) return depth.status();

  Pack pack;
  pack.name = fs::path(folder).filename().string();
  pack.sensor_depth = depth->sensor;
  pack.reliable_scale = depth->sensor && info->contains("fx");
  std::vector<fs::path> pictures;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(fs::path(folder) / "rgb", error)) {
    pictures.push_back(entry.path());
  }
  std::sort(pictures.begin(), pictures.end());
  for (const fs::path& picture : pictures) {
    Frame frame;
    frame.name = picture.stem().string();
    const cv::Mat bgr = cv::imread(picture.string(), cv::IMREAD_COLOR);
    if (bgr.empty()) return bad_pack(picture, "cannot read this picture: remove or mend it");
    frame.depth = read_depth(*depth, frame.name, bgr.cols, bgr.rows);
    if (frame.depth.empty()) continue;
    cv::cvtColor(shrink(bgr, options.max_width), frame.rgb, cv::COLOR_BGR2RGB);
    frame.camera = camera_of(*info, frame.rgb.cols, frame.rgb.rows, options.assumed_field_of_view);
    pack.frames.push_back(std::move(frame));
  }
  if (pack.frames.empty()) return bad_pack(folder, "holds no picture with depth");
  return pack;
}

Split split_pack(const Pack& pack) {
  Split split;
  const std::size_t count = pack.frames.size();
  const std::size_t validation = count / 10;
  const std::size_t gap = std::min(kValidationGap, count / 5);
  for (std::size_t i = 0; i < count; ++i) {
    if (i + validation >= count) {
      split.validation.push_back(&pack.frames[i]);
    } else if (i + validation + gap < count) {
      split.train.push_back(&pack.frames[i]);
    }
  }
  return split;
}

Sample make_sample(const Frame& frame, int width, int height, double canonical_focal,
                   const AugmentOptions& augment, std::mt19937_64& random) {
  const cv::Rect2d crop =
      choose_crop(frame.rgb, static_cast<double>(width) / height, augment, random);
  const cv::Rect rect = to_pixels(crop, frame.rgb.size(), frame.rgb.size());
  cv::Mat image, depth;
  const bool shrinking = rect.width >= width;
  cv::resize(frame.rgb(rect), image, {width, height}, 0, 0,
             shrinking ? cv::INTER_AREA : cv::INTER_LINEAR);
  // Nearest: a mean across an edge would be a depth that is nowhere.
  cv::resize(frame.depth(to_pixels(crop, frame.rgb.size(), frame.depth.size())), depth,
             {width, height}, 0, 0, cv::INTER_NEAREST);
  image.convertTo(image, CV_32F, 1.0 / 255);
  if (augment.enabled) {
    if (uniform(random, 0, 1) < 0.5F) jitter(image, random);
    if (uniform(random, 0, 1) < 0.5F) {
      cv::flip(image, image, 1);
      cv::flip(depth, depth, 1);
    }
  }
  const double fx_network = frame.camera.fx * static_cast<double>(width) / rect.width;
  depth *= canonical_focal / fx_network;
  return {(to_tensor(image) - kMean) / kDeviation, to_tensor(depth)};
}

}  // namespace lcdm::model
