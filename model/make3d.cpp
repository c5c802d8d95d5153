#include "model/make3d.h"

#include <algorithm>
#include <filesystem>
#include <opencv2/imgproc.hpp>
#include <utility>
#include <vector>

#include "model/dataset_files.h"

namespace lcdm::model {
namespace {

namespace fs = std::filesystem;
using dataset::guarded;
using dataset::MatFile;

// The focal length in pixels of a picture whose longer side has one: the authors' code gives 2400.2
// and 2407.3 px for 2272 x 1704, and names the axes now one way and now the other.
constexpr float kFocalLength = 2403.8F / 2272;
// Position3DGrid[row][column]: x, y, z and what published evaluations take for depth, metres.
constexpr int kDepthPlane = 3;

CameraModel assumed_camera(cv::Size size) {
  const float focal = kFocalLength * static_cast<float>(std::max(size.width, size.height));
  return {size.width,
          size.height,
          focal,
          focal,
          (static_cast<float>(size.width) - 1) / 2,
          (static_cast<float>(size.height) - 1) / 2,
          false};
}

class Make3dFrames final : public Frames {
 public:
  Make3dFrames(fs::path pictures, fs::path depths, std::vector<std::string> names,
               const Make3dOptions& options)
      : pictures_(std::move(pictures)),
        depths_(std::move(depths)),
        names_(std::move(names)),
        max_width_(options.max_width) {}

  std::size_t size() const override { return names_.size(); }
  std::string name(std::size_t index) const override { return names_[index]; }

  Result<PackFrame> read(std::size_t index) const override {
    return guarded(names_[index], [&]() -> Result<PackFrame> {
      const Result<cv::Mat> rgb = dataset::read_rgb(pictures_ / ("img-" + names_[index] + ".jpg"));
      if (!rgb) return rgb.status();
      const Result<cv::Mat> grid =
          read_grid(depths_ / ("depth_sph_corr-" + names_[index] + ".mat"));
      if (!grid) return grid.status();
      PackFrame frame;
      frame.name = names_[index];
      frame.rgb = dataset::reduced(*rgb, max_width_);
      cv::resize(*grid, frame.depth, frame.rgb.size(), 0, 0, cv::INTER_NEAREST_EXACT);
      frame.camera = assumed_camera(frame.rgb.size());
      keep_centre(frame);
      return frame;
    });
  }

 private:
  // The middle rows, half as many as the picture is wide.
  static void keep_centre(PackFrame& frame) {
    const int height = std::min(frame.rgb.rows, std::max(1, frame.rgb.cols / 2));
    const int top = (frame.rgb.rows - height) / 2;
    frame.rgb = frame.rgb.rowRange(top, top + height).clone();
    frame.depth = frame.depth.rowRange(top, top + height).clone();
    frame.camera.height = height;
    frame.camera.cy -= static_cast<float>(top);
  }

  static Result<cv::Mat> read_grid(const fs::path& path) {
    const auto file = MatFile::open(path);
    if (!file) return file.status();
    const auto shape = (*file)->shape("Position3DGrid");
    if (!shape) return shape.status();
    if (shape->size() != 3 || (*shape)[2] <= kDepthPlane) {
      return Status::error(StatusCode::kCorrupt,
                           "%s: Position3DGrid is not [rows][columns][4]: fetch it again",
                           path.c_str());
    }
    const Result<cv::Mat> grid = (*file)->plane("Position3DGrid", kDepthPlane);
    if (!grid) return grid.status();
    return dataset::plausible(*grid);
  }

  fs::path pictures_;
  fs::path depths_;
  std::vector<std::string> names_;
  int max_width_;
};

Result<std::shared_ptr<const Frames>> open_checked(const fs::path& root,
                                                   const Make3dOptions& options) {
  if (options.max_width < 1) {
    return Status::error(StatusCode::kInvalidInput, "max_width must be 1 or more");
  }
  const fs::path pictures = root / options.pictures;
  const fs::path depths = root / options.depths;
  std::vector<std::string> names;
  for (const std::string& file : dataset::names_in(pictures)) {
    if (!file.starts_with("img-") || !file.ends_with(".jpg") || file.size() < 9) continue;
    names.push_back(file.substr(4, file.size() - 8));
  }
  if (names.empty()) {
    return Status::error(StatusCode::kNotFound, "%s: no pictures img-*.jpg", pictures.c_str());
  }
  std::error_code error;
  const bool any = std::any_of(names.begin(), names.end(), [&](const std::string& name) {
    return fs::is_regular_file(depths / ("depth_sph_corr-" + name + ".mat"), error);
  });
  if (!any) {
    return Status::error(StatusCode::kNotFound, "%s: no depth_sph_corr-*.mat of the pictures in %s",
                         depths.c_str(), pictures.c_str());
  }
  return std::shared_ptr<const Frames>(
      std::make_shared<Make3dFrames>(pictures, depths, std::move(names), options));
}

}  // namespace

Result<std::shared_ptr<const Frames>> open_make3d(const std::string& root,
                                                  const Make3dOptions& options) {
  return guarded(root, [&] { return open_checked(root, options); });
}

}  // namespace lcdm::model
