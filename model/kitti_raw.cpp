#include "model/kitti_raw.h"

#include <algorithm>
#include <array>
#include <cstdio>
#include <filesystem>
#include <map>
#include <optional>
#include <set>
#include <string_view>
#include <utility>
#include <vector>

#include "model/dataset_files.h"
#include "model/kitti_calibration.h"
#include "model/pack.h"

namespace lcdm::model {
namespace {

namespace fs = std::filesystem;
using dataset::guarded;
using dataset::matches;
using dataset::number_of;
using dataset::split;
using Depth = KittiRawOptions::Depth;

constexpr std::size_t kMostListBytes = 64U << 20;
constexpr double kDepthUnit = 1.0 / 256;                                   // metres
constexpr std::array<const char*, 2> kFolders = {"image_02", "image_03"};  // left, right

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
  std::map<std::string, KittiCameras> cameras;  // by date
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

// Looks which pictures of the listed cameras exist. Returns how many listed ones do.
std::size_t find_listed(const fs::path& root, Opened& opened) {
  std::set<std::pair<std::size_t, std::size_t>> looked;
  std::size_t found = 0;
  for (const Listed& frame : opened.frames) {
    Drive& drive = opened.drives[frame.drive];
    auto& pictures = drive.pictures[frame.side];
    if (looked.emplace(frame.drive, frame.side).second) {
      pictures = find_pictures(root / drive.date / drive.name / kFolders[frame.side] / "data");
    }
    if (pictures.contains(frame.number)) ++found;
  }
  return found;
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
      return PackFrame{name(index), *rgb, *depth,
                       camera_of(frame).model.resized(rgb->cols, rgb->rows)};
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
  const KittiCamera& camera_of(const Listed& frame) const {
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
      const Result<cv::Mat> full = read_kitti_sweep(
          folder_of(drive) / "velodyne_points" / "data" / numbered(frame.number, ".bin"),
          camera_of(frame));
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

Result<std::shared_ptr<const Frames>> open_checked(const KittiRawOptions& options) {
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
    const Result<KittiCameras> cameras =
        read_kitti_cameras(fs::path(options.root) / drive.date, options.depth == Depth::kVelodyne);
    if (!cameras) return cameras.status();
    opened.cameras[drive.date] = *cameras;
  }
  if (find_listed(options.root, opened) == 0) {
    return Status::error(StatusCode::kNotFound,
                         "%s: has none of the %zu pictures that %s lists: is this the raw data?",
                         options.root.c_str(), opened.frames.size(), options.list.c_str());
  }
  return std::shared_ptr<const Frames>(
      std::make_shared<KittiRawFrames>(options, std::move(opened)));
}

}  // namespace

Result<std::shared_ptr<const Frames>> open_kitti_raw(const KittiRawOptions& options) {
  return guarded(options.root, [&] { return open_checked(options); });
}

}  // namespace lcdm::model
