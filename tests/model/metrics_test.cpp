// Metrics against values worked out by hand.
#include "model/metrics.h"

#include <cmath>
#include <gtest/gtest.h>

namespace lcdm::model {
namespace {

TEST(Metrics, OfAPerfectEstimateAtAnotherScaleAreZero) {
  const cv::Mat truth = (cv::Mat_<float>(1, 3) << 1, 2, 4);
  Metrics m;
  ASSERT_TRUE(measure(truth * 7, truth, Protocol::indoor(), m));
  EXPECT_NEAR(m.abs_rel, 0, 1e-6);
  EXPECT_NEAR(m.rmse, 0, 1e-6);
  EXPECT_EQ(m.delta1, 1);
}

TEST(Metrics, OfOneWrongPixelAreThoseOfTheFormulas) {
  const cv::Mat truth = (cv::Mat_<float>(1, 3) << 1, 2, 4);
  const cv::Mat estimate = (cv::Mat_<float>(1, 3) << 1, 2, 6);  // the median agrees: no scaling
  Metrics m;
  ASSERT_TRUE(measure(estimate, truth, Protocol::indoor(), m));
  EXPECT_NEAR(m.abs_rel, 0.5 / 3, 1e-6);
  EXPECT_NEAR(m.sq_rel, 1.0 / 3, 1e-6);  // 2^2 / 4 over 3 pixels
  EXPECT_NEAR(m.rmse, std::sqrt(4.0 / 3), 1e-6);
  EXPECT_NEAR(m.rmse_log, std::log(1.5) / std::sqrt(3.0), 1e-6);
  EXPECT_NEAR(m.delta1, 2.0 / 3, 1e-6);
  EXPECT_NEAR(m.delta2, 1, 1e-6);  // 1.5 < 1.5625
  EXPECT_NEAR(m.delta3, 1, 1e-6);
}

TEST(Metrics, CountOnlyDepthWithinTheProtocol) {
  const cv::Mat truth = (cv::Mat_<float>(1, 4) << 0, 0.2F, 5, 20);  // hole, too near, good, too far
  const cv::Mat estimate = (cv::Mat_<float>(1, 4) << 9, 9, 5, 9);
  Metrics m;
  ASSERT_TRUE(measure(estimate, truth, Protocol::indoor(), m));
  EXPECT_NEAR(m.abs_rel, 0, 1e-6);
  EXPECT_FALSE(measure(estimate, cv::Mat::zeros(1, 4, CV_32F), Protocol::indoor(), m));
}

TEST(Metrics, GargCropLeavesOutTheSky) {
  cv::Mat truth(100, 100, CV_32F, cv::Scalar(10));
  cv::Mat estimate = truth.clone();
  estimate.rowRange(0, 40).setTo(70);  // above 40.8 %
  Metrics m;
  ASSERT_TRUE(measure(estimate, truth, Protocol::driving(), m));
  EXPECT_NEAR(m.abs_rel, 0, 1e-6);
}

TEST(Metrics, ResizeInverseDepthAndKeepItsMeaning) {
  const cv::Mat estimate = (cv::Mat_<float>(1, 2) << 1, 3);
  const cv::Mat truth = (cv::Mat_<float>(1, 4) << 1, 1.2F, 2, 3);  // 1/d: 1, 5/6, 1/2, 1/3
  Metrics m;
  ASSERT_TRUE(measure(estimate, truth, Protocol::indoor(), m));
  EXPECT_NEAR(m.abs_rel, 0, 1e-6);
}

}  // namespace
}  // namespace lcdm::model
