#include "model/onnx_graph.h"

#include <cerrno>
#include <cstring>
#include <fstream>

namespace lcdm::model {
namespace {

constexpr std::int64_t kIrVersion = 8;
constexpr std::int64_t kOperatorSet = 17;

// AttributeProto.AttributeType, in the order of OnnxAttribute's variant, and the field of each.
struct AttributeForm {
  std::uint64_t type;
  int field;
};
constexpr AttributeForm kForms[] = {{2, 3}, {1, 2}, {3, 4}, {7, 8}};
constexpr int kTypeField = 20;

void write_attribute(wire::ProtobufWriter& proto, const OnnxAttribute& attribute) {
  const AttributeForm form = kForms[attribute.value.index()];
  proto.string_field(1, attribute.name);
  if (const auto* integer = std::get_if<std::int64_t>(&attribute.value)) {
    proto.varint_field(form.field, static_cast<std::uint64_t>(*integer));
  } else if (const auto* number = std::get_if<float>(&attribute.value)) {
    std::uint32_t bits = 0;
    std::memcpy(&bits, number, sizeof(bits));
    proto.fixed32_field(form.field, bits);
  } else if (const auto* text = std::get_if<std::string>(&attribute.value)) {
    proto.string_field(form.field, *text);
  } else {
    for (const std::int64_t each : std::get<std::vector<std::int64_t>>(attribute.value)) {
      proto.varint_field(form.field, static_cast<std::uint64_t>(each));
    }
  }
  proto.varint_field(kTypeField, form.type);
}

}  // namespace

template <typename Write>
void OnnxGraph::append(std::size_t bytes, Write&& write) {
  constexpr std::size_t kSmallFields = 4096;
  const std::size_t at = graph_.size();
  graph_.resize(at + bytes + kSmallFields);
  wire::ByteWriter writer(std::span<std::byte>(graph_).subspan(at));
  wire::ProtobufWriter proto(writer);
  write(proto);
  LCDM_CHECK(writer.ok());
  graph_.resize(at + writer.size());
}

OnnxGraph::OnnxGraph() {
  append(0, [](wire::ProtobufWriter& proto) { proto.string_field(2, "lcdm"); });
}

std::string OnnxGraph::input(const std::string& name, const OnnxShape& shape) {
  value_info(11, name, shape);
  return name;
}

void OnnxGraph::output(const std::string& name, const OnnxShape& shape) {
  value_info(12, name, shape);
}

std::string OnnxGraph::constant(const std::string& name, const OnnxShape& shape,
                                std::span<const float> values) {
  tensor(name, shape, kFloat, std::as_bytes(values));
  return name;
}

std::string OnnxGraph::integer(const std::string& name, std::int64_t value) {
  tensor(name, {}, kInt64, std::as_bytes(std::span<const std::int64_t>(&value, 1)));
  return name;
}

std::string OnnxGraph::integers(const std::string& name, const std::vector<std::int64_t>& values) {
  tensor(name, {static_cast<std::int64_t>(values.size())}, kInt64,
         std::as_bytes(std::span(values)));
  return name;
}

std::string OnnxGraph::node(const std::string& name, const std::string& type,
                            const std::vector<std::string>& inputs,
                            const std::vector<OnnxAttribute>& attributes) {
  append(0, [&](wire::ProtobufWriter& proto) {
    proto.message_field(1, [&] {
      for (const std::string& each : inputs) proto.string_field(1, each);
      proto.string_field(2, name);
      proto.string_field(3, name);
      proto.string_field(4, type);
      for (const OnnxAttribute& each : attributes) {
        proto.message_field(5, [&] { write_attribute(proto, each); });
      }
    });
  });
  return name;
}

void OnnxGraph::value_info(int field, const std::string& name, const OnnxShape& shape) {
  append(0, [&](wire::ProtobufWriter& proto) {
    const auto dimensions = [&] {
      for (const std::int64_t extent : shape) {
        proto.message_field(1, [&] { proto.varint_field(1, static_cast<std::uint64_t>(extent)); });
      }
    };
    const auto tensor_type = [&] {
      proto.varint_field(1, kFloat);
      proto.message_field(2, dimensions);
    };
    proto.message_field(field, [&] {
      proto.string_field(1, name);
      proto.message_field(2, [&] { proto.message_field(1, tensor_type); });
    });
  });
}

void OnnxGraph::tensor(const std::string& name, const OnnxShape& shape, int type,
                       std::span<const std::byte> bytes) {
  append(bytes.size(), [&](wire::ProtobufWriter& proto) {
    proto.message_field(5, [&] {
      for (const std::int64_t extent : shape) {
        proto.varint_field(1, static_cast<std::uint64_t>(extent));
      }
      proto.varint_field(2, static_cast<std::uint64_t>(type));
      proto.string_field(8, name);
      proto.bytes_field(9, bytes);
    });
  });
}

Status OnnxGraph::save(const std::string& path) const {
  std::vector<std::byte> block(graph_.size() + 256);
  wire::ByteWriter bytes(block);
  wire::ProtobufWriter proto(bytes);
  proto.varint_field(1, kIrVersion);
  proto.string_field(2, "lcdm-train");
  proto.bytes_field(7, graph_);
  proto.message_field(8, [&] {
    proto.string_field(1, "");
    proto.varint_field(2, kOperatorSet);
  });
  LCDM_CHECK(bytes.ok());
  std::ofstream file(path, std::ios::binary);
  file.write(reinterpret_cast<const char*>(block.data()),
             static_cast<std::streamsize>(bytes.size()));
  file.close();
  if (!file) return Status::system(errno, "%s cannot be written", path.c_str());
  return Status::ok();
}

}  // namespace lcdm::model
