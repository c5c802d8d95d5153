#include "firmware/base/file.h"

#include <cerrno>
#include <filesystem>
#include <memory>
#include <system_error>
#include <utility>

#include "firmware/base/os.h"

namespace lcdm {

Status write_file(const std::string& path, std::span<const std::byte> bytes) {
  std::unique_ptr<std::FILE, int (*)(std::FILE*)> file(std::fopen(path.c_str(), "wbe"),
                                                       &std::fclose);
  if (file == nullptr) return Status::system(errno, "%s: cannot write", path.c_str());
  const bool written = std::fwrite(bytes.data(), 1, bytes.size(), file.get()) == bytes.size();
  const int write_errno = errno;
  const bool closed = std::fclose(file.release()) == 0;
  if (written && closed) return Status::ok();
  const int fault = written ? errno : write_errno;
  std::error_code ignored;
  if (std::filesystem::is_regular_file(path, ignored)) std::remove(path.c_str());
  return Status::system(fault, "%s: cannot write", path.c_str());
}

Status write_file(const std::string& path, std::string_view text) {
  return write_file(path, std::as_bytes(std::span(text)));
}

bool is_plain_file(const std::string& path) {
  std::error_code ignored;
  switch (std::filesystem::status(path, ignored).type()) {
    case std::filesystem::file_type::regular:
    case std::filesystem::file_type::not_found:
    case std::filesystem::file_type::none:  // as for a folder that may not be entered
    case std::filesystem::file_type::unknown:
      return true;
    default:
      return false;
  }
}

Status unreadable_file(const char* what, const std::string& path, int sys_errno) {
  const bool lasts = sys_errno == ENOENT || sys_errno == ENOTDIR || sys_errno == EISDIR ||
                     sys_errno == ELOOP || sys_errno == ENAMETOOLONG || sys_errno == EACCES;
  const Status fault = Status::system(sys_errno, "cannot read %s %.120s", what, path.c_str());
  if (!lasts) return fault;
  return Status::error(StatusCode::kInvalidInput, "%s: give an existing file", fault.text());
}

FileReplacement::FileReplacement(std::string path)
    : path_(std::move(path)), unfinished_(path_ + ".new") {
  std::remove(unfinished_.c_str());
  file_ = std::fopen(unfinished_.c_str(), "wbxe");  // x: fails rather than follow a link
  if (file_ == nullptr) fault_ = errno;
}

FileReplacement::~FileReplacement() {
  if (file_ == nullptr) return;
  std::fclose(file_);
  std::remove(unfinished_.c_str());
}

void FileReplacement::append(std::span<const std::byte> bytes) {
  if (fault_ != 0) return;
  if (std::fwrite(bytes.data(), 1, bytes.size(), file_) != bytes.size()) fault_ = errno;
}

Status FileReplacement::commit() {
  // On the disk before it takes the old one's place: a power cut leaves one of the two.
  if (fault_ == 0 &&
      (!os::sync_file(file_) || std::rename(unfinished_.c_str(), path_.c_str()) != 0)) {
    fault_ = errno;
  }
  if (fault_ != 0) {
    return Status::system(fault_,
                          "%s could not be written; free space or choose another folder, the file "
                          "that was there is unharmed",
                          path_.c_str());
  }
  std::fclose(std::exchange(file_, nullptr));
  os::sync_folder(std::filesystem::path(path_).parent_path().c_str());
  return Status::ok();
}

Status replace_file(const std::string& path, std::span<const std::byte> bytes) {
  FileReplacement file(path);
  file.append(bytes);
  return file.commit();
}

Status replace_file(const std::string& path, std::string_view text) {
  return replace_file(path, std::as_bytes(std::span(text)));
}

}  // namespace lcdm
