// The seven depth metrics and the protocols they are measured under (Eigen et al. 2014).
#pragma once

#include <cstdint>
#include <opencv2/core.hpp>
#include <string>
#include <vector>

#include "firmware/base/status.h"

namespace lcdm::model {

struct Metrics {
  double abs_rel = 0;
  double sq_rel = 0;  // metres
  double rmse = 0;    // metres
  double rmse_log = 0;
  double delta1 = 0;  // share of pixels with max(p/g, g/p) < 1.25
  double delta2 = 0;  // 1.25^2
  double delta3 = 0;  // 1.25^3
};

struct Protocol {
  double nearest = 1e-3;  // metres; ground truth outside is not counted, estimates are clamped
  double farthest = 80;
  // The pixels that count, as shares of the picture; all by default.
  enum class Crop : std::uint8_t { kNone, kGarg, kEigenIndoor } crop = Crop::kNone;
  // Whether the estimate is first scaled by the ratio of the medians.
  bool median_scaling = true;
};

// By name: `kitti` (Garg crop, 80 m), `kitti-improved` (80 m, no crop), `nyu` (Eigen's crop, 10 m),
// `make3d` (70 m), `rgbd` (0.1 to 10 m), `indoor` (0.3 to 10 m), `scene` (0.3 to 80 m).
// kInvalidInput: no such name.
Result<Protocol> protocol_named(const std::string& name);

// One image. `estimate`: CV_32F depth of any size and scale, resized bilinearly as inverse depth to
// the ground truth's; `truth`: CV_32F metres, 0 = unknown. Medians are those of the counted pixels.
// False where no pixel counts, where the estimate of one that does is not positive (0: none) or no
// number, or where its median is nothing to scale by.
bool measure(const cv::Mat& estimate, const cv::Mat& truth, const Protocol& protocol,
             Metrics& metrics);

// Mean of per-image metrics.
Metrics mean_of(const std::vector<Metrics>& images);

}  // namespace lcdm::model
