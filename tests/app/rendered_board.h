// Pictures of a checkerboard through a lens, rendered ray by ray with OpenCV's own lens model.
#pragma once

#include <cmath>
#include <opencv2/calib3d.hpp>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <vector>

namespace lcdm::test {

struct TrueCamera {
  int width = 320;
  int height = 240;
  cv::Matx33d matrix{262, 0, 163, 0, 264, 117, 0, 0, 1};
  cv::Vec<double, 5> lens{-0.24, 0.06, 0.001, -0.001, 0};
};

// Where the board stands: turned by `turn` (Rodrigues, radians) around its middle, which is `place`
// squares from the camera.
struct Pose {
  cv::Vec3d turn;
  cv::Vec3d place;
};

class BoardRenderer {
 public:
  static constexpr int kSamples = 3;  // along each side of a pixel

  explicit BoardRenderer(const TrueCamera& camera) : camera_(camera) {
    std::vector<cv::Point2d> pixels;
    for (int y = 0; y < camera.height * kSamples; ++y) {
      for (int x = 0; x < camera.width * kSamples; ++x) {
        pixels.emplace_back((x + 0.5) / kSamples - 0.5, (y + 0.5) / kSamples - 0.5);
      }
    }
    const cv::TermCriteria exactly(cv::TermCriteria::COUNT | cv::TermCriteria::EPS, 20, 1e-9);
    cv::undistortPoints(pixels, rays_, camera.matrix, camera.lens, cv::noArray(), cv::noArray(),
                        exactly);
  }

  // A board of columns x rows inner corners, a white margin around it, grey beyond. 8-bit BGR.
  cv::Mat render(int columns, int rows, const Pose& pose) const {
    cv::Matx33d rotation;
    cv::Rodrigues(pose.turn, rotation);
    const cv::Vec3d normal(rotation(0, 2), rotation(1, 2), rotation(2, 2));
    cv::Mat fine(camera_.height * kSamples, camera_.width * kSamples, CV_32F);
    for (int i = 0; i < static_cast<int>(rays_.size()); ++i) {
      const cv::Point2d& seen = rays_[static_cast<std::size_t>(i)];
      const cv::Vec3d ray(seen.x, seen.y, 1);
      const double way = normal.dot(pose.place) / normal.dot(ray);
      const cv::Vec3d at = rotation.t() * (ray * way - pose.place);
      fine.at<float>(i / fine.cols, i % fine.cols) =
          shade(at[0] + (columns + 1) / 2.0, at[1] + (rows + 1) / 2.0, columns + 1, rows + 1);
    }
    cv::Mat grey;
    cv::resize(fine, grey, {camera_.width, camera_.height}, 0, 0, cv::INTER_AREA);
    grey.convertTo(grey, CV_8U);
    cv::Mat bgr;
    cv::cvtColor(grey, bgr, cv::COLOR_GRAY2BGR);
    return bgr;
  }

 private:
  static float shade(double x, double y, int squares_x, int squares_y) {
    if (x < -1 || y < -1 || x > squares_x + 1 || y > squares_y + 1) return 110;
    if (x < 0 || y < 0 || x > squares_x || y > squares_y) return 225;
    return (static_cast<int>(x) + static_cast<int>(y)) % 2 == 0 ? 30 : 225;
  }

  TrueCamera camera_;
  std::vector<cv::Point2d> rays_;
};

// All over the picture and tilted to every side: what a calibration needs.
inline std::vector<Pose> good_poses() {
  std::vector<Pose> poses;
  for (int i = 0; i < 15; ++i) {
    const double x = (i % 3 - 1) * 3.3;
    const double y = (i / 3 % 3 - 1) * 2.6;
    const double tilt_x = 0.55 * std::sin(i * 2.4);
    const double tilt_y = 0.55 * std::cos(i * 2.4);
    poses.push_back({{tilt_x, tilt_y, 0.1 * (i % 3)}, {x, y, 12.5 + i % 4}});
  }
  return poses;
}

}  // namespace lcdm::test
