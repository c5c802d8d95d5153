// How KITTI's colour cameras and its scanner saw on one day (Geiger et al. 2013), and a sweep of
// the scanner as a camera's depth.
#pragma once

#include <array>
#include <filesystem>
#include <opencv2/core.hpp>

#include "firmware/base/status.h"
#include "firmware/vision/camera_model.h"

namespace lcdm::model {

struct KittiCamera {
  CameraModel model;
  cv::Matx34d from_scanner;  // homogeneous point of the velodyne to pixel times depth, and depth
};
using KittiCameras = std::array<KittiCamera, 2>;  // left, right

// From `date`/calib_cam_to_cam.txt and, `with_scanner`, calib_velo_to_cam.txt. kNotFound, kCorrupt.
Result<KittiCameras> read_kitti_cameras(const std::filesystem::path& date, bool with_scanner);

// Depth [height][width] in metres, 0 where no point falls, of the sweep in `file`, as monodepth2
// and, before it, Eigen's and Garg's evaluations make it: the scanner's forward distance, about
// .27 m more than that along the camera's optical axis. kNotFound, kCorrupt: no whole points.
Result<cv::Mat> read_kitti_sweep(const std::filesystem::path& file, const KittiCamera& camera);

}  // namespace lcdm::model
