#include "model/kitti_calibration.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "model/dataset_files.h"

namespace lcdm::model {
namespace {

namespace fs = std::filesystem;
using dataset::number_of;
using dataset::split;

constexpr std::size_t kMostCalibrationBytes = 1U << 20;
constexpr std::size_t kMostSweepBytes = 64U << 20;  // sweeps have 2 MB
constexpr int kMostPixels = 1 << 14;                // a side of a picture

// The lines "key: numbers" of a calibration file.
class Calibration {
 public:
  static Result<Calibration> read(const fs::path& file);

  // The `count` finite numbers of `key`.
  Result<std::vector<double>> numbers(const std::string& key, std::size_t count) const;

 private:
  std::string file_;
  std::map<std::string, std::string> values_;
};

Result<Calibration> Calibration::read(const fs::path& file) {
  const Result<std::string> text = dataset::read_bytes(file, kMostCalibrationBytes);
  if (!text) return text.status();
  Calibration out;
  out.file_ = file.string();
  for (const std::string_view line : split(*text, "\r\n")) {
    const std::size_t colon = line.find(':');
    if (colon == std::string_view::npos) continue;
    out.values_[std::string(line.substr(0, colon))] = line.substr(colon + 1);
  }
  return out;
}

Result<std::vector<double>> Calibration::numbers(const std::string& key, std::size_t count) const {
  std::vector<double> numbers;
  const auto found = values_.find(key);
  if (found != values_.end()) {
    for (const std::string_view word : split(found->second, " \t")) {
      const std::optional<double> number = number_of<double>(word);
      numbers.push_back(number.value_or(NAN));
    }
  }
  const bool finite = std::all_of(numbers.begin(), numbers.end(),
                                  [](double number) { return std::isfinite(number); });
  if (finite && numbers.size() == count) return numbers;
  return Status::error(StatusCode::kCorrupt,
                       "%s: \"%s:\" is not followed by %zu numbers: fetch the calibration again",
                       file_.c_str(), key.c_str(), count);
}

Result<CameraModel> model_of(const std::vector<double>& size, const std::vector<double>& projection,
                             const fs::path& file) {
  const bool sizes = size[0] >= 1 && size[0] <= kMostPixels && size[1] >= 1 &&
                     size[1] <= kMostPixels && std::floor(size[0]) == size[0] &&
                     std::floor(size[1]) == size[1];
  if (!sizes || projection[0] <= 0 || projection[5] <= 0) {
    return Status::error(StatusCode::kCorrupt,
                         "%s: S_rect or P_rect describe no camera: fetch the calibration again",
                         file.c_str());
  }
  return CameraModel{static_cast<int>(size[0]),
                     static_cast<int>(size[1]),
                     static_cast<float>(projection[0]),
                     static_cast<float>(projection[5]),
                     static_cast<float>(projection[2]),
                     static_cast<float>(projection[6]),
                     true};
}

// Into the frame of the rectified reference camera: R_rect_00 [R | T].
Result<cv::Matx44d> rectified_from_scanner(const Calibration& cameras, const fs::path& date) {
  const Result<Calibration> scanner = Calibration::read(date / "calib_velo_to_cam.txt");
  if (!scanner) return scanner.status();
  const auto r = scanner->numbers("R", 9);
  if (!r) return r.status();
  const auto t = scanner->numbers("T", 3);
  if (!t) return t.status();
  const auto rect = cameras.numbers("R_rect_00", 9);
  if (!rect) return rect.status();
  cv::Matx44d to_camera = cv::Matx44d::eye();
  cv::Matx44d rectify = cv::Matx44d::eye();
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      to_camera(i, j) = (*r)[static_cast<std::size_t>(3 * i + j)];
      rectify(i, j) = (*rect)[static_cast<std::size_t>(3 * i + j)];
    }
    to_camera(i, 3) = (*t)[static_cast<std::size_t>(i)];
  }
  return rectify * to_camera;
}

// The projection is rounded half to even, minus one (the development kit counts pixels from 1); the
// nearest point of a pixel counts. The published evaluations also mix the last column of a row with
// the first of the next, an oversight in their indices that their crop hides; it is not repeated.
cv::Mat project_sweep(const std::string& bytes, const KittiCamera& camera) {
  cv::Mat depth = cv::Mat::zeros(camera.model.height, camera.model.width, CV_32F);
  for (std::size_t at = 0; at + 16 <= bytes.size(); at += 16) {
    std::array<float, 4> point;  // forward, left, up, reflectance
    std::memcpy(point.data(), bytes.data() + at, sizeof(point));
    const cv::Vec3d pixel = camera.from_scanner * cv::Vec4d(static_cast<double>(point[0]),
                                                            static_cast<double>(point[1]),
                                                            static_cast<double>(point[2]), 1);
    if (!(point[0] >= 0 && pixel[2] > 0)) continue;  // behind, or not a number
    const double x = std::nearbyint(pixel[0] / pixel[2]) - 1;
    const double y = std::nearbyint(pixel[1] / pixel[2]) - 1;
    if (!(x >= 0 && y >= 0 && x < depth.cols && y < depth.rows)) continue;
    float& nearest = depth.at<float>(static_cast<int>(y), static_cast<int>(x));
    if (nearest <= 0 || point[0] < nearest) nearest = point[0];
  }
  return depth;
}

}  // namespace

Result<KittiCameras> read_kitti_cameras(const fs::path& date, bool with_scanner) {
  const fs::path file = date / "calib_cam_to_cam.txt";
  const Result<Calibration> calibration = Calibration::read(file);
  if (!calibration) return calibration.status();
  cv::Matx44d scanner = cv::Matx44d::eye();
  if (with_scanner) {
    const auto found = rectified_from_scanner(*calibration, date);
    if (!found) return found.status();
    scanner = *found;
  }
  KittiCameras cameras;
  for (std::size_t side = 0; side < cameras.size(); ++side) {
    const std::string suffix = side == 0 ? "_rect_02" : "_rect_03";
    const auto size = calibration->numbers("S" + suffix, 2);
    if (!size) return size.status();
    const auto projection = calibration->numbers("P" + suffix, 12);
    if (!projection) return projection.status();
    const Result<CameraModel> model = model_of(*size, *projection, file);
    if (!model) return model.status();
    cameras[side] = {*model, cv::Matx34d(projection->data()) * scanner};
  }
  return cameras;
}

Result<cv::Mat> read_kitti_sweep(const fs::path& file, const KittiCamera& camera) {
  const Result<std::string> bytes = dataset::read_bytes(file, kMostSweepBytes);
  if (!bytes) return bytes.status();
  if (bytes->size() % 16 != 0) {
    return Status::error(StatusCode::kCorrupt,
                         "%s: %zu bytes are no whole points of 16: cut short, fetch it again",
                         file.c_str(), bytes->size());
  }
  return project_sweep(*bytes, camera);
}

}  // namespace lcdm::model
