// The V4L2 driver against scripted kernels: every answer a real one was seen to give, and some that
// only a broken one would.
#include "drivers/v4l2_camera.h"

#include <chrono>
#include <gtest/gtest.h>
#include <string>

#include "firmware/base/alloc_watch.h"
#include "firmware/base/os.h"
#include "tests/support/fake_v4l2.h"

namespace lcdm {
namespace {

using test::FakeV4l2;
using Answer = FakeV4l2::Answer;
using std::chrono::milliseconds;

class V4l2CameraTest : public ::testing::Test {
 protected:
  void SetUp() override {
    if (!test::umockdev_active()) GTEST_SKIP() << "run under umockdev-wrapper";
  }
};

FakeV4l2::Behaviour answering(std::function<Answer(int)> answer) {
  FakeV4l2::Behaviour behaviour;
  behaviour.answer = std::move(answer);
  return behaviour;
}

// Configures and starts; the test fails with the driver's own words if that does not work.
void open_camera(V4l2Camera& camera) {
  const Status configured = camera.configure({});
  ASSERT_TRUE(configured) << configured.text();
  const Status started = camera.start();
  ASSERT_TRUE(started) << started.text();
}

TEST_F(V4l2CameraTest, StreamsThreeHundredFramesInPlaceAndInOrder) {
  const FakeV4l2 device({});
  V4l2Camera camera(FakeV4l2::kPath);
  open_camera(camera);
  EXPECT_EQ(camera.format(), (FrameFormat{PixelFormat::kYuyv, 64, 48, 128}));
  for (std::uint64_t i = 0; i < 300; ++i) {
    const auto frame = camera.dequeue(milliseconds(500));
    ASSERT_TRUE(frame) << frame.status().text();
    EXPECT_EQ(frame->view.meta.sequence, i);
    EXPECT_EQ(frame->view.bytes, 64U * 48 * 2);
    EXPECT_EQ(frame->view.data[0], i & 0xFF);
    EXPECT_EQ(frame->view.data[frame->view.bytes - 1], i & 0xFF);
    EXPECT_LT(os::monotonic_ns() - frame->view.meta.sensor_ns, 1'000'000'000);
    ASSERT_TRUE(camera.requeue(frame->index));
  }
}

TEST_F(V4l2CameraTest, AllocatesNothingWhileItStreams) {
  if (!alloc_watch::hooked()) GTEST_SKIP() << "built with a sanitizer, which owns malloc";
  const FakeV4l2 device({});
  V4l2Camera camera(FakeV4l2::kPath);
  open_camera(camera);
  // umockdev's preloaded ioctl allocates in this process; reading what was dequeued must not. So
  // the count is held against the fake's own, measured on a bare requeue of the same number.
  const auto once = [&] {
    const auto frame = camera.dequeue(milliseconds(500));
    ASSERT_TRUE(frame);
    ASSERT_TRUE(camera.requeue(frame->index));
  };
  once();
  const std::uint64_t before = alloc_watch::thread_allocations();
  once();
  const std::uint64_t first = alloc_watch::thread_allocations() - before;
  for (int i = 0; i < 98; ++i) once();
  EXPECT_EQ(alloc_watch::thread_allocations() - before, 99 * first);
}

TEST_F(V4l2CameraTest, KeepsTheDriversRowPadding) {
  FakeV4l2::Behaviour behaviour;
  behaviour.row_padding = 64;
  const FakeV4l2 device(behaviour);
  V4l2Camera camera(FakeV4l2::kPath);
  open_camera(camera);
  EXPECT_EQ(camera.format().stride, 64 * 2 + 64);
}

TEST_F(V4l2CameraTest, TakesMjpegWhereThereIsNothingElse) {
  FakeV4l2::Behaviour behaviour;
  behaviour.fourcc = V4L2_PIX_FMT_MJPEG;
  const FakeV4l2 device(behaviour);
  V4l2Camera camera(FakeV4l2::kPath);
  open_camera(camera);
  EXPECT_EQ(camera.format().pixel, PixelFormat::kMjpeg);
  EXPECT_TRUE(camera.dequeue(milliseconds(500)));
}

TEST_F(V4l2CameraTest, RefusesAFormatItCannotRead) {
  FakeV4l2::Behaviour behaviour;
  behaviour.fourcc = V4L2_PIX_FMT_SRGGB10;
  const FakeV4l2 device(behaviour);
  V4l2Camera camera(FakeV4l2::kPath);
  const Status status = camera.configure({});
  EXPECT_EQ(status.code(), StatusCode::kUnsupported);
  EXPECT_NE(std::string(status.text()).find("neither YUYV nor MJPEG"), std::string::npos);
}

TEST_F(V4l2CameraTest, SkipsNodesThatCaptureNothingAndSaysWhy) {
  FakeV4l2::Behaviour behaviour;
  behaviour.capabilities = V4L2_CAP_META_CAPTURE | V4L2_CAP_STREAMING;
  const FakeV4l2 device(behaviour);
  const auto nodes = list_v4l2_nodes();
  ASSERT_EQ(nodes.size(), 1U);
  EXPECT_EQ(nodes[0].path, FakeV4l2::kPath);
  EXPECT_FALSE(nodes[0].usable);
  EXPECT_NE(nodes[0].reason.find("captures no"), std::string::npos);
}

TEST_F(V4l2CameraTest, ListsAUsableNodeWithItsName) {
  const FakeV4l2 device({});
  const auto nodes = list_v4l2_nodes();
  ASSERT_EQ(nodes.size(), 1U);
  EXPECT_TRUE(nodes[0].usable) << nodes[0].reason;
  EXPECT_EQ(nodes[0].card, "fake camera");
}

TEST_F(V4l2CameraTest, LivesWithFewerBuffersThanItAskedFor) {
  FakeV4l2::Behaviour behaviour;
  behaviour.most_buffers = 2;
  const FakeV4l2 device(behaviour);
  V4l2Camera camera(FakeV4l2::kPath);
  open_camera(camera);
  EXPECT_EQ(camera.buffer_count(), 2);
  EXPECT_TRUE(camera.dequeue(milliseconds(500)));
}

TEST_F(V4l2CameraTest, ASilentCameraIsATimeOutInTime) {
  const FakeV4l2 device(answering([](int) { return Answer::kNothing; }));
  V4l2Camera camera(FakeV4l2::kPath);
  open_camera(camera);
  const std::int64_t begin = os::monotonic_ns();
  EXPECT_EQ(camera.dequeue(milliseconds(100)).code(), StatusCode::kTimeout);
  EXPECT_LT(os::monotonic_ns() - begin, 1'000'000'000);
}

TEST_F(V4l2CameraTest, AFrameMarkedDamagedIsGivenBackAndTheNextOneComes) {
  FakeV4l2 device(answering([](int n) { return n == 1 ? Answer::kErrorFlag : Answer::kFrame; }));
  V4l2Camera camera(FakeV4l2::kPath);
  open_camera(camera);
  const auto first = camera.dequeue(milliseconds(500));
  ASSERT_TRUE(first);
  ASSERT_TRUE(camera.requeue(first->index));
  EXPECT_EQ(camera.dequeue(milliseconds(500)).code(), StatusCode::kCorrupt);
  EXPECT_EQ(device.buffers_with_driver(), camera.buffer_count());
  const auto third = camera.dequeue(milliseconds(500));
  ASSERT_TRUE(third);
  EXPECT_EQ(third->view.meta.sequence, 2U);  // the gap shows that one was lost
}

TEST_F(V4l2CameraTest, AbsurdLengthsNeverReachTheReader) {
  for (const Answer absurd : {Answer::kShortFrame, Answer::kHugeFrame}) {
    const FakeV4l2 device(answering([=](int n) { return n == 0 ? absurd : Answer::kFrame; }));
    V4l2Camera camera(FakeV4l2::kPath);
    open_camera(camera);
    EXPECT_EQ(camera.dequeue(milliseconds(500)).code(), StatusCode::kCorrupt);
    EXPECT_TRUE(camera.dequeue(milliseconds(500)));
  }
}

TEST_F(V4l2CameraTest, ABufferThatDoesNotExistIsAnErrorNotACrash) {
  const FakeV4l2 device(answering([](int) { return Answer::kWildIndex; }));
  V4l2Camera camera(FakeV4l2::kPath);
  open_camera(camera);
  EXPECT_EQ(camera.dequeue(milliseconds(500)).code(), StatusCode::kIoError);
}

TEST_F(V4l2CameraTest, AnUnpluggedCameraIsGoneAndComesBackByConfiguringAgain) {
  FakeV4l2 device(answering([](int n) { return n == 3 ? Answer::kGone : Answer::kFrame; }));
  V4l2Camera camera(FakeV4l2::kPath);
  open_camera(camera);
  for (int i = 0; i < 3; ++i) ASSERT_TRUE(camera.dequeue(milliseconds(500)));
  EXPECT_EQ(camera.dequeue(milliseconds(500)).code(), StatusCode::kDeviceGone);
  camera.stop();
  open_camera(camera);
  EXPECT_TRUE(camera.dequeue(milliseconds(500)));
}

TEST_F(V4l2CameraTest, AnIoErrorIsCuredByStoppingAndConfiguringAgain) {
  const FakeV4l2 device(
      answering([](int n) { return n == 0 ? Answer::kIoError : Answer::kFrame; }));
  V4l2Camera camera(FakeV4l2::kPath);
  open_camera(camera);
  EXPECT_EQ(camera.dequeue(milliseconds(500)).code(), StatusCode::kIoError);
  camera.stop();
  open_camera(camera);
  EXPECT_TRUE(camera.dequeue(milliseconds(500)));
}

TEST_F(V4l2CameraTest, AnotherFormatAfterReopeningIsReported) {
  FakeV4l2 device({});
  V4l2Camera camera(FakeV4l2::kPath);
  open_camera(camera);
  EXPECT_EQ(camera.format().width, 64);
  FakeV4l2::Behaviour larger;
  larger.width = 128;
  device.set_behaviour(larger);
  camera.stop();
  open_camera(camera);
  EXPECT_EQ(camera.format().width, 128);
}

TEST_F(V4l2CameraTest, TheSequenceGoesOnWhereTheDriversCounterWraps) {
  FakeV4l2::Behaviour behaviour;
  behaviour.first_sequence = 0xFFFFFFFE;
  const FakeV4l2 device(behaviour);
  V4l2Camera camera(FakeV4l2::kPath);
  open_camera(camera);
  for (std::uint64_t i = 0; i < 4; ++i) {
    const auto frame = camera.dequeue(milliseconds(500));
    ASSERT_TRUE(frame);
    EXPECT_EQ(frame->view.meta.sequence, i);
  }
}

TEST_F(V4l2CameraTest, AMissingNodeSaysWhatToDo) {
  V4l2Camera camera("/dev/video7");
  const Status status = camera.configure({});
  EXPECT_EQ(status.code(), StatusCode::kNotFound);
  EXPECT_NE(std::string(status.text()).find("/dev/video7"), std::string::npos);
  EXPECT_NE(std::string(status.text()).find("plugged in"), std::string::npos);
}

}  // namespace
}  // namespace lcdm
