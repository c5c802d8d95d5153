// KITTI's raw recordings, synchronised and rectified (Geiger et al. 2013), as the lists of the
// published splits name them: lines "DATE/DATE_drive_NNNN_sync FRAME l|r".
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "firmware/base/status.h"
#include "model/frames.h"

namespace lcdm::model {

struct KittiRawOptions {
  enum class Depth : std::uint8_t {
    kNone,
    kVelodyne,  // the sweep of the frame, projected (kitti_calibration.h)
    kImproved,  // KITTI's annotated depth maps (Uhrig et al. 2017), 1/256 m
    kMaps,      // a teacher's: DRIVE/image_02/NNNNNNNNNN.png, 16 bit, 1/256 m, of any size
  };

  // DATE/DATE_drive_NNNN_sync/image_02|03/data/NNNNNNNNNN.png|jpg, velodyne_points/data/*.bin,
  // DATE/calib_cam_to_cam.txt, DATE/calib_velo_to_cam.txt.
  std::string root;
  std::string list;
  Depth depth = Depth::kNone;
  // kImproved: the folder of the drives, or of `train` and `val` with them; kMaps: of the drives.
  std::string depth_root;
  // Wider pictures are reduced. Sparse depth keeps the nearest point in each pixel.
  int max_width = kFullWidth;
};

// Reads the list and the calibrations; pictures and depth only when asked for. Frames are named
// DATE_drive_NNNN_sync/image_02/NNNNNNNNNN; neighbours are those of the drive, listed or not.
// Listed pictures that are not there fail with kNotFound when read. kNotFound: root, list,
// calibration, or all pictures are missing.
Result<std::shared_ptr<const Frames>> open_kitti_raw(const KittiRawOptions& options);

}  // namespace lcdm::model
