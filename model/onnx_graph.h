// Writes one ONNX model of a fixed feed-forward graph: the few messages of onnx.proto it needs
// (github.com/onnx/onnx, operator set 17).
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <variant>
#include <vector>

#include "firmware/base/status.h"
#include "firmware/wire/protobuf.h"

namespace lcdm::model {

using OnnxShape = std::vector<std::int64_t>;

struct OnnxAttribute {
  std::string name;
  std::variant<std::int64_t, float, std::string, std::vector<std::int64_t>> value;
};

// Values are known by name. Every function that makes one returns its name.
class OnnxGraph {
 public:
  OnnxGraph();

  std::string input(const std::string& name, const OnnxShape& shape);
  void output(const std::string& name, const OnnxShape& shape);
  std::string constant(const std::string& name, const OnnxShape& shape,
                       std::span<const float> values);
  std::string scalar(const std::string& name, float value) {
    return constant(name, {}, {&value, 1});
  }
  std::string integer(const std::string& name, std::int64_t value);
  // The list of numbers some operators take as an input.
  std::string integers(const std::string& name, const std::vector<std::int64_t>& values);
  // One operator with one output, which is called `name`. An empty input is one left out.
  std::string node(const std::string& name, const std::string& type,
                   const std::vector<std::string>& inputs,
                   const std::vector<OnnxAttribute>& attributes = {});

  // Writes the model. kIoError where the file cannot be written.
  Status save(const std::string& path) const;

 private:
  static constexpr int kFloat = 1;  // TensorProto.DataType
  static constexpr int kInt64 = 7;

  void value_info(int field, const std::string& name, const OnnxShape& shape);
  void tensor(const std::string& name, const OnnxShape& shape, int type,
              std::span<const std::byte> bytes);

  // Appends one field of the graph, which is about `bytes` long.
  template <typename Write>
  void append(std::size_t bytes, Write&& write);

  std::vector<std::byte> graph_;  // GraphProto
};

}  // namespace lcdm::model
