// The trainer's command line as scripts use it: one line for each bad input, and the exit statuses
// of app/README.md.
#include <algorithm>
#include <filesystem>
#include <fstream>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <string>
#include <vector>

#include "tests/app/program.h"
#include "tests/support/temporary_folder.h"

namespace lcdm {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;
using testing::StartsWith;

class TrainCli : public testing::Test {
 protected:
  // Expects one line that says `wanted` and the status.
  static void expect_refusal(const std::vector<std::string>& arguments, int status,
                             const std::string& wanted) {
    test::Program program(LCDM_TRAIN_PROGRAM, arguments);
    EXPECT_EQ(program.wait(), status) << program.text();
    EXPECT_THAT(program.text(), StartsWith("lcdm-train: "));
    EXPECT_THAT(program.text(), HasSubstr(wanted));
    EXPECT_EQ(std::count(program.text().begin(), program.text().end(), '\n'), 1) << program.text();
  }

  test::TemporaryFolder folder_;
};

TEST_F(TrainCli, HelpIsNoFault) {
  test::Program program(LCDM_TRAIN_PROGRAM, {"evaluate", "--help"});
  EXPECT_EQ(program.wait(), 0);
  EXPECT_THAT(program.text(), HasSubstr("--checkpoint"));
}

TEST_F(TrainCli, RefusesACommandLineItDoesNotUnderstand) {
  expect_refusal({}, 2, "see lcdm-train --help");
  expect_refusal({"evaluate", "--fast"}, 2, "--fast");
  expect_refusal({"export", "--checkpoint", "/nowhere"}, 2, "/nowhere");
  expect_refusal({"--recipe", "/nowhere.toml", "train"}, 2, "/nowhere.toml");
  expect_refusal({"--recipe", folder_.write("recipe.toml", "[train]\nsteps = \"many\"\n"), "train"},
                 2, "many");
  expect_refusal({"--recipe", folder_.write("typo.toml", "[train]\nsteeps = 5\n"), "train"}, 2,
                 "steeps");
  expect_refusal({"--recipe", folder_.write("other.toml", "[train]\nsteps = 5\n"), "ablate"}, 2,
                 "[ablate]");
}

TEST_F(TrainCli, RefusesACommandLineThatAsksForWhatCannotBe) {
  expect_refusal({"evaluate"}, 2, "nothing to evaluate");
  expect_refusal({"export"}, 2, "nothing to export");
  expect_refusal({"train", "--stage", "1:2"}, 2, "SHARE:IMAGES:UNTIL");
  expect_refusal({"ablate", "--seed", "3"}, 2, "--seed");
  expect_refusal(
      {"teach", "--pack", folder_.path(), "--checkpoint", "/dev/null", "--gives", "depth"}, 2,
      "--torchscript");
}

// Who gives an option that nothing reads takes what comes for its doing.
TEST_F(TrainCli, RefusesOptionsThatWouldDoNothing) {
  const std::string model = "model/weights/lcdm-xxs.safetensors";
  expect_refusal({"evaluate", "--model", model, "--steps", "2"}, 2,
                 "--steps requires --checkpoint");
  for (const std::string option : {"--every", "--scene-frames"}) {
    for (const std::string command : {"evaluate", "report"}) {
      expect_refusal({command, "--model", model, "--test", option, "2"}, 2, option);
    }
  }
  for (const std::string option : {"--output", "--name", "--card", "--licence", "--start"}) {
    expect_refusal(
        {"export", "--model", model, "--onnx", folder_.file("net.onnx"), option, "zeros"}, 2,
        option + " requires --checkpoint");
  }
  expect_refusal({"export", "--model", model, "--width", "320"}, 2, "--width requires --onnx");
  expect_refusal({"train", "--dry-run", "--data", folder_.write("data.toml", ""), "--encoder-bgr"},
                 2, "--encoder-bgr requires --encoder-weights");
}

// Peers are other people's programs: what they answer is what the table says.
TEST_F(TrainCli, ComparesWithWhatAPeerAnswers) {
  const auto compare = [&](const std::string& peer) {
    return std::vector<std::string>{"--threads",
                                    "1",
                                    "compare",
                                    "--model",
                                    "model/weights/lcdm-xxs.safetensors",
                                    "--onnx",
                                    folder_.file("net.onnx"),
                                    "--width",
                                    "96",
                                    "--height",
                                    "64",
                                    "--rounds",
                                    "2",
                                    "--frames",
                                    "1",
                                    "--peer",
                                    peer};
  };
  const std::string answers = "while read n; do echo 5000 4000; done";
  test::Program program(LCDM_TRAIN_PROGRAM, compare(answers));
  EXPECT_EQ(program.wait(60), 0) << program.text();
  EXPECT_THAT(program.text(), HasSubstr("| LibTorch |"));
  EXPECT_THAT(program.text(), HasSubstr("| " + answers + " | 5000.0 | 1.00 | 4000.0 |"));
  expect_refusal(compare("true"), 1, "'true' gave no answer in round 0");
}

TEST_F(TrainCli, RefusesARecordingWithoutAPicture) {
  const std::string recording = folder_.write("empty.mcap", "\x89MCAP0\r\n");
  expect_refusal({"pack", "--recording", recording, "--output", folder_.file("pack")}, 78,
                 "no JPEG pictures");
  EXPECT_FALSE(fs::exists(folder_.file("pack")));
}

// A new training would destroy it.
TEST_F(TrainCli, RefusesAFolderThatHoldsATraining) {
  folder_.write("checkpoint.safetensors", "hours of work");
  expect_refusal({"train", "--output", folder_.path()}, 2, "holds a training: give --resume");
  std::string kept;
  std::getline(std::ifstream(folder_.file("checkpoint.safetensors")), kept);
  EXPECT_EQ(kept, "hours of work");
}
TEST_F(TrainCli, RefusesAFolderThatHoldsABestStateAlone) {
  folder_.write("best.safetensors", "of a run that ended before its first checkpoint");
  expect_refusal({"train", "--output", folder_.path()}, 2, "holds a training: give --resume");
}

// As packs of fewer than 34 pictures have no validation part.
TEST_F(TrainCli, RefusesToMeasureOnNothing) {
  const std::string catalogue = folder_.write("data.toml", "");
  const std::string estimates = folder_.path();
  expect_refusal({"evaluate", "--data", catalogue, "--estimates", estimates}, 2,
                 "nothing to evaluate on");
  expect_refusal({"evaluate", "--data", folder_.write("scene.toml", "[scene]\nframes = 1\n"),
                  "--only", "nowhere", "--estimates", estimates},
                 2, "--only nowhere: no set of this name");
  expect_refusal({"report", "--data", catalogue, "--model", "model/weights/lcdm-xxs.safetensors"},
                 2, "nothing to evaluate on");
  expect_refusal(
      {"train", "--data", catalogue, "--validate-every", "5", "--output", folder_.file("training")},
      2, "nothing to validate on");
}

// An estimate that no frame has must not leave the others' rows alone on the table.
TEST_F(TrainCli, SaysThatNoFrameHasAnEstimate) {
  test::Program program(LCDM_TRAIN_PROGRAM,
                        {"evaluate", "--data", folder_.write("data.toml", "[scene]\nframes = 1\n"),
                         "--estimates", folder_.path()});
  EXPECT_EQ(program.wait(60), 78) << program.text();
  EXPECT_THAT(program.text(), HasSubstr("frames could not be measured; the last: "));
  EXPECT_THAT(program.text(), HasSubstr("folder could not be measured on any frame"));
}

TEST_F(TrainCli, RefusesEstimatesOfOtherPicturesThanBlurredOnes) {
  expect_refusal({"evaluate", "--estimates", folder_.path(), "--blur", "20"}, 2, "--blur");
}

TEST_F(TrainCli, SaysThatTheFiguresOfFramesCouldNotBeKept) {
  if (!fs::exists("/dev/full")) GTEST_SKIP() << "no /dev/full here";
  test::Program program(LCDM_TRAIN_PROGRAM,
                        {"evaluate", "--data", folder_.write("data.toml", "[scene]\nframes = 1\n"),
                         "--estimates", folder_.path(), "--frames", "/dev/full"});
  EXPECT_EQ(program.wait(60), 1) << program.text();
  EXPECT_THAT(program.text(), HasSubstr("--frames /dev/full: cannot write"));
}

TEST_F(TrainCli, TheTableOfFramesKeepsItsColumnsWhateverAModelIsCalled) {
  const std::string model = folder_.file("north, \"3\".safetensors");
  fs::copy_file("model/weights/lcdm-xxs.safetensors", model);
  const std::string table = folder_.file("frames.csv");
  test::Program program(LCDM_TRAIN_PROGRAM,
                        {"evaluate", "--data", folder_.write("data.toml", "[scene]\nframes = 1\n"),
                         "--model", model, "--share", "0.3", "--frames", table});
  ASSERT_EQ(program.wait(60), 0) << program.text();
  std::ifstream file(table);
  std::string line;
  std::getline(file, line);
  std::getline(file, line);
  EXPECT_THAT(line, StartsWith("scene,\"north, \"\"3\"\"\",900000-0,"));
}

// What the one set asks of its weights the other's licence would leave out.
TEST_F(TrainCli, AMeanOfDifferentLicencesNeedsOneThatIsSaid) {
  std::vector<std::string> mean = {
      "export", "--output", folder_.file("mean.safetensors"), "--name", "mean", "--card", "two"};
  for (const std::string licence : {"free", "research"}) {
    const std::string data =
        folder_.write(licence + ".toml", "licence = \"" + licence + "\"\n[scene]\nframes = 8\n");
    test::Program program(LCDM_TRAIN_PROGRAM,
                          {"train", "--data", data, "--encoder", "xxs", "--steps", "1", "--stage",
                           "0.2:1:1", "--output", folder_.file(licence)});
    ASSERT_EQ(program.wait(120), 0) << program.text();
    mean.insert(mean.end(), {"--checkpoint", folder_.file(licence) + "/checkpoint.safetensors"});
  }
  expect_refusal(mean, 2, "follows from both \"free\"");
  mean.insert(mean.end(), {"--licence", "research"});
  test::Program program(LCDM_TRAIN_PROGRAM, mean);
  EXPECT_EQ(program.wait(60), 0) << program.text();
}

TEST_F(TrainCli, RefusesDataAndWeightsThatNoRetryCures) {
  expect_refusal({"train", "--data", "/nowhere.toml"}, 78, "/nowhere.toml");
  expect_refusal({"train", "--data", folder_.write("data.toml", "[[train]\n")}, 78, "data.toml");
  const std::string junk = folder_.write("junk.safetensors", "this is no model");
  expect_refusal({"evaluate", "--model", junk}, 78, "junk.safetensors");
  expect_refusal({"evaluate", "--checkpoint", junk}, 78, "junk.safetensors");
}

}  // namespace
}  // namespace lcdm
