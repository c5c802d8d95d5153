#include "app/http_server.h"

#include <algorithm>
#include <arpa/inet.h>
#include <cerrno>
#include <chrono>
#include <civetweb.h>
#include <cstdio>
#include <dlfcn.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <pthread.h>
#include <sys/socket.h>
#include <thread>
#include <unistd.h>

#include "app/address.h"
#include "app/http_guard.h"
#include "firmware/base/os.h"

// CivetWeb makes its threads with stacks of 100 KB, of which OpenBLAS, brought by OpenCV, takes 60
// for its thread-local data: too little room for comfort, and none under a sanitizer. It offers no
// setting, so the program answers its request with a larger stack.
extern "C" int pthread_attr_setstacksize(pthread_attr_t* attributes, std::size_t bytes) noexcept {
  constexpr std::size_t kLeastStack = 512 << 10;
  using Function = int (*)(pthread_attr_t*, std::size_t);
  static const auto next =
      reinterpret_cast<Function>(dlsym(RTLD_NEXT, "pthread_attr_setstacksize"));
  return next(attributes, std::max(bytes, kLeastStack));
}

namespace lcdm {
namespace {

// Threads beyond the viewers', for short requests such as the status, and how many of them may wait
// for something: nobody who asks for pictures keeps the others from the status.
constexpr int kShortRequestThreads = 8;
constexpr int kWaitingThreads = kShortRequestThreads / 2;
constexpr const char* kMaxRequestBytes = "8192";
// What the kernel may hold for one client. A slow one then loses frames, not seconds.
constexpr int kSendBufferBytes = 256 * 1024;
// How long the kernel keeps a connection that has said nothing yet to itself, give or take.
constexpr int kSilenceSeconds = 30;
// No descriptor of ours is higher: the number of threads and files is capped.
constexpr int kMaxDescriptor = 1024;

const char* reason_of(int status) {
  switch (status) {
    case 200:
      return "OK";
    case 400:
      return "Bad Request";
    case 401:
      return "Unauthorized";
    case 403:
      return "Forbidden";
    case 404:
      return "Not Found";
    case 405:
      return "Method Not Allowed";
    case 421:
      return "Misdirected Request";
    case 503:
      return "Service Unavailable";
    default:
      return "Internal Server Error";
  }
}

std::string_view header(const mg_connection* connection, const char* name) {
  const char* value = mg_get_header(connection, name);
  return value == nullptr ? std::string_view() : value;
}

std::string bracketed(const std::string& address) {
  return address.find(':') == std::string::npos ? address : "[" + address + "]";
}

// Whether this machine has the address at this moment, and civetweb can serve it: others cannot be
// bound.
bool has_address(const std::string& address) {
  const int error = bind_error(address, 0);
  return error != EADDRNOTAVAIL && error != EAFNOSUPPORT;
}

// "127.0.0.1:8080,10.0.0.1:8080".
std::string places(const std::vector<std::string>& addresses, int port) {
  std::string text;
  for (const std::string& address : addresses) {
    text += (text.empty() ? "" : ",") + bracketed(address) + ":" + std::to_string(port);
  }
  return text;
}

int local_port(int descriptor) {
  sockaddr_storage address{};
  socklen_t length = sizeof(address);
  if (getsockname(descriptor, reinterpret_cast<sockaddr*>(&address), &length) != 0) return -1;
  if (address.ss_family == AF_INET) {
    return ntohs(reinterpret_cast<const sockaddr_in*>(&address)->sin_port);
  }
  if (address.ss_family == AF_INET6) {
    return ntohs(reinterpret_cast<const sockaddr_in6*>(&address)->sin6_port);
  }
  return -1;
}

// civetweb keeps its sockets to itself, so we find them by their port: the listening one and those
// it accepted.
template <typename Function>
void for_each_socket(int port, Function&& function) {
  for (int descriptor = 0; descriptor < kMaxDescriptor; ++descriptor) {
    if (local_port(descriptor) == port) function(descriptor);
  }
}

}  // namespace

// ---- HttpExchange -------------------------------------------------------------------------------

std::string HttpExchange::query(const char* name) const {
  const char* text = mg_get_request_info(connection_)->query_string;
  if (text == nullptr) return {};
  std::string value(std::char_traits<char>::length(text) + 1, '\0');
  const int length = mg_get_var(text, value.size() - 1, name, value.data(), value.size());
  value.resize(length < 0 ? 0 : static_cast<std::size_t>(length));
  return value;
}

bool HttpExchange::is_head_request() const {
  return std::string_view(mg_get_request_info(connection_)->request_method) == "HEAD";
}

bool HttpExchange::send_head(int status, std::string_view type, long long length,
                             const HttpHeaders& headers) {
  std::string head = "HTTP/1.1 " + std::to_string(status) + " " + reason_of(status) + "\r\n";
  head += "Content-Type: " + std::string(type) + "\r\n";
  if (length >= 0) head += "Content-Length: " + std::to_string(length) + "\r\n";
  for (const auto& [name, value] : headers) {
    head.append(name).append(": ").append(value).append("\r\n");
  }
  head +=
      "Connection: close\r\n"
      "Cache-Control: no-store\r\n"
      "Content-Security-Policy: default-src 'self'; img-src 'self' blob:; base-uri 'none'; "
      "form-action 'none'; frame-ancestors 'none'\r\n"
      "Cross-Origin-Resource-Policy: same-origin\r\n"
      "Referrer-Policy: no-referrer\r\n"
      "X-Content-Type-Options: nosniff\r\n\r\n";
  begun_ = true;
  return write_text(head);
}

void HttpExchange::send(int status, std::string_view type, std::span<const std::byte> body,
                        const HttpHeaders& headers) {
  if (!send_head(status, type, static_cast<long long>(body.size()), headers)) return;
  if (!is_head_request()) write(body);
}

void HttpExchange::send_text(int status, std::string_view type, std::string_view body,
                             const HttpHeaders& headers) {
  send(status, type, std::as_bytes(std::span(body.data(), body.size())), headers);
}

bool HttpExchange::begin_stream(std::string_view type) {
  return send_head(200, type, -1, {}) && !is_head_request();
}

bool HttpExchange::write(std::span<const std::byte> bytes) {
  if (stopping_) return false;
  const int written = mg_write(connection_, bytes.data(), bytes.size());
  return written == static_cast<int>(bytes.size());
}

bool HttpExchange::write_text(std::string_view text) {
  return write(std::as_bytes(std::span(text.data(), text.size())));
}

// ---- HttpServer ---------------------------------------------------------------------------------

HttpServer::HttpServer(HttpOptions options, std::vector<HttpRoute> routes)
    : options_(std::move(options)), routes_(std::move(routes)) {
  char name[256] = {};
  if (gethostname(name, sizeof(name) - 1) == 0) machine_name_ = name;
}

Result<std::unique_ptr<HttpServer>> HttpServer::start(const HttpOptions& options,
                                                      std::vector<HttpRoute> routes) {
  std::unique_ptr<HttpServer> server(new HttpServer(options, std::move(routes)));
  LCDM_RETURN_IF_ERROR(server->listen());
  server->tune_sockets();
  return server;
}

Status HttpServer::listen() {
  const auto first_left_out =
      std::stable_partition(options_.listen.begin(), options_.listen.end(), has_address);
  left_out_.assign(first_left_out, options_.listen.end());
  options_.listen.erase(first_left_out, options_.listen.end());
  if (options_.listen.empty()) {
    return Status::error(
        StatusCode::kNotFound,
        "http: cannot listen on %s: this machine has no such address now, or its "
        "HTTP library (civetweb) was built without IPv6: set http.listen (--listen) to "
        "127.0.0.1, 0.0.0.0 or an address it has",
        places(left_out_, options_.port).c_str());
  }
  const std::string place = places(options_.listen, options_.port);
  const std::string threads = std::to_string(options_.max_clients + kShortRequestThreads);
  const std::string timeout = std::to_string(options_.timeout_ms);
  const char* settings[] = {"listening_ports",
                            place.c_str(),
                            "num_threads",
                            threads.c_str(),
                            "request_timeout_ms",
                            timeout.c_str(),
                            "max_request_size",
                            kMaxRequestBytes,
                            "enable_keep_alive",
                            "no",
                            "tcp_nodelay",
                            "1",
                            nullptr};
  mg_callbacks callbacks{};
  callbacks.begin_request = &HttpServer::begin_request;
  callbacks.log_message = &HttpServer::log_message;
  callbacks.init_thread = &HttpServer::begin_thread;
  starting_ = true;
  context_ = mg_start(&callbacks, this, settings);
  starting_ = false;
  if (context_ == nullptr) {
    return Status::error(StatusCode::kUnavailable,
                         "http: cannot listen on %s (%s): stop the program that uses the port or "
                         "choose another (--port N, http.port), on an address this machine has "
                         "(--listen, http.listen)",
                         place.c_str(), last_complaint_.c_str());
  }
  mg_server_port ports[4] = {};
  if (mg_get_server_ports(context_, 4, ports) > 0) port_ = ports[0].port;
  return Status::ok();
}

// Accepted sockets inherit the buffer from the listening one. A connection that says nothing (such
// as browsers open in advance) costs no thread: the kernel gives it to us with its first bytes.
void HttpServer::tune_sockets() const {
  for_each_socket(port_, [](int descriptor) {
    setsockopt(descriptor, SOL_SOCKET, SO_SNDBUF, &kSendBufferBytes, sizeof(kSendBufferBytes));
    setsockopt(descriptor, IPPROTO_TCP, TCP_DEFER_ACCEPT, &kSilenceSeconds,
               sizeof(kSilenceSeconds));
  });
}

// civetweb looks at its stop flag only every two seconds while it waits on a socket. Shutting the
// sockets down wakes those waits, so that the program can end within one.
void HttpServer::stop() {
  stopping_ = true;
  if (context_ == nullptr) return;
  std::atomic<bool> stopped{false};
  std::thread joiner;
  try {
    joiner = std::thread([this, &stopped] {
      mg_stop(context_);
      stopped = true;
    });
  } catch (const std::system_error&) {  // no thread to be had: in its own time, then
    mg_stop(context_);
    context_ = nullptr;
    return;
  }
  while (!stopped) {
    for_each_socket(port_, [](int descriptor) { shutdown(descriptor, SHUT_RDWR); });
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  joiner.join();
  context_ = nullptr;
}

std::string HttpServer::address() const {
  const std::string& first = options_.listen.front();
  const bool everybody = first == "0.0.0.0" || first == "::";
  const std::string host = everybody ? machine_name_ : bracketed(first);
  return "http://" + host + ":" + std::to_string(port_) + "/";
}

std::string HttpServer::local_address() const {
  for (const std::string& listen : options_.listen) {
    std::string address = reachable_address(listen);
    if (bind_error(address, 0) == 0) return address;
  }
  return {};
}

int HttpServer::log_message(const mg_connection* connection, const char* text) {
  auto* server = static_cast<HttpServer*>(mg_get_user_data(mg_get_context(connection)));
  // Only while starting; later complaints are about clients. A client may already be there.
  if (server == nullptr || !server->starting_) return 1;
  const std::lock_guard lock(server->complaint_mutex_);
  server->last_complaint_ = text;
  return 1;
}

// The page waits for inference, never the reverse.
void* HttpServer::begin_thread(const mg_context* /*context*/, int kind) {
  constexpr int kServesRequests = 1;
  if (kind == kServesRequests) os::lower_thread_priority(5);
  return nullptr;
}

int HttpServer::begin_request(mg_connection* connection) {
  // We read no body: one that is announced must not hold a thread until it has come.
  mg_disable_connection_keep_alive(connection);
  static_cast<HttpServer*>(mg_get_user_data(mg_get_context(connection)))->handle(connection);
  return 1;  // answered here, whatever it was
}

const HttpRoute* HttpServer::find_route(const std::string& path, std::string_view method) const {
  const HttpRoute* found = nullptr;
  for (const HttpRoute& route : routes_) {
    if (route.path != path) continue;
    if (found == nullptr || route.method == method) found = &route;
  }
  return found;
}

// The library is C: nothing may fly through it.
void HttpServer::handle(mg_connection* connection) {
  HttpExchange exchange(connection, stopping_, viewers_);
  try {
    answer(connection, exchange);
  } catch (const std::exception& error) {
    if (exchange.begun()) return;
    exchange.send_text(500, "text/plain; charset=utf-8", std::string(error.what()) + "\n");
  }
}

void HttpServer::answer(mg_connection* connection, HttpExchange& exchange) {
  const mg_request_info* request = mg_get_request_info(connection);
  const char* path = request->local_uri == nullptr ? "" : request->local_uri;
  const HttpRoute* route = find_route(path, request->request_method);
  const Verdict verdict = judge_request(
      {request->request_method, header(connection, "Host"), header(connection, "Origin"),
       request->remote_addr, header(connection, "Authorization")},
      route == nullptr ? "GET" : std::string_view(route->method), machine_name_,
      {options_.token, options_.insecure});
  if (verdict.status != 200) {
    HttpHeaders headers;
    if (verdict.status == 405) headers.emplace_back("Allow", route ? route->method : "GET");
    if (verdict.status == 401) headers.emplace_back("WWW-Authenticate", "Bearer");
    exchange.send_text(verdict.status, "text/plain; charset=utf-8",
                       std::string(verdict.reason) + "\n", headers);
  } else if (route == nullptr) {
    exchange.send_text(404, "text/plain; charset=utf-8", "nothing here: see /\n");
  } else {
    serve(*route, exchange);
  }
}

void HttpServer::serve(const HttpRoute& route, HttpExchange& exchange) {
  if (route.stay == HttpStay::kShort) {
    route.serve(exchange);
    return;
  }
  const bool is_stream = route.stay == HttpStay::kStream;
  struct Place {
    std::atomic<int>& taken;
    const int before = taken.fetch_add(1);
    ~Place() { taken.fetch_sub(1); }
  } const place{is_stream ? viewers_ : waiting_};
  if (place.before < (is_stream ? options_.max_clients : kWaitingThreads)) {
    route.serve(exchange);
  } else if (!is_stream) {
    exchange.send_text(503, "text/plain; charset=utf-8",
                       "others wait for this already, as many as may: ask again\n",
                       {{"Retry-After", "1"}});
  } else {
    exchange.send_text(503, "text/plain; charset=utf-8",
                       "all viewers' places are taken: close a page or raise http.max_clients\n",
                       {{"Retry-After", "5"}});
  }
}

}  // namespace lcdm
