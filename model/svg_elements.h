// What a chart is drawn with; the page's style sheet knows the classes.
#pragma once

#include <cstddef>
#include <string>

namespace lcdm::model::svg {

// A place in a drawing, to a tenth.
std::string place(double value);
std::string attribute(const char* name, double value);

std::string text_at(const char* kind, double x, double y, const char* anchor,
                    const std::string& text);
std::string line_from(const char* kind, double x1, double y1, double x2, double y2);
// A point of the series of this number. Shapes differ too, for a printer without colours.
std::string mark_at(std::size_t series, double x, double y, const std::string& title);
std::string line_class(std::size_t series);

}  // namespace lcdm::model::svg
