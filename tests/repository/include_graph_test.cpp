// The dependency rule of the house: which room may include what. Read as the rule's text.
#include <filesystem>
#include <fstream>
#include <gtest/gtest.h>
#include <map>
#include <regex>
#include <set>
#include <string>
#include <vector>

namespace {

namespace fs = std::filesystem;

struct Include {
  std::string file;    // path from the repository root
  std::string target;  // what stands between the brackets or quotes
  bool quoted;
};

bool starts_with(const std::string& text, const std::string& prefix) {
  return text.rfind(prefix, 0) == 0;
}

std::vector<Include> includes_of(const std::string& room) {
  static const std::regex kInclude(R"re(^\s*#\s*include\s*([<"])([^">]+)[">])re");
  std::vector<Include> found;
  for (const auto& entry : fs::recursive_directory_iterator(room)) {
    const std::string extension = entry.path().extension().string();
    if (extension != ".h" && extension != ".cpp") continue;
    std::ifstream file(entry.path());
    std::smatch match;
    for (std::string line; std::getline(file, line);) {
      if (!std::regex_search(line, match, kInclude)) continue;
      found.push_back({entry.path().generic_string(), match[2], match[1] == "\""});
    }
  }
  return found;
}

std::string describe(const Include& include) {
  return include.file + " includes " + include.target;
}

// Expects every quoted include of `room` to begin with one of `allowed`.
void expect_only(const std::string& room, const std::vector<std::string>& allowed) {
  const std::vector<Include> includes = includes_of(room);
  EXPECT_FALSE(includes.empty()) << "no sources under " << room;
  for (const Include& include : includes) {
    if (!include.quoted) continue;
    bool ok = false;
    for (const std::string& prefix : allowed) ok = ok || starts_with(include.target, prefix);
    EXPECT_TRUE(ok) << describe(include);
  }
}

// Headers of the C++ standard library have neither a slash nor a suffix.
bool is_standard(const std::string& header) {
  return header.find('/') == std::string::npos && header.find('.') == std::string::npos;
}

// The drivers' units: a folder, or the files of one name.
std::string driver_of(const fs::path& path) { return std::next(path.begin())->stem().string(); }

// Highway asks for its headers in quotes (foreach_target.h).
TEST(DependencyRule, FirmwareIncludesOnlyItselfAndHighway) {
  expect_only("firmware", {"firmware/", "hwy/"});
}

TEST(DependencyRule, FirmwareNeedsOnlyTheStandardLibraryEigenAndHighway) {
  for (const Include& include : includes_of("firmware")) {
    if (include.quoted || is_standard(include.target)) continue;
    if (starts_with(include.target, "Eigen/") || starts_with(include.target, "hwy/")) continue;
    // What the operating system gives has one door; the allocation watch hooks into malloc itself.
    const bool is_door = starts_with(include.file, "firmware/base/os.") ||
                         starts_with(include.file, "firmware/base/alloc_");
    EXPECT_TRUE(is_door) << describe(include);
  }
}

// Without a circle: each folder knows those before it at most.
TEST(DependencyRule, FirmwaresFoldersStandOnEachOther) {
  const std::map<std::string, std::vector<std::string>> below = {
      {"base", {}},
      {"buffer", {"base"}},
      {"health", {"base"}},
      {"vision", {"base", "buffer"}},
      {"wire", {"base", "vision"}},
      {"nn", {"base", "buffer", "vision"}},
      {"pipeline", {"base", "buffer", "health", "vision", "nn"}}};
  for (const auto& entry : fs::directory_iterator("firmware")) {
    const std::string folder = entry.path().filename().string();
    EXPECT_TRUE(!entry.is_directory() || below.count(folder) > 0)
        << folder << " is not in the list";
  }
  for (const auto& [folder, others] : below) {
    std::vector<std::string> allowed = {"firmware/" + folder + "/", "hwy/"};
    for (const std::string& other : others) allowed.push_back("firmware/" + other + "/");
    expect_only("firmware/" + folder, allowed);
  }
}

TEST(DependencyRule, DriversIncludeFirmwareAndOfEachOtherTheCodecsOnly) {
  expect_only("drivers", {"firmware/", "drivers/"});
  for (const Include& include : includes_of("drivers")) {
    if (!include.quoted || !starts_with(include.target, "drivers/")) continue;
    if (driver_of(include.target) == "codec") continue;
    EXPECT_EQ(driver_of(include.file), driver_of(include.target)) << describe(include);
  }
}

TEST(DependencyRule, AppIncludesFirmwareAndDrivers) {
  expect_only("app", {"app/", "firmware/", "drivers/"});
}

TEST(DependencyRule, ModelIncludesFirmwareHighwayAndTheSourcesItTrainsOn) {
  expect_only("model", {"model/", "firmware/", "hwy/", "drivers/scene/", "drivers/replay/",
                        "drivers/mcap_camera", "drivers/codec/"});
}

TEST(DependencyRule, OnlyModelSeesTorch) {
  for (const std::string room : {"firmware", "drivers", "app"}) {
    for (const Include& include : includes_of(room)) {
      EXPECT_FALSE(starts_with(include.target, "torch/") || starts_with(include.target, "ATen/"))
          << describe(include);
    }
  }
}

}  // namespace
