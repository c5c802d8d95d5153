// The seven depth metrics and the protocols they are measured under (MODEL.md: Eigen et al. 2014).
#pragma once

#include <opencv2/core.hpp>
#include <string>
#include <vector>

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
  bool garg_crop = false;

  static Protocol driving() { return {1e-3, 80, true}; }
  static Protocol indoor() { return {0.3, 10, false}; }
  static Protocol scene() { return {0.3, 80, false}; }
};

// One image. `estimate`: CV_32F depth of any size and scale, resized bilinearly as inverse depth to
// the ground truth's; `truth`: CV_32F metres, 0 = unknown. The estimate is scaled by the ratio of
// the medians over the counted pixels. False where no pixel counts.
bool measure(const cv::Mat& estimate, const cv::Mat& truth, const Protocol& protocol,
             Metrics& metrics);

// Mean of per-image metrics.
Metrics mean_of(const std::vector<Metrics>& images);

}  // namespace lcdm::model
