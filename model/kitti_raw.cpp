#include "model/kitti_raw.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <map>
#include <optional>
#include <set>
#include <string_view>
#include <utility>
#include <vector>

#include "model/dataset_files.h"
#include "model/pack.h"

namespace lcdm::model {
namespace {

namespace fs = std::filesystem;
using dataset::guarded;
using dataset::matches;
using Depth = KittiRawOptions::Depth;

constexpr std::size_t kMostListBytes = 64U << 20;
constexpr std::size_t kMostCalibrationBytes = 1U << 20;
constexpr std::size_t kMostSweepBytes = 64U << 20;                         // sweeps have 2 MB
constexpr double kDepthUnit = 1.0 / 256;                                   // metres
constexpr int kMostPixels = 1 << 14;                                       // a side of a picture
constexpr std::array<const char*, 2> kFolders = {"image_02", "image_03"};  // left, right

std::vector<std::string_view> split(std::string_view text, std::string_view separators) {
  std::vector<std::string_view> parts;
  std::size_t at = 0;
  while ((at = text.find_first_not_of(separators, at)) != std::string_view::npos) {
    const std::size_t end = std::min(text.find_first_of(separators, at), text.size());
    parts.push_back(text.substr(at, end - at));
    at = end;
  }
  return parts;
}

template <typename Number>
std::optional<Number> number_of(std::string_view text) {
  Number value{};
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size()) return std::nullopt;
  return value;
}

// ---- Calibration --------------------------------------------------------------------------------

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

// One colour camera on one day.
struct Camera {
  CameraModel model;
  cv::Matx34d from_scanner;  // homogeneous point of the velodyne to pixel times depth, and depth
};

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

using Cameras = std::array<Camera, 2>;  // left, right

Result<Cameras> read_cameras(const fs::path& date, bool with_scanner) {
  const fs::path file = date / "calib_cam_to_cam.txt";
  const Result<Calibration> calibration = Calibration::read(file);
  if (!calibration) return calibration.status();
  cv::Matx44d scanner = cv::Matx44d::eye();
  if (with_scanner) {
    const auto found = rectified_from_scanner(*calibration, date);
    if (!found) return found.status();
    scanner = *found;
  }
  Cameras cameras;
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

// ---- Velodyne -----------------------------------------------------------------------------------

// Depth [height][width] of a sweep, as monodepth2 and, before it, Eigen's and Garg's evaluations
// make it: the projection rounded half to even, minus one (the development kit counts pixels from
// 1), the nearest point of a pixel. Theirs also mixes the last column of a row with the first of
// the next, an oversight in their indices that the evaluation's crop hides; it is not repeated.
cv::Mat project_sweep(const std::string& bytes, const Camera& camera, bool scanner_depth) {
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
    const float value = scanner_depth ? point[0] : static_cast<float>(pixel[2]);
    if (nearest <= 0 || value < nearest) nearest = value;
  }
  return depth;
}

Result<cv::Mat> read_sweep(const fs::path& file, const Camera& camera, bool scanner_depth) {
  const Result<std::string> bytes = dataset::read_bytes(file, kMostSweepBytes);
  if (!bytes) return bytes.status();
  if (bytes->size() % 16 != 0) {
    return Status::error(StatusCode::kCorrupt,
                         "%s: %zu bytes are no whole points of 16: cut short, fetch it again",
                         file.c_str(), bytes->size());
  }
  return project_sweep(*bytes, camera, scanner_depth);
}

// ---- Lists and folders --------------------------------------------------------------------------

struct Drive {
  std::string date;  // 2011_09_26
  std::string name;  // 2011_09_26_drive_0002_sync
  // Of each camera: the pictures that exist, and whether as .jpg.
  std::array<std::map<std::int64_t, bool>, 2> pictures;
};

struct Listed {
  std::size_t drive = 0;
  std::int64_t number = 0;
  std::size_t side = 0;
};

std::string numbered(std::int64_t number, const char* extension) {
  char text[40];
  std::snprintf(text, sizeof(text), "%010lld%s", static_cast<long long>(number), extension);
  return text;
}

std::map<std::int64_t, bool> find_pictures(const fs::path& folder) {
  std::map<std::int64_t, bool> pictures;
  for (const std::string& name : dataset::names_in(folder)) {
    const bool jpg = matches(name, "##########.jpg");
    if (!jpg && !matches(name, "##########.png")) continue;
    // Sorted: the .png of the same number comes second, and counts.
    pictures[number_of<std::int64_t>(std::string_view(name).substr(0, 10)).value_or(0)] = jpg;
  }
  return pictures;
}

// A whole data set opened: what is listed, what is there, and how its cameras see.
struct Opened {
  std::vector<Drive> drives;
  std::vector<Listed> frames;
  std::map<std::string, Cameras> cameras;  // by date
};

// A list's line, without its drive's index; nothing where it is malformed.
struct Line {
  std::string date;
  std::string drive;
  Listed frame;
};
std::optional<Line> parse_line(std::string_view text) {
  const auto words = split(text, " \t");
  if (words.size() != 3 || !matches(words[0], "####_##_##/####_##_##_drive_####_sync")) return {};
  const std::string_view date = words[0].substr(0, 10);
  const auto number = number_of<std::int64_t>(words[1]);
  const bool digits = number && *number >= 0 && words[1].size() <= 10;
  if (words[0].substr(11, 10) != date || !digits || (words[2] != "l" && words[2] != "r")) return {};
  return Line{
      std::string(date), std::string(words[0].substr(11)), {0, *number, words[2] == "l" ? 0U : 1U}};
}

Status read_list(const std::string& file, Opened& opened) {
  const Result<std::string> text = dataset::read_bytes(file, kMostListBytes);
  if (!text) return text.status();
  std::map<std::string, std::size_t> known;
  std::size_t line_number = 0;
  for (std::size_t at = 0; at < text->size();) {
    const std::size_t end = std::min(text->find('\n', at), text->size());
    std::string_view line = std::string_view(*text).substr(at, end - at);
    at = end + 1;
    ++line_number;
    if (line.ends_with('\r')) line.remove_suffix(1);
    if (line.empty()) continue;
    std::optional<Line> parsed = parse_line(line);
    if (!parsed) {
      return Status::error(StatusCode::kCorrupt,
                           "%s:%zu: not \"DATE/DATE_drive_NNNN_sync FRAME l|r\": mend the line",
                           file.c_str(), line_number);
    }
    const auto [drive, added] = known.emplace(parsed->drive, opened.drives.size());
    if (added) opened.drives.push_back({parsed->date, parsed->drive, {}});
    parsed->frame.drive = drive->second;
    opened.frames.push_back(parsed->frame);
  }
  if (!opened.frames.empty()) return Status::ok();
  return Status::error(StatusCode::kCorrupt, "%s: lists no frame", file.c_str());
}

Status need_folder(const std::string& folder, const char* what) {
  std::error_code error;
  if (fs::is_directory(folder, error)) return Status::ok();
  return Status::error(StatusCode::kNotFound, "\"%s\" is no folder: name that of %s",
                       folder.c_str(), what);
}

// Looks which pictures of the listed cameras exist. Returns how many listed ones do not.
std::size_t find_listed(const fs::path& root, Opened& opened) {
  std::set<std::pair<std::size_t, std::size_t>> looked;
  std::size_t missing = 0;
  for (const Listed& frame : opened.frames) {
    Drive& drive = opened.drives[frame.drive];
    auto& pictures = drive.pictures[frame.side];
    if (looked.emplace(frame.drive, frame.side).second) {
      pictures = find_pictures(root / drive.date / drive.name / kFolders[frame.side] / "data");
    }
    if (!pictures.contains(frame.number)) ++missing;
  }
  return missing;
}

// ---- Frames -------------------------------------------------------------------------------------

class KittiRawFrames final : public Frames {
 public:
  KittiRawFrames(KittiRawOptions options, Opened opened)
      : options_(std::move(options)), opened_(std::move(opened)) {}

  std::size_t size() const override { return opened_.frames.size(); }

  std::string name(std::size_t index) const override {
    const Listed& frame = opened_.frames[index];
    return drive_of(frame).name + "/" + kFolders[frame.side] + "/" + numbered(frame.number, "");
  }

  Result<PackFrame> read(std::size_t index) const override {
    return guarded(name(index), [&]() -> Result<PackFrame> {
      const Listed& frame = opened_.frames[index];
      const Result<cv::Mat> rgb = picture(frame, frame.number);
      if (!rgb) return rgb.status();
      const Result<cv::Mat> depth = depth_of(frame, rgb->size());
      if (!depth) return depth.status();
      const CameraModel& full = camera_of(frame).model;
      const bool is_full = rgb->cols == full.width;
      return PackFrame{name(index), *rgb, *depth,
                       is_full ? full : full.resized(rgb->cols, rgb->rows)};
    });
  }

  bool has_neighbours(std::size_t index) const override {
    const Listed& frame = opened_.frames[index];
    const auto& pictures = drive_of(frame).pictures[frame.side];
    return pictures.contains(frame.number - 1) && pictures.contains(frame.number + 1);
  }

  Result<cv::Mat> neighbour(std::size_t index, int offset) const override {
    return guarded(name(index), [&] {
      const Listed& frame = opened_.frames[index];
      return picture(frame, frame.number + offset);
    });
  }

 private:
  const Drive& drive_of(const Listed& frame) const { return opened_.drives[frame.drive]; }
  const Camera& camera_of(const Listed& frame) const {
    return opened_.cameras.at(drive_of(frame).date)[frame.side];
  }
  fs::path folder_of(const Drive& drive) const {
    return fs::path(options_.root) / drive.date / drive.name;
  }

  // Picture `number` of the frame's drive and camera, reduced.
  Result<cv::Mat> picture(const Listed& frame, std::int64_t number) const;
  // Of the frame at `size`.
  Result<cv::Mat> depth_of(const Listed& frame, cv::Size size) const;
  Result<cv::Mat> improved_of(const Listed& frame, cv::Size size) const;

  KittiRawOptions options_;
  Opened opened_;
};

Result<cv::Mat> KittiRawFrames::picture(const Listed& frame, std::int64_t number) const {
  const Drive& drive = drive_of(frame);
  const fs::path folder = folder_of(drive) / kFolders[frame.side] / "data";
  const auto found = drive.pictures[frame.side].find(number);
  if (found == drive.pictures[frame.side].end()) {
    return Status::error(StatusCode::kNotFound, "%s: no picture %s.png or .jpg", folder.c_str(),
                         numbered(number, "").c_str());
  }
  const fs::path file = folder / numbered(number, found->second ? ".jpg" : ".png");
  const Result<cv::Mat> rgb = dataset::read_rgb(file);
  if (!rgb) return rgb.status();
  const CameraModel& camera = camera_of(frame).model;
  if (rgb->size() != cv::Size(camera.width, camera.height)) {
    return Status::error(StatusCode::kCorrupt,
                         "%s: %dx%d pixels where its calibration says %dx%d: use the pictures as "
                         "published",
                         file.c_str(), rgb->cols, rgb->rows, camera.width, camera.height);
  }
  return dataset::reduced(*rgb, options_.max_width);
}

Result<cv::Mat> KittiRawFrames::depth_of(const Listed& frame, cv::Size size) const {
  const Drive& drive = drive_of(frame);
  switch (options_.depth) {
    case Depth::kNone:
      break;
    case Depth::kVelodyne: {
      const Result<cv::Mat> full =
          read_sweep(folder_of(drive) / "velodyne_points" / "data" / numbered(frame.number, ".bin"),
                     camera_of(frame), options_.scanner_depth);
      if (!full) return full.status();
      return dataset::reduce_sparse(*full, size);
    }
    case Depth::kImproved:
      return improved_of(frame, size);
    case Depth::kMaps: {
      const Result<cv::Mat> map =
          dataset::read_depth(fs::path(options_.depth_root) / drive.name / kFolders[frame.side] /
                                  numbered(frame.number, ".png"),
                              kDepthUnit);
      if (!map) return map.status();
      return resize_inverse(*map, size);
    }
  }
  return cv::Mat(cv::Mat::zeros(size, CV_32F));
}

Result<cv::Mat> KittiRawFrames::improved_of(const Listed& frame, cv::Size size) const {
  const Drive& drive = drive_of(frame);
  const fs::path root = options_.depth_root;
  const fs::path below = fs::path(drive.name) / "proj_depth" / "groundtruth" /
                         kFolders[frame.side] / numbered(frame.number, ".png");
  fs::path file = root / below;
  for (const fs::path& folder : {root / "train", root / "val"}) {
    std::error_code error;
    if (fs::is_regular_file(folder / below, error)) file = folder / below;
  }
  const Result<cv::Mat> full = dataset::read_depth(file, kDepthUnit);
  if (!full) return full.status();
  const CameraModel& camera = camera_of(frame).model;
  if (full->size() != cv::Size(camera.width, camera.height)) {
    return Status::error(StatusCode::kCorrupt, "%s: %dx%d pixels, its picture has %dx%d",
                         file.c_str(), full->cols, full->rows, camera.width, camera.height);
  }
  return dataset::reduce_sparse(*full, size);
}

Result<std::shared_ptr<const Frames>> open_checked(const KittiRawOptions& options,
                                                   std::size_t* missing) {
  LCDM_RETURN_IF_ERROR(need_folder(options.root, "KITTI's raw data"));
  if (options.depth == Depth::kImproved || options.depth == Depth::kMaps) {
    LCDM_RETURN_IF_ERROR(need_folder(options.depth_root, "the depth maps"));
  }
  if (options.max_width < 1) {
    return Status::error(StatusCode::kInvalidInput, "max_width must be 1 or more");
  }
  Opened opened;
  LCDM_RETURN_IF_ERROR(read_list(options.list, opened));
  for (const Drive& drive : opened.drives) {
    if (opened.cameras.contains(drive.date)) continue;
    const Result<Cameras> cameras =
        read_cameras(fs::path(options.root) / drive.date, options.depth == Depth::kVelodyne);
    if (!cameras) return cameras.status();
    opened.cameras[drive.date] = *cameras;
  }
  const std::size_t absent = find_listed(options.root, opened);
  if (missing != nullptr) *missing = absent;
  if (absent == opened.frames.size()) {
    return Status::error(StatusCode::kNotFound,
                         "%s: has none of the %zu pictures that %s lists: is this the raw data?",
                         options.root.c_str(), absent, options.list.c_str());
  }
  return std::shared_ptr<const Frames>(
      std::make_shared<KittiRawFrames>(options, std::move(opened)));
}

}  // namespace

Result<std::shared_ptr<const Frames>> open_kitti_raw(const KittiRawOptions& options,
                                                     std::size_t* missing) {
  return guarded(options.root, [&] { return open_checked(options, missing); });
}

}  // namespace lcdm::model
