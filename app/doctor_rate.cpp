#include "app/doctor_rate.h"

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <limits>
#include <nlohmann/json.hpp>
#include <optional>
#include <thread>
#include <utility>

#include "app/address.h"
#include "app/http_client.h"
#include "firmware/base/os.h"

namespace lcdm {
namespace {

constexpr std::int64_t kFirstFrameNs = 3'000'000'000;  // longer than the pipeline waits for it
constexpr std::int64_t kSettleNs = 500'000'000;        // frames after it wait for the exposure
constexpr std::int64_t kTrialNs = 1'500'000'000;       // at least
constexpr std::int64_t kCountNs = 1'000'000'000;       // at least

// `least`, or three periods where that is longer. 0: the rate is not known.
std::int64_t trial_of(std::int64_t least_ns, float frames_per_second) {
  if (!(frames_per_second > 0)) return least_ns;
  return std::max(least_ns, static_cast<std::int64_t>(3e9F / frames_per_second));
}

struct Taken {
  int frames = 0;
  std::int64_t last_ns = 0;  // when the last came
};

// Takes frames until `end_ns`, or until there are `most`.
Result<Taken> take_frames(Camera& camera, std::int64_t end_ns,
                          int most = std::numeric_limits<int>::max()) {
  Taken taken;
  while (taken.frames < most && os::monotonic_ns() < end_ns) {
    const auto frame = camera.dequeue(std::chrono::milliseconds(100));
    if (frame) {
      LCDM_RETURN_IF_ERROR(camera.requeue(frame->index));
      ++taken.frames;
      taken.last_ns = os::monotonic_ns();
    } else if (frame.code() != StatusCode::kTimeout && frame.code() != StatusCode::kCorrupt) {
      return frame.status();
    }
  }
  return taken;
}

// From the last frame of the settling to the last of the trial: whole periods.
Result<float> rate_of_stream(Camera& camera, float asked) {
  const Result<Taken> first = take_frames(camera, os::monotonic_ns() + kFirstFrameNs, 1);
  if (!first) return first.status();
  const std::int64_t settled_ns = os::monotonic_ns() + kSettleNs;
  const Result<Taken> before = take_frames(camera, settled_ns);
  if (!before) return before.status();
  const float promised = camera.info().frames_per_second;
  const float rate = promised > 0 ? std::min(promised, asked) : asked;
  const Result<Taken> trial = take_frames(camera, settled_ns + trial_of(kTrialNs, rate));
  if (!trial) return trial.status();
  if (first->frames == 0 || trial->frames == 0) {
    return Status::error(StatusCode::kTimeout,
                         "no frame comes: is its lens, cable or signal well?");
  }
  const std::int64_t begin_ns = before->frames > 0 ? before->last_ns : first->last_ns;
  return static_cast<float>(trial->frames) * 1e9F / static_cast<float>(trial->last_ns - begin_ns);
}

// What /status.json says now; empty where nothing, or nothing of that kind, listens.
std::optional<nlohmann::json> status_at(const std::string& address, int port) {
  const std::optional<std::string> body = http_get(address, port, "/status.json");
  nlohmann::json json = nlohmann::json::parse(body.value_or(""), nullptr, false);
  return json.is_object() ? std::optional(std::move(json)) : std::nullopt;
}

// What a status says of the camera `uri`; empty: it shows something else.
struct Count {
  double frames = 0;
  double seconds = 0;
};
std::optional<Count> count_in(const nlohmann::json& status, const std::string& uri) {
  const auto at = [&status](const char* path) {
    const nlohmann::json::json_pointer pointer(path);
    return status.contains(pointer) ? status.at(pointer) : nlohmann::json();
  };
  const nlohmann::json frames = at("/frames/captured");
  const nlohmann::json seconds = at("/uptime_s");
  if (at("/source/uri") != uri || !frames.is_number() || !seconds.is_number()) return std::nullopt;
  return Count{frames.get<double>(), seconds.get<double>()};
}

}  // namespace

Result<float> measure_rate(Camera& camera, const CaptureRequest& request) {
  LCDM_RETURN_IF_ERROR(camera.configure(request));
  const Status started = camera.start();
  const Result<float> rate =
      started ? rate_of_stream(camera, request.frames_per_second) : Result<float>(started);
  camera.stop();
  return rate;
}

Result<float> served_rate(const Config& config, const std::string& uri) {
  for (const std::string& listen : listen_addresses(config.http.listen)) {
    const std::string address = reachable_address(listen);
    const auto first = status_at(address, config.http.port);
    if (!first) continue;
    std::this_thread::sleep_for(std::chrono::nanoseconds(
        trial_of(kCountNs, static_cast<float>(config.camera.frames_per_second))));
    const auto second = status_at(address, config.http.port);
    const auto begin = count_in(*first, uri);
    const auto end = second ? count_in(*second, uri) : std::nullopt;
    if (!begin || !end || end->seconds <= begin->seconds) continue;
    return static_cast<float>((end->frames - begin->frames) / (end->seconds - begin->seconds));
  }
  return Status::error(StatusCode::kUnavailable,
                       "another program holds %.120s, and no lcdm that answers on http.port: close "
                       "it, then ask again",
                       uri.c_str());
}

}  // namespace lcdm
