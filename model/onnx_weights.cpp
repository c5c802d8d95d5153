#include "model/onnx_weights.h"

#include <algorithm>
#include <cerrno>
#include <fstream>
#include <iterator>
#include <optional>
#include <span>

#include "firmware/base/file.h"
#include "firmware/wire/protobuf.h"

namespace lcdm::model {
namespace {

using wire::ProtobufField;
using wire::ProtobufReader;
using wire::WireType;

// Fields of ModelProto, GraphProto, NodeProto and TensorProto.
constexpr int kGraph = 7;
constexpr int kNode = 1, kInitializer = 5;
constexpr int kNodeInput = 1, kNodeName = 3;
constexpr int kDims = 1, kDataType = 2, kTensorName = 8, kRawData = 9;
constexpr std::uint64_t kFloat = 1;  // TensorProto.DataType

struct Initializer {
  std::string name;
  torch::Tensor tensor;  // undefined: not of floats, or not kept in raw_data
};

// TensorProto; none where its shape is not that of its data.
std::optional<Initializer> read_tensor(std::span<const std::byte> message) {
  Initializer out;
  std::vector<std::int64_t> shape;
  std::span<const std::byte> raw;
  std::uint64_t type = 0;
  ProtobufReader reader(message);
  while (const auto field = reader.next()) {
    if (field->number == kDims && field->type == WireType::kVarint) {
      shape.push_back(static_cast<std::int64_t>(field->value));
    } else if (field->number == kDims && field->type == WireType::kLength) {
      return std::nullopt;  // packed: nobody writes that in proto2
    }
    if (field->number == kDataType) type = field->value;
    if (field->number == kTensorName) out.name = field->text();
    if (field->number == kRawData) raw = field->bytes;
  }
  if (!reader.ok()) return std::nullopt;
  if (type != kFloat || raw.empty()) return out;
  std::uint64_t bytes = sizeof(float);
  for (const std::int64_t extent : shape) {
    if (extent <= 0 || static_cast<std::uint64_t>(extent) > raw.size()) return std::nullopt;
    bytes *= static_cast<std::uint64_t>(extent);
    if (bytes > raw.size()) return std::nullopt;
  }
  if (bytes != raw.size()) return std::nullopt;
  out.tensor = torch::empty(shape);
  std::copy(raw.begin(), raw.end(), static_cast<std::byte*>(out.tensor.data_ptr()));
  return out;
}

struct Node {
  std::string name;
  std::vector<std::string> inputs;
};

std::optional<Node> read_node(std::span<const std::byte> message) {
  Node out;
  ProtobufReader reader(message);
  while (const auto field = reader.next()) {
    if (field->number == kNodeInput) out.inputs.emplace_back(field->text());
    if (field->number == kNodeName) out.name = field->text();
  }
  return reader.ok() ? std::optional(out) : std::nullopt;
}

struct Graph {
  std::vector<Node> nodes;
  std::map<std::string, torch::Tensor> tensors;
};

std::optional<Graph> read_graph(std::span<const std::byte> message) {
  Graph graph;
  ProtobufReader reader(message);
  while (const auto field = reader.next()) {
    if (field->number == kNode) {
      const auto node = read_node(field->bytes);
      if (!node) return std::nullopt;
      graph.nodes.push_back(*node);
    } else if (field->number == kInitializer) {
      const auto tensor = read_tensor(field->bytes);
      if (!tensor) return std::nullopt;
      if (tensor->tensor.defined()) graph.tensors[tensor->name] = tensor->tensor;
    }
  }
  return reader.ok() ? std::optional(graph) : std::nullopt;
}

}  // namespace

Result<std::map<std::string, std::vector<torch::Tensor>>> read_onnx_weights(
    const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  if (!in) return unreadable_file("the network", path, errno);
  const std::string all((std::istreambuf_iterator<char>(in)), std::istreambuf_iterator<char>());
  std::optional<Graph> graph;
  ProtobufReader model(std::as_bytes(std::span(all)));
  while (const auto field = model.next()) {
    if (field->number == kGraph && field->type == WireType::kLength) {
      graph = read_graph(field->bytes);
      if (!graph) break;
    }
  }
  if (!model.ok() || !graph) {
    return Status::error(StatusCode::kInvalidInput, "%s: not a readable ONNX file", path.c_str());
  }
  std::map<std::string, std::vector<torch::Tensor>> weights;
  for (const Node& node : graph->nodes) {
    for (const std::string& input : node.inputs) {
      const auto found = graph->tensors.find(input);
      if (found != graph->tensors.end()) weights[node.name].push_back(found->second);
    }
  }
  return weights;
}

}  // namespace lcdm::model
