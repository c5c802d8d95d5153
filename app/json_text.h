// How JSON leaves this program.
#pragma once

#include <nlohmann/json.hpp>
#include <string>

namespace lcdm {

// Indented, with a line's end. Names of cameras and files, and faults, may hold bytes that are no
// UTF-8: they are replaced.
inline std::string json_text(const nlohmann::json& json) {
  return json.dump(2, ' ', false, nlohmann::json::error_handler_t::replace) + "\n";
}

}  // namespace lcdm
