#include "model/html_text.h"

#include <algorithm>
#include <cmath>

namespace lcdm::model {
namespace {

constexpr const char* kReplacement = "\xEF\xBF\xBD";
constexpr const char* kDash = "\xE2\x80\x93";
constexpr const char* kThinSpace = "\xE2\x80\xAF";  // between groups of digits; does not break

// Bytes of the UTF-8 character at the start of `text`; 0 where it is none that a page may hold.
std::size_t character_length(std::string_view text) {
  const auto lead = static_cast<unsigned char>(text[0]);
  if (lead < 0x80) return lead >= 0x20 || lead == '\t' || lead == '\n' || lead == '\r' ? 1 : 0;
  const std::size_t length = lead < 0xC2   ? 0
                             : lead < 0xE0 ? 2
                             : lead < 0xF0 ? 3
                             : lead < 0xF5 ? 4
                                           : 0;
  if (length == 0 || text.size() < length) return 0;
  for (std::size_t i = 1; i < length; ++i) {
    if (!is_continuation(text[i])) return 0;
  }
  const auto second = static_cast<unsigned char>(text[1]);
  const bool overlong = (lead == 0xE0 && second < 0xA0) || (lead == 0xF0 && second < 0x90);
  const bool surrogate = lead == 0xED && second > 0x9F;
  const bool beyond = lead == 0xF4 && second > 0x8F;
  return overlong || surrogate || beyond ? 0 : length;
}

}  // namespace

bool is_continuation(char byte) { return (static_cast<unsigned char>(byte) & 0xC0) == 0x80; }

std::string escaped(std::string_view text) {
  std::string out;
  while (!text.empty()) {
    const std::size_t length = character_length(text);
    const std::string_view character = text.substr(0, std::max<std::size_t>(length, 1));
    if (length == 0) {
      out += kReplacement;
    } else if (character == "&") {
      out += "&amp;";
    } else if (character == "<") {
      out += "&lt;";
    } else if (character == ">") {
      out += "&gt;";
    } else if (character == "\"") {
      out += "&quot;";
    } else if (character == "'") {
      out += "&#39;";
    } else {
      out += character;
    }
    text.remove_prefix(character.size());
  }
  return out;
}

std::string format(double value, std::chars_format how, int precision) {
  char buffer[512];  // the longest double in fixed notation has 309 digits
  const auto end = std::to_chars(buffer, buffer + sizeof(buffer), value, how, precision).ptr;
  return {buffer, end};
}

void trim_zeros(std::string& text) {
  if (text.find('.') == std::string::npos) return;
  text.erase(text.find_last_not_of('0') + 1);
  if (text.back() == '.') text.pop_back();
}

// 2e-5
std::string scientific(double value, int digits) {
  const std::string text = format(value, std::chars_format::scientific, digits - 1);
  const std::size_t e = text.find('e');
  std::string mantissa = text.substr(0, e);
  trim_zeros(mantissa);
  const std::size_t exponent = text.find_first_not_of('0', e + 2);
  if (exponent == std::string::npos) return mantissa;
  return mantissa + (text[e + 1] == '-' ? "e-" : "e") + text.substr(exponent);
}

// 12 300.50
std::string fixed(double value, int decimals) {
  std::string text = format(value, std::chars_format::fixed, decimals);
  const std::size_t first = text[0] == '-' ? 1 : 0;
  if (text.find_first_not_of("0.", first) == std::string::npos) return text.substr(first);  // no -0
  const std::size_t point = std::min(text.find('.'), text.size());
  for (std::size_t i = point; i > first + 3; i -= 3) text.insert(i - 3, kThinSpace);
  return text;
}

int exponent_of(double value) { return static_cast<int>(std::floor(std::log10(value) + 1e-9)); }

bool needs_exponent(double magnitude, double smallest) {
  return magnitude >= 1e7 || magnitude < smallest;
}

std::string number_text(double value, int significant_digits) {
  if (!std::isfinite(value)) return kDash;
  if (value == 0) return "0";
  // Rounded first: 9.99996 is 10, whose first digit stands elsewhere.
  const std::string rounded =
      format(std::abs(value), std::chars_format::scientific, significant_digits - 1);
  double magnitude = 0;
  std::from_chars(rounded.data(), rounded.data() + rounded.size(), magnitude);
  if (needs_exponent(magnitude, 1e-4)) return scientific(value, significant_digits);
  std::string text = fixed(value, std::max(0, significant_digits - 1 - exponent_of(magnitude)));
  trim_zeros(text);
  return text;
}

}  // namespace lcdm::model
