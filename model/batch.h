// Augmented batches: each a function of the seed and the batch's number alone, made ahead by
// threads.
#pragma once

#include <cstdint>
#include <deque>
#include <future>
#include <string>
#include <vector>

#include "model/pack.h"
#include "model/torch.h"
#include "model/training_batch.h"

namespace lcdm::model {

// The size of one batch's pictures, and the canonical focal length in pixels of that size: the
// deployed one times the size's share of the deployed size, so that what a picture shows means the
// same canonical depth at every training size.
struct BatchShape {
  int width = 0;
  int height = 0;
  float canonical_focal = 0;
  int images = 0;
  bool wide = false;
  bool views = false;  // with the neighbouring frames
  int first = 0;       // number of its first sample in a batch that several processes share
  // Aspect of the device's pictures over this size's: sides are multiples of 32, and the device too
  // squeezes whole pictures into such.
  double squeeze = 1;
};

// Random numbers of one sample; the same on every machine.
class SampleRandom {
 public:
  SampleRandom(std::uint64_t seed, std::uint64_t step, std::uint64_t sample);
  double uniform(double low, double high);
  bool chance(double probability) { return uniform(0, 1) < probability; }
  std::size_t below(std::size_t n);
  // For another generator.
  std::uint64_t seed() { return static_cast<std::uint64_t>(uniform(1, 0x1p52)); }

 private:
  std::uint64_t next();
  std::uint64_t state_;
};

// (rgb - 0.45) / 0.225 of an 8-bit or float [0, 1] picture, [H, W, 3] float.
torch::Tensor normalised(const cv::Mat& rgb);

struct AugmentedSample {
  cv::Mat rgb;         // CV_32FC3 in [0, 1], jittered
  cv::Mat plain;       // the same without jitter
  cv::Mat earlier;     // the frame before and the frame after, cut and flipped alike; empty where
  cv::Mat later;       // the shape asks for no views or there are none
  cv::Mat depth;       // CV_32FC1, canonical, 0 = unknown
  CameraModel camera;  // of the crop at its new size, flipped
};
// Frame `index` of the pack with rendered things in it (as often as the pack is to have them; not
// where views are asked for: the neighbours show none), under a random roll (nor there: their
// motion is known for upright cameras only), crop (45 to 100 % of the largest of about the shape's
// aspect), flip, colour jitter, blur and noise. Errors as Frames::read.
Result<AugmentedSample> augment(const Pack& pack, std::size_t index, const BatchShape& shape,
                                SampleRandom& random);

// Batch `number`: packs drawn by their share for the shape. Frames that cannot be read are counted
// and replaced by others. The error of the last one where most cannot.
Result<Batch> make_batch(const std::vector<Pack>& packs, const BatchShape& shape,
                         std::uint64_t seed, std::uint64_t number);

// Frames that were drawn, and those of them that could not be read.
class DrawnFrames {
 public:
  void add(const Batch& batch);
  // kCorrupt where they are too many for a damaged file or two: the data is broken.
  Status check() const;
  // What to tell at the end; empty where all could be read.
  std::string note() const;

 private:
  std::int64_t drawn_ = 0;
  std::int64_t unreadable_ = 0;
  Status why_;  // the last of them
};

// Makes the batches `first`, `first` + 1, ... ahead, each in a thread of its own, `ahead` at a
// time.
class BatchLoader {
 public:
  // `shapes[i % shapes.size()]` is the shape of batch i. `packs` must outlive the loader.
  BatchLoader(const std::vector<Pack>& packs, std::vector<BatchShape> shapes, std::uint64_t seed,
              std::uint64_t first, std::size_t ahead);

  Result<Batch> next();

 private:
  void start_one();

  const std::vector<Pack>& packs_;
  std::vector<BatchShape> shapes_;
  std::uint64_t seed_;
  std::uint64_t number_;  // of the next batch to start
  std::deque<std::future<Result<Batch>>> running_;
};

}  // namespace lcdm::model
