#include "model/svg_elements.h"

#include <array>

#include "model/html_text.h"

namespace lcdm::model::svg {
namespace {

constexpr std::size_t kColours = 6;

std::string class_of(std::size_t series) { return "s" + std::to_string(series % kColours); }

}  // namespace

std::string place(double value) {
  std::string text = format(value, std::chars_format::fixed, 1);
  trim_zeros(text);
  return text == "-0" ? "0" : text;
}

std::string attribute(const char* name, double value) {
  return std::string(" ") + name + "=\"" + place(value) + "\"";
}

std::string text_at(const char* kind, double x, double y, const char* anchor,
                    const std::string& text) {
  return std::string("<text class=\"") + kind + "\"" + attribute("x", x) + attribute("y", y) +
         " text-anchor=\"" + anchor + "\">" + escaped(text) + "</text>\n";
}

std::string line_from(const char* kind, double x1, double y1, double x2, double y2) {
  return std::string("<path class=\"") + kind + "\" d=\"M" + place(x1) + " " + place(y1) + "L" +
         place(x2) + " " + place(y2) + "\"/>\n";
}

std::string mark_at(std::size_t series, double x, double y, const std::string& title) {
  static constexpr std::array<const char*, 4> kShapes = {
      "M-4 0a4 4 0 1 0 8 0a4 4 0 1 0-8 0z", "M-3.7-3.7h7.4v7.4h-7.4z", "M0-4.8L4.8 3.6H-4.8z",
      "M0-5L5 0L0 5L-5 0z"};
  return "<path class=\"mark " + class_of(series) + "\" transform=\"translate(" + place(x) + " " +
         place(y) + ")\" d=\"" + kShapes[series % kShapes.size()] + "\">" +
         (title.empty() ? "" : "<title>" + escaped(title) + "</title>") + "</path>\n";
}

std::string line_class(std::size_t series) {
  return "line " + class_of(series) + (series / kColours % 2 == 1 ? " again" : "");
}

}  // namespace lcdm::model::svg
