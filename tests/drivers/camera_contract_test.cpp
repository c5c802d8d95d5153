// What every source of frames owes the pipeline. One suite, all sources: run it under
// `umockdev-wrapper` to include the V4L2 driver.
#include <chrono>
#include <functional>
#include <gtest/gtest.h>
#include <memory>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/videoio.hpp>
#include <ostream>
#include <set>
#include <vector>

#include "drivers/codec/codec.h"
#ifdef LCDM_LIBCAMERA
#include "drivers/libcamera/camera.h"
#endif
#include "drivers/mcap_camera.h"
#include "drivers/replay/camera.h"
#include "drivers/scene/camera.h"
#include "drivers/v4l2/camera.h"
#include "firmware/base/alloc_watch.h"
#include "firmware/base/os.h"
#include "firmware/wire/foxglove.h"
#include "firmware/wire/mcap_writer.h"
#include "tests/support/fake_v4l2.h"
#include "tests/support/file_sink.h"
#include "tests/support/temporary_folder.h"

namespace lcdm {
namespace {

using std::chrono::milliseconds;
using test::FakeV4l2;
using test::TemporaryFolder;

constexpr milliseconds kPatience{3000};  // the machine may be busy

// What a source needs around it: files, or a device that does not exist.
struct World {
  TemporaryFolder folder;
  std::unique_ptr<FakeV4l2> device;
};

struct SourceCase {
  const char* name;
  std::function<std::unique_ptr<Camera>(World&)> make;
  bool sealed = false;          // promises not to allocate between start and stop
  bool paced = true;            // keeps its own rate
  bool needs_umockdev = false;  // its device is the fake
  bool real = false;            // a device of this machine: it may lose frames and know few sizes
};

void PrintTo(const SourceCase& source, std::ostream* out) { *out << source.name; }

std::unique_ptr<Camera> make_scene(World& /*world*/) { return std::make_unique<SceneCamera>(2); }

cv::Mat numbered(int i) { return {48, 64, CV_8UC3, cv::Scalar(10.0 * i, 20, 200)}; }

std::unique_ptr<Camera> make_folder(World& world) {
  for (int i = 0; i < 5; ++i) {
    cv::imwrite(world.folder.file("image" + std::to_string(i) + ".png"), numbered(i));
  }
  return std::make_unique<ReplayCamera>(world.folder.path(), ReplayCamera::Playback::kLive);
}

std::unique_ptr<Camera> make_image(World& world) {
  cv::imwrite(world.folder.file("image.jpg"), numbered(3));
  return std::make_unique<ReplayCamera>(world.folder.file("image.jpg"),
                                        ReplayCamera::Playback::kLive);
}

std::unique_ptr<Camera> make_video(World& world) {
  const std::string path = world.folder.file("clip.avi");
  cv::VideoWriter writer(path, cv::CAP_FFMPEG, cv::VideoWriter::fourcc('M', 'J', 'P', 'G'), 30,
                         {64, 48});
  for (int i = 0; i < 5; ++i) writer.write(numbered(i));
  writer.release();
  return std::make_unique<ReplayCamera>(path, ReplayCamera::Playback::kLive);
}

std::unique_ptr<Camera> make_recording(World& world) {
  const wire::McapChannel channels[] = {{"/camera/image", wire::kCompressedImageSchema,
                                         wire::foxglove_descriptor(wire::kCompressedImageSchema)}};
  test::FileSink sink(world.folder.file("clip.mcap"));
  wire::McapWriter writer(1U << 16, 64, 64);
  EXPECT_TRUE(writer.begin(sink, channels, {}));
  std::vector<std::byte> block(1U << 15);
  for (int i = 0; i < 5; ++i) {
    std::vector<std::uint8_t> jpeg;
    cv::imencode(".jpg", numbered(i), jpeg);
    const std::int64_t stamp = 1'700'000'000'000'000'000 + i * 33'333'333LL;
    wire::ByteWriter out(block);
    wire::encode(wire::CompressedImage{stamp, "jpeg", std::as_bytes(std::span(jpeg))}, out);
    EXPECT_TRUE(writer.write_message(1, static_cast<std::uint32_t>(i),
                                     static_cast<std::uint64_t>(stamp), out.written()));
  }
  EXPECT_TRUE(writer.finish());
  return std::make_unique<McapCamera>(world.folder.path(), McapCamera::Playback::kLive);
}

std::function<std::unique_ptr<Camera>(World&)> make_v4l2(std::uint32_t fourcc,
                                                         bool multi_planar = false) {
  return [fourcc, multi_planar](World& world) {
    FakeV4l2::Behaviour behaviour;
    behaviour.fourcc = fourcc;
    if (multi_planar) behaviour.capabilities = V4L2_CAP_VIDEO_CAPTURE_MPLANE | V4L2_CAP_STREAMING;
    world.device = std::make_unique<FakeV4l2>(behaviour);
    return std::make_unique<V4l2Camera>(FakeV4l2::kPath);
  };
}

// The first camera that libcamera finds on this machine; null: none, or built without libcamera.
std::unique_ptr<Camera> make_libcamera(World& /*world*/) {
#ifdef LCDM_LIBCAMERA
  const std::vector<std::string> ids = list_libcamera_cameras();
  if (!ids.empty()) return std::make_unique<LibcameraCamera>(ids[0]);
#endif
  return nullptr;
}

// The fake's ioctls allocate in this very thread; tests/drivers/v4l2_camera_test.cpp tells those
// apart, so `sealed` stays false for it here.
const SourceCase kSources[] = {
    {"Scene", make_scene, true, true, false},
    {"ImageFolder", make_folder, false, true, false},
    {"OneImage", make_image, false, true, false},
    {"Video", make_video, false, true, false},
    {"Recording", make_recording, false, true, false},
    {"Libcamera", make_libcamera, false, false, false, true},
    {"V4l2Yuyv", make_v4l2(V4L2_PIX_FMT_YUYV), false, false, true},
    {"V4l2Uyvy", make_v4l2(V4L2_PIX_FMT_UYVY), false, false, true},
    {"V4l2Grey", make_v4l2(V4L2_PIX_FMT_GREY), false, false, true},
    {"V4l2Nv12InPlanes", make_v4l2(V4L2_PIX_FMT_NV12, true), false, false, true},
    {"V4l2MjpegInPlanes", make_v4l2(V4L2_PIX_FMT_MJPEG, true), false, false, true},
    {"V4l2Mjpeg", make_v4l2(V4L2_PIX_FMT_MJPEG), false, false, true},
};

class CameraContract : public ::testing::TestWithParam<SourceCase> {
 protected:
  void SetUp() override {
    if (GetParam().needs_umockdev && !test::umockdev_active()) {
      GTEST_SKIP() << "run under umockdev-wrapper";
    }
    camera_ = GetParam().make(world_);
    if (!camera_) GTEST_SKIP() << "this machine has no such camera";
    request_.width = 64;
    request_.height = 48;
  }
  void TearDown() override { camera_.reset(); }  // before its device

  void configure() {
    const Status status = camera_->configure(request_);
    ASSERT_TRUE(status) << status.text();
  }
  void configure_and_start() {
    ASSERT_NO_FATAL_FAILURE(configure());
    const Status status = camera_->start();
    ASSERT_TRUE(status) << status.text();
  }
  // One frame taken and given back.
  void pass_one_frame() {
    const auto frame = camera_->dequeue(kPatience);
    ASSERT_TRUE(frame) << frame.status().text();
    ASSERT_TRUE(camera_->requeue(frame->index));
  }

  World world_;
  CaptureRequest request_;
  std::unique_ptr<Camera> camera_;
};

TEST_P(CameraContract, ConfigureGivesASaneFormatModelAndDescription) {
  ASSERT_NO_FATAL_FAILURE(configure());
  const FrameFormat& format = camera_->format();
  if (!GetParam().real) {
    EXPECT_EQ(format.width, 64);
    EXPECT_EQ(format.height, 48);
  }
  EXPECT_GE(format.stride, packed_stride(format.pixel, format.width));
  const CameraModel model = camera_->model();
  EXPECT_EQ(model.width, format.width);
  EXPECT_EQ(model.height, format.height);
  EXPECT_GT(model.fx, 0);
  EXPECT_GT(model.fy, 0);
  EXPECT_GE(camera_->buffer_count(), 4);
  const CameraInfo info = camera_->info();
  EXPECT_NE(info.uri.find(':'), std::string::npos);
  EXPECT_FALSE(info.description.empty());
}

TEST_P(CameraContract, FramesRiseInSequenceAndTime) {
  ASSERT_NO_FATAL_FAILURE(configure_and_start());
  std::int64_t last = GetParam().real ? 0 : os::monotonic_ns() - 1'000'000;
  std::uint64_t expected = 0;
  for (int i = 0; i < 20; ++i) {
    const auto frame = camera_->dequeue(kPatience);
    ASSERT_TRUE(frame) << frame.status().text();
    const FrameView& view = frame->view;
    EXPECT_EQ(view.format, camera_->format());
    EXPECT_EQ(frame->stamp, camera_->info().stamp);
    EXPECT_GE(view.meta.sequence, expected);
    if (!GetParam().real) {
      EXPECT_EQ(view.meta.sequence, expected);
    }
    expected = view.meta.sequence + 1;
    EXPECT_GE(view.meta.sensor_ns, last);
    EXPECT_LE(view.meta.sensor_ns, os::monotonic_ns());
    EXPECT_NEAR(static_cast<double>(view.meta.unix_ns - view.meta.sensor_ns),
                static_cast<double>(os::unix_offset_ns()), 1e6);
    ASSERT_NE(view.data, nullptr);
    if (view.format.pixel == PixelFormat::kMjpeg) {
      EXPECT_GT(view.bytes, 0U);
    } else {
      EXPECT_GE(view.bytes, picture_bytes(view.format));
    }
    last = view.meta.sensor_ns;
    ASSERT_TRUE(camera_->requeue(frame->index));
  }
}

TEST_P(CameraContract, EveryBufferMayBeHeldAndKeepsItsPicture) {
  ASSERT_NO_FATAL_FAILURE(configure_and_start());
  std::set<int> indices;
  std::vector<CapturedFrame> held;
  std::vector<std::vector<std::uint8_t>> copies;
  for (int i = 0; i < camera_->buffer_count(); ++i) {
    const auto frame = camera_->dequeue(kPatience);
    ASSERT_TRUE(frame) << frame.status().text();
    EXPECT_GE(frame->index, 0);
    EXPECT_LT(frame->index, camera_->buffer_count());
    EXPECT_TRUE(indices.insert(frame->index).second) << "buffer lent twice";
    held.push_back(*frame);
    copies.emplace_back(frame->view.data, frame->view.data + frame->view.bytes);
  }
  for (std::size_t i = 0; i < held.size(); ++i) {
    EXPECT_TRUE(std::equal(copies[i].begin(), copies[i].end(), held[i].view.data));
  }
}

TEST_P(CameraContract, WithNoFreeBufferItTimesOutInTimeAndARequeueCuresIt) {
  ASSERT_NO_FATAL_FAILURE(configure_and_start());
  int last = -1;
  for (int i = 0; i < camera_->buffer_count(); ++i) {
    const auto frame = camera_->dequeue(kPatience);
    ASSERT_TRUE(frame) << frame.status().text();
    last = frame->index;
  }
  const std::int64_t begin = os::monotonic_ns();
  EXPECT_EQ(camera_->dequeue(milliseconds(80)).code(), StatusCode::kTimeout);
  const std::int64_t waited = os::monotonic_ns() - begin;
  EXPECT_GE(waited, 75'000'000);
  EXPECT_LT(waited, 1'000'000'000);
  ASSERT_TRUE(camera_->requeue(last));
  const auto again = camera_->dequeue(kPatience);
  ASSERT_TRUE(again) << again.status().text();
  EXPECT_EQ(again->index, last);
}

TEST_P(CameraContract, ForeignBuffersAreRefused) {
  ASSERT_NO_FATAL_FAILURE(configure_and_start());
  for (const int index : {-1, camera_->buffer_count(), 1 << 20}) {
    EXPECT_EQ(camera_->requeue(index).code(), StatusCode::kInvalidInput);
  }
  pass_one_frame();
}

TEST_P(CameraContract, StoppedWithFramesOutItStartsAgain) {
  ASSERT_NO_FATAL_FAILURE(configure_and_start());
  for (int round = 0; round < 3; ++round) {
    ASSERT_TRUE(camera_->dequeue(kPatience));  // never given back
    camera_->stop();
    EXPECT_FALSE(camera_->dequeue(milliseconds(10)));
    ASSERT_TRUE(camera_->start());
    for (int i = 0; i < camera_->buffer_count() + 1; ++i) {
      ASSERT_NO_FATAL_FAILURE(pass_one_frame());
    }
  }
}

TEST_P(CameraContract, ConfiguredAnewItWorksAgainEvenWithoutAStop) {
  for (int round = 0; round < 3; ++round) {
    ASSERT_NO_FATAL_FAILURE(configure_and_start());
    ASSERT_NO_FATAL_FAILURE(pass_one_frame());
    if (round % 2 == 0) camera_->stop();
  }
}

TEST_P(CameraContract, ClosedItWorksAgainOnceItIsConfigured) {
  for (int round = 0; round < 2; ++round) {
    ASSERT_NO_FATAL_FAILURE(configure_and_start());
    ASSERT_NO_FATAL_FAILURE(pass_one_frame());
    camera_->close();
    EXPECT_FALSE(camera_->dequeue(milliseconds(10)));
  }
}

TEST_P(CameraContract, BeforeConfigureNothingStarts) { EXPECT_FALSE(camera_->start()); }

TEST_P(CameraContract, KeepsItsPace) {
  if (!GetParam().paced) GTEST_SKIP() << "its device sets the pace";
  ASSERT_NO_FATAL_FAILURE(configure_and_start());
  const std::int64_t begin = os::monotonic_ns();
  constexpr int kFrames = 13;
  for (int i = 0; i < kFrames; ++i) ASSERT_NO_FATAL_FAILURE(pass_one_frame());
  // Not faster than 30 a second; how much slower is up to the machine. Between rounds a recording
  // and a video may begin at once.
  EXPECT_GE(os::monotonic_ns() - begin, (kFrames - 4) * 33'000'000LL);
}

TEST_P(CameraContract, SealedSourcesAllocateNothing) {
  if (!GetParam().sealed) GTEST_SKIP() << "promises nothing about memory";
  if (!alloc_watch::hooked()) GTEST_SKIP() << "built with a sanitizer, which owns malloc";
  ASSERT_NO_FATAL_FAILURE(configure_and_start());
  const std::uint64_t before = alloc_watch::thread_allocations();
  for (int i = 0; i < 10; ++i) ASSERT_NO_FATAL_FAILURE(pass_one_frame());
  EXPECT_EQ(camera_->dequeue(milliseconds(0)).code(), StatusCode::kTimeout);
  EXPECT_EQ(alloc_watch::thread_allocations(), before);
}

INSTANTIATE_TEST_SUITE_P(Sources, CameraContract, ::testing::ValuesIn(kSources),
                         [](const auto& one) { return one.param.name; });

}  // namespace
}  // namespace lcdm
