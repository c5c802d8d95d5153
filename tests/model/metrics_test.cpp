// Metrics against values worked out by hand, and by a script that shares no code with them.
#include "model/metrics.h"

#include <cmath>
#include <gtest/gtest.h>

namespace lcdm::model {
namespace {

const Protocol indoor = *protocol_named("indoor");

TEST(Metrics, OfAPerfectEstimateAtAnotherScaleAreZero) {
  const cv::Mat truth = (cv::Mat_<float>(1, 3) << 1, 2, 4);
  Metrics m;
  ASSERT_TRUE(measure(truth * 7, truth, indoor, m));
  EXPECT_NEAR(m.abs_rel, 0, 1e-6);
  EXPECT_NEAR(m.rmse, 0, 1e-6);
  EXPECT_EQ(m.delta1, 1);
}

TEST(Metrics, OfOneWrongPixelAreThoseOfTheFormulas) {
  const cv::Mat truth = (cv::Mat_<float>(1, 3) << 1, 2, 4);
  const cv::Mat estimate = (cv::Mat_<float>(1, 3) << 1, 2, 6);  // the median agrees: no scaling
  Metrics m;
  ASSERT_TRUE(measure(estimate, truth, indoor, m));
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
  ASSERT_TRUE(measure(estimate, truth, indoor, m));
  EXPECT_NEAR(m.abs_rel, 0, 1e-6);
  EXPECT_FALSE(measure(estimate, cv::Mat::zeros(1, 4, CV_32F), indoor, m));
}

// One would make the mean of a whole set none.
TEST(Metrics, RefuseAnEstimateThatIsNoNumber) {
  const cv::Mat truth = (cv::Mat_<float>(1, 3) << 1, 2, 0);
  Metrics m;
  for (const float bad : {NAN, INFINITY}) {
    EXPECT_FALSE(measure((cv::Mat_<float>(1, 3) << bad, bad, 1), truth, indoor, m)) << bad;
  }
  EXPECT_FALSE(measure((cv::Mat_<float>(1, 3) << 1, NAN, 1), truth, indoor, m));
  EXPECT_TRUE(measure((cv::Mat_<float>(1, 3) << 1, 2, NAN), truth, indoor, m))
      << "where nothing is known nothing is asked";
}

// Resizing makes 0 of what is no number, and 0 is none: neither is the nearest depth.
TEST(Metrics, RefuseAnEstimateWithHolesWhereDepthIsKnown) {
  const cv::Mat truth(8, 8, CV_32F, cv::Scalar(2));
  Metrics m;
  for (const int side : {4, 8}) {
    cv::Mat estimate(side, side, CV_32F, cv::Scalar(1));
    EXPECT_TRUE(measure(estimate, truth, indoor, m));
    for (const float hole : {0.0F, NAN, -1.0F}) {
      estimate.at<float>(1, 1) = hole;
      EXPECT_FALSE(measure(estimate, truth, indoor, m)) << side << " " << hole;
    }
  }
}

TEST(Metrics, GargCropLeavesOutTheSky) {
  cv::Mat truth(100, 100, CV_32F, cv::Scalar(10));
  cv::Mat estimate = truth.clone();
  estimate.rowRange(0, 40).setTo(70);  // above 40.8 %
  Metrics m;
  ASSERT_TRUE(measure(estimate, truth, *protocol_named("kitti"), m));
  EXPECT_NEAR(m.abs_rel, 0, 1e-6);
}

TEST(Metrics, ResizeInverseDepthAndKeepItsMeaning) {
  const cv::Mat estimate = (cv::Mat_<float>(1, 2) << 1, 3);
  const cv::Mat truth = (cv::Mat_<float>(1, 4) << 1, 1.2F, 2, 3);  // 1/d: 1, 5/6, 1/2, 1/3
  Metrics m;
  ASSERT_TRUE(measure(estimate, truth, indoor, m));
  EXPECT_NEAR(m.abs_rel, 0, 1e-6);
}

// Counted: rows 45 to 470 and columns 41 to 600 of 640x480.
TEST(Metrics, NyuCropIsEigens) {
  cv::Mat truth(480, 640, CV_32F, cv::Scalar(2));
  cv::Mat estimate(480, 640, CV_32F, cv::Scalar(9));
  estimate(cv::Rect(41, 45, 560, 426)).setTo(2);
  Protocol nyu = *protocol_named("nyu");
  nyu.median_scaling = false;
  Metrics m;
  ASSERT_TRUE(measure(estimate, truth, nyu, m));
  EXPECT_EQ(m.abs_rel, 0);
  estimate.at<float>(45, 41) = 9;
  ASSERT_TRUE(measure(estimate, truth, nyu, m));
  EXPECT_GT(m.abs_rel, 0);
}

TEST(Metrics, WithoutScalingAFactorIsAnError) {
  const cv::Mat truth = (cv::Mat_<float>(1, 3) << 1, 2, 4);
  Protocol metric = indoor;
  metric.median_scaling = false;
  Metrics m;
  ASSERT_TRUE(measure(truth * 1.5, truth, metric, m));
  EXPECT_NEAR(m.abs_rel, 0.5, 1e-6);
}

TEST(Protocols, AreKnownByName) {
  EXPECT_EQ(protocol_named("make3d")->farthest, 70);
  const auto none = protocol_named("cityscapes");
  EXPECT_EQ(none.code(), StatusCode::kInvalidInput);
  EXPECT_NE(std::string(none.status().text()).find("kitti-improved"), std::string::npos);
}

// The figures that tests/fixtures/metrics/expected_metrics.py prints for the same arrays.
class AgainstTheScript : public testing::Test {
 protected:
  static double value(int i, int multiplier) { return (i * multiplier % 1009) / 1009.0; }
  void SetUp() override {
    for (int i = 0; i < 40 * 24; ++i) {
      truth_.at<float>(i / 40, i % 40) =
          i % 7 == 0 ? 0 : static_cast<float>(0.2 + 11 * value(i, 577));
      estimate_.at<float>(i / 40, i % 40) =
          static_cast<float>(0.3 + 4 * value(i, 577) + 2 * value(i, 311));
    }
  }
  void expect(const Protocol& protocol, const std::vector<double>& figures) {
    Metrics m;
    ASSERT_TRUE(measure(estimate_, truth_, protocol, m));
    const std::vector<double> ours = {m.abs_rel, m.sq_rel, m.rmse,  m.rmse_log,
                                      m.delta1,  m.delta2, m.delta3};
    for (std::size_t i = 0; i < ours.size(); ++i) {
      EXPECT_NEAR(ours[i], figures[i], 1e-6 * figures[i]) << i;
    }
  }

  cv::Mat truth_ = cv::Mat(24, 40, CV_32F);
  cv::Mat estimate_ = cv::Mat(24, 40, CV_32F);
};

TEST_F(AgainstTheScript, MedianScaledFiguresAgree) {
  expect(indoor, {0.486010704, 1.064187416, 1.438754891, 0.486228338, 0.572230014, 0.834502104,
                  0.886395512});
}

TEST_F(AgainstTheScript, UnscaledFiguresAgree) {
  Protocol metric = indoor;
  metric.median_scaling = false;
  expect(metric, {0.491674221, 1.321848585, 2.985039914, 0.624530312, 0.117812062, 0.304347826,
                  0.646563815});
}

}  // namespace
}  // namespace lcdm::model
