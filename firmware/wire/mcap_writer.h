// Writes one MCAP file: schemas and channels, messages in checksummed chunks, then the summary.
// Memory is taken in the constructor; nothing allocates afterwards.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string_view>
#include <vector>

#include "firmware/base/status.h"
#include "firmware/wire/bytes.h"
#include "firmware/wire/mcap_format.h"

namespace lcdm::wire {

// Where bytes go: a file, a test's vector.
class ByteSink {
 public:
  virtual ~ByteSink() = default;
  virtual Status write(std::span<const std::byte> bytes) = 0;
  // Everything written so far is on the medium when this returns.
  virtual Status flush() = 0;
};

struct McapChannel {
  std::string_view topic;
  std::string_view schema_name;       // protobuf message name
  std::span<const std::byte> schema;  // FileDescriptorSet
};

// Life cycle: begin -> (write_message*, end_chunk)* -> finish, and again from begin. The file is
// readable up to its last whole chunk at every moment. Not thread-safe: one thread, the recorder's.
class McapWriter {
 public:
  static constexpr std::size_t kMaxChannels = 4;

  // Room for one chunk of `chunk_bytes` and `chunk_messages`, and `chunks` chunks in a file.
  McapWriter(std::size_t chunk_bytes, std::size_t chunk_messages, std::size_t chunks);

  // Starts a file. Channel ids are 1, 2, ... in the order of `channels`, whose texts and schemas
  // must live until finish. `metadata` is stored under the name "lcdm": key, value, key, value...
  Status begin(ByteSink& sink, std::span<const McapChannel> channels,
               std::span<const std::string_view> metadata);

  // Appends to the chunk. kUnavailable: the chunk is full; end it and try again.
  Status write_message(std::uint16_t channel, std::uint32_t sequence, std::uint64_t log_time_ns,
                       std::span<const std::byte> data);

  // Writes the chunk and its indexes and flushes the sink. Does nothing when it is empty.
  Status end_chunk();

  // Ends the last chunk and writes data end, summary and footer.
  Status finish();

  std::uint64_t file_bytes() const { return position_ + chunk_.size(); }
  // Whether the index holds two more chunks: one that is ended now, and the next, which finish()
  // ends.
  bool has_room_for_chunk() const { return chunks_.size() + 1 < chunks_.capacity(); }

 private:
  struct IndexEntry {
    std::uint16_t channel;
    std::uint64_t time;
    std::uint64_t offset;  // within the uncompressed chunk
  };
  struct ChunkIndex {
    std::uint64_t start_time;
    std::uint64_t end_time;
    std::uint64_t offset;
    std::uint64_t length;                                   // of the whole chunk record
    std::array<std::uint64_t, kMaxChannels> message_index;  // file offset; 0 = no messages
    std::uint64_t message_index_length;
    std::uint64_t records_size;
  };

  Status emit();
  void write_schemas_and_channels(ByteWriter& out) const;
  void write_message_index(ByteWriter& out, std::uint16_t channel) const;
  void write_chunk_index(ByteWriter& out, const ChunkIndex& index) const;
  void write_statistics(ByteWriter& out) const;
  Status write_summary();

  std::vector<std::byte> chunk_memory_;
  std::vector<std::byte> scratch_memory_;
  ByteWriter chunk_;    // the records of the open chunk
  ByteWriter scratch_;  // everything else, handed to the sink by emit()
  std::vector<IndexEntry> entries_;
  std::vector<ChunkIndex> chunks_;
  std::span<const McapChannel> channels_;
  ByteSink* sink_ = nullptr;
  std::uint64_t position_ = 0;  // bytes handed to the sink
  std::uint64_t metadata_offset_ = 0;
  std::uint64_t metadata_length_ = 0;
  std::array<std::uint64_t, kMaxChannels> message_counts_{};
  std::uint64_t first_time_ = 0;
  std::uint64_t last_time_ = 0;
};

}  // namespace lcdm::wire
