// Photographs as paint: where they are cut from, and how alike they are.
#include "model/photographs.h"

#include <gtest/gtest.h>
#include <memory>
#include <opencv2/imgproc.hpp>
#include <vector>

namespace lcdm::model {
namespace {

Pack pack_of(const cv::Mat& rgb, float share) {
  const cv::Mat depth(rgb.size(), CV_32F, cv::Scalar(2));
  const CameraModel camera = CameraModel::from_field_of_view(rgb.cols, rgb.rows, 60);
  Pack pack;
  pack.use.tall_share = share;
  pack.frames =
      std::make_shared<MemoryFrames>(std::vector<PackFrame>{{"a", rgb, depth, camera}}, false);
  pack.train = {0};
  return pack;
}

// Dim, of little contrast.
cv::Mat speckled() {
  cv::Mat rgb(96, 128, CV_8UC3);
  cv::RNG random(3);
  random.fill(rgb, cv::RNG::UNIFORM, 0, 100);
  cv::resize(rgb, rgb, {512, 384}, 0, 0, cv::INTER_NEAREST);
  return rgb;
}

TEST(Photographs, AreTheSameForTheSamePicturesAndAllOfOneContrast) {
  const std::vector<Pack> packs = {pack_of(speckled(), 1)};
  const auto all = cut_photographs(packs, 5);
  ASSERT_EQ(all.size(), 5U);
  for (const scene::Photograph& photograph : all) {
    cv::Scalar mean, deviation;
    cv::meanStdDev(std::vector<std::uint8_t>(photograph.grey.begin(), photograph.grey.end()), mean,
                   deviation);
    EXPECT_NEAR(mean[0], 128, 3);
    EXPECT_NEAR(deviation[0], 52, 5);
  }
  EXPECT_NE(all[0].grey, all[1].grey);
  EXPECT_EQ(all[4].grey, cut_photographs(packs, 5)[4].grey);
}

TEST(Photographs, AreOfPicturesThatAreTrainedOnAndShowSomething) {
  const cv::Mat grey(48, 64, CV_8UC3, cv::Scalar::all(90));
  EXPECT_TRUE(cut_photographs({pack_of(speckled(), 0)}, 3).empty());
  EXPECT_TRUE(cut_photographs({pack_of(grey, 1)}, 3).empty());
  EXPECT_TRUE(cut_photographs({}, 3).empty());
}

}  // namespace
}  // namespace lcdm::model
