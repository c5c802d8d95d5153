// The files of app/web, built into the program.
#pragma once

#include <cstddef>
#include <span>
#include <string_view>

namespace lcdm {

// By file name, e.g. "index.html"; empty when there is none.
std::span<const std::byte> find_web_file(std::string_view name);

}  // namespace lcdm
