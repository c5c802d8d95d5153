// Reads an MCAP file front to back, trusting nothing: works on files that a power cut ended.
#pragma once

#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "firmware/base/status.h"
#include "firmware/wire/mcap_format.h"

namespace lcdm::wire {

// Bytes from somewhere: fills as much of `out` as there is and returns the count; 0 = the end.
using ReadBytes = std::function<Result<std::size_t>(std::span<std::byte> out)>;

// Borrowed from the reader: valid until its next call.
struct McapMessage {
  std::string_view topic;
  std::string_view schema_name;
  std::uint32_t sequence = 0;
  std::uint64_t log_time_ns = 0;
  std::span<const std::byte> data;
};

// Allocates as the file asks, up to kMaxRecord. Not thread-safe.
class McapReader {
 public:
  static constexpr std::size_t kMaxAside = 16U << 20;       // bytes that are no message, of a call
  static constexpr std::uint64_t kMaxRecord = 64ULL << 20;  // bytes of one record
  static constexpr std::size_t kMaxChannels = 1024;
  static constexpr std::size_t kMaxName = 1024;  // bytes of a topic or of a schema's name

  explicit McapReader(ReadBytes read) : read_(std::move(read)) {}

  // Checks the magic. kCorrupt when this is no MCAP file.
  Status open();

  // The next message in file order. kEndOfStream at the end and where a cut file stops (see
  // truncated()); kUnavailable: much else lay before it, go on at the next call; kCorrupt when a
  // chunk's checksum or a record's form is wrong (the reader goes on behind that chunk at the next
  // call); kUnsupported for a compressed chunk.
  Result<McapMessage> next();

  // The file ended without its footer: what was readable was delivered.
  bool truncated() const { return truncated_; }

 private:
  struct Schema {
    std::uint16_t id;
    std::string name;
  };
  struct Channel {
    std::uint16_t id;
    std::string topic;
    std::string schema_name;
  };

  Status read_record();
  Status enter_chunk();
  Status add_schema(std::span<const std::byte> body);
  Status add_channel(std::span<const std::byte> body);
  Result<McapMessage> parse_message(std::span<const std::byte> body) const;
  Result<McapMessage> next_in_chunk();

  ReadBytes read_;
  std::vector<std::byte> body_;         // of the record read last
  McapOp op_ = McapOp::kHeader;         // its opcode
  std::span<const std::byte> records_;  // what is left of the chunk in body_
  std::vector<Schema> schemas_;
  std::vector<Channel> channels_;
  bool truncated_ = false;
  bool ended_ = false;
};

}  // namespace lcdm::wire
