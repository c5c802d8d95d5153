// Distortion and its removal, held to OpenCV's calib3d.
#include "firmware/vision/lens_map.h"

#include <cmath>
#include <gtest/gtest.h>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>

#include "firmware/vision/preprocess.h"
#include "tests/firmware/isa.h"

namespace lcdm {
namespace {

CameraModel make_camera(const std::array<float, 8>& distortion) {
  CameraModel camera;
  camera.width = 320;
  camera.height = 240;
  camera.fx = 260;
  camera.fy = 264;
  camera.cx = 163.2F;
  camera.cy = 116.7F;
  camera.calibrated = true;
  camera.distortion = distortion;
  return camera;
}

// A wide lens, one drawn slightly the other way, tilted, and a rational model.
const CameraModel kCameras[] = {make_camera({-0.28F, 0.09F, 0.001F, -0.002F, -0.01F}),
                                make_camera({0.15F, -0.05F, 0, 0, 0}),
                                make_camera({-0.1F, 0.01F, 0.008F, 0.006F, 0}),
                                make_camera({0.3F, 0.05F, 0, 0, 0, 0.6F, 0.1F, 0.01F})};

cv::Matx33d matrix_of(const CameraModel& m) { return {m.fx, 0, m.cx, 0, m.fy, m.cy, 0, 0, 1}; }

cv::Mat distortion_of(const CameraModel& m) {
  return cv::Mat(1, 8, CV_32F, const_cast<float*>(m.distortion.data())).clone();
}

// Smooth, as what a lens shows: 8-bit RGB.
cv::Mat smooth_picture(int width, int height) {
  cv::Mat picture(height, width, CV_8UC3);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      for (int c = 0; c < 3; ++c) {
        picture.at<cv::Vec3b>(y, x)[c] = cv::saturate_cast<std::uint8_t>(
            128 + 60 * std::sin(x * 0.09 + c) + 50 * std::cos(y * 0.07 - c + x * 0.02));
      }
    }
  }
  return picture;
}

FrameView view_of(const cv::Mat& rgb) {
  return {{PixelFormat::kRgb24, rgb.cols, rgb.rows, static_cast<int>(rgb.step)},
          {},
          rgb.data,
          rgb.total() * 3};
}

// In bytes, so that differences read as grey levels.
cv::Mat run(const FrameView& frame, int width, int height, std::vector<CameraBox> map,
            int workers = 1) {
  auto preprocess = Preprocess::prepare(frame.format, width, height, workers, std::move(map));
  EXPECT_TRUE(preprocess) << preprocess.status().text();
  cv::Mat out(height, width, CV_32FC3);
  for (int i = 0; i < workers; ++i) {
    preprocess->run_rows(frame, i, height * i / workers, height * (i + 1) / workers,
                         out.ptr<float>());
  }
  return out * (255 * 0.225) + cv::Scalar::all(255 * 0.45);
}

TEST(CameraModel, ProjectsAsOpenCvDoesAndBack) {
  for (const CameraModel& camera : kCameras) {
    for (const double x : {-0.5, -0.1, 0.0, 0.3, 0.6}) {
      for (const double y : {-0.4, 0.05, 0.35}) {
        std::vector<cv::Point2d> expected;
        cv::projectPoints(std::vector<cv::Point3d>{{x, y, 1}}, cv::Vec3d(), cv::Vec3d(),
                          matrix_of(camera), distortion_of(camera), expected);
        const Point pixel = camera.project({x, y});
        ASSERT_NEAR(pixel.x, expected[0].x, 1e-6);
        ASSERT_NEAR(pixel.y, expected[0].y, 1e-6);
        const auto ray = camera.unproject(pixel);
        ASSERT_TRUE(ray);
        ASSERT_NEAR(ray->x, x, 1e-5);
        ASSERT_NEAR(ray->y, y, 1e-5);
      }
    }
  }
}

TEST(LensMap, LiesWhereOpenCvsDoes) {
  for (const CameraModel& camera : kCameras) {
    const auto view = pinhole_view(camera, 160, 96);
    ASSERT_TRUE(view) << view.status().text();
    const auto map = make_lens_map(camera, *view);
    ASSERT_TRUE(map) << map.status().text();
    cv::Mat map_x;
    cv::Mat map_y;
    cv::initUndistortRectifyMap(matrix_of(camera), distortion_of(camera), cv::Matx33d::eye(),
                                matrix_of(*view), {160, 96}, CV_32FC1, map_x, map_y);
    for (int v = 1; v < 95; ++v) {  // boxes of the outermost pixels are moved into the picture
      for (int u = 1; u < 159; ++u) {
        const CameraBox& box = (*map)[static_cast<std::size_t>(v * 160 + u)];
        const float x = box.columns.begin + box.columns.length / 2 - 0.5F;
        const float y = box.rows.begin + box.rows.length / 2 - 0.5F;
        ASSERT_NEAR(x, map_x.at<float>(v, u), 5e-3) << u << ", " << v;
        ASSERT_NEAR(y, map_y.at<float>(v, u), 5e-3) << u << ", " << v;
      }
    }
  }
}

TEST(LensMap, ShowsWhatTheCameraSawInEveryCornerAndAsMuchAsItCan) {
  for (const CameraModel& camera : kCameras) {
    const CameraModel view = *pinhole_view(camera, 160, 96);
    double nearest = 1e9;  // to the picture's border, of the view's border
    for (int i = 0; i <= 160; ++i) {
      const double u = -0.5 + i;
      const double v = -0.5 + i * 0.6;
      for (const Point& at : {Point{u, -0.5}, Point{u, 95.5}, Point{-0.5, v}, Point{159.5, v}}) {
        const Point seen = camera.project({(at.x - view.cx) / view.fx, (at.y - view.cy) / view.fy});
        nearest = std::min({nearest, seen.x + 0.5, 319.5 - seen.x, seen.y + 0.5, 239.5 - seen.y});
      }
    }
    EXPECT_GT(nearest, -0.02) << "no empty corner";
    EXPECT_LT(nearest, 0.5) << "nor anything left that would fit";
    EXPECT_NEAR(view.fx / view.fy, camera.fx * 160 / 320 / (camera.fy * 96 / 240), 1e-5);
  }
}

TEST(LensMap, WithoutDistortionTheWholePictureIsShownAsEver) {
  CameraModel camera = kCameras[0];
  camera.distortion = {};
  EXPECT_EQ(*pinhole_view(camera, 160, 96), camera.resized(160, 96));
  const cv::Mat picture = smooth_picture(320, 240);
  for (const auto& [width, height] :
       {std::pair(160, 96), std::pair(199, 223), std::pair(384, 288)}) {
    const auto map = make_lens_map(camera, camera.resized(width, height));
    const cv::Mat through_map = run(view_of(picture), width, height, *map);
    EXPECT_LT(cv::norm(through_map, run(view_of(picture), width, height, {}), cv::NORM_INF), 0.05)
        << width << "x" << height;
  }
}

TEST(Preprocess, UndistortsAsOpenCvDoes) {
  const cv::Mat picture = smooth_picture(320, 240);
  cv::Mat image;
  picture.convertTo(image, CV_32F);
  test::for_each_isa([&] {
    for (const CameraModel& camera : kCameras) {
      // The camera's own size: its pixels are interpolated.
      CameraModel view = *pinhole_view(camera, 320, 240);
      cv::Mat map_x;
      cv::Mat map_y;
      cv::initUndistortRectifyMap(matrix_of(camera), distortion_of(camera), cv::Matx33d::eye(),
                                  matrix_of(view), {320, 240}, CV_32FC1, map_x, map_y);
      cv::Mat expected;
      cv::remap(image, expected, map_x, map_y, cv::INTER_LINEAR, cv::BORDER_REPLICATE);
      const cv::Mat same = run(view_of(picture), 320, 240, *make_lens_map(camera, view));
      // OpenCV takes positions in 32nds; ours may average a little more than a pixel.
      ASSERT_LT(cv::norm(same, expected, cv::NORM_INF), 3);
      ASSERT_LT(cv::norm(same, expected, cv::NORM_L1) / same.total() / 3, 0.25);

      // Smaller: what the view of four times the size is when each 4 x 4 are averaged.
      view = *pinhole_view(camera, 96, 64);
      const CameraModel fine = view.resized(384, 256);
      cv::initUndistortRectifyMap(matrix_of(camera), distortion_of(camera), cv::Matx33d::eye(),
                                  matrix_of(fine), {384, 256}, CV_32FC1, map_x, map_y);
      cv::remap(image, expected, map_x, map_y, cv::INTER_LINEAR, cv::BORDER_REPLICATE);
      cv::resize(expected, expected, {96, 64}, 0, 0, cv::INTER_AREA);
      const cv::Mat small = run(view_of(picture), 96, 64, *make_lens_map(camera, view));
      ASSERT_LT(cv::norm(small, expected, cv::NORM_INF), 3);
      ASSERT_LT(cv::norm(small, expected, cv::NORM_L1) / small.total() / 3, 0.25);
    }
  });
}

TEST(Preprocess, UndistortsEveryFormatForAnyNumberOfWorkersAlike) {
  const CameraModel& camera = kCameras[0];
  const auto map = make_lens_map(camera, *pinhole_view(camera, 96, 64));
  const cv::Mat rgb = smooth_picture(320, 240);
  cv::Mat bgr;
  cv::cvtColor(rgb, bgr, cv::COLOR_RGB2BGR);
  FrameView reversed = view_of(bgr);
  reversed.format.pixel = PixelFormat::kBgr24;
  const cv::Mat one = run(view_of(rgb), 96, 64, *map);
  EXPECT_EQ(cv::norm(run(reversed, 96, 64, *map), one, cv::NORM_INF), 0);
  EXPECT_EQ(cv::norm(run(view_of(rgb), 96, 64, *map, 3), one, cv::NORM_INF), 0);

  std::vector<std::uint8_t> nv12(320 * 360, 128);
  for (std::size_t i = 0; i < 320 * 240; ++i) nv12[i] = static_cast<std::uint8_t>(16 + i / 400);
  const FrameView yuv = {{PixelFormat::kNv12, 320, 240, 320}, {}, nv12.data(), nv12.size()};
  cv::Mat as_rgb;
  cv::cvtColor(cv::Mat(360, 320, CV_8UC1, nv12.data()), as_rgb, cv::COLOR_YUV2RGB_NV12);
  EXPECT_LT(cv::norm(run(yuv, 96, 64, *map), run(view_of(as_rgb), 96, 64, *map), cv::NORM_INF),
            1.01);
}

TEST(LensMap, RefusesALensThatFoldsThePicture) {
  const CameraModel folding = make_camera({-2.5F, 0, 0, 0, 0});
  EXPECT_EQ(pinhole_view(folding, 160, 96).code(), StatusCode::kInvalidInput);
  EXPECT_EQ(make_lens_map(folding, folding.resized(160, 96)).code(), StatusCode::kInvalidInput);
  CameraModel hole = CameraModel::from_field_of_view(640, 480, 65);
  hole.fx = hole.fy = 426.66666F;
  hole.cx = 320.33334F;
  hole.cy = 240.33333F;
  hole.distortion = {-2, 0, 0, 0, 0, -2, 0, 0};  // 0/0 at one pixel, 1 everywhere else
  const Result<CameraModel> through = pinhole_view(hole, 384, 288);
  ASSERT_TRUE(through) << through.status().text();
  EXPECT_EQ(make_lens_map(hole, *through).code(), StatusCode::kInvalidInput);
  const CameraModel mad = make_camera({1e30F, -1e30F, 1e20F, 0, 0});
  EXPECT_EQ(pinhole_view(mad, 160, 96).code(), StatusCode::kInvalidInput);
}

}  // namespace
}  // namespace lcdm
