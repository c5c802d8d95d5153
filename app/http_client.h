// Asks a server of this machine, as any client would.
#pragma once

#include <optional>
#include <string>

namespace lcdm {

// The body of what GET `path` is answered, whatever its status; empty: no answer. `address` is a
// number. Waits 2 s at most for each of connecting, sending and the next bytes; reads 1 MiB at
// most.
std::optional<std::string> http_get(const std::string& address, int port, const std::string& path);

}  // namespace lcdm
