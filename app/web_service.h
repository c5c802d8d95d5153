// What a browser finds at this program's address.
#pragma once

#include <vector>

#include "app/http_server.h"
#include "app/live_view.h"
#include "firmware/pipeline/pipeline.h"

namespace lcdm {

// /  the page; /live its stream; /stream.mjpg[?view=colour|depth]; /depth.png; /status.json;
// /healthz. The pipeline and the view are borrowed and must outlive the server.
std::vector<HttpRoute> web_routes(const Pipeline& pipeline, LiveView& view);

}  // namespace lcdm
