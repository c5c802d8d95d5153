// A model file, read once and checked whole: safetensors bytes from anywhere, trusted by nobody.
#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "firmware/base/status.h"
#include "firmware/nn/network_config.h"

namespace lcdm {

class ModelFile {
 public:
  static constexpr std::size_t kMaxFileBytes = 64U << 20;
  static constexpr std::size_t kMaxHeaderBytes = 1U << 20;
  static constexpr std::size_t kMaxTensors = 4096;
  static constexpr std::size_t kMaxRank = 4;

  enum class Type : std::uint8_t { kF16, kF32 };

  struct Tensor {
    Type type = Type::kF32;
    std::vector<std::int64_t> shape;
    std::size_t offset = 0;  // of the first value, in bytes from the start of the file
    std::size_t count = 0;   // values
  };

  // Reads at most kMaxFileBytes. kInvalidInput, naming `path`: not there, or none of
  // ours; kIoError: a later try may succeed (unreadable_file).
  static Result<ModelFile> load(const std::string& path);

  // Checks everything that can be checked without knowing the network: header and metadata within
  // limits, known types, shapes that match their bytes, offsets aligned, in range, without overlap
  // or gap, every value finite. kCorrupt or kInvalidInput otherwise; kUnsupported: metadata of a
  // version we do not know.
  static Result<ModelFile> parse(std::vector<std::byte> bytes);

  const ModelConfig& config() const { return config_; }
  const std::map<std::string, Tensor, std::less<>>& tensors() const { return tensors_; }
  std::uint64_t hash() const { return hash_; }  // FNV-1a of the whole file: an identity, not a seal
  std::size_t file_bytes() const { return bytes_.size(); }

  // Writes the tensor's values as float, row-major; `out` has exactly its count. The tensor must
  // be one of tensors().
  void read(const Tensor& tensor, std::span<float> out) const;

 private:
  ModelFile() = default;
  Status parse_header();
  Status check_values() const;

  std::vector<std::byte> bytes_;
  std::map<std::string, Tensor, std::less<>> tensors_;
  ModelConfig config_;
  std::uint64_t hash_ = 0;
};

// IEEE 754 binary16 to binary32, exact.
float half_to_float(std::uint16_t half);

}  // namespace lcdm
