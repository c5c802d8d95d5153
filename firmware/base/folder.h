// What lies in a folder.
#pragma once

#include <filesystem>
#include <vector>

#include "firmware/base/status.h"

namespace lcdm {

// The paths in `folder`, sorted. Never throws for what the disk or the system says; kNotFound and
// others: it cannot be listed.
Result<std::vector<std::filesystem::path>> list_folder(const std::filesystem::path& folder);

}  // namespace lcdm
