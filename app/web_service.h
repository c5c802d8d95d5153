// What a browser finds at this program's address.
#pragma once

#include <vector>

#include "app/http_server.h"
#include "app/live_view.h"
#include "app/recorder.h"
#include "app/service.h"
#include "firmware/pipeline/pipeline.h"

namespace lcdm {

// /  the page; /live its stream; /stream.mjpg[?view=colour|depth]; /depth.png; /status.json;
// /healthz; POST /record/start and /record/stop. All four are borrowed and must outlive the
// server.
std::vector<HttpRoute> web_routes(const Pipeline& pipeline, LiveView& view, Recorder& recorder,
                                  const Service& service);

}  // namespace lcdm
