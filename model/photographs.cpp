#include "model/photographs.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <optional>

#include "model/batch.h"

namespace lcdm::model {
namespace {

constexpr int kTriesEach = 8;
constexpr double kLeastDeviation = 12;  // of 255: less is a wall without a pattern
constexpr double kMean = 128;
constexpr double kDeviation = 52;

std::optional<scene::Photograph> cut(const cv::Mat& rgb, SampleRandom& random) {
  const int shorter = std::min(rgb.rows, rgb.cols);
  const int side = std::max(1, static_cast<int>(shorter * std::pow(0.25, random.uniform(0, 1))));
  const auto place = [&](int length) {
    return static_cast<int>(random.below(static_cast<std::size_t>(length - side + 1)));
  };
  const int x = place(rgb.cols);
  const int y = place(rgb.rows);
  cv::Mat grey;
  cv::cvtColor(rgb({x, y, side, side}), grey, cv::COLOR_RGB2GRAY);
  constexpr int kSide = scene::Photograph::kSide;
  cv::resize(grey, grey, {kSide, kSide}, 0, 0, side > kSide ? cv::INTER_AREA : cv::INTER_LINEAR);
  cv::Scalar mean, deviation;
  cv::meanStdDev(grey, mean, deviation);
  if (deviation[0] < kLeastDeviation) return std::nullopt;
  const double gain = kDeviation / deviation[0];
  scene::Photograph out;
  grey.convertTo(cv::Mat(kSide, kSide, CV_8U, out.grey.data()), CV_8U, gain,
                 kMean - gain * mean[0]);
  return out;
}

}  // namespace

std::vector<scene::Photograph> cut_photographs(const std::vector<Pack>& packs, int count) {
  std::vector<const Pack*> trained;
  for (const Pack& pack : packs) {
    const bool drawn = pack.use.wide_share + pack.use.tall_share > 0 && !pack.train.empty();
    if (drawn && pack.use.teacher != Teacher::kRenderer) trained.push_back(&pack);
  }
  std::vector<scene::Photograph> all;
  for (int i = 0; !trained.empty() && i < count; ++i) {
    SampleRandom random(0, static_cast<std::uint64_t>(i), 0);
    for (int tries = 0; tries < kTriesEach; ++tries) {
      const Pack& pack = *trained[random.below(trained.size())];
      const Result<PackFrame> frame =
          pack.frames->read(pack.train[random.below(pack.train.size())]);
      const auto photograph = frame ? cut(frame->rgb, random) : std::nullopt;
      if (!photograph) continue;
      all.push_back(*photograph);
      break;
    }
  }
  return all;
}

int use_photographs_of(const std::vector<Pack>& packs, int count) {
  if (count == 0) return 0;
  const std::vector<scene::Photograph> photographs = cut_photographs(packs, count);
  scene::use_photographs(photographs);
  return static_cast<int>(photographs.size());
}

}  // namespace lcdm::model
