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

#include "firmware/base/folder.h"

namespace lcdm::replay {
namespace {

namespace fs = std::filesystem;
constexpr std::size_t kMaxImageBytes = 256U << 20;
constexpr std::size_t kMaxJsonBytes = 1U << 20;
constexpr std::uint64_t kMaxPixels = 100'000'000;
constexpr std::uint64_t kMaxSide = 8192;  // as the engine's pre-processing

using File = std::unique_ptr<std::FILE, int (*)(std::FILE*)>;

bool is_digit(char c) { return c >= '0' && c <= '9'; }

// Up to `limit` bytes of a file, and one more where it is longer.
Result<std::vector<std::uint8_t>> read_bytes(const std::string& path, std::size_t limit) {
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

std::uint32_t big_endian(std::span<const std::uint8_t> bytes) {
  std::uint32_t value = 0;
  for (const std::uint8_t byte : bytes) value = value << 8 | byte;
  return value;
}

const char* size_fault(std::uint64_t width, std::uint64_t height) {
  if (width == 0 || height == 0) return "it has no size";
  if (width > kMaxSide || height > kMaxSide) return "a side is longer than 8192 pixels";
  return width * height > kMaxPixels ? "it has over 100 megapixels" : nullptr;
}

// Walks the marker segments (ITU-T T.81, B.1) to the end of the image.
const char* jpeg_fault(std::span<const std::uint8_t> bytes) {
  constexpr const char* kCut = "it is cut short";
  std::size_t at = 2;
  while (true) {
    // Entropy-coded data, fill bytes and stuffed or restart markers lie between segments.
    while (at + 1 < bytes.size() &&
           (bytes[at] != 0xFF || bytes[at + 1] == 0 || bytes[at + 1] == 0xFF ||
            (bytes[at + 1] >= 0xD0 && bytes[at + 1] <= 0xD7))) {
      ++at;
    }
    if (at + 1 >= bytes.size()) return kCut;
    const std::uint8_t marker = bytes[at + 1];
    at += 2;
    if (marker == 0xD9) return nullptr;
    if (at + 2 > bytes.size()) return kCut;
    const std::uint32_t length = big_endian(bytes.subspan(at, 2));
    if (at + length > bytes.size()) return kCut;
    const bool frame =
        marker >= 0xC0 && marker <= 0xCF && marker != 0xC4 && marker != 0xC8 && marker != 0xCC;
    if (frame && length >= 7) {
      const char* fault =
          size_fault(big_endian(bytes.subspan(at + 5, 2)), big_endian(bytes.subspan(at + 3, 2)));
      if (fault != nullptr) return fault;
    }
    at += std::max<std::uint32_t>(length, 2);
  }
}

// Walks the chunks (ISO/IEC 15948, 5.3) to IEND.
const char* png_fault(std::span<const std::uint8_t> bytes) {
  constexpr std::size_t kSignature = 8;
  constexpr std::size_t kAround = 12;  // length, type and checksum of a chunk
  if (bytes.size() < kSignature + kAround + 13) return "it is cut short";
  const char* fault =
      size_fault(big_endian(bytes.subspan(16, 4)), big_endian(bytes.subspan(20, 4)));
  if (fault != nullptr) return fault;
  std::size_t at = kSignature;
  while (at + kAround <= bytes.size()) {
    const std::size_t length = big_endian(bytes.subspan(at, 4));
    const bool end = big_endian(bytes.subspan(at + 4, 4)) == 0x49454E44;  // "IEND"
    at += kAround + length;
    if (end && at <= bytes.size()) return nullptr;
  }
  return "it is cut short";
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

const char* image_fault(std::span<const std::uint8_t> bytes) {
  if (bytes.size() >= 2 && bytes[0] == 0xFF && bytes[1] == 0xD8) return jpeg_fault(bytes);
  if (bytes.size() >= 4 && big_endian(bytes.first(4)) == 0x89504E47) return png_fault(bytes);
  return nullptr;
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
