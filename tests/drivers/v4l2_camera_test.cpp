// What a V4L2 camera gives, against scripted kernels: formats, rates, stamps, controls, buffers.
#include <cerrno>
#include <chrono>
#include <cstdint>
#include <fcntl.h>
#include <limits>
#include <string>
#include <sys/time.h>
#include <unistd.h>

#include "firmware/base/alloc_watch.h"
#include "firmware/base/os.h"
#include "tests/drivers/v4l2_camera_fixture.h"

namespace lcdm {
namespace {

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

TEST_F(V4l2CameraTest, ItsQueueSharesBuffersWithOtherDevices) {
  const FakeV4l2 node({});
  V4l2Device device;
  ASSERT_TRUE(device.open(FakeV4l2::kPath));
  V4l2Queue queue(device);
  ASSERT_TRUE(queue.map());
  const Result<int> shared = queue.export_buffer(0);
  ASSERT_TRUE(shared) << shared.status().text();
  EXPECT_EQ(fcntl(*shared, F_GETFD), FD_CLOEXEC);
  EXPECT_EQ(close(*shared), 0);
  EXPECT_EQ(queue.export_buffer(queue.size()).code(), StatusCode::kInvalidInput);
}

TEST_F(V4l2CameraTest, ItsQueueSaysThatADriverCannotShare) {
  FakeV4l2::Behaviour behaviour;
  behaviour.shares_buffers = false;
  const FakeV4l2 node(behaviour);
  V4l2Device device;
  ASSERT_TRUE(device.open(FakeV4l2::kPath));
  V4l2Queue queue(device);
  ASSERT_TRUE(queue.map());
  EXPECT_EQ(queue.export_buffer(0).code(), StatusCode::kUnsupported);
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
  for (const std::uint32_t capture : {V4L2_CAP_VIDEO_CAPTURE, V4L2_CAP_VIDEO_CAPTURE_MPLANE}) {
    FakeV4l2::Behaviour behaviour;
    behaviour.capabilities = capture | V4L2_CAP_STREAMING;
    behaviour.fourcc = V4L2_PIX_FMT_MJPEG;
    const FakeV4l2 device(behaviour);
    V4l2Camera camera(FakeV4l2::kPath);
    open_camera(camera);
    EXPECT_EQ(camera.format().pixel, PixelFormat::kMjpeg);
    EXPECT_TRUE(camera.dequeue(milliseconds(500)));
  }
}

TEST_F(V4l2CameraTest, RefusesAFormatItCannotRead) {
  FakeV4l2::Behaviour behaviour;
  behaviour.fourcc = V4L2_PIX_FMT_SRGGB10;
  const FakeV4l2 device(behaviour);
  V4l2Camera camera(FakeV4l2::kPath);
  const Status status = camera.configure({});
  EXPECT_EQ(status.code(), StatusCode::kUnsupported);
  EXPECT_NE(std::string(status.text()).find("offers RG10"), std::string::npos);
}

TEST_F(V4l2CameraTest, ReadsEveryUncompressedFormatWholeFromEitherKindOfQueue) {
  struct Known {
    std::uint32_t fourcc;
    PixelFormat pixel;
    std::size_t bytes;
  };
  const Known known[] = {{V4L2_PIX_FMT_YUYV, PixelFormat::kYuyv, 64 * 48 * 2},
                         {V4L2_PIX_FMT_UYVY, PixelFormat::kUyvy, 64 * 48 * 2},
                         {V4L2_PIX_FMT_NV12, PixelFormat::kNv12, 64 * 48 * 3 / 2},
                         {V4L2_PIX_FMT_NV21, PixelFormat::kNv21, 64 * 48 * 3 / 2},
                         {V4L2_PIX_FMT_RGB24, PixelFormat::kRgb24, 64 * 48 * 3},
                         {V4L2_PIX_FMT_BGR24, PixelFormat::kBgr24, 64 * 48 * 3},
                         {V4L2_PIX_FMT_GREY, PixelFormat::kGrey, 64 * 48}};
  for (const std::uint32_t capture : {V4L2_CAP_VIDEO_CAPTURE, V4L2_CAP_VIDEO_CAPTURE_MPLANE}) {
    for (const Known& each : known) {
      SCOPED_TRACE(std::string(to_string(each.pixel)) + ", capability " + std::to_string(capture));
      FakeV4l2::Behaviour behaviour;
      behaviour.capabilities = capture | V4L2_CAP_STREAMING;
      behaviour.fourcc = each.fourcc;
      const FakeV4l2 device(behaviour);
      V4l2Camera camera(FakeV4l2::kPath);
      open_camera(camera);
      EXPECT_EQ(camera.format().pixel, each.pixel);
      const auto frame = camera.dequeue(milliseconds(500));
      ASSERT_TRUE(frame) << frame.status().text();
      EXPECT_EQ(frame->view.bytes, each.bytes);
    }
  }
}

FakeV4l2::Behaviour multi_planar() {
  FakeV4l2::Behaviour behaviour;
  behaviour.capabilities = V4L2_CAP_VIDEO_CAPTURE_MPLANE | V4L2_CAP_STREAMING;
  behaviour.fourcc = V4L2_PIX_FMT_NV12;
  return behaviour;
}

TEST_F(V4l2CameraTest, StreamsFromAMultiPlanarDriver) {
  const FakeV4l2 device(multi_planar());
  V4l2Camera camera(FakeV4l2::kPath);
  open_camera(camera);
  EXPECT_EQ(camera.format(), (FrameFormat{PixelFormat::kNv12, 64, 48, 64}));
  for (std::uint64_t i = 0; i < 20; ++i) {
    const auto frame = camera.dequeue(milliseconds(500));
    ASSERT_TRUE(frame) << frame.status().text();
    EXPECT_EQ(frame->view.meta.sequence, i);
    ASSERT_EQ(frame->view.bytes, 64U * 48 * 3 / 2);
    EXPECT_EQ(frame->view.data[frame->view.bytes - 1], i & 0xFF);
    ASSERT_TRUE(camera.requeue(frame->index));
  }
}

TEST_F(V4l2CameraTest, ReadsAPictureThatBeginsBehindItsPlanesStart) {
  FakeV4l2::Behaviour behaviour = multi_planar();
  behaviour.data_offset = 96;
  const FakeV4l2 device(behaviour);
  V4l2Camera camera(FakeV4l2::kPath);
  open_camera(camera);
  ASSERT_TRUE(camera.dequeue(milliseconds(500)));
  const auto second = camera.dequeue(milliseconds(500));
  ASSERT_TRUE(second) << second.status().text();
  ASSERT_EQ(second->view.bytes, 64U * 48 * 3 / 2);
  EXPECT_EQ(second->view.data[0], 1);
  EXPECT_EQ(second->view.data[second->view.bytes - 1], 1);
}

TEST_F(V4l2CameraTest, AbsurdLengthsOfAPlaneNeverReachTheReader) {
  for (const Answer absurd : {Answer::kShortFrame, Answer::kHugeFrame}) {
    FakeV4l2::Behaviour behaviour = multi_planar();
    behaviour.answer = [=](int n) { return n == 0 ? absurd : Answer::kFrame; };
    const FakeV4l2 device(behaviour);
    V4l2Camera camera(FakeV4l2::kPath);
    open_camera(camera);
    EXPECT_EQ(camera.dequeue(milliseconds(500)).code(), StatusCode::kCorrupt);
    EXPECT_TRUE(camera.dequeue(milliseconds(500)));
  }
}

TEST_F(V4l2CameraTest, RefusesPlanesInSeparateMemory) {
  FakeV4l2::Behaviour behaviour = multi_planar();
  behaviour.planes = 2;
  const FakeV4l2 device(behaviour);
  V4l2Camera camera(FakeV4l2::kPath);
  const Status status = camera.configure({});
  EXPECT_EQ(status.code(), StatusCode::kUnsupported);
  EXPECT_NE(std::string(status.text()).find("2 planes"), std::string::npos) << status.text();
}

// Only the full size is slow: judged by that, the small one would be too.
TEST_F(V4l2CameraTest, TheRateOfARangeIsThatOfTheSizeThatIsTaken) {
  FakeV4l2::Behaviour behaviour;
  behaviour.range = {{64, 64, 0}, {1920, 1088, 0}, 64, 640 * 480 * 30};
  const FakeV4l2 device(behaviour);
  V4l2Device opened;
  ASSERT_TRUE(opened.open(FakeV4l2::kPath));
  CaptureRequest request;
  request.width = 650;  // off the driver's grid, where it lists no rates
  request.height = 470;
  const std::vector<V4l2Mode> modes = list_modes(opened, request);
  ASSERT_EQ(modes.size(), 1U);
  EXPECT_EQ(modes[0].max_width, 1920);
  ASSERT_EQ(modes[0].rates.size(), 1U);
  EXPECT_NEAR(modes[0].rates[0], 640 * 480 * 30 / (640.0 * 448), 0.01);
  const auto choice = choose_mode(modes, request);
  ASSERT_TRUE(choice);
  EXPECT_EQ(choice->width, 640);
  EXPECT_EQ(choice->height, 448);
}

TEST_F(V4l2CameraTest, SaysWhatItDoesAndAtWhichRate) {
  FakeV4l2::Behaviour behaviour;
  behaviour.rate = 15;
  const FakeV4l2 device(behaviour);
  V4l2Camera camera(FakeV4l2::kPath);
  open_camera(camera);
  EXPECT_EQ(camera.info().frames_per_second, 15);
  EXPECT_EQ(camera.info().description, "fake camera, YUYV 64x48 at 15.0 frames/s");
}

TEST_F(V4l2CameraTest, AsksForTheRateThatIsWanted) {
  const FakeV4l2 device({});
  V4l2Camera camera(FakeV4l2::kPath);
  CaptureRequest request;
  request.frames_per_second = 12.5;
  ASSERT_TRUE(camera.configure(request));
  const auto period = device.period_asked();
  ASSERT_TRUE(period);
  EXPECT_FLOAT_EQ(static_cast<float>(period->denominator) / static_cast<float>(period->numerator),
                  12.5);
}

TEST_F(V4l2CameraTest, WhereNoRateCanBeSetTheDriversOwnIsSaid) {
  FakeV4l2::Behaviour behaviour;
  behaviour.refuse = [](unsigned request) { return request == VIDIOC_S_PARM ? ENOTTY : 0; };
  FakeV4l2 device(behaviour);
  V4l2Camera camera(FakeV4l2::kPath);
  open_camera(camera);
  EXPECT_EQ(camera.info().frames_per_second, 25);
  behaviour.refuse = [](unsigned request) {
    return request == VIDIOC_S_PARM || request == VIDIOC_G_PARM ? ENOTTY : 0;
  };
  device.set_behaviour(behaviour);
  open_camera(camera);
  EXPECT_EQ(camera.info().frames_per_second, 0);
  EXPECT_EQ(camera.info().description, "fake camera, YUYV 64x48 at an unknown rate");
}

TEST_F(V4l2CameraTest, FindsAFormatAtTheEndOfALongList) {
  FakeV4l2::Behaviour behaviour;
  behaviour.raw_formats = 95;
  const FakeV4l2 device(behaviour);
  V4l2Camera camera(FakeV4l2::kPath);
  open_camera(camera);
  EXPECT_EQ(camera.format().pixel, PixelFormat::kYuyv);
}

TEST_F(V4l2CameraTest, TellsWhatItsStampsMean) {
  struct Kind {
    std::uint32_t flags;
    StampSource meaning;
  };
  const Kind kinds[] = {
      {V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC | V4L2_BUF_FLAG_TSTAMP_SRC_EOF, StampSource::kEndOfFrame},
      {V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC | V4L2_BUF_FLAG_TSTAMP_SRC_SOE,
       StampSource::kStartOfExposure},
      {V4L2_BUF_FLAG_TIMESTAMP_UNKNOWN, StampSource::kArrival},
      {V4L2_BUF_FLAG_TIMESTAMP_COPY, StampSource::kArrival}};
  for (const Kind& kind : kinds) {
    FakeV4l2::Behaviour behaviour;
    behaviour.stamp_flags = kind.flags;
    const FakeV4l2 device(behaviour);
    V4l2Camera camera(FakeV4l2::kPath);
    open_camera(camera);
    EXPECT_EQ(camera.info().stamp, kind.meaning);
  }
}

timeval seconds_from_now(std::int64_t seconds) {
  return {static_cast<time_t>(os::monotonic_ns() / 1'000'000'000 + seconds), 0};
}

TEST_F(V4l2CameraTest, AStampThatCannotBeIsReplacedByTheTimeOfArrival) {
  constexpr auto kMost = std::numeric_limits<std::int64_t>::max();
  const timeval absurd[] = {{0, 0},
                            seconds_from_now(60),
                            seconds_from_now(-60),  // on this clock the machine may be younger
                            {-1, 0},
                            {kMost, 999'999},
                            {kMost / 1'000'000'000 + 1, 0},  // just beyond what nanoseconds hold
                            {seconds_from_now(0).tv_sec, -1},
                            {seconds_from_now(-1).tv_sec, kMost / 2'000}};
  for (const timeval& stamp : absurd) {
    FakeV4l2::Behaviour behaviour;
    behaviour.stamp = stamp;
    const FakeV4l2 device(behaviour);
    V4l2Camera camera(FakeV4l2::kPath);
    open_camera(camera);
    EXPECT_EQ(camera.info().stamp, StampSource::kEndOfFrame) << "nothing is known against it yet";
    const std::int64_t before = os::monotonic_ns();
    const auto frame = camera.dequeue(milliseconds(500));
    ASSERT_TRUE(frame) << frame.status().text();
    EXPECT_GE(frame->view.meta.sensor_ns, before) << stamp.tv_sec << " s " << stamp.tv_usec;
    EXPECT_LE(frame->view.meta.sensor_ns, os::monotonic_ns());
    EXPECT_EQ(frame->stamp, StampSource::kArrival);
    EXPECT_EQ(camera.info().stamp, StampSource::kArrival);
  }
}

TEST_F(V4l2CameraTest, ADriverWhoseStampWasWrongOnceIsNotAskedAgainUntilItIsReopened) {
  FakeV4l2 device({});
  V4l2Camera camera(FakeV4l2::kPath);
  open_camera(camera);
  const auto good = camera.dequeue(milliseconds(500));
  ASSERT_TRUE(good);
  EXPECT_EQ(good->stamp, StampSource::kEndOfFrame);
  FakeV4l2::Behaviour behaviour;
  behaviour.stamp = timeval{0, 0};
  device.set_behaviour(behaviour);
  EXPECT_EQ(camera.dequeue(milliseconds(500))->stamp, StampSource::kArrival);
  device.set_behaviour({});
  EXPECT_EQ(camera.dequeue(milliseconds(500))->stamp, StampSource::kArrival);
  open_camera(camera);
  EXPECT_EQ(camera.dequeue(milliseconds(500))->stamp, StampSource::kEndOfFrame);
}

TEST_F(V4l2CameraTest, LeftAloneEverythingIsAutomaticAndTheRateSteady) {
  FakeV4l2::Behaviour behaviour;
  behaviour.controls = {V4L2_CID_EXPOSURE_AUTO_PRIORITY, V4L2_CID_EXPOSURE_AUTO, V4L2_CID_AUTOGAIN,
                        V4L2_CID_AUTO_WHITE_BALANCE, V4L2_CID_POWER_LINE_FREQUENCY};
  const FakeV4l2 device(behaviour);
  V4l2Camera camera(FakeV4l2::kPath);
  open_camera(camera);
  EXPECT_EQ(device.control(V4L2_CID_EXPOSURE_AUTO_PRIORITY), 0) << "the rate never halves";
  EXPECT_EQ(device.control(V4L2_CID_EXPOSURE_AUTO), V4L2_EXPOSURE_APERTURE_PRIORITY);
  EXPECT_EQ(device.control(V4L2_CID_AUTOGAIN), 1);
  EXPECT_EQ(device.control(V4L2_CID_AUTO_WHITE_BALANCE), 1);
  EXPECT_EQ(device.control(V4L2_CID_POWER_LINE_FREQUENCY), V4L2_CID_POWER_LINE_FREQUENCY_AUTO);
}

TEST_F(V4l2CameraTest, SetsWhatIsAskedForAndSaysWhatTheCameraHasNot) {
  FakeV4l2::Behaviour behaviour;
  behaviour.controls = {V4L2_CID_EXPOSURE_AUTO, V4L2_CID_EXPOSURE_ABSOLUTE,
                        V4L2_CID_POWER_LINE_FREQUENCY};
  const FakeV4l2 device(behaviour);
  V4l2Camera camera(FakeV4l2::kPath);
  CaptureRequest request;
  request.controls = {12.5, 30, 4000, 50};
  ASSERT_TRUE(camera.configure(request));
  EXPECT_EQ(device.control(V4L2_CID_EXPOSURE_AUTO), V4L2_EXPOSURE_MANUAL);
  EXPECT_EQ(device.control(V4L2_CID_EXPOSURE_ABSOLUTE), 125) << "in steps of 100 us";
  EXPECT_EQ(device.control(V4L2_CID_POWER_LINE_FREQUENCY), V4L2_CID_POWER_LINE_FREQUENCY_50HZ);
  const std::string text = camera.info().description;
  EXPECT_NE(text.find("it cannot set gain, white balance"), std::string::npos) << text;
  EXPECT_EQ(text.find("it sets"), std::string::npos) << text;
}

TEST_F(V4l2CameraTest, SaysWhatTheCameraMadeOfAControl) {
  FakeV4l2::Behaviour behaviour;
  behaviour.controls = {V4L2_CID_EXPOSURE_ABSOLUTE, V4L2_CID_GAIN,
                        V4L2_CID_WHITE_BALANCE_TEMPERATURE};
  behaviour.most_of_a_control = 301;
  const FakeV4l2 device(behaviour);
  V4l2Camera camera(FakeV4l2::kPath);
  CaptureRequest request;
  request.controls = {40, 300, 4000, 0};
  ASSERT_TRUE(camera.configure(request));
  const std::string text = camera.info().description;
  EXPECT_NE(text.find("; it sets exposure to 30.1 ms, white balance to 301 K"), std::string::npos)
      << text;
  EXPECT_EQ(text.find("gain"), std::string::npos) << "that is what was asked for: " << text;
}

}  // namespace
}  // namespace lcdm
