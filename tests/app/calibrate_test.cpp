// lcdm calibrate: true intrinsics are found again, bad views are refused with their cure, and the
// file does what it says.
#include <cmath>
#include <filesystem>
#include <fstream>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <regex>

#include "app/board_calibrator.h"
#include "app/calibrated_camera.h"
#include "app/calibration_file.h"
#include "drivers/mcap_camera.h"
#include "tests/app/program.h"
#include "tests/app/rendered_board.h"
#include "tests/firmware_pipeline/fake_camera.h"
#include "tests/support/temporary_folder.h"

namespace lcdm {
namespace {

namespace fs = std::filesystem;
using test::BoardRenderer;
using test::Pose;
using test::TrueCamera;
using testing::EndsWith;
using testing::HasSubstr;
using Verdict = BoardCalibrator::Verdict;

constexpr BoardSize kBoard{7, 5};

RgbPicture picture_of(const cv::Mat& bgr) {
  RgbPicture picture;
  picture.resize(bgr.cols, bgr.rows);
  cv::Mat rgb(bgr.rows, bgr.cols, CV_8UC3, picture.pixels.data());
  cv::cvtColor(bgr, rgb, cv::COLOR_BGR2RGB);
  return picture;
}

BoardCalibrator shown(const std::vector<Pose>& poses, const TrueCamera& camera = {}) {
  const BoardRenderer renderer(camera);
  BoardCalibrator calibrator(kBoard, camera.width, camera.height);
  for (const Pose& pose : poses) {
    calibrator.add(picture_of(renderer.render(kBoard.columns, kBoard.rows, pose)));
  }
  return calibrator;
}

TEST(BoardCalibrator, FindsTheTrueCameraAgain) {
  const TrueCamera truth{640, 480, {524, 0, 326.5, 0, 528, 234.5, 0, 0, 1}};
  const BoardCalibrator calibrator = shown(test::good_poses(), truth);
  const Result<Calibration> found = calibrator.solve();
  ASSERT_TRUE(found) << found.status().text();
  EXPECT_LT(found->rms_error, 0.15);
  EXPECT_GE(found->views, BoardCalibrator::kFewestViews);
  EXPECT_NEAR(found->model.fx, truth.matrix(0, 0), 0.005 * truth.matrix(0, 0));
  EXPECT_NEAR(found->model.fy, truth.matrix(1, 1), 0.005 * truth.matrix(1, 1));
  EXPECT_NEAR(found->model.cx, truth.matrix(0, 2), 2);
  EXPECT_NEAR(found->model.cy, truth.matrix(1, 2), 2);
  // Coefficients may trade among themselves; where things are seen may not.
  for (const double x : {-0.5, -0.25, 0.0, 0.25, 0.5}) {
    for (const double y : {-0.35, 0.0, 0.35}) {
      std::vector<cv::Point2d> expected;
      cv::projectPoints(std::vector<cv::Point3d>{{x, y, 1}}, cv::Vec3d(), cv::Vec3d(), truth.matrix,
                        truth.lens, expected);
      const Point seen = found->model.project({x, y});
      EXPECT_NEAR(seen.x - found->model.cx, expected[0].x - truth.matrix(0, 2), 0.7);
      EXPECT_NEAR(seen.y - found->model.cy, expected[0].y - truth.matrix(1, 2), 0.7);
    }
  }
}

// samples/data/left_intrinsics.yml of OpenCV: fx = fy = 535.916, centre 342.283, 235.571.
TEST(BoardCalibrator, AgreesWithOpenCvAboutItsOwnPictures) {
  const fs::path folder = "/usr/share/doc/opencv-doc/examples/data";
  if (!fs::exists(folder / "left01.jpg")) GTEST_SKIP() << "package opencv-doc is not installed";
  BoardCalibrator calibrator({9, 6}, 640, 480);
  for (int i = 1; i <= 14; ++i) {
    char name[16];
    std::snprintf(name, sizeof(name), "left%02d.jpg", i);
    const cv::Mat bgr = cv::imread((folder / name).string());
    if (!bgr.empty()) calibrator.add(picture_of(bgr));
  }
  const Result<Calibration> found = calibrator.solve();
  ASSERT_TRUE(found) << found.status().text();
  EXPECT_LT(found->rms_error, 0.4) << "theirs";
  EXPECT_NEAR(found->model.fx, 535.916, 0.01 * 535.916);
  EXPECT_NEAR(found->model.fy, 535.916, 0.01 * 535.916);
  EXPECT_NEAR(found->model.cx, 342.283, 3);
  EXPECT_NEAR(found->model.cy, 235.571, 3);
}

TEST(BoardCalibrator, JudgesEveryView) {
  const BoardRenderer renderer{TrueCamera{}};
  const cv::Mat sharp = renderer.render(7, 5, {{0.2, 0.3, 0}, {0, 0, 13}});
  cv::Mat blurred;
  cv::GaussianBlur(sharp, blurred, {0, 0}, 2.5);
  BoardCalibrator calibrator(kBoard, 320, 240);
  EXPECT_EQ(calibrator.add(picture_of(blurred)), Verdict::kBlurred);
  EXPECT_EQ(calibrator.add(picture_of(cv::Mat(240, 320, CV_8UC3, {90, 90, 90}))),
            Verdict::kNoBoard);
  EXPECT_EQ(calibrator.add(picture_of(renderer.render(7, 5, {{0, 0, 0}, {7, 0, 13}}))),
            Verdict::kNoBoard)
      << "half of it outside";
  EXPECT_EQ(calibrator.views(), 0);
  EXPECT_EQ(calibrator.add(picture_of(sharp)), Verdict::kTaken);
  EXPECT_EQ(calibrator.add(picture_of(sharp)), Verdict::kRepeated);
  EXPECT_EQ(calibrator.add(picture_of(renderer.render(7, 5, {{0.2, 0.3, 0}, {0.2, 0, 13}}))),
            Verdict::kRepeated)
      << "hardly moved";
  EXPECT_EQ(calibrator.views(), 1);
}

TEST(BoardCalibrator, SendsTheBoardWhereItWasNotYet) {
  EXPECT_EQ(shown({}).where_next(), "at the top left");
  EXPECT_EQ(shown({{{0, 0, 0}, {-3, -2.5, 13}}}).where_next(), "at the top right");
}

TEST(BoardCalibrator, RefusesWhatCannotBeReliedOnAndSaysTheCure) {
  const auto refusal = [](const std::vector<Pose>& poses) {
    const Result<Calibration> found = shown(poses).solve();
    EXPECT_EQ(found.code(), StatusCode::kUnavailable);
    return std::string(found ? "accepted" : found.status().text());
  };
  std::vector<Pose> few = test::good_poses();
  few.resize(5);
  EXPECT_THAT(refusal(few), HasSubstr("5 good views"));

  std::vector<Pose> middle;
  std::vector<Pose> facing;
  for (int i = 0; i < 12; ++i) {
    middle.push_back({{0.5 * std::sin(i), 0.5 * std::cos(i), 0.25 * i}, {0, 0, 14}});
    facing.push_back({{0, 0, 0}, {(i % 4 - 1.5) * 2.2, (i / 4 - 1) * 2.6, 12}});
  }
  EXPECT_THAT(refusal(middle), HasSubstr("cover"));
  EXPECT_THAT(refusal(facing), HasSubstr("tilted in fewer than 4 views"));
}

TEST(BoardCalibrator, RefusesViewsThatNoOneCameraCouldSee) {
  TrueCamera other;
  other.matrix = {330, 0, 163, 0, 220, 117, 0, 0, 1};
  const BoardRenderer one{TrueCamera{}};
  const BoardRenderer two(other);
  BoardCalibrator calibrator(kBoard, 320, 240);
  int i = 0;
  for (const Pose& pose : test::good_poses()) {
    calibrator.add(picture_of((++i % 2 == 0 ? one : two).render(7, 5, pose)));
  }
  EXPECT_THAT(std::string(calibrator.solve().status().text()), HasSubstr("misses the corners"));
}

// ---- the file -----------------------------------------------------------------------------------

class CalibrationFile : public testing::Test {
 protected:
  static Calibration make_calibration() {
    Calibration calibration;
    calibration.camera = "v4l2:/dev/v4l/by-id/a \"quoted\" \\ name";
    calibration.date = "2026-11-21T11:30:05Z";
    calibration.views = 15;
    calibration.rms_error = 0.1875;
    calibration.model = {320, 240,      262.25F, 264.5F,
                         163, 117.125F, true,    {-0.24F, 0.06F, 0.001F, -1e-6F, 0, 0, 0, 0}};
    return calibration;
  }

  // The error after `from` in the file became `to`, without the folder.
  std::string error_after(const std::string& from, const std::string& to) const {
    EXPECT_TRUE(write_calibration(file_, make_calibration()));
    std::ifstream in(file_);
    std::string text{std::istreambuf_iterator<char>(in), {}};
    EXPECT_NE(text.find(from), std::string::npos) << from;
    text.replace(text.find(from), from.size(), to);
    std::ofstream(file_) << text;
    const auto read = read_calibration(file_);
    return read ? "accepted" : std::string(read.status().text()).substr(folder_.path().size() + 1);
  }

  test::TemporaryFolder folder_;
  const std::string file_ = folder_.file("calibration.toml");
};

TEST_F(CalibrationFile, ComesBackAsItWasWritten) {
  const Calibration written = make_calibration();
  ASSERT_TRUE(write_calibration(file_, written));
  ASSERT_TRUE(write_calibration(file_, written)) << "over the old one";
  const auto read = read_calibration(file_);
  ASSERT_TRUE(read) << read.status().text();
  EXPECT_EQ(read->camera, written.camera);
  EXPECT_EQ(read->date, written.date);
  EXPECT_EQ(read->views, written.views);
  EXPECT_EQ(read->rms_error, written.rms_error);
  EXPECT_EQ(read->model, written.model);
  EXPECT_FALSE(write_calibration(folder_.file("nowhere/c.toml"), written));
}

TEST_F(CalibrationFile, FollowsNoLinkThatWasPlantedAtItsUnfinishedName) {
  const std::string target = folder_.write("precious", "keep");
  fs::create_symlink(target, file_ + ".new");
  EXPECT_TRUE(write_calibration(file_, make_calibration()));
  EXPECT_TRUE(read_calibration(file_));
  std::string kept;
  std::ifstream(target) >> kept;
  EXPECT_EQ(kept, "keep");
}

// Another one is there in its place, or it came back on a slower bus with smaller pictures.
TEST_F(CalibrationFile, OfACameraThatCanBePluggedWaitsForThatCamera) {
  const auto configured = [](bool pluggable) {
    auto camera = std::make_unique<test::FakeCamera>();
    camera->format_of = [](int) { return FrameFormat{PixelFormat::kRgb24, 64, 36, 64 * 3}; };
    return CalibratedCamera(std::move(camera), make_calibration(), pluggable).configure({}).code();
  };
  EXPECT_EQ(configured(false), StatusCode::kInvalidInput);
  EXPECT_EQ(configured(true), StatusCode::kNotFound);
}

TEST_F(CalibrationFile, IsReadStrictly) {
  EXPECT_THAT(error_after("version = 1", "version = 2"),
              HasSubstr("calibration.toml:3:11: version must be a whole number from 1 to 1"));
  EXPECT_THAT(error_after("fx = 262.25", "fx = -3"),
              HasSubstr("calibration.toml:14:6: intrinsics.fx"));
  EXPECT_THAT(error_after("fx = 262.25", "fx = nan"), HasSubstr("intrinsics.fx must be"));
  EXPECT_THAT(error_after("fx = 262.25", "fx = \"wide\""), HasSubstr("intrinsics.fx must be"));
  EXPECT_THAT(error_after("width = 320", "width = 320.5"), HasSubstr("whole number"));
  EXPECT_THAT(error_after("fx = 262.25\n", ""), EndsWith("intrinsics.fx is missing: make the file "
                                                         "with lcdm calibrate"));
  EXPECT_THAT(error_after("k1 = ", "k9 = "), HasSubstr("no key lens.k9"));
  EXPECT_THAT(error_after("camera = \"", "camera = 3 #"), HasSubstr("camera must be a text"));
  EXPECT_THAT(error_after("[lens]", "[lens"), HasSubstr("calibration.toml:"));
  EXPECT_THAT(error_after("[lens]", "[picture.lens]"), HasSubstr("picture.lens"));
  EXPECT_THAT(std::string(read_calibration("/nowhere.toml").status().text()),
              HasSubstr("cannot read the calibration"));
}

TEST_F(CalibrationFile, FollowsTheSizeButNotTheShape) {
  const Calibration calibration = make_calibration();
  EXPECT_EQ(*model_for(calibration, 320, 240), calibration.model);
  const auto twice = model_for(calibration, 640, 480);
  ASSERT_TRUE(twice);
  EXPECT_EQ(twice->fx, 524.5F);
  EXPECT_EQ(twice->distortion, calibration.model.distortion);
  EXPECT_THAT(std::string(model_for(calibration, 640, 360).status().text()),
              HasSubstr("calibration is of 320x240, pictures of 640x360"));
}

// ---- the command --------------------------------------------------------------------------------

class CalibrateCommand : public CalibrationFile {
 protected:
  struct Outcome {
    int status;
    std::string text;
  };
  static Outcome lcdm(const std::vector<std::string>& arguments) {
    test::Program program(LCDM_PROGRAM, arguments);
    const int status = program.wait();
    return {status, program.text()};
  }

  // Pictures of the board, and one without.
  std::string make_pictures(int count) const {
    const BoardRenderer renderer{TrueCamera{}};
    const fs::path pictures = folder_.file("pictures");
    fs::create_directories(pictures);
    const auto poses = test::good_poses();
    for (int i = 0; i < count; ++i) {
      cv::imwrite((pictures / ("view" + std::to_string(10 + i) + ".png")).string(),
                  renderer.render(7, 5, poses[static_cast<std::size_t>(i)]));
    }
    cv::imwrite((pictures / "wall.png").string(), cv::Mat(240, 320, CV_8UC3, {90, 90, 90}));
    return "file:" + pictures.string();
  }
};

TEST_F(CalibrateCommand, MakesAFileThatRecordingsCarry) {
  const std::string source = make_pictures(15);
  const Outcome made = lcdm({"calibrate", "--source", source, "--board", "7x5", "--output", file_});
  ASSERT_EQ(made.status, 0) << made.text;
  EXPECT_THAT(made.text, HasSubstr("view10: taken"));
  EXPECT_THAT(made.text, HasSubstr("wall: no board"));
  EXPECT_THAT(made.text, HasSubstr("written to " + file_));
  const auto calibration = read_calibration(file_);
  ASSERT_TRUE(calibration) << calibration.status().text();
  EXPECT_EQ(calibration->camera, source);
  EXPECT_TRUE(
      std::regex_match(calibration->date, std::regex(R"(\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ)")));

  const std::string recording = folder_.file("recording");
  const Outcome recorded = lcdm({"record", "--source", source, "--output", recording, "--set",
                                 "camera.calibration=" + file_});
  ASSERT_EQ(recorded.status, 0) << recorded.text;
  McapCamera camera(recording, McapCamera::Playback::kOffline);
  ASSERT_TRUE(camera.configure({}));
  EXPECT_EQ(camera.model(), calibration->model);
}

TEST_F(CalibrateCommand, RefusesTooFewViewsAndWritesNothing) {
  const Outcome outcome =
      lcdm({"calibrate", "--source", make_pictures(4), "--board", "7x5", "--output", file_});
  EXPECT_EQ(outcome.status, 1) << "more views may cure it";
  EXPECT_THAT(outcome.text, HasSubstr("10 are needed"));
  EXPECT_FALSE(fs::exists(file_));
}

TEST_F(CalibrateCommand, ACalibrationOfAnotherShapeIsRefusedByWhateverUsesIt) {
  Calibration calibration = make_calibration();
  calibration.model.height = 180;
  ASSERT_TRUE(write_calibration(file_, calibration));
  const std::string source = make_pictures(1);
  const Outcome outcome = lcdm({"record", "--source", source, "--output", folder_.path(), "--set",
                                "camera.calibration=" + file_});
  EXPECT_EQ(outcome.status, 78);
  EXPECT_THAT(outcome.text, HasSubstr("calibration is of 320x180"));
}

TEST_F(CalibrateCommand, LiveItGuidesUntilItIsToldToEnd) {
  test::Program program(LCDM_PROGRAM, {"calibrate", "--source", "scene:", "--output", file_});
  ASSERT_TRUE(program.wait_for("hold the board before the camera"));
  ASSERT_TRUE(program.wait_for("no board, or not all of it"));
  kill(program.pid(), SIGINT);
  EXPECT_EQ(program.wait(), 1);
  EXPECT_THAT(program.text(), HasSubstr("0 good views"));
  EXPECT_FALSE(fs::exists(file_));
}

TEST_F(CalibrateCommand, UnderstandsItsBoardOrSaysHowToWriteIt) {
  EXPECT_EQ(lcdm({"calibrate", "--board", "9"}).status, 2);
  EXPECT_EQ(lcdm({"calibrate", "--board", "2x9"}).status, 2);
}

}  // namespace
}  // namespace lcdm
