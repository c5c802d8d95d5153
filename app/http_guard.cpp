#include "app/http_guard.h"

#include <algorithm>
#include <cctype>

#include "app/address.h"
#include "app/http_token.h"

namespace lcdm {
namespace {

std::string lower(std::string_view text) {
  std::string out(text);
  std::transform(out.begin(), out.end(), out.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return out;
}

bool is_port(std::string_view text) {
  return !text.empty() && text.size() <= 5 &&
         std::all_of(text.begin(), text.end(),
                     [](unsigned char c) { return std::isdigit(c) != 0; });
}

// "name:port" or "[v6]:port" without the port and the brackets; empty when malformed.
std::string host_name(std::string_view host) {
  std::string_view rest;
  std::string_view name = host;
  if (host.substr(0, 1) == "[") {
    const std::size_t end = host.find(']');
    if (end == std::string_view::npos) return {};
    name = host.substr(1, end - 1);
    rest = host.substr(end + 1);
  } else if (const std::size_t colon = host.find(':'); colon != std::string_view::npos) {
    name = host.substr(0, colon);
    rest = host.substr(colon);
  }
  if (!rest.empty() && (rest[0] != ':' || !is_port(rest.substr(1)))) return {};
  return lower(name);
}

bool is_ours(std::string_view host, std::string_view machine_name) {
  const std::string name = host_name(host);
  if (name.empty()) return false;
  const std::string machine = lower(machine_name);
  if (name == "localhost" || is_numeric_address(name)) return true;
  return !machine.empty() && (name == machine || name == machine + ".local");
}

// As the server writes addresses: IPv4 on an IPv6 socket is mapped.
bool is_loopback(std::string_view address) {
  constexpr std::string_view kMapped = "::ffff:";
  if (address.substr(0, kMapped.size()) == kMapped) address.remove_prefix(kMapped.size());
  return address == "::1" ||
         (address.substr(0, 4) == "127." && is_numeric_address(std::string(address)));
}

Verdict judge_control(const RequestFacts& facts, const ControlRule& control) {
  if (control.everybody || is_loopback(facts.client)) return {};
  if (control.token.empty()) {
    return {403, "control from the network is off: set http.token_file, or http.insecure = true"};
  }
  if (carries_token(facts.authorization, control.token)) return {};
  return {401, "control from the network needs the token, as Authorization: Bearer TOKEN"};
}

}  // namespace

Verdict judge_request(const RequestFacts& facts, std::string_view allowed_method,
                      std::string_view machine_name, const ControlRule& control) {
  if (facts.host.empty()) return {400, "the request has no Host header"};
  if (!is_ours(facts.host, machine_name)) {
    return {421, "this machine is not known by that name: use its address"};
  }
  const bool reads = facts.method == "GET" || facts.method == "HEAD";
  if (!(facts.method == allowed_method || (reads && allowed_method == "GET"))) {
    return {405, "this address takes another method"};
  }
  if (reads) return {};
  if (!facts.origin.empty() && lower(facts.origin) != "http://" + lower(facts.host)) {
    return {403, "requests from other sites are refused"};
  }
  return judge_control(facts, control);
}

}  // namespace lcdm
