// Make3D's 134 test pictures with a laser scanner's depth (Saxena et al. 2009).
#pragma once

#include <memory>
#include <string>

#include "firmware/base/status.h"
#include "model/frames.h"

namespace lcdm::model {

struct Make3dOptions {
  std::string pictures = "Test134";      // img-*.jpg
  std::string depths = "Gridlaserdata";  // depth_sph_corr-*.mat
  int max_width = kFullWidth;            // wider pictures are reduced
};

// Both folders are looked for below `root`. Frames are named as the pictures, without "img-"; they
// have no neighbours. The scanner's grid of 55 x 305 is resized by nearest to the whole picture's
// size, so that every cell keeps its weight; then the middle 2:1 of picture and depth is taken, as
// the published protocol has it (Godard et al. 2017), whose 70 m are the evaluation's business. The
// camera is assumed, not calibrated.
// kNotFound: no pictures, or no depth for any of them; a single one without depth fails when read.
Result<std::shared_ptr<const Frames>> open_make3d(const std::string& root,
                                                  const Make3dOptions& options = {});

}  // namespace lcdm::model
