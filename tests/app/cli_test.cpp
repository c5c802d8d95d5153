// The real program, as scripts and people use it: exit statuses, one line for each bad input, and
// the interfaces that scripts rely on.
#include <algorithm>
#include <cctype>
#include <filesystem>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <iterator>
#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <opencv2/videoio.hpp>

#include "app/http_server.h"
#include "firmware/base/os.h"
#include "firmware/nn/kernels/isa.h"
#include "tests/app/program.h"
#include "tests/app/raw_client.h"
#include "tests/support/random_model.h"
#include "tests/support/temporary_folder.h"

namespace lcdm {
namespace {

namespace fs = std::filesystem;
using test::Program;
using testing::ContainsRegex;
using testing::HasSubstr;
using testing::Not;
using testing::StartsWith;

struct Outcome {
  int status;
  std::string text;
};

class Cli : public testing::Test {
 protected:
  static Outcome lcdm(const std::vector<std::string>& arguments) {
    Program program(LCDM_PROGRAM, arguments);
    const int status = program.wait();
    return {status, program.text()};
  }

  // Expects one line that says `wanted` and the status.
  static void expect_refusal(const std::vector<std::string>& arguments, int status,
                             const std::string& wanted) {
    const Outcome outcome = lcdm(arguments);
    EXPECT_EQ(outcome.status, status) << outcome.text;
    EXPECT_THAT(outcome.text, StartsWith("lcdm: "));
    EXPECT_THAT(outcome.text, HasSubstr(wanted));
    EXPECT_EQ(std::count(outcome.text.begin(), outcome.text.end(), '\n'), 1) << outcome.text;
  }

  // A folder of two pictures of different sizes.
  fs::path make_images() const {
    const fs::path images = folder_.file("images");
    fs::create_directories(images);
    cv::imwrite((images / "wide.png").string(), cv::Mat(60, 200, CV_8UC3, {40, 80, 120}));
    cv::imwrite((images / "tall.jpg").string(), cv::Mat(160, 90, CV_8UC3, {120, 80, 40}));
    return images;
  }

  std::vector<std::string> small(std::vector<std::string> arguments) const {
    for (const char* each : {"--set", "model.width=96", "--set", "model.height=64", "--model"}) {
      arguments.emplace_back(each);
    }
    arguments.push_back(model_);
    return arguments;
  }

  test::TemporaryFolder folder_;
  const std::string model_ = folder_.write(
      "model.safetensors",
      test::make_random_model(test::make_config(EncoderKind::kXxs, PresetKind::kLcdm), 1));
};

TEST_F(Cli, SaysItsVersionAndHelps) {
  EXPECT_THAT(lcdm({"--version"}).text, ContainsRegex("^lcdm [0-9]+\\.[0-9]+\\.[0-9]+\n$"));
  for (const char* command : {"run", "infer", "bench", "inspect", "check"}) {
    const Outcome help = lcdm({command, "--help"});
    EXPECT_EQ(help.status, 0) << command;
    EXPECT_THAT(help.text, HasSubstr("--help")) << command;
  }
  EXPECT_THAT(lcdm({"--help"}).text, HasSubstr("infer"));
}

TEST_F(Cli, RefusesACommandLineItDoesNotUnderstand) {
  expect_refusal({}, 2, "subcommand");
  expect_refusal({"fly"}, 2, "see lcdm --help");
  expect_refusal({"run", "--fast"}, 2, "--fast");
  expect_refusal({"infer", "--source", "scene:"}, 2, "--output");
  expect_refusal({"bench", "--threads", "0"}, 2, "--threads");
  expect_refusal({"bench", "--size", "big"}, 2, "640x192");
  expect_refusal({"bench", "--size", "100x64"}, 2, "multiples of 32");
  for (const char* format : {"yuyv", "yuyv:", "yuyv:0x0", "yuyv:63x64", "mjpeg:64x64", "x:64x64"}) {
    expect_refusal({"bench", "--source-format", format}, 2, "yuyv:640x480");
  }
  expect_refusal({"calibrate", "--board", "9"}, 2, "9x6");
}

TEST_F(Cli, RefusesACommandLineThatAsksForWhatCannotBe) {
  const std::string out = folder_.file("out");
  expect_refusal({"run", "--set", "http.port=x"}, 2, "--set http.port=x");
  expect_refusal({"run", "--listen", "example.org"}, 2, "numeric address");
  expect_refusal({"run", "--port", "web"}, 2, "--port web");
  expect_refusal({"doctor", "--set", "width=3"}, 2, "section.key=value");
  expect_refusal({"inspect", "model", "--set", "model.width=x"}, 2, "model.width = x");
  for (const char* command : {"run", "record", "calibrate"}) {
    expect_refusal({command, "--source", "webcam"}, 2, "--source webcam");
  }
  for (const char* source : {"webcam", "auto", "scene:x"}) {
    expect_refusal({"infer", "--output", out, "--model", model_, "--source", source}, 2,
                   "no such source");
  }
}

TEST_F(Cli, OnlyCommandsThatUseAModelTakeOne) {
  for (const char* command : {"record", "calibrate", "check", "probe"}) {
    expect_refusal({command, "--model", model_}, 2, "--model");
  }
}

TEST_F(Cli, CheckNamesTheLineThatIsWrong) {
  const std::string file = folder_.write("lcdm.toml", "[camera]\nwidth = 640\n");
  const Outcome valid = lcdm({"check", file});
  EXPECT_EQ(valid.status, 0);
  EXPECT_THAT(valid.text, HasSubstr("valid"));
  EXPECT_EQ(lcdm({"check", "systemd/lcdm.toml"}).status, 0);
  folder_.write("lcdm.toml", "[camera]\nwidht = 640\n");
  expect_refusal({"check", file}, 78, "lcdm.toml:2:9: no key camera.widht");
  folder_.write("lcdm.toml", "[http]\nport = 123456\n");
  expect_refusal({"check", file}, 78, "lcdm.toml:2:8: http.port = 123456");
  expect_refusal({"check", "/nowhere/lcdm.toml"}, 78, "cannot read");
}

TEST_F(Cli, EveryCommandRefusesBadConfiguration) {
  const std::string file = folder_.write("lcdm.toml", "[model]\nthreds = 1\n");
  const auto expect_both_refused = [&file](std::vector<std::string> command) {
    command.insert(command.end(), {"--config", file});
    expect_refusal(command, 78, "no key model.threds");
    command.back() = "/nowhere/lcdm.toml";
    expect_refusal(command, 78, "cannot read");
  };
  for (const char* name : {"run", "record", "calibrate", "bench", "doctor"}) {
    expect_both_refused({name});
  }
  expect_both_refused({"infer", "--source", "scene:", "--output", folder_.file("out")});
  Program program(LCDM_PROGRAM, {"run"}, {"LCDM_CAMERA_WIDTH=wide"});
  EXPECT_EQ(program.wait(), 78);
  EXPECT_THAT(program.text(), HasSubstr("LCDM_CAMERA_WIDTH"));
}

TEST_F(Cli, RefusesAModelThatIsMissingTruncatedOrHostile) {
  expect_refusal({"run", "--source", "scene:", "--model", "/nowhere.safetensors"}, 78,
                 "/nowhere.safetensors");
  expect_refusal({"bench", "--model", "/"}, 78, "cannot read the model /");
  auto bytes = test::make_random_model(test::make_config(EncoderKind::kXxs, PresetKind::kLcdm), 1);
  bytes.resize(bytes.size() / 2);
  const std::string truncated = folder_.write("truncated.safetensors", bytes);
  expect_refusal({"run", "--source", "scene:", "--model", truncated}, 78, "truncated");
  const std::string hostile = folder_.write("hostile.safetensors", std::string(8, '\xff') + "{}");
  expect_refusal({"bench", "--model", hostile}, 78, "hostile.safetensors");
  expect_refusal({"inspect", "model", hostile}, 78, "hostile.safetensors");
  const ModelConfig config = test::make_config(EncoderKind::kXxs, PresetKind::kLcdm);
  const std::string lacking =
      folder_.write("lacking.safetensors",
                    test::make_model_image(test::metadata_json(config), {{"a", {1}, {0}}}));
  EXPECT_EQ(lcdm({"inspect", "model", lacking}).status, 78);
  expect_refusal(
      {"infer", "--source", "scene:", "--output", folder_.file("out"), "--model", hostile}, 78,
      "hostile.safetensors");
  EXPECT_FALSE(fs::exists(folder_.file("out"))) << "nothing half-started";
}

TEST_F(Cli, RefusesASourceThatIsMissingOrBroken) {
  const auto run = [&](const std::string& source, const std::string& wanted) {
    expect_refusal({"run", "--port", "0", "--model", model_, "--source", source}, 1, wanted);
    expect_refusal(
        {"infer", "--output", folder_.file("out"), "--model", model_, "--source", source}, 1,
        wanted);
    EXPECT_FALSE(fs::exists(folder_.file("out"))) << "nothing half-started";
  };
  run("v4l2:/dev/null", "/dev/null");
  run("file:/nowhere.mp4", "/nowhere.mp4");
  run("mcap:/nowhere.mcap", "/nowhere.mcap");
  run("file:" + folder_.write("video.mp4", "this is no video"), "video.mp4");
  fs::create_directories(folder_.file("empty"));
  run("file:" + folder_.file("empty"), "empty");
}

TEST_F(Cli, ACameraThatIsNotPluggedInIsWaitedForByRunOnly) {
  expect_refusal({"infer", "--output", folder_.file("out"), "--model", model_, "--source",
                  "v4l2:/dev/video99"},
                 1, "/dev/video99");
  Program program(LCDM_PROGRAM,
                  {"run", "--port", "0", "--model", model_, "--source", "v4l2:serial=NOBODY"});
  ASSERT_TRUE(program.wait_for("waiting for camera")) << program.text();
  EXPECT_THAT(program.text(), HasSubstr("v4l2:serial=NOBODY: no such camera"));
  kill(program.pid(), SIGTERM);
  EXPECT_EQ(program.wait(), 0) << program.text();
}

TEST_F(Cli, RunRefusesAPortInUse) {
  HttpOptions options;
  options.listen = {"127.0.0.1"};
  const auto other = HttpServer::start(options, {});
  ASSERT_TRUE(other);
  const std::string port = std::to_string((*other)->port());
  expect_refusal({"run", "--source", "scene:", "--model", model_, "--port", port}, 1,
                 "127.0.0.1:" + port);
}

TEST_F(Cli, RunServesItsPageAndEndsWhenToldTo) {
  for (const int signal : {SIGTERM, SIGINT}) {
    Program program(LCDM_PROGRAM, small({"run", "--source", "scene:", "--port", "0"}));
    ASSERT_TRUE(program.wait_for("page    http://127.0.0.1:")) << program.text();
    ASSERT_TRUE(program.wait_for("streaming")) << program.text();
    EXPECT_THAT(program.text(), HasSubstr("\nlicence "));
    const std::size_t at = program.text().find("http://127.0.0.1:") + 17;
    const int port = std::stoi(program.text().substr(at));

    EXPECT_THAT(test::get(port, "/"), HasSubstr("<title>LCDM-Mono</title>"));
    EXPECT_THAT(test::get(port, "/healthz"), StartsWith("HTTP/1.1 200 "));
    const std::string answer = test::get(port, "/status.json");
    const auto status = nlohmann::json::parse(answer.substr(answer.find("\r\n\r\n")));
    EXPECT_EQ(status["state"], "streaming");
    EXPECT_EQ(status["source"]["uri"], "scene:1");
    EXPECT_EQ(status["depth"]["scale"], "relative");
    EXPECT_EQ(status["depth"]["calibrated"], true) << "the scene knows its own";
    EXPECT_NEAR(status["depth"]["cx"], (status["depth"]["width"].get<double>() - 1) / 2, 0.01);
    EXPECT_GT(status["depth"]["fx"], 0);
    EXPECT_GT(status["depth"]["fy"], 0);
    EXPECT_GE(status["frame"]["age_ms"], 0);

    test::RawClient viewer(port);
    viewer.send("GET /stream.mjpg HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n");
    EXPECT_THAT(viewer.read(5000, 2000), HasSubstr("X-Depth-Scale: relative"));

    kill(program.pid(), signal);
    EXPECT_EQ(program.wait(), 0) << program.text();
  }
}

TEST_F(Cli, RunTakesTheSceneWhenThereIsNoCamera) {
  if (!fs::exists("/dev/video0")) {
    Program program(LCDM_PROGRAM, small({"run", "--port", "0"}));
    ASSERT_TRUE(program.wait_for("page    http://")) << program.text();
    EXPECT_THAT(program.text(), StartsWith("no camera found"));
    EXPECT_THAT(program.text(), HasSubstr("showing the rendered scene"));
  } else {
    GTEST_SKIP() << "this machine has a camera";
  }
}

TEST_F(Cli, DepthPngHasSixteenBitsAndSaysWhatItIs) {
  Program program(LCDM_PROGRAM, small({"run", "--source", "scene:", "--port", "0"}));
  ASSERT_TRUE(program.wait_for("streaming")) << program.text();
  const std::size_t at = program.text().find("http://127.0.0.1:") + 17;
  const std::string answer = test::get(std::stoi(program.text().substr(at)), "/depth.png");
  const std::size_t body = answer.find("\r\n\r\n") + 4;
  EXPECT_THAT(answer, HasSubstr("X-Depth-Scale: relative\r\n"));
  EXPECT_THAT(answer, HasSubstr("X-Depth-Unit: millimetre\r\n"));
  EXPECT_THAT(answer, ContainsRegex("X-Frame-Age: [0-9.]+\r\n"));
  EXPECT_THAT(answer, HasSubstr("tEXtscale"));
  EXPECT_THAT(answer, HasSubstr("tEXtsource"));
  const cv::Mat bytes(1, static_cast<int>(answer.size() - body), CV_8U,
                      const_cast<char*>(answer.data() + body));
  const cv::Mat depth = cv::imdecode(bytes, cv::IMREAD_UNCHANGED);
  EXPECT_EQ(depth.type(), CV_16UC1);
  EXPECT_EQ(depth.size(), cv::Size(96, 64));
}

TEST_F(Cli, InferWritesDepthForEveryImageAtItsOwnShape) {
  const fs::path out = folder_.file("out");
  const Outcome outcome = lcdm({"infer", "--source", "file:" + make_images().string(), "--output",
                                out.string(), "--model", model_, "--float", "--colour"});
  ASSERT_EQ(outcome.status, 0) << outcome.text;
  for (const std::string name : {"tall", "wide"}) {
    const cv::Mat depth = cv::imread((out / (name + ".png")).string(), cv::IMREAD_UNCHANGED);
    const cv::Mat metres = cv::imread((out / (name + ".tiff")).string(), cv::IMREAD_UNCHANGED);
    const cv::Mat colour = cv::imread((out / (name + ".jpg")).string(), cv::IMREAD_UNCHANGED);
    ASSERT_EQ(depth.type(), CV_16UC1) << name;
    ASSERT_EQ(metres.type(), CV_32FC1) << name;
    ASSERT_EQ(colour.type(), CV_8UC3) << name;
    EXPECT_EQ(depth.size(), metres.size());
    EXPECT_EQ(depth.size(), colour.size());
    EXPECT_EQ(depth.cols > depth.rows, name == "wide") << "the network follows the picture's shape";
    cv::Mat rounded;
    metres.convertTo(rounded, CV_16U, 1000);
    EXPECT_LE(cv::norm(rounded, depth, cv::NORM_INF), 1) << "one depth in two formats";
  }
}

TEST_F(Cli, InferNamesBrokenImagesAndGoesOn) {
  const fs::path images = make_images();
  folder_.write("images/middle.png", "this is no picture");
  const fs::path out = folder_.file("out");
  const Outcome outcome =
      lcdm(small({"infer", "--source", "file:" + images.string(), "--output", out.string()}));
  EXPECT_EQ(outcome.status, 1);
  EXPECT_THAT(outcome.text, HasSubstr("middle.png"));
  EXPECT_TRUE(fs::exists(out / "wide.png")) << outcome.text;
  EXPECT_TRUE(fs::exists(out / "tall.png")) << outcome.text;
}

TEST_F(Cli, InferTakesAsManyFramesAsAskedForFromAnEndlessSource) {
  const fs::path out = folder_.file("out");
  const Outcome outcome =
      lcdm(small({"infer", "--source", "scene:7", "--output", out.string(), "--frames", "3"}));
  EXPECT_EQ(outcome.status, 0) << outcome.text;
  EXPECT_EQ(std::distance(fs::directory_iterator(out), fs::directory_iterator()), 3);
}

TEST_F(Cli, InferRefusesAFolderItCannotWrite) {
  expect_refusal(
      small({"infer", "--source", "scene:", "--frames", "1", "--output", model_ + "/below_a_file"}),
      1, "below_a_file");
}

TEST_F(Cli, InferRefusesToOverwriteItsOwnPictures) {
  const fs::path images = make_images();
  for (const fs::path& source : {images, images / "wide.png"}) {
    expect_refusal(
        small({"infer", "--source", "file:" + source.string(), "--output", images.string()}), 2,
        "its files would be overwritten");
  }
}

// Libraries have made threads before main: the signal must not end the program through them.
TEST_F(Cli, RecordEndsWithAWholeFileWhenItIsToldTo) {
  for (const int signal : {SIGTERM, SIGINT}) {
    const fs::path out = folder_.file(std::to_string(signal));
    Program program(LCDM_PROGRAM, {"record", "--source", "scene:", "--output", out.string()});
    ASSERT_TRUE(program.wait_for("file    ")) << program.text();
    std::this_thread::sleep_for(std::chrono::milliseconds(500));
    kill(program.pid(), signal);
    EXPECT_EQ(program.wait(), 0) << program.text();
    EXPECT_THAT(program.text(), ContainsRegex("[1-9][0-9]* frames"));
  }
}

// Only frames of the first one's size can be recorded; the others are lost, not waited for.
TEST_F(Cli, RecordDropsPicturesOfAnotherSize) {
  const Outcome outcome = lcdm(
      {"record", "--source", "file:" + make_images().string(), "--output", folder_.file("out")});
  EXPECT_EQ(outcome.status, 0) << outcome.text;
  EXPECT_THAT(outcome.text, HasSubstr("1 frame,"));
  EXPECT_THAT(outcome.text, HasSubstr("1 dropped"));
}

TEST_F(Cli, StatusSurvivesAFileNameThatIsNoUtf8) {
  const fs::path picture = folder_.file("caf\xe9.png");
  cv::imwrite(picture.string(), cv::Mat(60, 90, CV_8UC3, {40, 80, 120}));
  Program program(LCDM_PROGRAM,
                  small({"run", "--source", "file:" + picture.string(), "--port", "0"}));
  ASSERT_TRUE(program.wait_for("streaming")) << program.text();
  const std::size_t at = program.text().find("http://127.0.0.1:") + 17;
  const std::string answer = test::get(std::stoi(program.text().substr(at)), "/status.json");
  EXPECT_THAT(answer, StartsWith("HTTP/1.1 200 "));
  EXPECT_THAT(answer, HasSubstr("caf"));
}

TEST_F(Cli, BenchPrintsTheKeysThatScriptsRead) {
  const Outcome outcome =
      lcdm({"bench", "--json", "--size", "96x64", "--threads", "2", "--model", model_});
  ASSERT_EQ(outcome.status, 0) << outcome.text;
  const auto json = nlohmann::json::parse(outcome.text);
  EXPECT_GT(json["latency_ms"]["p50"], 0);
  EXPECT_GE(json["latency_ms"]["p99"], json["latency_ms"]["p50"]);
  EXPECT_GT(json["frames_per_second"], 0);
  EXPECT_GT(json["arena_bytes"], 0);
  EXPECT_GT(json["weight_bytes"], 1'000'000);
  EXPECT_GT(json["peak_rss_bytes"], json["weight_bytes"]);
  EXPECT_EQ(json["allocations_per_frame"], 0);
  EXPECT_GT(json["prepare_ms"], 0);
  EXPECT_EQ(json["threads"], std::min(2, os::processor_count()));
  EXPECT_EQ(json["width"], 96);
  EXPECT_EQ(json["height"], 64);
}

TEST_F(Cli, BenchReadsFramesOfACamerasFormatAndFitsThreadsToTheMachine) {
  const Outcome outcome =
      lcdm({"bench", "--size", "64x64", "--source-format", "nv12:128x96", "--profile", "--set",
            "model.precision=int8", "--threads", "64", "--model", model_});
  ASSERT_EQ(outcome.status, 0) << outcome.text;
  for (const char* wanted : {"prepared   in ", " ms\n", "preprocess", "\nlimit  "}) {
    EXPECT_THAT(outcome.text, HasSubstr(wanted));
  }
  if (os::processor_count() >= 64) return;
  EXPECT_THAT(outcome.text, HasSubstr("warning: model.threads = 64, but this program may use"));
  EXPECT_THAT(outcome.text, HasSubstr("\nthreads    " + std::to_string(os::processor_count())));
}

TEST_F(Cli, BenchTimesKernelsBesideTheMachinesLimits) {
#ifdef __SANITIZE_THREAD__
  GTEST_SKIP() << "many minutes under the thread sanitizer";
#endif
  Program program(LCDM_PROGRAM, {"bench", "--kernels"});
  ASSERT_EQ(program.wait(300), 0) << program.text();  // a minute under the address sanitizer
  for (const char* text : {"1x1", "3x3", "inverted residual", "attention", "layer norm", "head",
                           "limit of multiply-adds, GFLOP/s", "limit of copying 8 MB, GB/s"}) {
    EXPECT_THAT(program.text(), HasSubstr(text));
  }
  EXPECT_THAT(program.text(), Not(ContainsRegex("nan|inf"))) << "every kernel was timed";
}

TEST_F(Cli, AnUnknownInstructionSetIsRefusedWithThoseThereAre) {
  test::Program child("/usr/bin/env", {"LCDM_ISA=avx9", LCDM_PROGRAM, "check"});
  EXPECT_EQ(child.wait(20), 2) << child.text();
  EXPECT_THAT(child.text(), HasSubstr("LCDM_ISA=avx9"));
  EXPECT_THAT(child.text(), HasSubstr("there are"));
}

TEST_F(Cli, ALesserInstructionSetIsUsedWhereItIsAskedFor) {
  const std::vector<std::string> names = kernels::isa_names();
  const std::string& lesser = names.at(names.size() > 1 ? 1 : 0);
  std::string lower = lesser;
  for (char& c : lower) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  test::Program child("/usr/bin/env", {"LCDM_ISA=" + lower, LCDM_PROGRAM, "bench", "--json",
                                       "--size", "64x64", "--model", model_});
  ASSERT_EQ(child.wait(300), 0) << child.text();
  EXPECT_EQ(nlohmann::json::parse(child.text())["isa"], lesser);
}

TEST_F(Cli, AnEmptyInstructionSetIsNone) {
  test::Program child("/usr/bin/env", {"LCDM_ISA=", LCDM_PROGRAM, "check"});
  EXPECT_EQ(child.wait(20), 0) << child.text();
}

TEST_F(Cli, InspectShowsTheModelLayerByLayer) {
  const Outcome outcome = lcdm({"inspect", "model", model_});
  EXPECT_EQ(outcome.status, 0);
  for (const char* wanted :
       {"licence", "encoder xxs", "encoder.stem", "decoder.condition", "640", "GMAC"}) {
    EXPECT_THAT(outcome.text, HasSubstr(wanted));
  }
  // Who writes a tensor and who reads it last: the input is the first, and the stem reads it.
  EXPECT_THAT(outcome.text, ContainsRegex("\n *0 input .* encoder\\.stem\n"));
}

}  // namespace
}  // namespace lcdm
