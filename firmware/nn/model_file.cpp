#include "firmware/nn/model_file.h"

#include <algorithm>
#include <bit>
#include <cerrno>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <memory>
#include <utility>

#include "firmware/base/file.h"
#include "firmware/nn/json.h"

namespace lcdm {
namespace {

constexpr std::size_t kPrefixBytes = 8;  // the header's length, little-endian
constexpr std::size_t kMaxExtent = 1U << 24;

Status corrupt(const char* what, std::string_view where) {
  return Status::error(StatusCode::kCorrupt, "model file: %s in `%.80s`: copy or export it again",
                       what, std::string(where).c_str());
}

std::uint64_t fnv1a(std::span<const std::byte> bytes) {
  std::uint64_t hash = 0xCBF29CE484222325ULL;
  for (const std::byte b : bytes)
    hash = (hash ^ std::to_integer<std::uint64_t>(b)) * 0x100000001B3ULL;
  return hash;
}

std::size_t width_of(ModelFile::Type type) { return type == ModelFile::Type::kF16 ? 2 : 4; }

// Fills type, shape, offset (relative to the data) and count from one header entry.
Status parse_entry(std::string_view name, const JsonValue& entry, std::size_t data_bytes,
                   ModelFile::Tensor& out) {
  if (!entry.is_object()) return corrupt("entry is not an object", name);
  const JsonValue* dtype = entry.find("dtype");
  const auto type = dtype != nullptr ? dtype->text() : std::nullopt;
  if (type != "F16" && type != "F32") return corrupt("dtype is not F16 or F32", name);
  out.type = type == "F16" ? ModelFile::Type::kF16 : ModelFile::Type::kF32;

  const JsonValue* shape = entry.find("shape");
  if (shape == nullptr || !shape->is_array() || shape->items().size() > ModelFile::kMaxRank) {
    return corrupt("shape is missing or has too many axes", name);
  }
  out.count = 1;
  for (const JsonValue& axis : shape->items()) {
    const auto extent = axis.whole();
    if (!extent || *extent == 0 || *extent > kMaxExtent) return corrupt("bad extent", name);
    out.shape.push_back(static_cast<std::int64_t>(*extent));
    out.count *= static_cast<std::size_t>(*extent);
    if (out.count > ModelFile::kMaxFileBytes) return corrupt("shape is too large", name);
  }

  const JsonValue* offsets = entry.find("data_offsets");
  if (offsets == nullptr || !offsets->is_array() || offsets->items().size() != 2) {
    return corrupt("data_offsets are missing", name);
  }
  const auto begin = offsets->items()[0].whole();
  const auto end = offsets->items()[1].whole();
  if (!begin || !end || *begin > *end || *end > data_bytes) {
    return corrupt("data_offsets are out of range", name);
  }
  if (*end - *begin != out.count * width_of(out.type)) {
    return corrupt("data_offsets do not match the shape", name);
  }
  if (*begin % width_of(out.type) != 0) return corrupt("data is not aligned", name);
  out.offset = static_cast<std::size_t>(*begin);
  return Status::ok();
}

// Tensors must tile the data: sorted by offset, each begins where the one before ends.
Status check_tiling(const std::map<std::string, ModelFile::Tensor, std::less<>>& tensors,
                    std::size_t data_bytes) {
  std::vector<std::pair<std::size_t, std::size_t>> ranges;  // begin, end
  ranges.reserve(tensors.size());
  for (const auto& [name, t] : tensors) {
    ranges.emplace_back(t.offset, t.offset + t.count * width_of(t.type));
  }
  std::sort(ranges.begin(), ranges.end());
  std::size_t covered = 0;
  for (const auto& [begin, end] : ranges) {
    if (begin != covered) return corrupt("tensors overlap or leave a gap", "data_offsets");
    covered = end;
  }
  if (covered != data_bytes) return corrupt("bytes after the last tensor", "data_offsets");
  return Status::ok();
}

}  // namespace

float half_to_float(std::uint16_t half) {
  const std::uint32_t sign = (half & 0x8000U) << 16;
  const std::uint32_t exponent = (half >> 10) & 0x1FU;
  const std::uint32_t mantissa = half & 0x3FFU;
  if (exponent == 0x1F) return std::bit_cast<float>(sign | 0x7F800000U | (mantissa << 13));
  if (exponent != 0) {
    return std::bit_cast<float>(sign | ((exponent + 112) << 23) | (mantissa << 13));
  }
  const float magnitude = static_cast<float>(mantissa) * 0x1p-24F;  // zero or subnormal
  return sign != 0 ? -magnitude : magnitude;
}

Result<ModelFile> ModelFile::load(const std::string& path) {
  if (!is_plain_file(path)) {
    return Status::error(StatusCode::kInvalidInput,
                         "cannot read the model %.120s: it is no file: give an existing one",
                         path.c_str());
  }
  const std::unique_ptr<std::FILE, int (*)(std::FILE*)> file(std::fopen(path.c_str(), "rb"),
                                                             &std::fclose);
  if (file == nullptr) return unreadable_file("the model", path, errno);
  std::vector<std::byte> bytes;
  std::vector<std::byte> block(1U << 20);
  while (true) {
    const std::size_t got = std::fread(block.data(), 1, block.size(), file.get());
    bytes.insert(bytes.end(), block.begin(), block.begin() + static_cast<std::ptrdiff_t>(got));
    if (bytes.size() > kMaxFileBytes) {
      return Status::error(StatusCode::kInvalidInput,
                           "the model %.120s is larger than %zu bytes: not one of ours",
                           path.c_str(), kMaxFileBytes);
    }
    if (got < block.size()) break;
  }
  if (std::ferror(file.get()) != 0) return unreadable_file("the model", path, errno);
  Result<ModelFile> model = parse(std::move(bytes));
  if (model) return model;
  return Status::error(StatusCode::kInvalidInput, "%.100s: %s", path.c_str(),
                       model.status().text());
}

Result<ModelFile> ModelFile::parse(std::vector<std::byte> bytes) {
  if (bytes.size() > kMaxFileBytes) return corrupt("too many bytes", "file");
  ModelFile model;
  model.bytes_ = std::move(bytes);
  model.hash_ = fnv1a(model.bytes_);
  LCDM_RETURN_IF_ERROR(model.parse_header());
  LCDM_RETURN_IF_ERROR(model.check_values());
  return model;
}

Status ModelFile::parse_header() {
  if (bytes_.size() < kPrefixBytes) return corrupt("no header", "file");
  std::uint64_t header_bytes = 0;
  for (std::size_t i = kPrefixBytes; i-- > 0;) {
    header_bytes = (header_bytes << 8) | std::to_integer<std::uint64_t>(bytes_[i]);
  }
  if (header_bytes > kMaxHeaderBytes || header_bytes > bytes_.size() - kPrefixBytes) {
    return corrupt("header length is out of range", "file");
  }
  std::string text(static_cast<std::size_t>(header_bytes), '\0');
  std::memcpy(text.data(), bytes_.data() + kPrefixBytes, text.size());
  const Result<JsonValue> header = parse_json(text, {.bytes = kMaxHeaderBytes, .depth = 4});
  if (!header) return header.status();
  if (!header->is_object()) return corrupt("header is not an object", "file");
  if (header->keys().size() > kMaxTensors) return corrupt("too many tensors", "header");

  const std::size_t data_begin = kPrefixBytes + text.size();
  const std::size_t data_bytes = bytes_.size() - data_begin;
  for (std::size_t i = 0; i < header->keys().size(); ++i) {
    const std::string& name = header->keys()[i];
    if (name == "__metadata__") continue;
    Tensor tensor;
    LCDM_RETURN_IF_ERROR(parse_entry(name, header->items()[i], data_bytes, tensor));
    tensors_.emplace(name, std::move(tensor));
  }
  LCDM_RETURN_IF_ERROR(check_tiling(tensors_, data_bytes));
  for (auto& [name, tensor] : tensors_) tensor.offset += data_begin;

  const JsonValue* metadata = header->find("__metadata__");
  const JsonValue* lcdm = metadata != nullptr ? metadata->find("lcdm") : nullptr;
  const auto config_text = lcdm != nullptr ? lcdm->text() : std::nullopt;
  if (!config_text) return corrupt("no `lcdm` text", "__metadata__");
  Result<ModelConfig> config = parse_model_config(*config_text);
  if (!config) return config.status();
  config_ = std::move(*config);
  return Status::ok();
}

Status ModelFile::check_values() const {
  std::vector<float> values;
  for (const auto& [name, tensor] : tensors_) {
    values.resize(tensor.count);
    read(tensor, values);
    const bool finite =
        std::all_of(values.begin(), values.end(), [](float v) { return std::isfinite(v); });
    if (!finite) return corrupt("a value is not finite", name);
  }
  return Status::ok();
}

void ModelFile::read(const Tensor& tensor, std::span<float> out) const {
  LCDM_CHECK(out.size() == tensor.count);
  const std::byte* data = bytes_.data() + tensor.offset;
  if (tensor.type == Type::kF32) {
    std::memcpy(out.data(), data, tensor.count * sizeof(float));
    return;
  }
  for (std::size_t i = 0; i < tensor.count; ++i) {
    std::uint16_t half = 0;
    std::memcpy(&half, data + i * sizeof(half), sizeof(half));
    out[i] = half_to_float(half);
  }
}

}  // namespace lcdm
