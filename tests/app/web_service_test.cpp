// What the page's addresses answer while no frame comes.
#include "app/web_service.h"

#include <atomic>
#include <chrono>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <string>
#include <thread>
#include <vector>

#include "tests/app/raw_client.h"
#include "tests/app/service_fixture.h"

namespace lcdm {
namespace {

using testing::ContainsRegex;
using testing::HasSubstr;
using testing::Not;
using testing::StartsWith;

class WebServiceTest : public test::InnerServiceTest {
 protected:
  void SetUp() override {
    camera_.on_dequeue = [this](int) {
      return silent_ ? Status::error(StatusCode::kTimeout, "fake: silent") : Status::ok();
    };
    make();
    HttpOptions options;
    options.listen = {"127.0.0.1"};
    auto server = HttpServer::start(options, web_routes(*pipeline_, view_, recorder_, *service_));
    ASSERT_TRUE(server) << server.status().text();
    server_ = std::move(*server);
  }
  void TearDown() override {
    view_.stop();
    if (server_) server_->stop();
    InnerServiceTest::TearDown();
  }

  // The frames that are on their way have come, too. False after a minute.
  bool falls_silent() {
    silent_ = true;
    for (int i = 0; i < 12'000; ++i) {
      if (pipeline_->health().state() == PipelineState::kNoSignal) return true;
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
    }
    return false;
  }
  std::string depth_png() const {
    return test::request(server_->port(), "GET", "/depth.png", "Host: 127.0.0.1\r\n", 60'000);
  }

  std::atomic<bool> silent_{false};
  std::unique_ptr<HttpServer> server_;
};

// The parts of a stream that came whole.
std::vector<std::string> parts_of(const std::string& stream) {
  const std::string mark = "--frame\r\n";
  std::vector<std::string> parts;
  std::size_t begin = stream.find(mark);
  for (std::size_t end; begin != std::string::npos; begin = end) {
    end = stream.find(mark, begin + mark.size());
    if (end != std::string::npos) parts.push_back(stream.substr(begin, end - begin));
  }
  return parts;
}

cv::Mat picture_of(const std::string& part) {
  const std::size_t body = part.find("\r\n\r\n") + 4;
  return cv::imdecode(
      std::vector<char>(part.begin() + static_cast<std::ptrdiff_t>(body), part.end()),
      cv::IMREAD_COLOR);
}

TEST_F(WebServiceTest, AStreamWithoutFramesSaysSoOnItsLastPictureEverySecond) {
  ASSERT_TRUE(pipeline_->start());
  test::RawClient viewer(server_->port());
  viewer.send("GET /stream.mjpg?view=colour HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n");
  EXPECT_THAT(viewer.read(60'000, 4000), HasSubstr("X-Frame-Stamp: "));
  silent_ = true;
  std::vector<std::string> said;
  std::string stream;
  for (int i = 0; i < 600 && said.size() < 2; ++i) {
    stream += viewer.read(100);
    said.clear();
    for (const std::string& part : parts_of(stream)) {
      if (part.find("X-Frame-Stamp: ") == std::string::npos) said.push_back(part);
    }
  }
  ASSERT_EQ(said.size(), 2U);
  EXPECT_THAT(said[0], ContainsRegex("X-Frame-Age: [0-9]{4,}\\.[0-9]\r\n")) << "over a second";
  const cv::Mat picture = picture_of(said[0]);
  ASSERT_EQ(picture.size(), cv::Size(64, 48)) << "as large as it was";
  cv::Mat channels[3];
  cv::split(picture, channels);
  EXPECT_LE(cv::norm(channels[0], channels[2], cv::NORM_INF), 2) << "grey";
  double darkest = 0;
  double brightest = 0;
  cv::minMaxLoc(channels[1], &darkest, &brightest);
  EXPECT_LT(darkest, 60) << "it was 100";
  EXPECT_GT(brightest, 120) << "the text";
}

TEST_F(WebServiceTest, AStreamThatNeverHadAFrameSaysSoToo) {
  silent_ = true;
  ASSERT_TRUE(pipeline_->start());
  test::RawClient viewer(server_->port());
  viewer.send("GET /stream.mjpg HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n");
  std::string stream;
  for (int i = 0; i < 600 && parts_of(stream).empty(); ++i) stream += viewer.read(100);
  ASSERT_FALSE(parts_of(stream).empty());
  EXPECT_THAT(stream, Not(HasSubstr("X-Frame-")));
  EXPECT_EQ(picture_of(parts_of(stream)[0]).size(), cv::Size(640, 480));
}

TEST_F(WebServiceTest, DepthWithoutASignalIsRefusedWithTheAgeOfTheLastFrame) {
  ASSERT_TRUE(pipeline_->start());
  EXPECT_THAT(depth_png(), StartsWith("HTTP/1.1 200 "));
  ASSERT_TRUE(falls_silent());
  const std::string answer = depth_png();
  EXPECT_THAT(answer, StartsWith("HTTP/1.1 503 "));
  EXPECT_THAT(answer, ContainsRegex("X-Frame-Age: [0-9]+\\.[0-9]\r\n"));
  EXPECT_THAT(answer, ContainsRegex("\nno signal, last frame [0-9]+ s ago: fake: silent\n"));
}

TEST_F(WebServiceTest, DepthThatNeverCameHasNoAge) {
  silent_ = true;
  ASSERT_TRUE(pipeline_->start());
  const std::string answer = depth_png();
  EXPECT_THAT(answer, StartsWith("HTTP/1.1 503 "));
  EXPECT_THAT(answer, Not(HasSubstr("X-Frame-Age")));
  EXPECT_THAT(answer, HasSubstr("\nno signal: fake: silent\n"));
}

}  // namespace
}  // namespace lcdm
