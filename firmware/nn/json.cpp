#include "firmware/nn/json.h"

#include <charconv>
#include <set>
#include <utility>

#include "firmware/base/printable.h"

namespace lcdm {
namespace {

// RFC 3629: no stray or missing bytes, none longer than they need be, no halves of surrogate pairs.
bool is_utf8(std::string_view text) {
  for (std::size_t i = 0; i < text.size();) {
    const auto first = static_cast<unsigned char>(text[i]);
    const std::size_t bytes = first < 0x80 ? 1 : first < 0xE0 ? 2 : first < 0xF0 ? 3 : 4;
    if ((first >= 0x80 && first < 0xC2) || first > 0xF4 || i + bytes > text.size()) return false;
    std::uint32_t code = bytes == 1 ? first : first & (0x7FU >> bytes);
    for (std::size_t k = 1; k < bytes; ++k) {
      const auto next = static_cast<unsigned char>(text[i + k]);
      if ((next & 0xC0U) != 0x80) return false;
      code = code << 6 | (next & 0x3FU);
    }
    constexpr std::uint32_t kLeast[] = {0, 0, 0x80, 0x800, 0x10000};
    if (code < kLeast[bytes] || code > 0x10FFFF || (code >= 0xD800 && code < 0xE000)) return false;
    i += bytes;
  }
  return true;
}

}  // namespace

std::optional<double> JsonValue::number() const {
  return kind_ == Kind::kNumber ? std::optional(number_) : std::nullopt;
}

std::optional<std::string_view> JsonValue::text() const {
  return kind_ == Kind::kString ? std::optional<std::string_view>(text_) : std::nullopt;
}

const JsonValue* JsonValue::find(std::string_view key) const {
  for (std::size_t i = 0; i < keys_.size(); ++i) {
    if (keys_[i] == key) return &items_[i];
  }
  return nullptr;
}

// Recursive descent; every method returns false after recording the first error.
class JsonParser {
 public:
  JsonParser(std::string_view text, const JsonLimits& limits) : text_(text), limits_(limits) {}

  bool parse(JsonValue& out) {
    if (text_.size() > limits_.bytes) return fail("text is too long");
    if (!value(out, 0)) return false;
    skip_space();
    return at_ == text_.size() || fail("something follows the value");
  }
  Status error() const {
    return Status::error(StatusCode::kCorrupt, "JSON: %s at byte %zu", message_, at_);
  }

 private:
  bool fail(const char* message) {
    if (message_ == nullptr) message_ = message;
    return false;
  }
  char peek() const { return at_ < text_.size() ? text_[at_] : '\0'; }
  void skip_space() {
    while (at_ < text_.size() &&
           (peek() == ' ' || peek() == '\n' || peek() == '\t' || peek() == '\r')) {
      ++at_;
    }
  }
  bool eat(char c) {
    skip_space();
    if (at_ >= text_.size() || text_[at_] != c) return false;
    ++at_;
    return true;
  }

  bool value(JsonValue& out, std::size_t depth) {
    if (++values_ > limits_.values) return fail("too many values");
    if (depth > limits_.depth) return fail("nested too deeply");
    skip_space();
    switch (peek()) {
      case '{':
        return object(out, depth);
      case '[':
        return array(out, depth);
      case '"':
        out.kind_ = JsonValue::Kind::kString;
        return string(out.text_);
      case 't':
        return word(out, "true", JsonValue::Kind::kBool);
      case 'f':
        return word(out, "false", JsonValue::Kind::kBool);
      case 'n':
        return word(out, "null", JsonValue::Kind::kNull);
      default:
        return number(out);
    }
  }

  bool word(JsonValue& out, std::string_view expected, JsonValue::Kind kind) {
    if (text_.substr(at_, expected.size()) != expected) return fail("unknown word");
    at_ += expected.size();
    out.kind_ = kind;
    return true;
  }

  bool object(JsonValue& out, std::size_t depth) {
    out.kind_ = JsonValue::Kind::kObject;
    ++at_;
    if (eat('}')) return true;
    std::set<std::string> seen;
    do {
      skip_space();
      std::string key;
      if (!string(key)) return false;
      if (!seen.insert(key).second) return fail("repeated key");
      if (!eat(':')) return fail("expected ':'");
      out.keys_.push_back(std::move(key));
      if (!value(out.items_.emplace_back(), depth + 1)) return false;
    } while (eat(','));
    return eat('}') || fail("expected ',' or '}'");
  }

  bool array(JsonValue& out, std::size_t depth) {
    out.kind_ = JsonValue::Kind::kArray;
    ++at_;
    if (eat(']')) return true;
    do {
      if (!value(out.items_.emplace_back(), depth + 1)) return false;
    } while (eat(','));
    return eat(']') || fail("expected ',' or ']'");
  }

  // What from_chars takes and JSON does not: 01 and 1.
  static bool is_number(std::string_view text) {
    const auto is_digit = [](char c) { return c >= '0' && c <= '9'; };
    if (text.front() == '-') text.remove_prefix(1);
    if (text.size() > 1 && text[0] == '0' && is_digit(text[1])) return false;
    const std::size_t dot = text.find('.');
    return dot == std::string_view::npos || (dot + 1 < text.size() && is_digit(text[dot + 1]));
  }

  bool number(JsonValue& out) {
    const char* begin = text_.data() + at_;
    const char* end = text_.data() + text_.size();
    const bool digit_first = peek() >= '0' && peek() <= '9';
    const bool signed_digit =
        peek() == '-' && at_ + 1 < text_.size() && begin[1] >= '0' && begin[1] <= '9';
    if (!digit_first && !signed_digit) return fail("expected a value");
    const auto [last, error] = std::from_chars(begin, end, out.number_);
    if (error != std::errc{}) return fail("number out of range");
    if (!is_number({begin, last})) return fail("expected a number");
    out.kind_ = JsonValue::Kind::kNumber;
    std::uint64_t whole = 0;
    const auto [whole_last, whole_error] = std::from_chars(begin, end, whole);
    if (whole_error == std::errc{} && whole_last == last) out.whole_ = whole;
    at_ += static_cast<std::size_t>(last - begin);
    return true;
  }

  bool string(std::string& out) {
    if (peek() != '"') return fail("expected a string");
    ++at_;
    while (at_ < text_.size()) {
      const char c = text_[at_];
      ++at_;
      if (c == '"') {
        if (find_control(out) != std::string::npos) return fail("control character in a string");
        return is_utf8(out) || fail("a string that is not UTF-8");
      }
      if (c != '\\') {
        out += c;
      } else if (!escape(out)) {
        return false;
      }
    }
    return fail("unterminated string");
  }

  bool escape(std::string& out) {
    constexpr std::string_view kNames = "\"\\/bfnrt";
    constexpr std::string_view kMeanings = "\"\\/\b\f\n\r\t";
    const char c = peek();
    ++at_;
    if (c == 'u') return unicode(out);
    const std::size_t index = kNames.find(c);
    if (c == '\0' || index == std::string_view::npos) return fail("unknown escape");
    out += kMeanings[index];
    return true;
  }

  // \uXXXX, and pairs of them outside the basic plane, as UTF-8.
  bool unicode(std::string& out) {
    std::uint32_t code = 0;
    if (!hex4(code)) return false;
    if (code >= 0xD800 && code < 0xDC00) {
      std::uint32_t low = 0;
      if (text_.substr(at_, 2) != "\\u") return fail("half a surrogate pair");
      at_ += 2;
      if (!hex4(low)) return false;
      if (low < 0xDC00 || low >= 0xE000) return fail("half a surrogate pair");
      code = 0x10000 + ((code - 0xD800) << 10) + (low - 0xDC00);
    } else if (code >= 0xDC00 && code < 0xE000) {
      return fail("half a surrogate pair");
    }
    append_utf8(out, code);
    return true;
  }
  bool hex4(std::uint32_t& code) {
    if (at_ + 4 > text_.size()) return fail("short \\u escape");
    const char* begin = text_.data() + at_;
    const auto [last, error] = std::from_chars(begin, begin + 4, code, 16);
    if (error != std::errc{} || last != begin + 4) return fail("bad \\u escape");
    at_ += 4;
    return true;
  }
  static void append_utf8(std::string& out, std::uint32_t code) {
    const auto tail = [&](int shift) {
      out += static_cast<char>(0x80U | ((code >> shift) & 0x3FU));
    };
    if (code < 0x80) {
      out += static_cast<char>(code);
    } else if (code < 0x800) {
      out += static_cast<char>(0xC0U | (code >> 6));
      tail(0);
    } else if (code < 0x10000) {
      out += static_cast<char>(0xE0U | (code >> 12));
      tail(6);
      tail(0);
    } else {
      out += static_cast<char>(0xF0U | (code >> 18));
      tail(12);
      tail(6);
      tail(0);
    }
  }

  std::string_view text_;
  JsonLimits limits_;
  std::size_t at_ = 0;
  std::size_t values_ = 0;
  const char* message_ = nullptr;
};

Result<JsonValue> parse_json(std::string_view text, const JsonLimits& limits) {
  JsonParser parser(text, limits);
  JsonValue value;
  if (!parser.parse(value)) return parser.error();
  return value;
}

}  // namespace lcdm
