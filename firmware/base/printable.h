// Texts from outside that people will see: what is in them must not steer the terminal.
#pragma once

#include <cstddef>
#include <span>
#include <string>
#include <string_view>

namespace lcdm {

// Where the first control character is (C0, DEL and, in UTF-8, C1, by its second byte); npos: there
// is none.
inline std::size_t find_control(std::string_view text) {
  for (std::size_t i = 0; i < text.size(); ++i) {
    const auto byte = static_cast<unsigned char>(text[i]);
    const bool c1 = byte >= 0x80 && byte < 0xA0 && i > 0 && text[i - 1] == '\xC2';
    if (byte < 0x20 || byte == 0x7F || c1) return i;
  }
  return std::string_view::npos;
}

// Puts question marks in their place.
inline void hide_controls(std::span<char> text) {
  const std::string_view view(text.data(), text.size());
  for (std::size_t i = find_control(view); i != std::string_view::npos; i = find_control(view)) {
    text[i] = '?';
  }
}

// The text without them.
inline std::string printable(std::string_view text) {
  std::string result(text);
  hide_controls(result);
  return result;
}

}  // namespace lcdm
