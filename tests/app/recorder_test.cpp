// What the recorder writes: read by the container's reference implementation, played back by our
// own source, and what happens when the disk does not play along.
#include "app/recorder.h"

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstring>
#include <fcntl.h>
#include <filesystem>
#include <fstream>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <string>
#include <sys/wait.h>
#include <thread>
#include <vector>

#include "drivers/codec/codec.h"
#include "drivers/mcap_camera.h"
#include "firmware/wire/foxglove.h"
#include "firmware/wire/mcap_writer.h"
#include "tests/support/file_sink.h"
#include "tests/support/temporary_folder.h"

namespace lcdm {
namespace {

namespace fs = std::filesystem;
using std::chrono::milliseconds;
using testing::HasSubstr;

constexpr FrameFormat kFormat{PixelFormat::kRgb24, 64, 48, 64 * 3};
constexpr CameraModel kCamera{64, 48, 60, 61, 31.5F, 23.5F, true};
constexpr std::int64_t kFirstStamp = 1'700'000'000'000'000'000;
constexpr std::int64_t kPeriod = 100'000'000;  // ten frames a second: a chunk holds ten

class RecorderTest : public ::testing::Test {
 protected:
  RecorderOptions options() const { return {folder_.string(), 64 << 20, 0}; }

  // Frame `number`: one grey level, so that what comes back can be told apart.
  FrameView frame(int number) {
    pixels_.assign(64 * 48 * 3, static_cast<std::uint8_t>(20 + 10 * (number % 20)));
    FrameView view{kFormat, {}, pixels_.data(), pixels_.size()};
    view.meta.sequence = static_cast<std::uint64_t>(number);
    view.meta.unix_ns = kFirstStamp + number * kPeriod;
    return view;
  }

  // Pushes as a file would: every frame waits for its turn.
  void record(Recorder& recorder, int count) {
    const Status started = recorder.start("scene:1", kFormat, kCamera);
    ASSERT_TRUE(started) << started.text();
    for (int i = 0; i < count; ++i) {
      while (recorder.status().recording && !recorder.push(frame(i))) {
        std::this_thread::sleep_for(milliseconds(1));
      }
    }
    recorder.stop();
  }

  std::vector<std::string> segments() const {
    std::vector<std::string> found;
    for (const auto& entry : fs::directory_iterator(folder_)) found.push_back(entry.path());
    std::sort(found.begin(), found.end());
    return found;
  }

  test::TemporaryFolder scratch_;
  const fs::path folder_ = scratch_.file("recordings");  // which the recorder makes
  std::vector<std::uint8_t> pixels_;
};

nlohmann::json read_with_peer(const std::string& file) {
  if (!fs::exists("tests/peers/node_modules/@mcap/core")) return {};
  FILE* pipe = popen(("node tests/peers/read_mcap.mjs " + file).c_str(), "r");
  std::string output;
  char block[4096];
  while (const std::size_t n = std::fread(block, 1, sizeof(block), pipe)) output.append(block, n);
  EXPECT_EQ(WEXITSTATUS(pclose(pipe)), 0) << "the reference reader refused " << file;
  return nlohmann::json::parse(output, nullptr, false);
}

TEST_F(RecorderTest, ASegmentIsReadByTheReferenceImplementation) {
  Recorder recorder(options());
  record(recorder, 25);
  ASSERT_EQ(segments().size(), 1U);
  const auto json = read_with_peer(segments()[0]);
  if (json.is_null()) GTEST_SKIP() << "run `npm install` in tests/peers first";
  EXPECT_EQ(json["metadata"]["lcdm"]["source"], "scene:1");
  EXPECT_EQ(json["chunks"], 3);  // one a second
  int pictures = 0;
  int calibrations = 0;
  for (const auto& message : json["messages"]) {
    if (message["topic"] == "/camera/calibration") {
      EXPECT_EQ(message["K"][0], 60);
      ++calibrations;
      continue;
    }
    EXPECT_EQ(message["stamp"], std::to_string(kFirstStamp + pictures * kPeriod));
    EXPECT_EQ(message["begins"], "ffd8ff");
    ++pictures;
  }
  EXPECT_EQ(pictures, 25);
  EXPECT_EQ(calibrations, 3);
}

TEST_F(RecorderTest, ARecordingPlaysBackAsASourceWithItsStampsAndIntrinsics) {
  Recorder recorder(options());
  record(recorder, 12);
  McapCamera camera(folder_.string(), McapCamera::Playback::kOffline);
  const Status configured = camera.configure({});
  ASSERT_TRUE(configured) << configured.text();
  EXPECT_EQ(camera.format(), (FrameFormat{PixelFormat::kMjpeg, 64, 48, 0}));
  EXPECT_TRUE(camera.model().calibrated);
  EXPECT_FLOAT_EQ(camera.model().fy, 61);
  ASSERT_TRUE(camera.start());
  for (int i = 0; i < 12; ++i) {
    const auto played = camera.dequeue(milliseconds(500));
    ASSERT_TRUE(played) << played.status().text();
    EXPECT_EQ(played->view.meta.unix_ns, kFirstStamp + i * kPeriod);
    ASSERT_TRUE(camera.requeue(played->index));
  }
  EXPECT_EQ(camera.dequeue(milliseconds(10)).code(), StatusCode::kEndOfStream);
}

// As a camera's first one after its start may be: the recorder keeps what comes.
TEST_F(RecorderTest, ADamagedFirstPictureCostsThatPictureOnly) {
  JpegWriter writer(kKeptQuality);
  const auto jpeg = writer.encode(frame(0));
  ASSERT_TRUE(jpeg) << jpeg.status().text();
  std::vector<std::uint8_t> bytes(jpeg->size());
  std::memcpy(bytes.data(), jpeg->data(), bytes.size());
  std::vector<std::uint8_t> damaged = bytes;
  std::fill_n(damaged.begin(), 16, std::uint8_t{0});
  const FrameFormat mjpeg{PixelFormat::kMjpeg, 64, 48, 0};

  Recorder recorder(options());
  ASSERT_TRUE(recorder.start("v4l2:any", mjpeg, kCamera));
  for (int i = 0; i < 5; ++i) {
    std::vector<std::uint8_t>& picture = i == 0 ? damaged : bytes;
    ASSERT_TRUE(recorder.push({mjpeg, frame(i).meta, picture.data(), picture.size()}));
  }
  recorder.stop();

  McapCamera camera(folder_.string(), McapCamera::Playback::kOffline);
  const Status configured = camera.configure({});
  ASSERT_TRUE(configured) << configured.text();
  EXPECT_EQ(camera.format(), mjpeg);
  EXPECT_EQ(camera.model().width, 64);
}

// Each chunk begins with a calibration; a foreign recording may have gigabytes between two
// pictures.
TEST_F(RecorderTest, WhateverLiesBeforeAPictureItIsWaitedForNoLongerThanAsked) {
  Recorder recorder(options());
  record(recorder, 25);
  McapCamera camera(folder_.string(), McapCamera::Playback::kOffline);
  ASSERT_TRUE(camera.configure({}));
  ASSERT_TRUE(camera.start());
  int pictures = 0;
  int timeouts = 0;
  while (true) {
    const auto played = camera.dequeue(milliseconds(0));
    if (played.code() == StatusCode::kEndOfStream) break;
    played ? ++pictures : ++timeouts;
    ASSERT_LT(timeouts, 100) << played.status().text();
    ASSERT_TRUE(!played || camera.requeue(played->index));
  }
  EXPECT_EQ(pictures, 25);
  EXPECT_EQ(timeouts, 3) << "a chunk each";
}

// Record, stop, record a moment and an hour later into the same folder: played live, both are
// skipped. At 1.2 s the pipeline would begin anew.
TEST_F(RecorderTest, LivePlaybackSkipsTheTimeBetweenTwoRecordings) {
  Recorder recorder(options());
  for (const int first : {0, 15, 36'000}) {
    ASSERT_TRUE(recorder.start("scene:1", kFormat, kCamera));
    for (int i = 0; i < 3; ++i) EXPECT_TRUE(recorder.push(frame(first + i)));
    recorder.stop();
    std::this_thread::sleep_for(milliseconds(2));  // segments are named by the millisecond
  }
  McapCamera camera(folder_.string(), McapCamera::Playback::kLive);
  ASSERT_TRUE(camera.configure({}));
  ASSERT_TRUE(camera.start());
  for (int i = 0; i < 9; ++i) {
    const auto played = camera.dequeue(milliseconds(1000));
    ASSERT_TRUE(played) << i << ": " << played.status().text();
    ASSERT_TRUE(camera.requeue(played->index));
  }
}

// As a stereo rig's recorder writes: the first pictures' camera plays, with its own intrinsics.
TEST_F(RecorderTest, OfTwoCamerasOnePlaysWithItsOwnCalibration) {
  const auto file = folder_ / "two.mcap";
  fs::create_directories(folder_);
  {
    test::FileSink sink(file.string());
    const wire::McapChannel channels[] = {
        {"/left/calibration", wire::kCameraCalibrationSchema, {}},
        {"/right/calibration", wire::kCameraCalibrationSchema, {}},
        {"/right/image", wire::kCompressedImageSchema, {}},
        {"/left/image", wire::kCompressedImageSchema, {}}};
    wire::McapWriter writer(1U << 16, 64, 64);
    ASSERT_TRUE(writer.begin(sink, channels, {}));
    std::vector<std::byte> block(1U << 14);
    const auto add = [&](std::uint16_t channel, const auto& message) {
      wire::ByteWriter out(block);
      wire::encode(message, out);
      ASSERT_TRUE(writer.write_message(channel, 0, 0, out.written()));
    };
    add(1, wire::CameraCalibration{kFirstStamp, {640, 480, 500, 500, 319.5F, 239.5F, true}});
    add(2, wire::CameraCalibration{kFirstStamp, kCamera});
    JpegWriter jpeg(kKeptQuality);
    for (int i = 0; i < 6; ++i) {
      add(i % 2 == 0 ? 3 : 4,
          wire::CompressedImage{kFirstStamp + i * kPeriod, "jpeg", *jpeg.encode(frame(i))});
    }
    ASSERT_TRUE(writer.finish());
  }
  McapCamera camera(file.string(), McapCamera::Playback::kOffline);
  const Status configured = camera.configure({});
  ASSERT_TRUE(configured) << configured.text();
  EXPECT_FLOAT_EQ(camera.model().fy, kCamera.fy);
  ASSERT_TRUE(camera.start());
  for (int i = 0; i < 6; i += 2) {
    const auto played = camera.dequeue(milliseconds(500));
    ASSERT_TRUE(played) << played.status().text();
    EXPECT_EQ(played->view.meta.unix_ns, kFirstStamp + i * kPeriod);
    ASSERT_TRUE(camera.requeue(played->index));
  }
  EXPECT_EQ(camera.dequeue(milliseconds(10)).code(), StatusCode::kEndOfStream);
}

TEST_F(RecorderTest, ASegmentThatAPowerCutLeftEmptyIsPassedOver) {
  Recorder recorder(options());
  record(recorder, 3);
  std::ofstream(folder_ / "lcdm-0.mcap").flush();    // sorts first
  std::ofstream(folder_ / "lcdm-zzz.mcap").flush();  // and last
  McapCamera camera(folder_.string(), McapCamera::Playback::kOffline);
  const Status configured = camera.configure({});
  ASSERT_TRUE(configured) << configured.text();
  ASSERT_TRUE(camera.start());
  for (int i = 0; i < 3; ++i) {
    const auto played = camera.dequeue(milliseconds(500));
    ASSERT_TRUE(played) << played.status().text();
    ASSERT_TRUE(camera.requeue(played->index));
  }
  EXPECT_EQ(camera.dequeue(milliseconds(10)).code(), StatusCode::kEndOfStream);
}

TEST_F(RecorderTest, AFullSegmentIsFollowedByTheNextWithoutLosingAFrame) {
  RecorderOptions small = options();
  small.segment_bytes = 8192;
  Recorder recorder(small);
  record(recorder, 120);
  EXPECT_GT(segments().size(), 1U);
  EXPECT_EQ(recorder.status().frames, 120U);

  McapCamera camera(folder_.string(), McapCamera::Playback::kOffline);
  ASSERT_TRUE(camera.configure({}));
  ASSERT_TRUE(camera.start());
  int played = 0;
  while (const auto next = camera.dequeue(milliseconds(500))) {
    EXPECT_EQ(next->view.meta.unix_ns, kFirstStamp + played * kPeriod);
    ASSERT_TRUE(camera.requeue(next->index));
    ++played;
  }
  EXPECT_EQ(played, 120);
}

TEST_F(RecorderTest, AFolderThatCannotBeMadeIsRefusedWithTheCure) {
  Recorder recorder({"/proc/nowhere", 1 << 20, 0});
  const Status status = recorder.start("scene:1", kFormat, kCamera);
  EXPECT_FALSE(status);
  EXPECT_NE(std::string(status.text()).find("[record] directory"), std::string::npos);
  EXPECT_FALSE(recorder.status().recording);
}

// The camera was replugged and has other frames now: what was recorded stays whole.
TEST_F(RecorderTest, NothingButFramesOfAnotherFormatEndsTheRecordingAndSaysSo) {
  Recorder recorder(options());
  ASSERT_TRUE(recorder.start("scene:1", kFormat, kCamera));
  ASSERT_TRUE(recorder.push(frame(0)));
  FrameView other = frame(1);
  other.format.width = 32;
  recorder.push_or_drop(other);
  ASSERT_TRUE(recorder.push(frame(1))) << "one odd picture is left out";
  EXPECT_EQ(recorder.status().dropped, 1U);
  for (int i = 0; i < 10; ++i) recorder.push_or_drop(other);
  while (recorder.status().recording) std::this_thread::sleep_for(milliseconds(1));
  recorder.stop();
  EXPECT_NE(recorder.status().fault.find("another format; start it again"), std::string::npos)
      << recorder.status().fault;
  EXPECT_EQ(recorder.status().frames, 2U);
  record(recorder, 2);
  EXPECT_EQ(recorder.status().fault, "");
}

// The page, the button and the network may all ask at once.
TEST_F(RecorderTest, StartedByTwoThreadsAtOnceItRecordsOnce) {
  Recorder recorder(options());
  const auto start_often = [&] {
    for (int i = 0; i < 50; ++i) EXPECT_TRUE(recorder.start("scene:1", kFormat, kCamera));
  };
  std::thread other(start_often);
  start_often();
  other.join();
  EXPECT_TRUE(recorder.push(frame(0)));
  recorder.stop();
  EXPECT_EQ(recorder.status().frames, 1U);
  EXPECT_EQ(segments().size(), 1U);
}

TEST_F(RecorderTest, CanBeStartedAgain) {
  Recorder recorder(options());
  record(recorder, 5);
  record(recorder, 3);
  EXPECT_EQ(segments().size(), 2U);
  EXPECT_EQ(recorder.status().frames, 3U) << "of this recording";
}

TEST_F(RecorderTest, ADriversPaddingBehindAPictureIsLeftOut) {
  Recorder recorder(options());
  ASSERT_TRUE(recorder.start("v4l2:/dev/video0", kFormat, kCamera));
  FrameView padded = frame(0);
  pixels_.resize(pixels_.size() + 4096);
  padded.data = pixels_.data();
  padded.bytes = pixels_.size();
  EXPECT_TRUE(recorder.push(padded));
  recorder.stop();
  EXPECT_EQ(recorder.status().frames, 1U);
}

TEST_F(RecorderTest, AFileThatIsDeletedEndsTheRecordingAndSaysSo) {
  Recorder recorder(options());
  ASSERT_TRUE(recorder.start("scene:1", kFormat, kCamera));
  fs::remove(recorder.status().file);
  for (int i = 0; recorder.status().recording && i < 1000; ++i) {
    recorder.push(frame(i));
    std::this_thread::sleep_for(milliseconds(1));
  }
  EXPECT_THAT(recorder.status().fault, HasSubstr("was deleted"));
}

TEST_F(RecorderTest, ADiskThatFillsUpEndsAWholeRecording) {
  constexpr std::int64_t kHog = 256 << 20;
  fs::create_directories(folder_);
  RecorderOptions nearly_full = options();
  nearly_full.keep_free_bytes = static_cast<std::int64_t>(fs::space(folder_).available) - kHog / 2;
  Recorder recorder(nearly_full);
  ASSERT_TRUE(recorder.start("scene:1", kFormat, kCamera));
  const std::string file = recorder.status().file;
  for (int i = 0; recorder.status().recording && i < 1000; ++i) {
    recorder.push(frame(i));
    std::this_thread::sleep_for(milliseconds(1));
    if (i != 20) continue;
    std::FILE* hog = std::fopen((folder_ / "hog").c_str(), "wbe");
    ASSERT_EQ(posix_fallocate(fileno(hog), 0, kHog), 0);
    std::fclose(hog);
  }
  EXPECT_THAT(recorder.status().fault, HasSubstr("MiB are free"));
  std::ifstream stream(file, std::ios::binary);
  const std::string bytes{std::istreambuf_iterator<char>(stream), {}};
  EXPECT_THAT(bytes, testing::EndsWith("\x89MCAP0\r\n")) << "its end is written";
}

TEST_F(RecorderTest, ADiskThatIsTooFullAlreadyIsRefusedAtTheStart) {
  RecorderOptions full = options();
  full.keep_free_bytes = std::int64_t{1} << 60;
  Recorder recorder(full);
  const Status started = recorder.start("scene:1", kFormat, kCamera);
  EXPECT_THAT(started.text(), HasSubstr("MiB are free"));
  EXPECT_EQ(segments().size(), 0U) << "no file is left";
  EXPECT_FALSE(recorder.status().recording);
}

}  // namespace
}  // namespace lcdm
