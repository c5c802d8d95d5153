// Numeric internet addresses, IPv4 and IPv6.
#pragma once

#include <string>

namespace lcdm {

bool is_numeric_address(const std::string& text);

// Where this machine itself reaches a server that listens there: of "every address" its own.
std::string reachable_address(const std::string& listen);

// Whether a server could listen there at this moment: 0, or the errno of trying. EADDRINUSE:
// another does; EADDRNOTAVAIL, EAFNOSUPPORT: this machine has no such address, or its HTTP library
// (civetweb, as Debian 12's) was built without IPv6. `port` 0: any port.
int bind_error(const std::string& address, int port);

}  // namespace lcdm
