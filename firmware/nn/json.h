// A small JSON reader for untrusted text (RFC 8259): model headers and their metadata. Its strings
// may be printed: one with a control character, however it is written, or that is not UTF-8, is
// refused.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "firmware/base/status.h"

namespace lcdm {

struct JsonLimits {
  std::size_t bytes = 1 << 20;  // of the text
  std::size_t depth = 8;        // of nested arrays and objects
  std::size_t values = 100000;  // of any kind, in all
};

class JsonValue {
 public:
  enum class Kind : std::uint8_t { kNull, kBool, kNumber, kString, kArray, kObject };

  Kind kind() const { return kind_; }
  bool is_object() const { return kind_ == Kind::kObject; }
  bool is_array() const { return kind_ == Kind::kArray; }

  // Each empty when the value is of another kind. `whole` is also empty for a number that is
  // negative, has a fraction or exponent, or does not fit.
  std::optional<double> number() const;
  std::optional<std::uint64_t> whole() const { return whole_; }
  std::optional<std::string_view> text() const;

  // Array elements, or an object's values in the order of keys().
  const std::vector<JsonValue>& items() const { return items_; }
  const std::vector<std::string>& keys() const { return keys_; }
  // The value under `key`, or null. Keys are unique: the parser refuses a repeated one.
  const JsonValue* find(std::string_view key) const;

 private:
  friend class JsonParser;
  Kind kind_ = Kind::kNull;
  double number_ = 0;
  std::optional<std::uint64_t> whole_;
  std::string text_;
  std::vector<JsonValue> items_;
  std::vector<std::string> keys_;
};

// kCorrupt: not one JSON value within the limits; the text says what and at which byte.
Result<JsonValue> parse_json(std::string_view text, const JsonLimits& limits = {});

}  // namespace lcdm
