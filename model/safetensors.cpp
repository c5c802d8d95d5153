#include "model/safetensors.h"

#include <cstdio>
#include <fstream>
#include <iterator>
#include <span>
#include <sstream>

#include "firmware/base/file.h"
#include "firmware/nn/json.h"

namespace lcdm::model {
namespace {

constexpr std::size_t kMaxHeader = 4U << 20;

struct TypeName {
  torch::ScalarType type;
  const char* name;
};
constexpr TypeName kTypes[] = {
    {torch::kFloat16, "F16"}, {torch::kFloat32, "F32"}, {torch::kInt64, "I64"}};

const char* name_of(torch::ScalarType type) {
  for (const TypeName& t : kTypes) {
    if (t.type == type) return t.name;
  }
  LCDM_CHECK(false && "tensor type that a file cannot hold");
  return "";
}

std::string header_of(const TensorFile& file) {
  std::ostringstream out;
  out << "{\"__metadata__\":{";
  const char* separator = "";
  for (const auto& [key, value] : file.metadata) {
    out << separator << json_quoted(key) << ':' << json_quoted(value);
    separator = ",";
  }
  out << '}';
  std::size_t offset = 0;
  for (const auto& [name, tensor] : file.tensors) {
    const std::size_t end = offset + tensor.nbytes();
    out << ',' << json_quoted(name) << ":{\"dtype\":\"" << name_of(tensor.scalar_type())
        << "\",\"shape\":[";
    separator = "";
    for (const std::int64_t extent : tensor.sizes()) {
      out << separator << extent;
      separator = ",";
    }
    out << "],\"data_offsets\":[" << offset << ',' << end << "]}";
    offset = end;
  }
  out << '}';
  const auto length = static_cast<std::size_t>(out.tellp());
  out << std::string((8 - length % 8) % 8, ' ');
  return out.str();
}

Status corrupt(const std::string& path, const char* what) {
  return Status::error(StatusCode::kInvalidInput, "%s: not a readable safetensors file (%s)",
                       path.c_str(), what);
}

// One tensor described by `entry`, copied out of the file's data.
Result<torch::Tensor> read_one(const std::string& path, const JsonValue& entry,
                               std::string_view data) {
  const JsonValue* dtype = entry.find("dtype");
  const JsonValue* shape = entry.find("shape");
  const JsonValue* offsets = entry.find("data_offsets");
  if (dtype == nullptr || shape == nullptr || offsets == nullptr || offsets->items().size() != 2) {
    return corrupt(path, "incomplete header");
  }
  const TypeName* type = nullptr;
  for (const TypeName& t : kTypes) {
    if (dtype->text() == t.name) type = &t;
  }
  if (type == nullptr) return corrupt(path, "unknown type");
  std::vector<std::int64_t> extents;
  std::uint64_t bytes = torch::elementSize(type->type);
  for (const JsonValue& extent : shape->items()) {
    const std::uint64_t n = extent.whole().value_or(0);
    if (n == 0 || n > data.size()) return corrupt(path, "impossible shape");
    bytes *= n;
    if (bytes > data.size()) return corrupt(path, "truncated");
    extents.push_back(static_cast<std::int64_t>(n));
  }
  const std::uint64_t begin = offsets->items()[0].whole().value_or(~0ULL);
  const std::uint64_t end = offsets->items()[1].whole().value_or(~0ULL);
  if (begin > end || end > data.size() || end - begin != bytes) return corrupt(path, "truncated");
  torch::Tensor tensor = torch::empty(extents, type->type);
  std::copy_n(data.data() + begin, bytes, static_cast<char*>(tensor.data_ptr()));
  return tensor;
}

}  // namespace

std::string json_quoted(const std::string& text) {
  std::string out = "\"";
  for (const char c : text) {
    if (c == '"' || c == '\\') {
      out += '\\';
      out += c;
    } else if (static_cast<unsigned char>(c) < 0x20) {
      char escape[8];
      std::snprintf(escape, sizeof(escape), "\\u%04x", static_cast<unsigned>(c));
      out += escape;
    } else {
      out += c;
    }
  }
  return out + "\"";
}

Status write_tensors(const std::string& path, const TensorFile& file) {
  const std::string header = header_of(file);
  const std::uint64_t length = header.size();  // little-endian machines only, as everything here
  FileReplacement out(path);
  out.append(std::as_bytes(std::span(&length, 1)));
  out.append(std::as_bytes(std::span(header)));
  for (const auto& [name, tensor] : file.tensors) {
    const torch::Tensor packed = tensor.detach().cpu().contiguous();
    out.append({static_cast<const std::byte*>(packed.data_ptr()), packed.nbytes()});
  }
  return out.commit();
}

Result<TensorFile> read_tensors(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  if (!in) return Status::error(StatusCode::kNotFound, "%s cannot be opened", path.c_str());
  const std::string all((std::istreambuf_iterator<char>(in)), std::istreambuf_iterator<char>());
  std::uint64_t length = 0;
  if (all.size() < sizeof(length)) return corrupt(path, "shorter than its header");
  std::copy_n(all.data(), sizeof(length), reinterpret_cast<char*>(&length));
  if (length > kMaxHeader || length > all.size() - sizeof(length))
    return corrupt(path, "header length");

  const std::string_view view(all);
  const Result<JsonValue> header =
      parse_json(view.substr(sizeof(length), length), JsonLimits{kMaxHeader, 8, 1U << 20});
  if (!header || !header->is_object()) return corrupt(path, "header is not JSON");
  TensorFile file;
  for (std::size_t i = 0; i < header->keys().size(); ++i) {
    const std::string& name = header->keys()[i];
    const JsonValue& entry = header->items()[i];
    if (name == "__metadata__") {
      for (std::size_t j = 0; j < entry.keys().size(); ++j) {
        file.metadata[entry.keys()[j]] = std::string(entry.items()[j].text().value_or(""));
      }
      continue;
    }
    const Result<torch::Tensor> tensor =
        read_one(path, entry, view.substr(sizeof(length) + length));
    if (!tensor) return tensor.status();
    file.tensors[name] = *tensor;
  }
  return file;
}

}  // namespace lcdm::model
