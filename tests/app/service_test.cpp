// `lcdm run` as systemd runs it: what it says on the notification socket, when, and what stops it.
#include <filesystem>
#include <fstream>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <regex>
#include <sys/ptrace.h>
#include <sys/stat.h>

#include "app/config.h"
#include "app/control.h"
#include "app/engine_factory.h"
#include "firmware/health/indicator.h"
#include "tests/app/program.h"
#include "tests/app/raw_client.h"
#include "tests/support/notify_socket.h"
#include "tests/support/random_model.h"
#include "tests/support/temporary_folder.h"

namespace lcdm {
namespace {

namespace fs = std::filesystem;
using test::Program;
using testing::HasSubstr;
using testing::Not;
using testing::StartsWith;

class ServiceTest : public testing::Test {
 protected:
  // `lcdm run` of a small network, with these arguments more.
  std::vector<std::string> arguments(const std::vector<std::string>& more) const {
    std::vector<std::string> all = {"run",
                                    "--port",
                                    "0",
                                    "--model",
                                    model_,
                                    "--set",
                                    "model.width=96",
                                    "--set",
                                    "model.height=64",
                                    "--set",
                                    "record.directory=" + folder_.file("recordings")};
    all.insert(all.end(), more.begin(), more.end());
    return all;
  }
  std::vector<std::string> environment() const {
    return {"NOTIFY_SOCKET=" + socket_.path(), "WATCHDOG_USEC=400000"};
  }

  // The next message that begins so; empty when none comes.
  std::string message(const std::string& start) {
    for (int i = 0; i < 200; ++i) {
      std::string text = socket_.next(30'000);
      if (text.empty() || text.rfind(start, 0) == 0) return text;
    }
    return {};
  }

  static int port_of(const Program& program) {
    const std::string mark = "http://127.0.0.1:";
    return std::stoi(program.text().substr(program.text().find(mark) + mark.size()));
  }
  static nlohmann::json status_of(int port) {
    const std::string answer = test::get(port, "/status.json");
    return nlohmann::json::parse(answer.substr(answer.find("\r\n\r\n")));
  }

  test::TemporaryFolder folder_;
  const std::string model_ = folder_.write(
      "model.safetensors",
      test::make_random_model(test::make_config(EncoderKind::kXxs, PresetKind::kLcdm), 1));
  test::NotifySocket socket_{folder_.file("notify")};
};

TEST_F(ServiceTest, TellsSystemdThatItIsReadyLivesAndStops) {
  Program program(LCDM_PROGRAM, arguments({"--source", "scene:"}), environment());
  EXPECT_EQ(message("STATUS="), "STATUS=booting");
  EXPECT_THAT(message("READY=1"), HasSubstr("STATUS=streaming"));
  for (int i = 0; i < 3; ++i) EXPECT_EQ(message("WATCHDOG=1"), "WATCHDOG=1");
  ASSERT_TRUE(program.wait_for("\nstreaming\n")) << program.text();
  const auto status = status_of(port_of(program));
  EXPECT_EQ(status["device"]["state"], "streaming");
  EXPECT_EQ(status["device"]["reason"], "");
  EXPECT_EQ(status["device"]["missed_vital"], 0);
  EXPECT_EQ(status["watchdog"]["managed"], true);
  EXPECT_EQ(status["watchdog"]["timeout_ms"], 400);
  EXPECT_GE(status["watchdog"]["pings"], 2) << "the third may be newer than this status";
  EXPECT_EQ(status["effort"]["rung"], "full network");
  EXPECT_TRUE(status["thermal"].contains("throttled"));
  kill(program.pid(), SIGTERM);
  EXPECT_THAT(message("STOPPING=1"), StartsWith("STOPPING=1"));
  EXPECT_EQ(program.wait(), 0) << program.text();
}

// Everything else runs on: main, capture and the page.
TEST_F(ServiceTest, AStalledInferenceStopsThePing) {
  Program program(LCDM_PROGRAM, arguments({"--source", "scene:"}), environment());
  EXPECT_THAT(message("READY=1"), HasSubstr("streaming"));
  ASSERT_TRUE(program.wait_for("\nstreaming\n")) << program.text();
  const pid_t infer = program.thread_of("infer");
  if (ptrace(PTRACE_SEIZE, infer, nullptr, nullptr) != 0) GTEST_SKIP() << "may not trace";
  ASSERT_EQ(ptrace(PTRACE_INTERRUPT, infer, nullptr, nullptr), 0);
  ASSERT_EQ(waitpid(infer, nullptr, __WALL), infer);
  EXPECT_THAT(message("STATUS=fault"), HasSubstr("fault: "));
  for (std::string said; !(said = socket_.next(1500)).empty();) {  // its time-out is 400 ms
    EXPECT_THAT(said, Not(HasSubstr("WATCHDOG=1")));
  }
  EXPECT_THAT(test::get(port_of(program), "/healthz"), StartsWith("HTTP/1.1 503 "));
  ASSERT_EQ(ptrace(PTRACE_DETACH, infer, nullptr, nullptr), 0);
  EXPECT_EQ(message("WATCHDOG=1"), "WATCHDOG=1") << "it goes on, and so does the ping";
}

TEST_F(ServiceTest, AbsentGpioIsAWarning) {
  Program program(LCDM_PROGRAM,
                  arguments({"--source", "scene:", "--set", "gpio.light=NO.SUCH.LINE", "--set",
                             "gpio.button=!NO.SUCH.BUTTON"}),
                  environment());
  EXPECT_THAT(message("READY=1"), HasSubstr("streaming"));
  ASSERT_TRUE(program.wait_for("\nstreaming\n")) << program.text();
  EXPECT_THAT(program.text(), HasSubstr("warning: gpio.light: gpio NO.SUCH.LINE: "));
  EXPECT_EQ(status_of(port_of(program))["gpio"]["warnings"].size(), 2U);
}

TEST_F(ServiceTest, ATokenFileThatIsNoneIsAFaultOfTheConfiguration) {
  const std::string file = folder_.write("token", "0123456789abcdef");
  chmod(file.c_str(), 0644);
  Program program(LCDM_PROGRAM,
                  arguments({"--source", "scene:", "--set", "http.token_file=" + file}));
  EXPECT_EQ(program.wait(), 78);
  EXPECT_THAT(program.text(), HasSubstr("http.token_file"));
}

TEST_F(ServiceTest, PowerOffIsAskedForByAFile) {
  unsetenv("RUNTIME_DIRECTORY");
  EXPECT_EQ(request_power_off().code(), StatusCode::kUnsupported);
  setenv("RUNTIME_DIRECTORY", folder_.path().c_str(), 1);
  EXPECT_TRUE(request_power_off());
  EXPECT_TRUE(fs::is_regular_file(folder_.file("poweroff")));
  setenv("RUNTIME_DIRECTORY", "/nowhere", 1);
  EXPECT_EQ(request_power_off().code(), StatusCode::kIoError);
  unsetenv("RUNTIME_DIRECTORY");
}

TEST(SmallerNetwork, HasAboutHalfThePixelsInTheSameShape) {
  for (const NetworkSize full :
       {NetworkSize{384, 288}, {640, 192}, {256, 192}, {288, 160}, {448, 256}, {640, 480}}) {
    const NetworkSize small = smaller_size(full);
    const double pixels = 1.0 * small.width * small.height / (full.width * full.height);
    const double shape = 1.0 * small.width / small.height * full.height / full.width;
    EXPECT_NEAR(pixels, 0.5, 0.1) << full.width << "x" << full.height;
    EXPECT_NEAR(shape, 1, 0.2) << full.width << "x" << full.height;
    EXPECT_EQ(small.width % 32 + small.height % 32, 0);
  }
  EXPECT_EQ(smaller_size({64, 64}).width, 64) << "there is none below";
}

// The first pair comes from the file that is in memory; later the file is read again, a step more.
TEST(EngineFactories, SayThatTheyLiveBetweenTheFileAndTheEngine) {
  Config config;
  config.model.file = "model/weights/lcdm-xxs.safetensors";
  config.model.width = config.model.height = 64;
  Result<ModelFile> file = ModelFile::load(config.model.file);
  ASSERT_TRUE(file);
  const EngineFactories factories = engine_factories(config, std::move(*file));
  const FrameFormat format = {PixelFormat::kRgb24, 64, 64, 3 * 64};
  const CameraModel camera = CameraModel::from_field_of_view(64, 64, 60);
  int steps = 0;
  const auto alive = [&steps] { ++steps; };
  ASSERT_TRUE(factories.full(format, camera, alive));
  EXPECT_EQ(steps, 0);
  const auto small = factories.small(format, camera, alive);
  ASSERT_TRUE(small);
  EXPECT_EQ(*small, nullptr) << "64x64 is as small as it can be";
  ASSERT_TRUE(factories.full(format, camera, alive));
  EXPECT_EQ(steps, 1);
}

// The table that people read is the one that blinks.
TEST(LightPatterns, StandInTheManuals) {
  for (const char* manual : {"app/README.md", "systemd/lcdm.toml"}) {
    std::ifstream file(manual);
    const std::string text((std::istreambuf_iterator<char>(file)), {});
    for (std::size_t i = 0; i < kDeviceStates; ++i) {
      const auto state = static_cast<DeviceState>(i);
      const std::string pattern(light_pattern(state));
      const std::string escaped = std::regex_replace(pattern, std::regex("\\."), "\\.");
      const std::regex row(std::string("[|#] +") + to_string(state) + " [^\n]*[ `]" + escaped +
                           "[`\n]");
      EXPECT_TRUE(std::regex_search(text, row)) << manual << ": " << to_string(state);
    }
  }
}

}  // namespace
}  // namespace lcdm
