#include "model/nyu_depth.h"

#include <array>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <opencv2/imgproc.hpp>
#include <utility>
#include <vector>

#include "model/dataset_files.h"

namespace lcdm::model {
namespace {

namespace fs = std::filesystem;
using dataset::guarded;
using dataset::matches;
using dataset::MatFile;

constexpr const char* kLabelled = "nyu_depth_v2_labeled.mat";
constexpr const char* kDepths = "rawDepths";  // the sensor's, with its holes
constexpr double kMillimetre = 0.001;
// Of the colour camera: camera_params.m of the authors' toolbox, whose pixels count from 1.
constexpr CameraModel kCamera{640, 480, 518.857901F, 519.469611F, 324.582449F, 252.736166F, true};

// A picture and its depth as PackFrame; `file` names them in errors.
Result<PackFrame> frame_of(const std::string& name, const cv::Mat& rgb, const cv::Mat& depth,
                           int max_width, const std::string& file) {
  if (rgb.cols * kCamera.height != rgb.rows * kCamera.width || depth.size() != rgb.size()) {
    return Status::error(StatusCode::kCorrupt,
                         "%s: a picture of %dx%d with depth of %dx%d: both must be alike, in 4:3",
                         file.c_str(), rgb.cols, rgb.rows, depth.cols, depth.rows);
  }
  PackFrame frame;
  frame.name = name;
  frame.rgb = dataset::reduced(rgb, max_width);
  cv::resize(dataset::plausible(depth), frame.depth, frame.rgb.size(), 0, 0,
             cv::INTER_NEAREST_EXACT);
  frame.camera = kCamera;
  if (frame.rgb.cols != kCamera.width) {
    frame.camera = kCamera.resized(frame.rgb.cols, frame.rgb.rows);
  }
  return frame;
}

// ---- The MATLAB file ----------------------------------------------------------------------------

class LabelledFrames final : public Frames {
 public:
  LabelledFrames(std::string path, std::shared_ptr<const MatFile> file, std::vector<int> numbers,
                 const NyuDepthOptions& options)
      : path_(std::move(path)),
        file_(std::move(file)),
        numbers_(std::move(numbers)),
        options_(options) {}

  std::size_t size() const override { return numbers_.size(); }

  std::string name(std::size_t index) const override {
    char text[32];
    std::snprintf(text, sizeof(text), "rgb_%05d", numbers_[index]);
    return text;
  }

  Result<PackFrame> read(std::size_t index) const override {
    const std::string what = path_ + ": " + name(index);
    return guarded(what, [&]() -> Result<PackFrame> {
      std::array<cv::Mat, 3> colours;
      for (int i = 0; i < 3; ++i) {
        const Result<cv::Mat> plane = file_->plane("images", i, numbers_[index]);
        if (!plane) return plane.status();
        colours[static_cast<std::size_t>(i)] = *plane;
      }
      cv::Mat rgb;
      cv::merge(colours, rgb);
      const Result<cv::Mat> depth = file_->plane(kDepths, numbers_[index]);
      if (!depth) return depth.status();
      return frame_of(name(index), rgb, *depth, options_.max_width, what);
    });
  }

 private:
  std::string path_;
  std::shared_ptr<const MatFile> file_;
  std::vector<int> numbers_;  // counted from 0
  NyuDepthOptions options_;
};

// The frames of a split, counted from 0 (splits.mat counts from 1).
Result<std::vector<int>> read_split(const fs::path& path, NyuDepthOptions::Split split, int count) {
  const auto file = MatFile::open(path);
  if (!file) return file.status();
  const bool test = split == NyuDepthOptions::Split::kTest;
  const Result<cv::Mat> plane = (*file)->plane(test ? "testNdxs" : "trainNdxs");
  if (!plane) return plane.status();
  cv::Mat numbers;
  plane->reshape(1, 1).convertTo(numbers, CV_64F);
  std::vector<int> frames;
  for (int i = 0; i < numbers.cols; ++i) {
    const double number = numbers.at<double>(i);
    if (!(number >= 1 && number <= count && std::floor(number) == number)) {
      return Status::error(StatusCode::kCorrupt,
                           "%s: frame %g of %d does not exist: use the splits.mat of this data set",
                           path.c_str(), number, count);
    }
    frames.push_back(static_cast<int>(number) - 1);
  }
  return frames;
}

Result<std::shared_ptr<const Frames>> open_labelled(const fs::path& root,
                                                    const NyuDepthOptions& options) {
  const fs::path path = root / kLabelled;
  const auto file = MatFile::open(path);
  if (!file) return file.status();
  const auto images = (*file)->shape("images");  // height, width, colour, frame
  if (!images) return images.status();
  const auto depths = (*file)->shape(kDepths);  // height, width, frame
  if (!depths) return depths.status();
  const Result<cv::Mat> first = (*file)->plane("images");
  if (!first) return first.status();
  const std::vector<int>& shape = *images;
  if (shape.size() != 4 || shape[2] != 3 || first->type() != CV_8U ||
      *depths != std::vector<int>{shape[0], shape[1], shape[3]}) {
    return Status::error(StatusCode::kCorrupt,
                         "%s: \"images\" and \"%s\" are not bytes [height][width][3][count] and "
                         "metres [height][width][count]",
                         path.c_str(), kDepths);
  }
  auto numbers = read_split(root / "splits.mat", options.split, shape[3]);
  if (!numbers) return numbers.status();
  return std::shared_ptr<const Frames>(
      std::make_shared<LabelledFrames>(path.string(), *file, std::move(*numbers), options));
}

// ---- The folders --------------------------------------------------------------------------------

class FolderFrames final : public Frames {
 public:
  FolderFrames(fs::path folder, std::vector<std::string> names, int max_width)
      : folder_(std::move(folder)), names_(std::move(names)), max_width_(max_width) {}

  std::size_t size() const override { return names_.size(); }
  std::string name(std::size_t index) const override { return names_[index]; }

  Result<PackFrame> read(std::size_t index) const override {
    const fs::path picture = folder_ / (names_[index] + ".jpg");
    return guarded(picture.string(), [&]() -> Result<PackFrame> {
      const Result<cv::Mat> rgb = dataset::read_rgb(picture);
      if (!rgb) return rgb.status();
      const std::string number = picture.stem().string().substr(4);
      const fs::path file = picture.parent_path() / ("sync_depth_" + number + ".png");
      const Result<cv::Mat> depth = dataset::read_depth(file, kMillimetre);
      if (!depth) return depth.status();
      return frame_of(names_[index], *rgb, *depth, max_width_, picture.string());
    });
  }

 private:
  fs::path folder_;
  std::vector<std::string> names_;  // SCENE/rgb_NNNNN
  int max_width_;
};

Result<std::shared_ptr<const Frames>> open_folders(const fs::path& folder,
                                                   const NyuDepthOptions& options) {
  std::vector<std::string> names;
  for (const std::string& scene : dataset::names_in(folder)) {
    for (const std::string& file : dataset::names_in(folder / scene)) {
      if (matches(file, "rgb_#####.jpg")) names.push_back(scene + "/" + file.substr(0, 9));
    }
  }
  if (names.empty()) {
    return Status::error(StatusCode::kNotFound, "%s: no pictures SCENE/rgb_NNNNN.jpg",
                         folder.c_str());
  }
  return std::shared_ptr<const Frames>(
      std::make_shared<FolderFrames>(folder, std::move(names), options.max_width));
}

Result<std::shared_ptr<const Frames>> open_any(const fs::path& root,
                                               const NyuDepthOptions& options) {
  if (options.max_width < 1) {
    return Status::error(StatusCode::kInvalidInput, "max_width must be 1 or more");
  }
  std::error_code error;
  if (fs::exists(root / kLabelled, error)) return open_labelled(root, options);
  const char* split = options.split == NyuDepthOptions::Split::kTest ? "test" : "train";
  for (const fs::path& folder : {root / "official_splits" / split, root / split}) {
    if (fs::is_directory(folder, error)) return open_folders(folder, options);
  }
  return Status::error(StatusCode::kNotFound, "%s: neither %s nor official_splits/%s is in it",
                       root.c_str(), kLabelled, split);
}

}  // namespace

Result<std::shared_ptr<const Frames>> open_nyu_depth(const std::string& root,
                                                     const NyuDepthOptions& options) {
  return guarded(root, [&] { return open_any(root, options); });
}

}  // namespace lcdm::model
