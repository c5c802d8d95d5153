// The configuration: the shipped file is the manual, and nothing wrong passes in silence.
#include "app/config.h"

#include <algorithm>
#include <fstream>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <map>
#include <regex>
#include <string>
#include <variant>
#include <vector>

#include "firmware/health/supervisor.h"
#include "tests/support/temporary_folder.h"

namespace lcdm {
namespace {

using testing::HasSubstr;
using testing::StartsWith;

constexpr const char* kShipped = "systemd/lcdm.toml";

class ConfigFile : public testing::Test {
 protected:
  std::string write(const std::string& text) const { return folder_.write("lcdm.toml", text); }

  // The error that the text gives, without the folder; empty when it is valid.
  std::string error_of(const std::string& text) const {
    const auto config = load_config({write(text), {}, {}});
    if (config) return {};
    const std::string message = config.status().text();
    EXPECT_THAT(message, StartsWith(folder_.file("lcdm.toml")));
    EXPECT_EQ(message.find('\n'), std::string::npos) << "one line";
    return message.substr(folder_.path().size() + 1);
  }

  test::TemporaryFolder folder_;
};

Status assign(const std::string& text) {
  const auto config = load_config({"", {}, {{text, "--set " + text}}});
  return config ? Status::ok() : config.status();
}

// But for the source, as an installed device waits for a camera where the program alone shows the
// rendered scene, and for the address that the network over USB brings.
TEST(ShippedConfig, HoldsTheDefaultsOfTheProgram) {
  auto config = load_config({kShipped, {}, {}});
  ASSERT_TRUE(config) << config.status().text();
  Config expected;
  EXPECT_EQ(expected.camera.source, "auto");
  expected.camera.source = "v4l2:any";
  expected.http.listen += ",192.168.58.1";
  const std::vector<ConfigField> shipped = config_fields(*config);
  const std::vector<ConfigField> ours = config_fields(expected);
  for (std::size_t i = 0; i < ours.size(); ++i) {
    const bool equal = std::visit(
        [&](auto* place) { return *place == *std::get<decltype(place)>(shipped[i].place); },
        ours[i].place);
    EXPECT_TRUE(equal) << ours[i].section << "." << ours[i].key;
  }
}

// `section.key` -> whether a comment stands above it.
std::map<std::string, bool> keys_in_file() {
  std::map<std::string, bool> keys;
  std::ifstream file(kShipped);
  std::string section;
  bool commented = false;
  const std::regex section_line(R"(\[(\w+)\])");
  const std::regex key_line(R"((\w+) = .*)");
  std::smatch match;
  for (std::string line; std::getline(file, line);) {
    if (std::regex_match(line, match, section_line)) section = match[1];
    if (std::regex_match(line, match, key_line)) keys[section + "." + match[1].str()] = commented;
    // A comment covers the keys that follow it without an empty line.
    commented = line.empty() ? false : commented || line[0] == '#';
  }
  return keys;
}

TEST(ShippedConfig, DocumentsEveryKeyOfTheProgramAndNoOther) {
  Config config;
  std::map<std::string, bool> expected;
  for (const ConfigField& field : config_fields(config)) {
    expected[std::string(field.section) + "." + field.key] = true;
  }
  EXPECT_EQ(keys_in_file(), expected);
}

TEST_F(ConfigFile, LeavesOutWhatItLikes) {
  const auto config = load_config({write("[camera]\nwidth = 1280\n"), {}, {}});
  ASSERT_TRUE(config) << config.status().text();
  EXPECT_EQ(config->camera.width, 1280);
  EXPECT_EQ(config->camera.height, Config{}.camera.height);
}

TEST_F(ConfigFile, TakesAWholeNumberWhereARealOneIsMeant) {
  const auto config = load_config({write("[camera]\nframes_per_second = 15\n"), {}, {}});
  ASSERT_TRUE(config) << config.status().text();
  EXPECT_DOUBLE_EQ(config->camera.frames_per_second, 15);
}

TEST_F(ConfigFile, NamesLineAndColumnOfAnUnknownKey) {
  const std::string error = error_of("# comment\n[camera]\nwidht = 640\n");
  EXPECT_THAT(error, StartsWith("lcdm.toml:3:9: no key camera.widht"));
  EXPECT_THAT(error, HasSubstr("width, height")) << "says which there are";
}

TEST_F(ConfigFile, NamesAnUnknownSection) {
  EXPECT_THAT(error_of("[cammera]\nwidth = 640\n"), StartsWith("lcdm.toml:1:1: no section"));
}

TEST_F(ConfigFile, RefusesAKeyOutsideASection) {
  EXPECT_THAT(error_of("width = 640\n"), StartsWith("lcdm.toml:1:9: key width outside"));
}

TEST_F(ConfigFile, RefusesAWrongType) {
  EXPECT_THAT(error_of("[camera]\nwidth = \"640\"\n"), HasSubstr("must be a number"));
  EXPECT_THAT(error_of("[camera]\nsource = 3\n"), HasSubstr("must be a text"));
  EXPECT_THAT(error_of("[camera]\nwidth = 640.5\n"), HasSubstr("whole number"));
  EXPECT_THAT(error_of("[camera]\nwidth = true\n"), HasSubstr("must be a number"));
  EXPECT_THAT(error_of("[camera]\nwidth = [640]\n"), HasSubstr("must be a number"));
}

TEST_F(ConfigFile, RefusesAValueOutOfRangeAndSaysTheRange) {
  const std::string error = error_of("[http]\nport = 70000\n");
  EXPECT_THAT(error, StartsWith("lcdm.toml:2:8: http.port = 70000"));
  EXPECT_THAT(error, HasSubstr("from 0 to 65535"));
  EXPECT_THAT(error_of("[camera]\nframes_per_second = nan\n"), HasSubstr("not allowed"));
  EXPECT_THAT(error_of("[camera]\nframes_per_second = inf\n"), HasSubstr("not allowed"));
}

// Three frames late is the camera's silence, and must be judged as that before the device's.
TEST_F(ConfigFile, RefusesARateAtWhichEveryFrameWouldBeAMissedDeadline) {
  Config config;
  for (const ConfigField& field : config_fields(config)) {
    if (field.key != std::string("frames_per_second")) continue;
    EXPECT_LT(3e9 / field.min, static_cast<double>(SupervisorOptions().depth_deadline_ns));
  }
  EXPECT_THAT(error_of("[camera]\nframes_per_second = 0.3\n"), HasSubstr("from 0.5 to 1000"));
}

TEST_F(ConfigFile, RefusesATextThatMeansNothing) {
  EXPECT_THAT(error_of("[camera]\nsource = \"webcam\"\n"), HasSubstr("is no source"));
  EXPECT_THAT(error_of("[http]\nlisten = \"example.org\"\n"), HasSubstr("numeric address"));
}

TEST_F(ConfigFile, RefusesHalfANetworkSize) {
  const auto half = load_config({write("[model]\nwidth = 640\n"), {}, {}});
  ASSERT_FALSE(half);
  EXPECT_THAT(half.status().text(), HasSubstr("give both"));
  EXPECT_FALSE(load_config({write("[model]\nwidth = 630\nheight = 192\n"), {}, {}}));
}

TEST_F(ConfigFile, ReportsBrokenTomlByLine) {
  EXPECT_THAT(error_of("[camera]\nwidth = \n"), StartsWith("lcdm.toml:2:"));
  EXPECT_THAT(error_of("[camera\n"), StartsWith("lcdm.toml:1:"));
  EXPECT_THAT(error_of("[camera]\nwidth = 1\nwidth = 2\n"), StartsWith("lcdm.toml:"));
}

TEST_F(ConfigFile, SurvivesHostileBytes) {
  std::string bytes;
  for (int i = 0; i < 4096; ++i) bytes += static_cast<char>(i * 37);
  EXPECT_FALSE(error_of(bytes).empty());
  EXPECT_THAT(error_of(std::string(300 * 1024, '#')), HasSubstr("larger than"));
}

TEST(ConfigSource, AMissingFileIsSaidSo) {
  const auto config = load_config({"/nowhere/lcdm.toml", {}, {}});
  ASSERT_FALSE(config);
  EXPECT_THAT(config.status().text(),
              StartsWith("cannot read the configuration /nowhere/lcdm.toml: No such"));
}

TEST_F(ConfigFile, CommandLineWinsOverEnvironmentOverFile) {
  const std::string text = "[camera]\nwidth = 100\n[http]\nport = 100\n[model]\nthreads = 1\n";
  const auto config = load_config({write(text),
                                   {"LCDM_CAMERA_WIDTH=200", "LCDM_HTTP_PORT=200"},
                                   {{"camera.width=300", "--set"}}});
  ASSERT_TRUE(config) << config.status().text();
  EXPECT_EQ(config->camera.width, 300);
  EXPECT_EQ(config->http.port, 200);
  EXPECT_EQ(config->model.threads, 1);
}

TEST(ConfigEnvironment, NamesTheVariableThatIsWrong) {
  const auto config = load_config({"", {"LCDM_HTTP_PORT=http"}, {}});
  ASSERT_FALSE(config);
  EXPECT_THAT(config.status().text(), StartsWith("LCDM_HTTP_PORT: http.port = http"));
  EXPECT_FALSE(load_config({"", {"LCDM_HTTP_PROT=80"}, {}})) << "a typing error is not ignored";
  EXPECT_TRUE(load_config({"", {"LCDM_SOMETHING=else", "PATH=/bin"}, {}}));
}

TEST(ConfigAssignment, NamesWhatIsWrong) {
  EXPECT_TRUE(assign("camera.source=file:/tmp/a=b.mp4").is_ok()) << "only the first = divides";
  EXPECT_THAT(assign("camera.width").text(), HasSubstr("section.key=value"));
  EXPECT_THAT(assign("width=3").text(), HasSubstr("section.key=value"));
  EXPECT_THAT(assign("camera.size=3").text(), HasSubstr("no key camera.size"));
  EXPECT_THAT(assign("camera.width=12x").text(), HasSubstr("whole number"));
  EXPECT_THAT(assign("camera.width=").text(), HasSubstr("whole number"));
  EXPECT_THAT(assign("=").text(), HasSubstr("section.key=value"));
}

TEST_F(ConfigFile, BracketsWithoutEndAreRefusedBeforeTheyEatTheStack) {
  EXPECT_THAT(error_of("[camera]\nwidth = " + std::string(100'000, '[')),
              HasSubstr("too deep in each other"));
}

// What is in quotes or a comment closes nothing, and opens nothing.
TEST_F(ConfigFile, BracketsCountWhereTheyAreStructure) {
  const std::string closing(20, ']');
  const std::string opening(20, '[');
  for (const char* quote : {"\"", "'", "\"\"\"", "'''"}) {
    const std::string hidden = quote + closing + quote;
    EXPECT_THAT(error_of("[camera]\nwidth = [" + hidden + ", " + opening),
                HasSubstr("too deep in each other"))
        << quote;
  }
  EXPECT_THAT(error_of("[camera]\nwidth = [ # " + closing + "\n" + opening),
              HasSubstr("too deep in each other"));
  EXPECT_EQ(
      error_of("[camera]\nwidth = 640  # " + opening + "\nsource = \"file:" + opening + "\"\n"),
      "");
}

TEST_F(ConfigFile, KeysOfManyPartsAreRefusedBeforeTheyEatTheStack) {
  std::string key = "a";
  for (int i = 0; i < 50'000; ++i) key += i % 2 == 0 ? ".a" : ".\"b\"";
  for (const std::string& text :
       {key + " = 1\n", "[" + key + "]\n", "camera = { x = \"\"\"\n\"\"\", " + key + " = 1 }\n"}) {
    EXPECT_THAT(error_of(text), HasSubstr("too deep in each other"));
  }
  EXPECT_EQ(error_of("[camera]\nsource = \"file:../../../../../../../../../../../a\"  # "
                     "....................\n"),
            "");
}

TEST_F(ConfigFile, ALongLineIsRefusedBeforeItsValuesCostSeconds) {
  std::string one_line = "[camera]\nwidth = [";
  std::string many_lines = one_line;
  for (int i = 0; i < 100'000; ++i) {
    one_line += "1,";
    many_lines += i % 1000 == 999 ? "1,\n" : "1,";
  }
  EXPECT_THAT(error_of(one_line + "]\n"), StartsWith("lcdm.toml:2: longer than 4096 bytes"));
  EXPECT_THAT(error_of(many_lines + "]\n"), HasSubstr("must be a number"));
}

TEST_F(ConfigFile, BracketsInCommentsDoNotCount) {
  std::string text = "[camera]\n";
  for (int i = 0; i < 40; ++i) text += "# a share in [0, 1)\n";
  EXPECT_EQ(error_of(text + "width = 320\n"), "");
}

TEST_F(ConfigFile, ANetworkSmallerThanItCanBeIsRefused) {
  const auto config = load_config({write("[model]\nwidth = 32\nheight = 32\n"), {}, {}});
  EXPECT_EQ(config.code(), StatusCode::kInvalidInput);
}

}  // namespace
}  // namespace lcdm
