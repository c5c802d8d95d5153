// A file to write a recording into, without any care for the disk.
#pragma once

#include <fstream>
#include <string>

#include "firmware/wire/mcap_writer.h"

namespace lcdm::test {

class FileSink final : public wire::ByteSink {
 public:
  explicit FileSink(const std::string& path) : file_(path, std::ios::binary) {}
  Status write(std::span<const std::byte> bytes) override {
    file_.write(reinterpret_cast<const char*>(bytes.data()),
                static_cast<std::streamsize>(bytes.size()));
    return Status::ok();
  }
  Status flush() override { return Status::ok(); }

 private:
  std::ofstream file_;
};

}  // namespace lcdm::test
