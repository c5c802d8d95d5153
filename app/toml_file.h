// TOML files from outside: read within limits, every fault named by its place.
#pragma once

#include <functional>
#include <string>
#include <toml.hpp>

#include "firmware/base/status.h"

namespace lcdm {

// kInvalidInput: "place: text".
Status config_error(const std::string& place, const std::string& text);

// file:line:column
std::string place_of(const std::string& file, const toml::source_location& location);

// Parses `file`, which is a `what` for the texts of errors, and gives it to `use`, whose status it
// returns. The texts begin with the place.
Status read_toml(const std::string& file, const std::string& what,
                 const std::function<Status(const toml::value&)>& use);

}  // namespace lcdm
