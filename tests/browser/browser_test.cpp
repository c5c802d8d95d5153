// Runs page.mjs: the live page in Chromium against the real program with a random model.
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <gtest/gtest.h>

#include "tests/app/program.h"
#include "tests/support/random_model.h"

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
  const fs::path folder = fs::path(testing::TempDir()) / "lcdm_browser";
  fs::remove_all(folder);
  fs::create_directories(folder);
  const fs::path model = folder / "model.safetensors";
  const auto bytes =
      test::make_random_model(test::make_config(EncoderKind::kXxs, PresetKind::kLcdm), 1);
  std::ofstream(model, std::ios::binary)
      .write(reinterpret_cast<const char*>(bytes.data()),
             static_cast<std::streamsize>(bytes.size()));
  test::Program page(node, {"tests/browser/page.mjs", LCDM_PROGRAM, model.string(), folder.string(),
                            (folder / "page.png").string()});
  EXPECT_EQ(page.wait(240), 0) << page.text();
}

}  // namespace
}  // namespace lcdm
