// The secret that lets a request from the network change something.
#pragma once

#include <string>
#include <string_view>

#include "firmware/base/status.h"

namespace lcdm {

// Reads the token: the file's first line, 16 to 256 printable characters without spaces. A file
// that everybody may read, or that holds anything else, is refused with the cure; no text of an
// error holds a part of it.
Result<std::string> read_token(const std::string& file);

// Whether an Authorization header (`Bearer TOKEN`) carries the token. How long it takes says
// nothing about the token but its length.
bool carries_token(std::string_view authorization, std::string_view token);

}  // namespace lcdm
