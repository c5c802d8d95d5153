// Text and numbers as they stand in a page.
#pragma once

#include <charconv>
#include <string>
#include <string_view>

namespace lcdm::model {

// Safe between tags and in attributes; bytes that are no UTF-8 are replaced.
std::string escaped(std::string_view text);
// Bytes that continue a UTF-8 character.
bool is_continuation(char byte);

// For tables: 0.3 of 0.30000000004, 12 300 of 12300.4, 2e-5, and a dash of what is not finite.
std::string number_text(double value, int significant_digits = 4);

// The pieces of number_text, for axes that need all their numbers alike.
std::string format(double value, std::chars_format how, int precision);
void trim_zeros(std::string& text);                // 1.500 -> 1.5, 2.0 -> 2
std::string scientific(double value, int digits);  // 2e-5
std::string fixed(double value, int decimals);     // 12 300.50
int exponent_of(double value);                     // of its first digit
bool needs_exponent(double magnitude, double smallest);

}  // namespace lcdm::model
