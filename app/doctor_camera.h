// Is the configured camera there, may it be opened, and does it give the frames that are asked for?
#pragma once

#include <string>
#include <vector>

#include "app/config.h"
#include "app/doctor_account.h"
#include "app/finding.h"
#include "drivers/v4l2/formats.h"
#include "drivers/v4l2/nodes.h"

namespace lcdm {

std::vector<Finding> check_cameras(const std::vector<V4l2Node>& nodes, const std::string& source,
                                   const Account& account);
// `ids`: the cameras that libcamera knows.
Finding check_libcamera(const std::string& source, const std::vector<std::string>& ids);

// Of the configured camera, where it is there: what its driver lists, and what comes. Takes two
// seconds.
std::vector<Finding> check_rates(const Config& config, const std::vector<V4l2Node>& nodes);
// What the driver lists.
Finding check_rate(const std::vector<V4l2Mode>& modes, const CaptureRequest& request);
// What really came, in frames/s; kUnavailable: it could not be measured.
Finding check_arrivals(const Result<float>& measured, float wanted);

}  // namespace lcdm
