// NYU Depth V2's 1449 labelled pictures (Silberman et al. 2012): 795 to train on, 654 to test on.
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "firmware/base/status.h"
#include "model/frames.h"

namespace lcdm::model {

struct NyuDepthOptions {
  enum class Split : std::uint8_t { kTrain, kTest } split = Split::kTest;
  int max_width = kFullWidth;  // wider pictures are reduced, their depth by nearest
};

// `root` holds either
//   nyu_depth_v2_labeled.mat and splits.mat, as the authors publish them, or
//   official_splits/test|train/SCENE/rgb_NNNNN.jpg and sync_depth_NNNNN.png (16 bit, millimetres),
//   into which many projects convert them (`root` may also be official_splits itself).
// Depth is the sensor's, with its holes (`rawDepths`).
// Frames are named rgb_NNNNN, counted from 0, and SCENE/rgb_NNNNN. They have no neighbours: the
// labelled pictures are far apart in time. kNotFound: neither of these.
Result<std::shared_ptr<const Frames>> open_nyu_depth(const std::string& root,
                                                     const NyuDepthOptions& options = {});

}  // namespace lcdm::model
