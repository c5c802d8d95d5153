// Depth of a network beside ground truth, over whole sets of frames.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "firmware/nn/network.h"
#include "model/metrics.h"
#include "model/network.h"
#include "model/pack.h"

namespace lcdm::model {

// Depth of one frame: CV_32F metres, any size; empty: none for this frame.
using Estimator = std::function<cv::Mat(const PackFrame&)>;

// The network at 0, 1 or more sampling steps, fed as the device feeds it: the whole frame at the
// deployed size nearest in shape. The network must be in evaluation mode and outlive the estimator.
// `share` of that size, rounded to multiples of 32, where it is not 1.
Estimator network_estimator(DepthNetwork& network, int steps, double share = 1);
// An exported file, with its own sampler. kInvalidInput where it cannot be used.
Result<Estimator> file_estimator(const std::string& path, double share = 1);
// The same file in the device's engine at a precision; kUnsupported where this processor would
// compute in a wider one. `threads` of the engine.
Result<Estimator> engine_estimator(const std::string& path, Precision precision, int threads,
                                   double share = 1);

// The mean, in inverse depth, of what is said of a picture and of its mirror image: it is wrong a
// little differently in the two. 0 where either is unknown; no depth where either has none.
Estimator both_ways(Estimator estimator);

// Mean difference of log depth; both of one size, as two estimators of one share make of a frame.
double log_distance(const cv::Mat& a, const cv::Mat& b);
// A folder of a teacher's maps, NAME.png in 1/256 m.
Estimator maps_estimator(const std::string& folder);
// NAME.tiff (float metres) or NAME.png (16 bit, millimetres) of a folder.
Estimator folder_estimator(const std::string& folder);
Estimator constant_estimator();

// The input size that the device chooses for this model and a camera of this picture size, or a
// share of it.
cv::Size deployed_size(const ModelConfig& model, cv::Size picture, double share = 1);

// The picture as a camera sees it that moves `length` pixels of a 640 pixels wide picture while it
// is exposed, straight, in a direction of the frame's own (`index` turns it by the golden angle).
cv::Mat motion_blurred(const cv::Mat& rgb, double length, std::size_t index);

struct FrameResult {
  std::string name;
  Metrics metrics;
};
struct SetResult {
  Metrics mean;
  std::vector<FrameResult> frames;
  std::size_t missing = 0;  // frames without usable estimate, ground truth or readable files
  Status why_missing;       // of the last of them
};
// `blur`: length of a motion blur in pixels, 0 for none.
SetResult evaluate(const Frames& set, const std::vector<std::size_t>& frames,
                   const Protocol& protocol, const Estimator& estimator, double blur = 0);

// A difference of means over the same frames, with a 95 % interval by the paired bootstrap: the
// wider of Efron's, of frames one by one, and the circular one of Politis and Romano, of runs as
// long as the root of their number. Frames of a video resemble their neighbours; of a few frames,
// runs say too little.
struct Difference {
  double mean = 0;
  double low = 0;
  double high = 0;
  std::size_t frames = 0;
};
// Of `metric`, a - b, over the frames that both have, in a's order. Few frames give a wide and
// rough interval.
Difference paired_difference(const SetResult& a, const SetResult& b, double Metrics::*metric);

// A colour picture: the frame, its depth where known, and the estimates side by side (inverse
// depth).
cv::Mat comparison_picture(const PackFrame& frame, const std::vector<cv::Mat>& estimates);

}  // namespace lcdm::model
