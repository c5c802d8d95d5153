#include "app/status_json.h"

#include <cmath>
#include <cstdio>

#include "app/version.h"
#include "firmware/base/os.h"

namespace lcdm {
namespace {

double milliseconds(std::int64_t ns) { return ns < 0 ? -1 : static_cast<double>(ns) * 1e-6; }

nlohmann::json model_json(const EngineStats& stats) {
  char hash[24];
  std::snprintf(hash, sizeof(hash), "%016llx", static_cast<unsigned long long>(stats.model_hash));
  return {{"name", stats.model_name},
          {"licence", stats.model_licence},
          {"hash", hash},
          {"width", stats.width},
          {"height", stats.height},
          {"threads", stats.threads},
          {"precision", to_string(stats.precision)},
          {"memory_locked", stats.memory_locked},
          {"arena_bytes", stats.arena_bytes},
          {"weight_bytes", stats.weight_bytes}};
}

nlohmann::json frames_json(const HealthSnapshot& now) {
  return {
      {"captured", now.captured}, {"inferred", now.inferred}, {"dropped", now.dropped},
      {"skipped", now.skipped},   {"corrupt", now.corrupt},   {"failed", now.failed},
      {"timeouts", now.timeouts}, {"reopened", now.reopened}, {"sequence_gaps", now.sequence_gaps}};
}

// How often each rung of the recovery ladder was stepped on, but for the last: a process that ends
// tells nobody, and systemd counts those.
nlohmann::json recovery_json(const HealthSnapshot& now) {
  const auto steps = [&now](RecoveryRung rung) {
    return now.recovery[static_cast<std::size_t>(rung)];
  };
  return {{"stream_restarts", steps(RecoveryRung::kRestartStream)},
          {"reopenings", steps(RecoveryRung::kReopen)},
          {"device_waits", steps(RecoveryRung::kWaitForDevice)},
          {"port_resets", steps(RecoveryRung::kResetPort)},
          {"port_resets_skipped", now.resets_skipped}};
}

nlohmann::json recording_json(const RecorderStatus& now) {
  return {{"on", now.recording}, {"frames", now.frames}, {"dropped", now.dropped},
          {"bytes", now.bytes},  {"file", now.file},     {"fault", now.fault}};
}

nlohmann::json frame_json(const HealthSnapshot& now) {
  return {{"sequence", now.sequence},
          {"age_ms", milliseconds(now.frame_age_ns)},
          {"latency_ms", milliseconds(now.latency_ns)}};
}

nlohmann::json inference_json(const HealthSnapshot& now) {
  return {{"p50", milliseconds(now.inference_p50_ns)}, {"p99", milliseconds(now.inference_p99_ns)}};
}

nlohmann::json source_json(const Pipeline::Source& source) {
  return {{"uri", source.info.uri},
          {"description", source.info.description},
          {"stamp", to_string(source.info.stamp)},
          {"pixel_format", to_string(source.format.pixel)},
          {"width", source.format.width},
          {"height", source.format.height}};
}

// With the intrinsics of the depth picture, which are not the camera's: points need them.
nlohmann::json depth_json(const Pipeline::EngineView& engine) {
  const CameraModel& camera = engine.depth_camera;
  return {{"scale", to_string(engine.scale)},
          {"width", camera.width},
          {"height", camera.height},
          {"fx", camera.fx},
          {"fy", camera.fy},
          {"cx", camera.cx},
          {"cy", camera.cy},
          {"calibrated", camera.calibrated}};
}

// The state of the whole device; `state` beside it is that of the pictures.
nlohmann::json device_json(const ServiceStatus& now) {
  return {{"state", to_string(now.judgement.state)},
          {"reason", now.judgement.reason},
          {"changes", now.judgement.changes},
          {"ready", now.judgement.ready},
          {"missed_vital", now.judgement.missed_vital},
          {"missed_outputs", now.judgement.missed_outputs}};
}

// The degrade ladder: where it stands, and how often it was climbed down and up.
nlohmann::json effort_json(const ServiceStatus& now) {
  return {{"rung", to_string(now.effort)},
          {"reason", now.effort_reason},
          {"lowered", now.lowered},
          {"raised", now.raised}};
}

// Null where the board tells nothing.
nlohmann::json thermal_json(const ThermalReading& now) {
  nlohmann::json json = {{"throttled", now.throttled}, {"cpu_limit", now.cpu_limit}};
  json["zone"] = now.zone.empty() ? nlohmann::json() : nlohmann::json(now.zone);
  json["celsius"] = now.zone.empty() ? nlohmann::json() : nlohmann::json(now.celsius);
  json["headroom_celsius"] =
      std::isinf(now.headroom_celsius) ? nlohmann::json() : nlohmann::json(now.headroom_celsius);
  return json;
}

nlohmann::json watchdog_json(const ServiceStatus& now) {
  return {{"managed", now.managed},
          {"alive", now.judgement.alive},
          {"timeout_ms", milliseconds(now.watchdog_ns)},
          {"pings", now.pings}};
}

}  // namespace

nlohmann::json status_json(const Pipeline& pipeline, const RecorderStatus& recorder,
                           const ServiceStatus& service, int viewers, std::int64_t started_ns) {
  const std::int64_t now_ns = os::monotonic_ns();
  const HealthSnapshot now = pipeline.health().snapshot(now_ns);
  const Pipeline::EngineView engine = pipeline.engine();
  nlohmann::json json;
  json["version"] = kVersion;
  json["state"] = to_string(now.state);
  json["fault"] = pipeline.fault();
  json["uptime_s"] = static_cast<double>(now_ns - started_ns) * 1e-9;
  json["viewers"] = viewers;
  json["frames_per_second"] = now.frames_per_second;
  json["frame"] = frame_json(now);
  json["inference_ms"] = inference_json(now);
  json["frames"] = frames_json(now);
  json["recovery"] = recovery_json(now);
  json["source"] = source_json(pipeline.source());
  json["depth"] = depth_json(engine);
  json["model"] = model_json(engine.stats);
  json["recording"] = recording_json(recorder);
  json["device"] = device_json(service);
  json["watchdog"] = watchdog_json(service);
  json["effort"] = effort_json(service);
  json["thermal"] = thermal_json(service.thermal);
  json["gpio"] = {{"warnings", service.gpio_warnings}};
  return json;
}

}  // namespace lcdm
