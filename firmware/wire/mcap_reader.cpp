#include "firmware/wire/mcap_reader.h"

#include <algorithm>

#include "firmware/wire/bytes.h"
#include "firmware/wire/crc32.h"

namespace lcdm::wire {
namespace {

Status corrupt(const char* what) {
  return Status::error(StatusCode::kCorrupt, "damaged MCAP %s: skipped", what);
}

Status end_of_file() { return Status::error(StatusCode::kEndOfStream, "end of the recording"); }

}  // namespace

Status McapReader::open() {
  std::array<std::byte, 8> magic{};
  const auto got = read_(magic);
  if (!got) return got.status();
  if (*got != magic.size() || magic != kMcapMagic) {
    return Status::error(StatusCode::kCorrupt, "this is not an MCAP recording");
  }
  return Status::ok();
}

Result<McapMessage> McapReader::next() {
  for (std::size_t aside = 0; aside <= kMaxAside; aside += body_.size() + 1) {
    while (!records_.empty()) {
      auto message = next_in_chunk();
      if (message || message.code() != StatusCode::kUnavailable) return message;
    }
    if (ended_) return end_of_file();
    LCDM_RETURN_IF_ERROR(read_record());
    switch (op_) {
      case McapOp::kSchema:
        LCDM_RETURN_IF_ERROR(add_schema(body_));
        break;
      case McapOp::kChannel:
        LCDM_RETURN_IF_ERROR(add_channel(body_));
        break;
      case McapOp::kMessage:
        return parse_message(body_);
      case McapOp::kChunk:
        LCDM_RETURN_IF_ERROR(enter_chunk());
        break;
      // Behind the data comes only the summary, which repeats what was seen.
      case McapOp::kDataEnd:
      case McapOp::kFooter:
        ended_ = true;
        break;
      default:
        break;
    }
  }
  return Status::error(StatusCode::kUnavailable, "no message yet");
}

// Reads one record into op_ and body_. A file that stops inside one is truncated.
Status McapReader::read_record() {
  std::array<std::byte, 9> head{};
  const auto got = read_(head);
  if (!got) return got.status();
  ByteReader reader(head);
  op_ = static_cast<McapOp>(reader.u8());
  const std::uint64_t length = reader.u64();
  if (*got != head.size()) {
    truncated_ = ended_ = true;
    return end_of_file();
  }
  if (length > kMaxRecord) {
    ended_ = true;  // no way to find the next record
    return corrupt("record length");
  }
  body_.resize(static_cast<std::size_t>(length));
  const auto filled = read_(body_);
  if (!filled) return filled.status();
  if (*filled != body_.size()) {
    truncated_ = ended_ = true;
    return end_of_file();
  }
  return Status::ok();
}

Status McapReader::enter_chunk() {
  ByteReader reader(body_);
  reader.bytes(16);  // start and end time
  const std::uint64_t size = reader.u64();
  const std::uint32_t expected_crc = reader.u32();
  const std::string_view compression = reader.string();
  const auto records = reader.bytes(reader.u64());
  if (!reader.ok()) return corrupt("chunk");
  if (!compression.empty()) {
    return Status::error(StatusCode::kUnsupported,
                         "this recording's chunks are compressed (%.16s): convert it with "
                         "`mcap compress --compression none`",
                         std::string(compression).c_str());
  }
  if (records.size() != size) return corrupt("chunk");
  if (expected_crc != 0 && crc32(records) != expected_crc) return corrupt("chunk (checksum)");
  records_ = records;
  return Status::ok();
}

// The next message of the open chunk; kUnavailable when this record was none.
Result<McapMessage> McapReader::next_in_chunk() {
  ByteReader reader(records_);
  const auto op = static_cast<McapOp>(reader.u8());
  const auto body = reader.bytes(reader.u64());
  if (!reader.ok()) {
    records_ = {};
    return corrupt("record in a chunk");
  }
  records_ = records_.last(reader.remaining());
  if (op == McapOp::kMessage) return parse_message(body);
  if (op == McapOp::kSchema) LCDM_RETURN_IF_ERROR(add_schema(body));
  if (op == McapOp::kChannel) LCDM_RETURN_IF_ERROR(add_channel(body));
  return Status::error(StatusCode::kUnavailable, "not a message");
}

Status McapReader::add_schema(std::span<const std::byte> body) {
  ByteReader reader(body);
  const std::uint16_t id = reader.u16();
  const std::string_view name = reader.string();
  if (!reader.ok() || name.size() > kMaxName) return corrupt("schema");
  const bool known = std::any_of(schemas_.begin(), schemas_.end(),
                                 [&](const Schema& schema) { return schema.id == id; });
  if (known) return Status::ok();
  if (schemas_.size() == kMaxChannels) return corrupt("file (too many schemas)");
  schemas_.push_back({id, std::string(name)});
  return Status::ok();
}

Status McapReader::add_channel(std::span<const std::byte> body) {
  ByteReader reader(body);
  const std::uint16_t id = reader.u16();
  const std::uint16_t schema_id = reader.u16();
  const std::string_view topic = reader.string();
  if (!reader.ok() || topic.size() > kMaxName) return corrupt("channel");
  const bool known = std::any_of(channels_.begin(), channels_.end(),
                                 [&](const Channel& channel) { return channel.id == id; });
  if (known) return Status::ok();
  if (channels_.size() == kMaxChannels) return corrupt("file (too many channels)");
  const auto schema = std::find_if(schemas_.begin(), schemas_.end(),
                                   [&](const Schema& s) { return s.id == schema_id; });
  channels_.push_back(
      {id, std::string(topic), schema == schemas_.end() ? std::string() : schema->name});
  return Status::ok();
}

Result<McapMessage> McapReader::parse_message(std::span<const std::byte> body) const {
  ByteReader reader(body);
  const std::uint16_t id = reader.u16();
  McapMessage message;
  message.sequence = reader.u32();
  message.log_time_ns = reader.u64();
  reader.u64();  // publish time
  message.data = reader.bytes(reader.remaining());
  if (!reader.ok()) return corrupt("message");
  const auto channel = std::find_if(channels_.begin(), channels_.end(),
                                    [&](const Channel& c) { return c.id == id; });
  if (channel == channels_.end()) return corrupt("message (unknown channel)");
  message.topic = channel->topic;
  message.schema_name = channel->schema_name;
  return message;
}

}  // namespace lcdm::wire
