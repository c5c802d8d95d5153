// A teacher from elsewhere: any monocular depth network saved as a TorchScript module.
#pragma once

#include <opencv2/core.hpp>
#include <string>

#include "firmware/base/status.h"
#include "model/evaluation.h"
#include "model/pixel_scale.h"

namespace lcdm::model {

struct TorchscriptOptions {
  std::string file;
  cv::Size input;  // what it is fed; multiples of what it needs
  PixelScale pixels = kImagenetPixels;
  // What comes out: metres, inverse depth of unknown scale (to be learned with Alignment::kScale),
  // or of unknown scale and shift, which is spread over 1 to 100 m (Alignment::kAffine).
  enum class Gives : std::uint8_t { kDepth, kInverse, kAffineInverse } gives = Gives::kInverse;
};

// A map whose scale means nothing, with its median at 10 m, for maps are stored in 1/256 m up to
// 255 m: what Monodepth2 and MonoViT call metres is some 30 times too little for that.
cv::Mat at_ten_metres(const cv::Mat& map);

// The module takes [1, 3, H, W] and gives [1, 1, h, w] or [1, h, w], alone or first of a tuple or
// list. An empty estimate where a frame makes it fail. kInvalidInput: no such module; kCorrupt: its
// answer to an empty picture is no depth.
Result<Estimator> torchscript_estimator(const TorchscriptOptions& options);

}  // namespace lcdm::model
