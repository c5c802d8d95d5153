// What a V4L2 camera survives: every answer a real kernel was seen to give, and some that only a
// broken one would.
#include <cerrno>
#include <cstdint>
#include <cstring>
#include <limits>
#include <string>

#include "firmware/base/os.h"
#include "tests/drivers/v4l2_camera_fixture.h"

namespace lcdm {
namespace {

TEST_F(V4l2CameraTest, AnotherSignalAtItsInputAsksForConfiguringAgain) {
  FakeV4l2 device({});
  V4l2Camera camera(FakeV4l2::kPath);
  open_camera(camera);
  ASSERT_TRUE(camera.dequeue(milliseconds(500)));
  device.change_source();
  EXPECT_EQ(camera.dequeue(milliseconds(500)).code(), StatusCode::kUnavailable);
  camera.stop();
  open_camera(camera);
  EXPECT_TRUE(camera.dequeue(milliseconds(500)));
}

TEST_F(V4l2CameraTest, ADriverWhoseSourceNeverChangesRefusesTheEventRightly) {
  FakeV4l2::Behaviour behaviour;
  behaviour.refuse = [](unsigned request) {
    return request == VIDIOC_SUBSCRIBE_EVENT ? EINVAL : 0;
  };
  FakeV4l2 device(behaviour);
  V4l2Camera camera(FakeV4l2::kPath);
  open_camera(camera);
  device.change_source();
  EXPECT_TRUE(camera.dequeue(milliseconds(500)));
}

TEST_F(V4l2CameraTest, AStreamThatStoppedStartsAgainAsItIs) {
  const FakeV4l2 device(
      answering([](int n) { return n == 2 ? Answer::kIoError : Answer::kFrame; }));
  V4l2Camera camera(FakeV4l2::kPath);
  open_camera(camera);
  for (int i = 0; i < 2; ++i) ASSERT_TRUE(camera.dequeue(milliseconds(500)));
  EXPECT_EQ(camera.dequeue(milliseconds(500)).code(), StatusCode::kIoError);
  camera.stop();
  const Status started = camera.start();
  ASSERT_TRUE(started) << started.text();
  const auto frame = camera.dequeue(milliseconds(500));
  ASSERT_TRUE(frame);
  EXPECT_EQ(frame->view.meta.sequence, 0U);
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

// As v4l2loopback does to a slow reader: it writes round its ring, whoever has the buffers.
TEST_F(V4l2CameraTest, ABufferThatTheDriverDidNotHaveIsALostFrameAndStaysOurs) {
  const FakeV4l2 device(
      answering([](int n) { return n == 1 ? Answer::kSameAgain : Answer::kFrame; }));
  V4l2Camera camera(FakeV4l2::kPath);
  open_camera(camera);
  const int with_driver = device.buffers_with_driver();
  const auto held = camera.dequeue(milliseconds(500));
  ASSERT_TRUE(held);
  EXPECT_EQ(camera.dequeue(milliseconds(500)).code(), StatusCode::kCorrupt);
  EXPECT_EQ(device.buffers_with_driver(), with_driver - 1);
  EXPECT_TRUE(camera.requeue(held->index));
  EXPECT_EQ(camera.dequeue(milliseconds(500))->view.meta.sequence, 2U);
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

TEST_F(V4l2CameraTest, ARefusalNamesTheCureThatItsErrnoTells) {
  struct Case {
    int fault;
    const char* cure;
  };
  const Case cases[] = {{EBUSY, "another program holds the camera"},
                        {ENOSPC, "a smaller [camera] width and height"},
                        {EIO, ""}};
  for (const unsigned request : {VIDIOC_S_FMT, VIDIOC_REQBUFS, VIDIOC_STREAMON}) {
    for (const Case& each : cases) {
      FakeV4l2::Behaviour behaviour;
      behaviour.refuse = [&](unsigned asked) { return asked == request ? each.fault : 0; };
      const FakeV4l2 device(behaviour);
      V4l2Camera camera(FakeV4l2::kPath);
      Status status = camera.configure({});
      if (status) status = camera.start();
      EXPECT_EQ(status.sys_errno(), each.fault);
      const std::string text = status.text();
      EXPECT_NE(text.find(each.cure), std::string::npos) << text;
      EXPECT_NE(text.find(std::strerror(each.fault)), std::string::npos) << "whole: " << text;
      EXPECT_EQ(text.find("program") != std::string::npos, each.fault == EBUSY) << text;
    }
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
