#include "model/pack.h"

#include <algorithm>
#include <cmath>
#include <fstream>
#include <map>
#include <opencv2/imgproc.hpp>

#include "drivers/replay/files.h"
#include "firmware/base/folder.h"
#include "firmware/nn/json.h"
#include "model/dataset_files.h"

namespace lcdm::model {
namespace {

namespace fs = std::filesystem;

constexpr double kValidationShare = 0.1;
constexpr std::size_t kGap = 20;
constexpr std::size_t kLeastTraining = 10;
constexpr float kMapUnit = 1.0F / 256;
constexpr std::size_t kKeptFrames = 1500;
constexpr std::size_t kMostJsonBytes = 16U << 20;

// The pictures of a folder; kInvalidInput: two of one name.
Result<std::vector<fs::path>> pictures_in(const fs::path& folder) {
  std::vector<fs::path> files;
  const auto all = list_folder(folder);
  if (!all) return files;
  std::copy_if(all->begin(), all->end(), std::back_inserter(files), [&](const fs::path& file) {
    return file.extension() == ".jpg" || file.extension() == ".png";
  });
  std::map<std::string, fs::path> of_name;
  for (const fs::path& file : files) {
    const auto [other, is_new] = of_name.emplace(file.stem().string(), file);
    if (is_new) continue;
    return Status::error(StatusCode::kInvalidInput,
                         "%s and %s would be one frame: take one of them away",
                         other->second.c_str(), file.filename().c_str());
  }
  return files;
}

// In their order in time: "frame2" before "frame10". Of a pack, or else of a clip.
Result<std::vector<fs::path>> pictures_of(const fs::path& folder) {
  Result<std::vector<fs::path>> pictures = pictures_in(folder / "rgb");
  if (pictures && pictures->empty()) pictures = pictures_in(folder);
  if (!pictures) return pictures.status();
  std::sort(pictures->begin(), pictures->end(), [](const fs::path& a, const fs::path& b) {
    return replay::natural_less(a.filename().string(), b.filename().string());
  });
  return pictures;
}

// What intrinsics.json says that training needs.
struct Intrinsics {
  fs::path file;
  JsonValue json;
  double depth_unit = 0.001;
};

// A clip's intrinsics.txt: fx fy cx cy.
Result<Intrinsics> read_clip_intrinsics(const fs::path& folder) {
  std::ifstream file(folder / "intrinsics.txt");
  double fx = 0;
  double fy = 0;
  double cx = 0;
  double cy = 0;
  if (!(file >> fx >> fy >> cx >> cy) || fx <= 0 || fy <= 0) {
    return Status::error(StatusCode::kCorrupt, "%s/intrinsics.txt does not hold fx fy cx cy",
                         folder.c_str());
  }
  const std::string json = "{\"fx\":" + std::to_string(fx) + ",\"fy\":" + std::to_string(fy) +
                           ",\"cx\":" + std::to_string(cx) + ",\"cy\":" + std::to_string(cy) + "}";
  const Result<JsonValue> parsed = parse_json(json);
  if (!parsed) return parsed.status();
  return Intrinsics{folder / "intrinsics.txt", *parsed};
}

Result<Intrinsics> read_intrinsics(const fs::path& folder) {
  if (fs::exists(folder / "intrinsics.txt")) return read_clip_intrinsics(folder);
  const fs::path file = folder / "intrinsics.json";
  const Result<std::string> text = dataset::read_bytes(file, kMostJsonBytes);
  if (!text) return text.status();
  const Result<JsonValue> json = parse_json(*text);
  if (!json) {
    return Status::error(StatusCode::kCorrupt, "%s: %s", file.c_str(), json.status().text());
  }
  Intrinsics out{file, *json};
  if (const JsonValue* unit = json->find("depth_unit_m"))
    out.depth_unit = unit->number().value_or(0);
  if (out.depth_unit <= 0) {
    return Status::error(StatusCode::kCorrupt, "%s: depth_unit_m is not positive", file.c_str());
  }
  return out;
}

// Where nothing is known of the camera but what the catalogue assumes.
Result<CameraModel> assumed_camera(const fs::path& file, cv::Size size, float field_of_view) {
  if (field_of_view > 0 && field_of_view < 180) {
    return CameraModel::from_field_of_view(size.width, size.height, field_of_view);
  }
  return Status::error(StatusCode::kInvalidInput,
                       "%s gives no fx, without which depth has no scale: write the focal length "
                       "there in pixels, or field-of-view (degrees, horizontal, below 180) into "
                       "the pack's entry of a catalogue (--data)",
                       file.c_str());
}

// A number of `source`: `otherwise` where it has none, NaN where it is something else.
float number_in(const JsonValue& source, const char* key, float otherwise) {
  const JsonValue* value = source.find(key);
  return value == nullptr ? otherwise : static_cast<float>(value->number().value_or(NAN));
}

// A view from some 1 to 160 degrees wide whose axis is in the picture, or near it as a cut leaves
// it: not focal lengths in millimetres, nor a camera's of other pictures.
bool plausible(const CameraModel& camera) {
  const auto width = static_cast<float>(camera.width);
  const auto focal = [&](float f) { return f >= width / 10 && f <= width * 50; };
  const auto axis = [](float at, int side) {
    return at > 0 && at < 1.5F * static_cast<float>(side);
  };
  return focal(camera.fx) && focal(camera.fy) && axis(camera.cx, camera.width) &&
         axis(camera.cy, camera.height);
}

// The camera that `source` describes for pictures of the size it names, at `size`.
Result<CameraModel> described_camera(const fs::path& file, const JsonValue& source, cv::Size size) {
  const float width = number_in(source, "width", static_cast<float>(size.width));
  const float height = number_in(source, "height", static_cast<float>(size.height));
  const float scale = static_cast<float>(size.width) / width;
  if (!(width >= 1 && std::abs(height * scale - static_cast<float>(size.height)) <= 1)) {
    return Status::error(StatusCode::kCorrupt,
                         "%s: is for pictures of %gx%g pixels, and these have %dx%d, another "
                         "shape: write what holds for these",
                         file.c_str(), width, height, size.width, size.height);
  }
  const float fx = number_in(source, "fx", NAN);
  const CameraModel camera{static_cast<int>(width),
                           static_cast<int>(height),
                           fx,
                           number_in(source, "fy", fx),
                           number_in(source, "cx", (width - 1) / 2),
                           number_in(source, "cy", (height - 1) / 2),
                           true};
  if (!plausible(camera)) {
    return Status::error(StatusCode::kCorrupt,
                         "%s: fx %g, fy %g, cx %g, cy %g are no camera's of %gx%g pixels: all four "
                         "are in pixels, fx and fy from a tenth of the width to fifty times it, cx "
                         "and cy in the picture or near it",
                         file.c_str(), camera.fx, camera.fy, camera.cx, camera.cy, width, height);
  }
  return camera.resized(size.width, size.height);
}

// The camera of one frame: the pack's, or the frame's own where `frames` lists it.
Result<CameraModel> camera_of(const Intrinsics& intrinsics, const std::string& frame, cv::Size size,
                              float field_of_view) {
  const JsonValue* source = &intrinsics.json;
  if (const JsonValue* frames = source->find("frames")) {
    if (const JsonValue* own = frames->find(frame)) source = own;
  }
  if (source->find("fx") != nullptr) return described_camera(intrinsics.file, *source, size);
  return assumed_camera(intrinsics.file, size, field_of_view);
}

// The rows of the full picture that the teacher's maps cover: all, or those of band.json.
Result<cv::Range> teacher_rows(const fs::path& folder, int height) {
  const fs::path path = folder / "band.json";
  if (!fs::exists(path)) return cv::Range(0, height);
  const Result<std::string> text = dataset::read_bytes(path, kMostJsonBytes);
  if (!text) return text.status();
  const Result<JsonValue> json = parse_json(*text);
  const JsonValue* rows = json ? json->find("rows") : nullptr;
  if (rows == nullptr || rows->items().size() != 2) {
    return Status::error(StatusCode::kCorrupt, "%s: no \"rows\": [first, end]", path.c_str());
  }
  const cv::Range range(static_cast<int>(rows->items()[0].number().value_or(-1)),
                        static_cast<int>(rows->items()[1].number().value_or(-1)));
  if (range.start < 0 || range.start >= range.end || range.end > height) {
    return Status::error(StatusCode::kCorrupt, "%s: rows are outside the picture", path.c_str());
  }
  return range;
}

// Depth of another shape was not registered to its picture: stretched over it, all of it would be
// in the wrong place. Smaller by a factor it may be, to the pixel.
Status check_shape(const fs::path& file, cv::Size depth, cv::Size picture) {
  const double height = static_cast<double>(picture.height) * depth.width / picture.width;
  if (std::abs(height - depth.height) <= 1) return Status::ok();
  return Status::error(StatusCode::kCorrupt,
                       "%s: depth of %dx%d pixels is not registered to a picture of %dx%d: give "
                       "depth as the camera of the picture sees it",
                       file.c_str(), depth.width, depth.height, picture.width, picture.height);
}

// The depth of the full picture of `full` pixels, sampled at `size`.
Result<cv::Mat> load_depth(const fs::path& folder, const std::string& frame, const PackUse& use,
                           double unit, cv::Size full, cv::Size size) {
  if (use.teacher == Teacher::kNone) return cv::Mat(cv::Mat::zeros(size, CV_32F));
  const fs::path maps = folder / (use.teacher == Teacher::kSensor ? "depth" : use.maps);
  const Result<cv::Mat> map = dataset::read_depth(
      maps / (frame + ".png"), use.teacher == Teacher::kSensor ? unit : kMapUnit);
  if (!map) return map.status();
  cv::Mat depth;
  if (use.teacher == Teacher::kSensor) {
    LCDM_RETURN_IF_ERROR(check_shape(maps / (frame + ".png"), map->size(), full));
    cv::resize(*map, depth, size, 0, 0, cv::INTER_NEAREST_EXACT);
    return depth;
  }
  const Result<cv::Range> rows = teacher_rows(maps, full.height);
  if (!rows) return rows.status();
  const double scale = static_cast<double>(size.height) / full.height;
  const cv::Range scaled(cvRound(rows->start * scale), cvRound(rows->end * scale));
  depth = cv::Mat::zeros(size, CV_32F);
  resize_inverse(*map, {size.width, scaled.size()}).copyTo(depth.rowRange(scaled));
  return depth;
}

// The frames of a pack's folder.
class FolderFrames final : public Frames {
 public:
  FolderFrames(fs::path folder, std::vector<fs::path> pictures, PackUse use, Intrinsics intrinsics,
               int max_width)
      : folder_(std::move(folder)),
        pictures_(std::move(pictures)),
        use_(std::move(use)),
        intrinsics_(std::move(intrinsics)),
        max_width_(max_width) {}

  std::size_t size() const override { return pictures_.size(); }
  std::string name(std::size_t index) const override { return pictures_[index].stem().string(); }

  Result<PackFrame> read(std::size_t index) const override {
    return dataset::guarded(name(index), [&] { return read_files(index); });
  }

  bool has_neighbours(std::size_t index) const override {
    return use_.video && amid_a_sequence(*this, index);
  }

  Result<cv::Mat> neighbour(std::size_t index, int offset) const override {
    const std::size_t at = index + static_cast<std::size_t>(offset);
    return dataset::guarded(name(at), [&]() -> Result<cv::Mat> {
      const Result<cv::Mat> rgb = dataset::read_rgb(pictures_[at]);
      if (!rgb) return rgb.status();
      return dataset::reduced(*rgb, max_width_);
    });
  }

 private:
  Result<PackFrame> read_files(std::size_t index) const {
    const Result<cv::Mat> full = dataset::read_rgb(pictures_[index]);
    if (!full) return full.status();
    PackFrame frame;
    frame.name = name(index);
    frame.rgb = dataset::reduced(*full, max_width_);
    const Result<CameraModel> camera =
        camera_of(intrinsics_, frame.name, full->size(), use_.field_of_view);
    if (!camera) return camera.status();
    frame.camera = camera->resized(frame.rgb.cols, frame.rgb.rows);
    const Result<cv::Mat> depth = load_depth(folder_, frame.name, use_, intrinsics_.depth_unit,
                                             full->size(), frame.rgb.size());
    if (!depth) return depth.status();
    frame.depth = *depth;
    return frame;
  }

  fs::path folder_;
  std::vector<fs::path> pictures_;
  PackUse use_;
  Intrinsics intrinsics_;
  int max_width_;
};

// The first error where none of the first frames can be read: then it is not a picture that is
// broken, but the pack.
Status check_first(const Frames& frames) {
  constexpr std::size_t kTried = 8;
  Status first;
  for (std::size_t i = 0; i < std::min(kTried, frames.size()); ++i) {
    const Result<PackFrame> frame = frames.read(i);
    if (frame) return Status::ok();
    if (first) first = frame.status();
  }
  return first;
}

std::shared_ptr<const Frames> keep_in_memory(const Frames& frames, bool video) {
  std::vector<PackFrame> kept;
  std::map<std::size_t, Status> unreadable;
  for (std::size_t i = 0; i < frames.size(); ++i) {
    Result<PackFrame> frame = frames.read(i);
    if (!frame) unreadable[i] = frame.status();
    kept.push_back(frame ? std::move(*frame) : PackFrame{frames.name(i), {}, {}, {}});
  }
  return std::make_shared<MemoryFrames>(std::move(kept), video, std::move(unreadable));
}

// Of the parts of all frames those that are kept, as indices of what is kept: what is left out does
// not move a frame from one part to the other.
std::vector<std::size_t> every_nth(const std::vector<std::size_t>& part, std::size_t every) {
  std::vector<std::size_t> kept;
  for (const std::size_t index : part) {
    if (index % every == 0) kept.push_back(index / every);
  }
  return kept;
}

}  // namespace

const std::map<std::string, Alignment>& alignment_names() {
  static const std::map<std::string, Alignment> names = {
      {"none", Alignment::kNone}, {"scale", Alignment::kScale}, {"affine", Alignment::kAffine}};
  return names;
}

Split split_frames(const std::vector<std::string>& names) {
  std::map<std::string, std::vector<std::size_t>> sequences;
  for (std::size_t i = 0; i < names.size(); ++i) {
    sequences[sequence_of(names[i])].push_back(i);
  }
  Split split;
  for (const auto& [name, frames] : sequences) {
    const auto tail =
        static_cast<std::size_t>(std::ceil(static_cast<double>(frames.size()) * kValidationShare));
    const bool too_short = frames.size() < tail + kGap + kLeastTraining;
    const std::size_t train = too_short ? frames.size() : frames.size() - tail - kGap;
    split.train.insert(split.train.end(), frames.begin(),
                       frames.begin() + static_cast<std::ptrdiff_t>(train));
    if (too_short) continue;
    split.validation.insert(split.validation.end(),
                            frames.end() - static_cast<std::ptrdiff_t>(tail), frames.end());
  }
  return split;
}

Result<Pack> load_pack(const fs::path& root, const PackUse& use, int max_width, std::size_t every) {
  const fs::path folder = root / use.name;
  const Result<std::vector<fs::path>> all = pictures_of(folder);
  if (!all) return all.status();
  if (all->empty()) {
    return Status::error(StatusCode::kNotFound, "%s/rgb holds no .jpg or .png: is this a pack?",
                         folder.c_str());
  }
  std::vector<std::string> names;
  std::vector<fs::path> pictures;
  for (const fs::path& picture : *all) {
    if (names.size() % every == 0) pictures.push_back(picture);
    names.push_back(picture.stem().string());
  }
  const Result<Intrinsics> intrinsics = read_intrinsics(folder);
  if (!intrinsics) return intrinsics.status();
  Pack pack;
  pack.use = use;
  pack.folder = folder;
  pack.frames =
      std::make_shared<FolderFrames>(folder, std::move(pictures), use, *intrinsics, max_width);
  LCDM_RETURN_IF_ERROR(check_first(*pack.frames));
  // At full size they are measured or taught on, each once: 1,500 could be 20 GB.
  if (max_width < kFullWidth && pack.frames->size() <= kKeptFrames) {
    pack.frames = keep_in_memory(*pack.frames, use.video);
  }
  const Split split = split_frames(names);
  pack.train = every_nth(split.train, every);
  pack.validation = every_nth(split.validation, every);
  return pack;
}

fs::path maps_beside_depth(const Pack& pack) {
  if (pack.folder.empty() || pack.use.teacher != Teacher::kSensor) return {};
  fs::path maps = pack.folder / pack.use.maps;
  const bool whole = fs::is_directory(maps) && !fs::exists(maps / "band.json");
  return whole ? maps : fs::path();
}

cv::Mat resize_inverse(const cv::Mat& depth, cv::Size size) {
  const cv::Mat known = depth > 0;
  cv::Mat inverse = 1 / cv::max(depth, 1e-3);
  inverse.setTo(0, ~known);
  cv::Mat resized;
  cv::resize(inverse, resized, size, 0, 0, cv::INTER_LINEAR);
  cv::Mat share;  // of a pixel that comes from known ones
  known.convertTo(share, CV_32F, 1.0 / 255);
  cv::Mat resized_share;
  cv::resize(share, resized_share, size, 0, 0, cv::INTER_LINEAR);
  cv::Mat out = 1 / resized;
  out.setTo(0, resized_share < 0.999);
  return out;
}

}  // namespace lcdm::model
