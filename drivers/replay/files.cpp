#include "drivers/replay/files.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <cerrno>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <system_error>

#include "drivers/replay/image_header.h"
#include "firmware/base/file.h"
#include "firmware/base/folder.h"

namespace lcdm::replay {
namespace {

namespace fs = std::filesystem;
constexpr std::size_t kMaxImageBytes = 256U << 20;
constexpr std::size_t kMaxJsonBytes = 1U << 20;

using File = std::unique_ptr<std::FILE, int (*)(std::FILE*)>;

bool is_digit(char c) { return c >= '0' && c <= '9'; }

// Up to `limit` bytes of a file, and one more where it is longer.
Result<std::vector<std::uint8_t>> read_bytes(const std::string& path, std::size_t limit) {
  if (!is_plain_file(path)) {
    return Status::error(StatusCode::kInvalidInput, "file:%s: cannot open: it is no file",
                         path.c_str());
  }
  const File file(std::fopen(path.c_str(), "rbe"), &std::fclose);
  if (file == nullptr) return Status::system(errno, "file:%s: cannot open", path.c_str());
  std::vector<std::uint8_t> bytes;
  std::array<std::uint8_t, 65536> chunk;
  while (bytes.size() <= limit) {
    const std::size_t got = std::fread(chunk.data(), 1, chunk.size(), file.get());
    bytes.insert(bytes.end(), chunk.begin(), chunk.begin() + static_cast<std::ptrdiff_t>(got));
    if (got < chunk.size()) break;
  }
  if (std::ferror(file.get()) != 0) {
    return Status::system(errno, "file:%s: cannot read", path.c_str());
  }
  return bytes;
}

Result<CameraModel> parse_intrinsics(const std::string& path) {
  const auto bytes = read_bytes(path, kMaxJsonBytes);
  if (!bytes) return bytes.status();
  const auto json = nlohmann::json::parse(*bytes, nullptr, false);
  if (bytes->size() > kMaxJsonBytes || !json.is_object()) {
    return Status::error(StatusCode::kInvalidInput,
                         "%s: not a JSON object of intrinsics: mend or remove it", path.c_str());
  }
  if (!json.contains("fx")) return CameraModel{};
  std::array<double, 6> values{};
  static constexpr std::array<const char*, 6> kKeys{"width", "height", "fx", "fy", "cx", "cy"};
  for (std::size_t i = 0; i < kKeys.size(); ++i) {
    const auto value = json.find(kKeys[i]);
    const double most = i < 2 ? 65536 : 1e6;
    const double least = i < 4 ? 1e-3 : -1e6;
    values[i] = value != json.end() && value->is_number() ? value->get<double>() : NAN;
    if (!(values[i] >= least && values[i] <= most)) {
      return Status::error(StatusCode::kInvalidInput,
                           "%s: \"%s\" must be a number of pixels: mend or remove the file",
                           path.c_str(), kKeys[i]);
    }
  }
  CameraModel model;
  model.width = static_cast<int>(values[0]);
  model.height = static_cast<int>(values[1]);
  model.fx = static_cast<float>(values[2]);
  model.fy = static_cast<float>(values[3]);
  model.cx = static_cast<float>(values[4]);
  model.cy = static_cast<float>(values[5]);
  model.calibrated = true;
  return model;
}

}  // namespace

bool is_image_name(std::string_view name) {
  const std::size_t dot = name.rfind('.');
  if (dot == std::string_view::npos) return false;
  std::string extension(name.substr(dot));
  for (char& c : extension) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  for (const char* known : {".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff"}) {
    if (extension == known) return true;
  }
  return false;
}

bool natural_less(std::string_view a, std::string_view b) {
  std::size_t i = 0;
  std::size_t j = 0;
  while (i < a.size() && j < b.size()) {
    if (!is_digit(a[i]) || !is_digit(b[j])) {
      if (a[i] != b[j]) return a[i] < b[j];
      ++i;
      ++j;
      continue;
    }
    while (i < a.size() && a[i] == '0') ++i;
    while (j < b.size() && b[j] == '0') ++j;
    std::size_t end_a = i;
    std::size_t end_b = j;
    while (end_a < a.size() && is_digit(a[end_a])) ++end_a;
    while (end_b < b.size() && is_digit(b[end_b])) ++end_b;
    if (end_a - i != end_b - j) return end_a - i < end_b - j;
    const int order = a.substr(i, end_a - i).compare(b.substr(j, end_b - j));
    if (order != 0) return order < 0;
    i = end_a;
    j = end_b;
  }
  if (a.size() - i != b.size() - j) return a.size() - i < b.size() - j;
  return a < b;  // they differ in leading zeros only
}

Result<std::vector<std::string>> list_images(const std::string& folder) {
  const auto files = list_folder(folder);
  if (!files) return Status::error(files.code(), "file:%s", files.status().text());
  std::vector<std::string> names;
  for (const fs::path& file : *files) {
    if (is_image_name(file.filename().string())) names.push_back(file.string());
  }
  if (names.empty()) {
    return Status::error(StatusCode::kNotFound,
                         "file:%s: no images in this folder (jpg, png, bmp or tif)",
                         folder.c_str());
  }
  std::sort(names.begin(), names.end(), natural_less);
  return names;
}

Result<std::vector<std::uint8_t>> read_image_file(const std::string& path) {
  auto bytes = read_bytes(path, kMaxImageBytes);
  if (!bytes) return Status::error(StatusCode::kCorrupt, "%s", bytes.status().text());
  const char* fault = bytes->empty()                   ? "it is empty"
                      : bytes->size() > kMaxImageBytes ? "it is larger than 256 MiB"
                                                       : image_fault(*bytes);
  if (fault == nullptr) return bytes;
  return Status::error(StatusCode::kCorrupt, "file:%s: unreadable image: %s", path.c_str(), fault);
}

Result<CameraModel> find_intrinsics(const std::string& folder) {
  std::error_code error;
  const fs::path here = fs::absolute(folder, error).lexically_normal();
  for (const fs::path& place : {here, here.parent_path()}) {
    const fs::path file = place / "intrinsics.json";
    if (fs::is_regular_file(file, error)) return parse_intrinsics(file.string());
  }
  return CameraModel{};
}

}  // namespace lcdm::replay
