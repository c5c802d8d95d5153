#include "firmware/base/folder.h"

#include <algorithm>

namespace lcdm {

Result<std::vector<std::filesystem::path>> list_folder(const std::filesystem::path& folder) {
  std::error_code error;
  std::vector<std::filesystem::path> paths;
  // Not a range-based for: its step throws, as for a disk that fails while it is read.
  for (std::filesystem::directory_iterator i(folder, error), end; !error && i != end;
       i.increment(error)) {
    paths.push_back(i->path());
  }
  if (error) return Status::system(error.value(), "%s: cannot list", folder.c_str());
  std::sort(paths.begin(), paths.end());
  return paths;
}

}  // namespace lcdm
