#include "model/pack.h"

#include <algorithm>
#include <fstream>
#include <map>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <sstream>

#include "firmware/base/folder.h"
#include "firmware/nn/json.h"

namespace lcdm::model {
namespace {

namespace fs = std::filesystem;

constexpr double kValidationShare = 0.1;
constexpr std::size_t kGap = 20;
constexpr std::size_t kLeastTraining = 10;
constexpr float kMapUnit = 1.0F / 256;
constexpr std::size_t kKeptFrames = 1500;

Result<std::string> read_text(const fs::path& path) {
  std::ifstream file(path);
  if (!file) {
    return Status::error(StatusCode::kNotFound, "%s cannot be read: is the pack complete?",
                         path.c_str());
  }
  std::ostringstream text;
  text << file.rdbuf();
  return text.str();
}

std::vector<fs::path> files_of(const fs::path& folder, const std::string& extension) {
  const auto all = list_folder(folder);
  if (!all) return {};
  std::vector<fs::path> files;
  std::copy_if(all->begin(), all->end(), std::back_inserter(files),
               [&](const fs::path& file) { return file.extension() == extension; });
  return files;
}

// What intrinsics.json says that training needs.
struct Intrinsics {
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
  return Intrinsics{*parsed};
}

Result<Intrinsics> read_intrinsics(const fs::path& folder) {
  if (fs::exists(folder / "intrinsics.txt")) return read_clip_intrinsics(folder);
  const Result<std::string> text = read_text(folder / "intrinsics.json");
  if (!text) return text.status();
  const Result<JsonValue> json = parse_json(*text);
  if (!json) {
    return Status::error(StatusCode::kCorrupt, "%s/intrinsics.json: %s", folder.c_str(),
                         json.status().text());
  }
  Intrinsics out{*json};
  if (const JsonValue* unit = json->find("depth_unit_m"))
    out.depth_unit = unit->number().value_or(0);
  if (out.depth_unit <= 0) {
    return Status::error(StatusCode::kCorrupt, "%s/intrinsics.json: depth_unit_m is not positive",
                         folder.c_str());
  }
  return out;
}

// The camera of one frame: the pack's, or the frame's own where `frames` lists it.
CameraModel camera_of(const Intrinsics& intrinsics, const std::string& frame, cv::Size size,
                      float field_of_view) {
  const JsonValue* source = &intrinsics.json;
  if (const JsonValue* frames = source->find("frames")) {
    if (const JsonValue* own = frames->find(frame)) source = own;
  }
  const auto value = [&](const char* key) {
    const JsonValue* v = source->find(key);
    return v != nullptr ? static_cast<float>(v->number().value_or(0)) : 0.0F;
  };
  CameraModel camera{size.width,  size.height, value("fx"), value("fy"),
                     value("cx"), value("cy"), true};
  if (camera.fx > 0) return camera;
  return CameraModel::from_field_of_view(size.width, size.height, field_of_view);
}

// The rows of the full picture that the teacher's maps cover: all, or those of band.json.
Result<cv::Range> teacher_rows(const fs::path& folder, int height) {
  const fs::path path = folder / "band.json";
  if (!fs::exists(path)) return cv::Range(0, height);
  const Result<std::string> text = read_text(path);
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

Result<cv::Mat> read_depth(const fs::path& path, double unit) {
  const cv::Mat raw = cv::imread(path.string(), cv::IMREAD_UNCHANGED);
  if (raw.type() != CV_16UC1) {
    return Status::error(StatusCode::kCorrupt, "%s is not a 16-bit grey PNG", path.c_str());
  }
  cv::Mat depth;
  raw.convertTo(depth, CV_32F, unit);
  return depth;
}

// The depth of the full picture of `full` pixels, sampled at `size`.
Result<cv::Mat> load_depth(const fs::path& folder, const std::string& frame, const PackUse& use,
                           double unit, cv::Size full, cv::Size size) {
  if (use.teacher == Teacher::kNone) return cv::Mat(cv::Mat::zeros(size, CV_32F));
  const fs::path maps = folder / (use.teacher == Teacher::kSensor ? "depth" : use.maps);
  const Result<cv::Mat> map =
      read_depth(maps / (frame + ".png"), use.teacher == Teacher::kSensor ? unit : kMapUnit);
  if (!map) return map.status();
  cv::Mat depth;
  if (use.teacher == Teacher::kSensor) {
    cv::resize(*map, depth, size, 0, 0, cv::INTER_NEAREST);
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
    PackFrame frame;
    frame.name = name(index);
    cv::Size full;
    const Result<cv::Mat> rgb = picture(index, full);
    if (!rgb) return rgb.status();
    frame.rgb = *rgb;
    frame.camera = camera_of(intrinsics_, frame.name, full, use_.field_of_view);
    if (full != rgb->size()) frame.camera = frame.camera.resized(rgb->cols, rgb->rows);
    const Result<cv::Mat> depth =
        load_depth(folder_, frame.name, use_, intrinsics_.depth_unit, full, rgb->size());
    if (!depth) return depth.status();
    frame.depth = *depth;
    return frame;
  }

  bool has_neighbours(std::size_t index) const override {
    return use_.video && amid_a_sequence(*this, index);
  }

  Result<cv::Mat> neighbour(std::size_t index, int offset) const override {
    cv::Size full;
    return picture(index + static_cast<std::size_t>(offset), full);
  }

 private:
  // RGB, reduced; `full` becomes its size on disk.
  Result<cv::Mat> picture(std::size_t index, cv::Size& full) const {
    const fs::path& path = pictures_[index];
    const cv::Mat bgr = cv::imread(path.string(), cv::IMREAD_COLOR);
    if (bgr.empty()) {
      return Status::error(StatusCode::kCorrupt, "%s is not a picture", path.c_str());
    }
    full = bgr.size();
    cv::Mat rgb;
    cv::cvtColor(bgr, rgb, cv::COLOR_BGR2RGB);
    if (rgb.cols <= max_width_) return rgb;
    const int height = cvRound(static_cast<double>(rgb.rows) * max_width_ / rgb.cols);
    cv::Mat reduced;
    cv::resize(rgb, reduced, {max_width_, height}, 0, 0, cv::INTER_AREA);
    return reduced;
  }

  fs::path folder_;
  std::vector<fs::path> pictures_;
  PackUse use_;
  Intrinsics intrinsics_;
  int max_width_;
};

Result<std::shared_ptr<const Frames>> keep_in_memory(const Frames& frames, bool video) {
  std::vector<PackFrame> kept;
  for (std::size_t i = 0; i < frames.size(); ++i) {
    Result<PackFrame> frame = frames.read(i);
    if (!frame) return frame.status();
    kept.push_back(std::move(*frame));
  }
  return std::shared_ptr<const Frames>(std::make_shared<MemoryFrames>(std::move(kept), video));
}

std::vector<fs::path> pictures_of(const fs::path& folder, std::size_t every) {
  std::vector<fs::path> all;
  for (const fs::path& place : {folder / "rgb", folder}) {  // the second: a clip
    for (const char* extension : {".jpg", ".png"}) {
      if (all.empty()) all = files_of(place, extension);
    }
  }
  std::vector<fs::path> kept;
  for (std::size_t i = 0; i < all.size(); i += every) kept.push_back(all[i]);
  return kept;
}

}  // namespace

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
  std::vector<fs::path> pictures = pictures_of(folder, every);
  if (pictures.empty()) {
    return Status::error(StatusCode::kNotFound, "%s/rgb holds no .jpg or .png: is this a pack?",
                         folder.c_str());
  }
  const Result<Intrinsics> intrinsics = read_intrinsics(folder);
  if (!intrinsics) return intrinsics.status();
  Pack pack;
  pack.use = use;
  pack.folder = folder;
  pack.frames =
      std::make_shared<FolderFrames>(folder, std::move(pictures), use, *intrinsics, max_width);
  if (pack.frames->size() <= kKeptFrames) {
    auto kept = keep_in_memory(*pack.frames, use.video);
    if (!kept) return kept.status();
    pack.frames = *kept;
  }
  std::vector<std::string> names;
  for (std::size_t i = 0; i < pack.frames->size(); ++i) names.push_back(pack.frames->name(i));
  Split split = split_frames(names);
  pack.train = std::move(split.train);
  pack.validation = std::move(split.validation);
  return pack;
}

fs::path maps_beside_depth(const Pack& pack) {
  if (pack.folder.empty() || pack.use.teacher != Teacher::kSensor) return {};
  fs::path maps = pack.folder / pack.use.maps;
  return fs::is_directory(maps) ? maps : fs::path();
}

cv::Mat resize_inverse(const cv::Mat& depth, cv::Size size) {
  cv::Mat inverse = 1 / cv::max(depth, 1e-3);
  cv::Mat resized;
  cv::resize(inverse, resized, size, 0, 0, cv::INTER_LINEAR);
  cv::Mat out = 1 / resized;
  cv::Mat valid;
  cv::resize(depth, valid, size, 0, 0, cv::INTER_NEAREST);
  out.setTo(0, valid <= 0);
  return out;
}

}  // namespace lcdm::model
