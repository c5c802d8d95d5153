// Files written whole.
#pragma once

#include <cstddef>
#include <cstdio>
#include <span>
#include <string>
#include <string_view>

#include "firmware/base/status.h"

namespace lcdm {

// The whole of `bytes` as a file; on error none is left. kIoError: names the path.
Status write_file(const std::string& path, std::span<const std::byte> bytes);
Status write_file(const std::string& path, std::string_view text);

// False for a folder, and for a pipe or a device, which to open or to read may take for ever; true
// where nothing is, so that opening it tells.
bool is_plain_file(const std::string& path);

// Why `path` could not be read, by its errno; `what` is its name for a person ("the model").
// kInvalidInput: it is not there or may not be read, until somebody mends that; kIoError: what may
// pass.
Status unreadable_file(const char* what, const std::string& path, int sys_errno);

// A file that takes its path once it is whole and on the disk: whatever comes before, a full disk
// or a power cut, leaves the one that was there. What is planted at the name that it has meanwhile
// (path.new) is not followed.
class FileReplacement {
 public:
  explicit FileReplacement(std::string path);
  ~FileReplacement();
  FileReplacement(const FileReplacement&) = delete;
  FileReplacement& operator=(const FileReplacement&) = delete;

  // A failure is told by commit().
  void append(std::span<const std::byte> bytes);
  // Once, at the end; without it, and on error, nothing is left of the new file. kIoError: names
  // the path and the cure.
  Status commit();

 private:
  const std::string path_;
  const std::string unfinished_;
  std::FILE* file_;
  int fault_ = 0;  // errno of the first failure
};

Status replace_file(const std::string& path, std::span<const std::byte> bytes);
Status replace_file(const std::string& path, std::string_view text);

}  // namespace lcdm
