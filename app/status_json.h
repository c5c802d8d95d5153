// The state of everything as JSON, for /status.json and the page.
#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>

#include "app/recorder.h"
#include "app/service.h"
#include "firmware/pipeline/pipeline.h"

namespace lcdm {

// Times are milliseconds, negative where there is none yet.
nlohmann::json status_json(const Pipeline& pipeline, const RecorderStatus& recorder,
                           const ServiceStatus& service, int viewers, std::int64_t started_ns);

}  // namespace lcdm
