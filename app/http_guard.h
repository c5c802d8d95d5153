// Which requests are refused before anybody looks at them. Pure: no sockets.
#pragma once

#include <string>
#include <string_view>

namespace lcdm {

struct RequestFacts {
  std::string_view method;
  std::string_view host;             // the Host header; empty when absent
  std::string_view origin;           // the Origin header; empty when absent
  std::string_view client{};         // the client's numeric address
  std::string_view authorization{};  // the Authorization header; empty when absent
};

// Who may change state over the network. Clients on this machine's own loopback always may.
struct ControlRule {
  std::string_view token;  // whoever carries it; empty: nobody
  bool everybody = false;  // http.insecure
};

struct Verdict {
  int status = 200;         // HTTP status; 200 lets the request through
  const char* reason = "";  // one line for a person
};

// `allowed_method` is the route's ("GET" also lets HEAD through); `machine_name` is this machine's.
//
// Host: a page of another site that points its own name at our address (DNS rebinding) sends that
// name here, so only numeric addresses, localhost and this machine's own names pass.
// Origin: whatever changes state is POST, and a browser sends Origin with it; it must be ours.
// Authorization: what changes state from beyond loopback must carry the token.
Verdict judge_request(const RequestFacts& facts, std::string_view allowed_method,
                      std::string_view machine_name, const ControlRule& control);

}  // namespace lcdm
