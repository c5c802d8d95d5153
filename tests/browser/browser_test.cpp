// Runs page.mjs: the live page in Chromium against the real program with a random model.
#include <filesystem>
#include <gtest/gtest.h>

#include "tests/app/program.h"
#include "tests/support/random_model.h"
#include "tests/support/temporary_folder.h"

namespace lcdm {
namespace {

namespace fs = std::filesystem;

TEST(Browser, ThePageShowsWhatTheCameraSees) {
  const char* node = "/usr/bin/node";
  if (!fs::exists(node)) GTEST_SKIP() << "no Node.js: systemd/install-packages.sh test";
  if (!fs::exists("/usr/bin/chromium")) {
    GTEST_SKIP() << "no Chromium: systemd/install-packages.sh test";
  }
  if (!fs::exists("tests/browser/node_modules/playwright-core")) {
    GTEST_SKIP() << "no playwright-core: npm --prefix tests/browser install";
  }
  const test::TemporaryFolder folder;
  const std::string model = folder.write(
      "model.safetensors",
      test::make_random_model(test::make_config(EncoderKind::kXxs, PresetKind::kLcdm), 1));
  test::Program page(node, {"tests/browser/page.mjs", LCDM_PROGRAM, model, folder.path()});
  EXPECT_EQ(page.wait(240), 0) << page.text();
}

}  // namespace
}  // namespace lcdm
