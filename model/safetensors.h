// Named tensors in a file: the trainer's own checkpoints and exported weights.
#pragma once

#include <map>
#include <string>

#include "firmware/base/status.h"
#include "model/torch.h"

namespace lcdm::model {

struct TensorFile {
  std::map<std::string, torch::Tensor> tensors;  // float16, float32 or int64, on the CPU
  std::map<std::string, std::string> metadata;
};

// `path` holds the old file or the whole new one, through a power cut too.
// kIoError: a full disk, a folder that is not there.
Status write_tensors(const std::string& path, const TensorFile& file);

// kNotFound; kInvalidInput: not a safetensors file of these types.
Result<TensorFile> read_tensors(const std::string& path);

// `text` as a JSON string, with its quotes.
std::string json_quoted(const std::string& text);

}  // namespace lcdm::model
