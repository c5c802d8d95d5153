// Depth of a network beside ground truth, over whole packs.
#pragma once

#include <functional>
#include <map>
#include <string>
#include <vector>

#include "model/metrics.h"
#include "model/network.h"
#include "model/pack.h"

namespace lcdm::model {

// Depth up to scale of one frame: CV_32F, any size; empty: none for this frame.
using Estimator = std::function<cv::Mat(const PackFrame&)>;

// The network at 0, 1 or more sampling steps, fed as the device feeds it: the whole frame at the
// deployed size nearest in shape. The network must be in evaluation mode and outlive the estimator.
// `share` of that size, rounded to multiples of 32, where it is not 1.
Estimator network_estimator(DepthNetwork& network, int steps, double share = 1);
// An exported file, with its own sampler. kInvalidInput where it cannot be used.
Result<Estimator> file_estimator(const std::string& path, double share = 1);
// The teacher's stored maps of the frame's pack: root/pack/teacher_meter.
Estimator teacher_estimator(const PackUse& use, const std::string& root);
// NAME.tiff (float metres) or NAME.png (16 bit, millimetres) of a folder.
Estimator folder_estimator(const std::string& folder);
Estimator constant_estimator();

// The network's deployed input size for a picture of this size.
cv::Size deployed_size(cv::Size picture, double share = 1);

struct PackResult {
  Metrics mean;
  std::vector<Metrics> images;
  std::size_t missing = 0;  // frames without estimate or ground truth
};
PackResult evaluate(const Pack& pack, const std::vector<std::size_t>& frames,
                    const Protocol& protocol, const Estimator& estimator);

// How a pack is measured.
Protocol protocol_of(const std::string& pack);

// A colour picture: the frame, its depth where known, and the estimate side by side (inverse
// depth).
cv::Mat comparison_picture(const PackFrame& frame, const cv::Mat& estimate);

}  // namespace lcdm::model
