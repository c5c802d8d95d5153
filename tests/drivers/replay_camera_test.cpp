// `file:`: what it finds, in which order, and what it says about what it cannot read.
#include <gtest/gtest.h>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/videoio.hpp>
#include <sys/stat.h>

#include "drivers/replay/camera.h"
#include "drivers/replay/files.h"
#include "firmware/base/os.h"
#include "tests/support/temporary_folder.h"

namespace lcdm {
namespace {

using std::chrono::milliseconds;
using test::TemporaryFolder;
using Playback = ReplayCamera::Playback;

void write_image(const std::string& path, int width, int height, int grey) {
  ASSERT_TRUE(cv::imwrite(path, cv::Mat(height, width, CV_8UC3, cv::Scalar::all(grey))));
}

std::string text_of(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

// What an offline run gives: "name WxH grey" per frame, "!" for a broken one, to the end.
std::vector<std::string> run_offline(ReplayCamera& camera) {
  std::vector<std::string> seen;
  const Status started = camera.start();
  EXPECT_TRUE(started) << started.text();
  while (seen.size() < 100) {
    const auto frame = camera.dequeue(milliseconds(1000));
    if (frame.code() == StatusCode::kEndOfStream) return seen;
    if (!frame) {
      EXPECT_EQ(frame.code(), StatusCode::kCorrupt) << frame.status().text();
      seen.emplace_back("!");
      continue;
    }
    const FrameView& view = frame->view;
    seen.push_back(camera.frame_name(view.meta.sequence) + " " + std::to_string(view.format.width) +
                   "x" + std::to_string(view.format.height) + " " +
                   std::to_string(static_cast<int>(view.data[0])));
    EXPECT_TRUE(camera.requeue(frame->index));
  }
  return seen;
}

// The error of configuring this path.
Status failure_of(const std::string& path) {
  ReplayCamera camera(path, Playback::kOffline);
  return camera.configure({});
}

bool mentions(const Status& status, const std::string& text) {
  return std::string(status.text()).find(text) != std::string::npos;
}

TEST(ReplayFolder, GivesEachImageOnceInNaturalOrderAtItsOwnSize) {
  const TemporaryFolder folder;
  write_image(folder.file("frame10.png"), 40, 30, 10);
  write_image(folder.file("frame2.png"), 32, 24, 2);
  write_image(folder.file("frame1.BMP"), 64, 48, 1);
  write_image(folder.file("last.tif"), 20, 20, 99);
  folder.write("notes.txt", "not an image");
  ReplayCamera camera(folder.path(), Playback::kOffline);
  ASSERT_TRUE(camera.configure({}));
  const std::vector<std::string> expected{"frame1 64x48 1", "frame2 32x24 2", "frame10 40x30 10",
                                          "last 20x20 99"};
  EXPECT_EQ(run_offline(camera), expected);
  EXPECT_EQ(camera.dequeue(milliseconds(1)).code(), StatusCode::kEndOfStream);
  EXPECT_EQ(run_offline(camera), expected) << "a second start begins again";
}

// Whoever names files after the frames must not overwrite one by the other.
TEST(ReplayFolder, ImagesThatDifferOnlyInTheirExtensionKeepIt) {
  const TemporaryFolder folder;
  write_image(folder.file("a.bmp"), 32, 24, 1);
  write_image(folder.file("a.png"), 32, 24, 2);
  write_image(folder.file("b.png"), 32, 24, 3);
  ReplayCamera camera(folder.path(), Playback::kOffline);
  ASSERT_TRUE(camera.configure({}));
  EXPECT_EQ(run_offline(camera),
            (std::vector<std::string>{"a.bmp 32x24 1", "a.png 32x24 2", "b 32x24 3"}));
}

TEST(ReplayFolder, LivePlaybackResizesToTheFirstAndStartsOver) {
  const TemporaryFolder folder;
  write_image(folder.file("a.png"), 64, 48, 10);
  write_image(folder.file("b.png"), 30, 90, 20);
  ReplayCamera camera(folder.path(), Playback::kLive);
  CaptureRequest request;
  request.frames_per_second = 200;
  ASSERT_TRUE(camera.configure(request));
  ASSERT_TRUE(camera.start());
  for (std::uint64_t i = 0; i < 7; ++i) {
    const auto frame = camera.dequeue(milliseconds(1000));
    ASSERT_TRUE(frame) << frame.status().text();
    EXPECT_EQ(frame->view.meta.sequence, i);
    EXPECT_EQ(frame->view.format, camera.format());
    EXPECT_EQ(frame->view.data[0], i % 2 == 0 ? 10 : 20);
    EXPECT_EQ(camera.frame_name(i), i % 2 == 0 ? "a" : "b");
    ASSERT_TRUE(camera.requeue(frame->index));
  }
}

TEST(ReplayFolder, BrokenImagesAreNamedAndLeaveAGap) {
  const TemporaryFolder folder;
  for (const char* name : {"a.jpg", "c.jpg", "e.jpg"}) write_image(folder.file(name), 64, 48, 50);
  const std::string whole = text_of(folder.file("a.jpg"));
  folder.write("b.jpg", whole.substr(0, whole.size() * 2 / 3));
  folder.write("d.jpg", "");
  ReplayCamera camera(folder.path(), Playback::kOffline);
  ASSERT_TRUE(camera.configure({}));
  ASSERT_TRUE(camera.start());
  ASSERT_TRUE(camera.dequeue(milliseconds(1000)));
  const auto broken = camera.dequeue(milliseconds(1000));
  EXPECT_EQ(broken.code(), StatusCode::kCorrupt);
  EXPECT_TRUE(mentions(broken.status(), "b.jpg")) << broken.status().text();
  const auto next = camera.dequeue(milliseconds(1000));
  ASSERT_TRUE(next);
  EXPECT_EQ(next->view.meta.sequence, 2U);
  EXPECT_EQ(camera.frame_name(2), "c");
  EXPECT_EQ(camera.dequeue(milliseconds(1000)).code(), StatusCode::kCorrupt);
  EXPECT_TRUE(camera.dequeue(milliseconds(1000)));
  EXPECT_EQ(camera.dequeue(milliseconds(1000)).code(), StatusCode::kEndOfStream);
}

TEST(ReplayFolder, CutAndOversizedImagesAreNoticedInEveryFormat) {
  const TemporaryFolder folder;
  for (const char* name : {"x.jpg", "x.png", "x.bmp", "x.tif"}) {
    write_image(folder.file(name), 64, 48, 50);
    const std::string whole = text_of(folder.file(name));
    const std::string cut = std::string("cut_") + name;
    folder.write(cut, whole.substr(0, whole.size() / 2));
    EXPECT_EQ(failure_of(folder.file(cut)).code(), StatusCode::kCorrupt) << cut;
  }
  // A PNG that claims 60000 x 60000.
  std::string huge = text_of(folder.file("x.png"));
  huge.replace(16, 8, std::string("\0\0\xEA\x60\0\0\xEA\x60", 8));
  const Status status = failure_of(folder.write("huge.png", huge));
  EXPECT_EQ(status.code(), StatusCode::kCorrupt);
  EXPECT_TRUE(mentions(status, "longer than 8192 pixels")) << status.text();
}

// OpenCV's own limit is ten times as many pixels.
TEST(ReplayFolder, SizesAreReadBeforeADecoderTakesMemoryForThem) {
  const TemporaryFolder folder;
  const std::string sixty_thousand("\x60\xEA\0\0", 4);
  write_image(folder.file("x.bmp"), 64, 48, 50);
  std::string bmp = text_of(folder.file("x.bmp"));
  bmp.replace(18, 4, sixty_thousand);
  write_image(folder.file("x.tif"), 64, 48, 50);
  std::string tiff = text_of(folder.file("x.tif"));
  const std::string width_tag("\0\x01", 2);  // 256, behind which are its type and a count of one
  std::size_t at = tiff.find(width_tag + '\x03' + std::string("\0\x01\0\0\0", 5));
  if (at == std::string::npos) at = tiff.find(width_tag + '\x04' + std::string("\0\x01\0\0\0", 5));
  ASSERT_NE(at, std::string::npos);
  tiff.replace(at + 8, 2, sixty_thousand, 0, 2);
  for (const std::string& file : {folder.write("huge.bmp", bmp), folder.write("huge.tif", tiff)}) {
    const Status status = failure_of(file);
    EXPECT_EQ(status.code(), StatusCode::kCorrupt);
    EXPECT_TRUE(mentions(status, "longer than 8192 pixels")) << status.text();
  }
}

// It would be said twice, once by the decoder.
TEST(ReplayFolder, WhatIsNoPictureIsNotGivenToADecoder) {
  const TemporaryFolder folder;
  for (const char* bytes : {"no picture at all", "BM", "II*"}) {
    const Status status = failure_of(folder.write("a.jpg", bytes));
    EXPECT_EQ(status.code(), StatusCode::kCorrupt) << bytes;
    EXPECT_TRUE(mentions(status, "it is no JPEG") || mentions(status, "cut short"))
        << status.text();
  }
}

// To open it waits until somebody writes to it.
TEST(ReplayImage, APipeIsNoPicture) {
  const TemporaryFolder folder;
  ASSERT_EQ(mkfifo(folder.file("a.png").c_str(), 0600), 0);
  EXPECT_TRUE(mentions(failure_of(folder.file("a.png")), "no file"));
}

TEST(ReplayFolder, AnImageFollowedByOtherBytesIsWhole) {
  const TemporaryFolder folder;
  write_image(folder.file("a.jpg"), 64, 48, 50);
  folder.write("b.jpg", text_of(folder.file("a.jpg")) + std::string(100, 'x'));
  EXPECT_TRUE(failure_of(folder.file("b.jpg")));
}

TEST(ReplayErrors, SayWhatWhereAndHowToMendIt) {
  const TemporaryFolder folder;
  const Status missing = failure_of(folder.file("nothing"));
  EXPECT_EQ(missing.code(), StatusCode::kNotFound);
  EXPECT_TRUE(mentions(missing, "nothing") && mentions(missing, "give a video"));

  const Status empty = failure_of(folder.path());
  EXPECT_EQ(empty.code(), StatusCode::kNotFound);
  EXPECT_TRUE(mentions(empty, "no images"));

  const Status text = failure_of(folder.write("movie.mp4", "this is no movie"));
  EXPECT_EQ(text.code(), StatusCode::kUnsupported);
  EXPECT_TRUE(mentions(text, "movie.mp4"));

  const TemporaryFolder broken;
  broken.write("a.png", "x");
  broken.write("b.png", "y");
  EXPECT_EQ(failure_of(broken.path()).code(), StatusCode::kCorrupt);
}

TEST(ReplayImage, OneImageIsASourceOfOneFrame) {
  const TemporaryFolder folder;
  write_image(folder.file("only.jpeg"), 48, 32, 128);
  ReplayCamera camera(folder.file("only.jpeg"), Playback::kOffline);
  ASSERT_TRUE(camera.configure({}));
  EXPECT_EQ(run_offline(camera), std::vector<std::string>{"only 48x32 128"});
}

// ---- video --------------------------------------------------------------------------------------

std::string write_video(const TemporaryFolder& folder, int frames, double rate) {
  std::string path = folder.file("clip.avi");
  cv::VideoWriter writer(path, cv::CAP_FFMPEG, cv::VideoWriter::fourcc('M', 'J', 'P', 'G'), rate,
                         {64, 48});
  for (int i = 0; i < frames; ++i) {
    writer.write(cv::Mat(48, 64, CV_8UC3, cv::Scalar::all(20 * i)));
  }
  return path;
}

TEST(ReplayVideo, GivesEveryFrameOnceNumbered) {
  const TemporaryFolder folder;
  ReplayCamera camera(write_video(folder, 6, 20), Playback::kOffline);
  ASSERT_TRUE(camera.configure({}));
  EXPECT_FLOAT_EQ(camera.info().frames_per_second, 20);
  const auto seen = run_offline(camera);
  ASSERT_EQ(seen.size(), 6U);
  EXPECT_EQ(seen.front().substr(0, 12), "000000 64x48");
  EXPECT_EQ(seen.back().substr(0, 12), "000005 64x48");
}

TEST(ReplayVideo, LivePlaybackKeepsItsRateAndStartsOver) {
  const TemporaryFolder folder;
  ReplayCamera camera(write_video(folder, 4, 50), Playback::kLive);
  ASSERT_TRUE(camera.configure({}));
  ASSERT_TRUE(camera.start());
  const std::int64_t begin = os::monotonic_ns();
  for (std::uint64_t i = 0; i < 11; ++i) {
    const auto frame = camera.dequeue(milliseconds(1000));
    ASSERT_TRUE(frame) << frame.status().text();
    EXPECT_EQ(frame->view.meta.sequence, i);
    EXPECT_NEAR(frame->view.data[0], 20 * static_cast<int>(i % 4), 6);
    ASSERT_TRUE(camera.requeue(frame->index));
  }
  EXPECT_GE(os::monotonic_ns() - begin, 195'000'000);  // ten periods of 20 ms
}

TEST(ReplayVideo, ACutVideoEndsEarlyWithoutHarm) {
  const TemporaryFolder folder;
  const std::string whole = text_of(write_video(folder, 30, 20));
  ReplayCamera camera(folder.write("cut.avi", whole.substr(0, whole.size() / 2)),
                      Playback::kOffline);
  const Status status = camera.configure({});
  if (!status) return;  // some OpenCV back ends refuse it: also an answer
  EXPECT_LT(run_offline(camera).size(), 30U);
}

// ---- intrinsics ---------------------------------------------------------------------------------

constexpr const char* kIntrinsics =
    R"({"width": 128, "height": 96, "fx": 100.0, "fy": 101, "cx": 63.5, "cy": 47.5})";

CameraModel model_of(const TemporaryFolder& folder) {
  ReplayCamera camera(folder.file("rgb"), Playback::kOffline);
  const Status status = camera.configure({});
  EXPECT_TRUE(status) << status.text();
  return camera.model();
}

TEST(ReplayIntrinsics, ComeFromTheFileBesideOrAboveAndFollowTheSize) {
  const TemporaryFolder folder;
  std::filesystem::create_directory(folder.file("rgb"));
  write_image(folder.file("rgb/a.png"), 64, 48, 1);
  EXPECT_FALSE(model_of(folder).calibrated);
  folder.write("intrinsics.json", kIntrinsics);
  EXPECT_TRUE(model_of(folder).calibrated);
  EXPECT_FLOAT_EQ(model_of(folder).fx, 50);
  EXPECT_FLOAT_EQ(model_of(folder).fy, 50.5F);
  EXPECT_FLOAT_EQ(model_of(folder).cx, 31.5F);
  folder.write("rgb/intrinsics.json", R"({"width": 64, "height": 48, "intrinsics": "UNKNOWN"})");
  EXPECT_FALSE(model_of(folder).calibrated) << "the nearer file counts, and it knows nothing";
}

TEST(ReplayIntrinsics, SayNothingAboutPicturesOfAnotherShape) {
  const TemporaryFolder folder;
  std::filesystem::create_directory(folder.file("rgb"));
  write_image(folder.file("rgb/a.png"), 64, 24, 1);
  folder.write("intrinsics.json", kIntrinsics);
  EXPECT_FALSE(model_of(folder).calibrated);
}

TEST(ReplayIntrinsics, HostileFilesAreRefusedByName) {
  const TemporaryFolder folder;
  write_image(folder.file("a.png"), 64, 48, 1);
  for (const std::string& content :
       {std::string("{"), std::string("[]"), std::string("null"), std::string(2000000, '['),
        std::string(R"({"fx": "100", "fy": 1, "cx": 1, "cy": 1, "width": 64, "height": 48})"),
        std::string(R"({"fx": -5, "fy": 1, "cx": 1, "cy": 1, "width": 64, "height": 48})"),
        std::string(R"({"fx": 1e99, "fy": 1, "cx": 1, "cy": 1, "width": 64, "height": 48})"),
        std::string(R"({"fx": 100, "fy": 1, "cx": 1, "cy": 1, "width": 1e12, "height": 48})"),
        std::string(R"({"fx": 100, "fy": 1, "cx": 1, "cy": 1, "width": 64})")}) {
    folder.write("intrinsics.json", content);
    const Status status = failure_of(folder.path());
    EXPECT_EQ(status.code(), StatusCode::kInvalidInput) << content.substr(0, 80);
    EXPECT_TRUE(mentions(status, "intrinsics.json"));
  }
}

TEST(ReplayIntrinsics, OfARealPackAreRead) {
  const std::string pack = "../shared/data/driving_kitti_91";
  if (!std::filesystem::exists(pack)) GTEST_SKIP() << "no " << pack << " beside the repository";
  ReplayCamera camera(pack + "/rgb", Playback::kOffline);
  ASSERT_TRUE(camera.configure({}));
  EXPECT_EQ(camera.format().width, 1242);
  EXPECT_TRUE(camera.model().calibrated);
  EXPECT_NEAR(camera.model().fx, 721.5, 1);
}

TEST(NaturalOrder, ComparesNumbersAsNumbers) {
  using replay::natural_less;
  EXPECT_TRUE(natural_less("a2", "a10"));
  EXPECT_FALSE(natural_less("a10", "a2"));
  EXPECT_TRUE(natural_less("a02", "a3"));
  EXPECT_TRUE(natural_less("a", "a1"));
  EXPECT_TRUE(natural_less("a1b2", "a1b10"));
  EXPECT_FALSE(natural_less("a1", "a1"));
  EXPECT_NE(natural_less("a01", "a1"), natural_less("a1", "a01"));
  EXPECT_TRUE(natural_less("99999999999999999999998", "99999999999999999999999"));
}

}  // namespace
}  // namespace lcdm
