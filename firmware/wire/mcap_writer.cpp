#include "firmware/wire/mcap_writer.h"

#include <algorithm>
#include <limits>

#include "firmware/wire/crc32.h"

namespace lcdm::wire {
namespace {

constexpr std::string_view kMetadataName = "lcdm";
constexpr std::size_t kRecordHead = 9;    // opcode and length
constexpr std::size_t kMessageHead = 22;  // channel, sequence, two times
constexpr std::size_t kIndexEntryBytes = 16;

// A record: its opcode, a length known afterwards, and what fill() writes.
template <typename Fill>
void record(ByteWriter& out, McapOp op, Fill&& fill) {
  out.u8(static_cast<std::uint8_t>(op));
  const std::size_t at = out.size();
  out.u64(0);
  fill();
  out.patch_u64(at, out.size() - at - 8);
}

std::uint16_t id_of(std::size_t channel_index) {
  return static_cast<std::uint16_t>(channel_index + 1);
}

// Enough for the largest thing outside a chunk's records: the index of a full chunk, or head and
// schemas; the summary goes out record by record.
std::size_t scratch_bytes(std::size_t chunk_messages) {
  constexpr std::size_t kSchemasAndMetadata = 16U << 10;
  return kSchemasAndMetadata + chunk_messages * kIndexEntryBytes;
}

}  // namespace

McapWriter::McapWriter(std::size_t chunk_bytes, std::size_t chunk_messages, std::size_t chunks)
    : chunk_memory_(chunk_bytes),
      scratch_memory_(scratch_bytes(chunk_messages)),
      chunk_(chunk_memory_),
      scratch_(scratch_memory_) {
  entries_.reserve(chunk_messages);
  chunks_.reserve(chunks);
}

Status McapWriter::begin(ByteSink& sink, std::span<const McapChannel> channels,
                         std::span<const std::string_view> metadata) {
  LCDM_CHECK(channels.size() <= kMaxChannels && metadata.size() % 2 == 0);
  sink_ = &sink;
  channels_ = channels;
  position_ = 0;
  chunk_.clear();
  scratch_.clear();
  entries_.clear();
  chunks_.clear();
  message_counts_.fill(0);
  first_time_ = std::numeric_limits<std::uint64_t>::max();
  last_time_ = 0;

  scratch_.bytes(kMcapMagic);
  record(scratch_, McapOp::kHeader, [&] {
    scratch_.string("");  // profile: none
    scratch_.string("lcdm");
  });
  write_schemas_and_channels(scratch_);
  metadata_offset_ = scratch_.size();
  record(scratch_, McapOp::kMetadata, [&] {
    scratch_.string(kMetadataName);
    const std::size_t at = scratch_.size();
    scratch_.u32(0);
    for (const std::string_view text : metadata) scratch_.string(text);
    scratch_.patch_u32(at, static_cast<std::uint32_t>(scratch_.size() - at - 4));
  });
  metadata_length_ = scratch_.size() - metadata_offset_;
  return emit();
}

Status McapWriter::write_message(std::uint16_t channel, std::uint32_t sequence,
                                 std::uint64_t log_time_ns, std::span<const std::byte> data) {
  LCDM_CHECK(channel >= 1 && channel <= channels_.size());
  const std::size_t needed = kRecordHead + kMessageHead + data.size();
  if (needed > chunk_memory_.size()) {
    return Status::error(StatusCode::kInvalidInput, "a message of %zu bytes is larger than a chunk",
                         data.size());
  }
  const bool full =
      needed > chunk_memory_.size() - chunk_.size() || entries_.size() == entries_.capacity();
  if (full) return Status::error(StatusCode::kUnavailable, "the chunk is full");

  entries_.push_back({channel, log_time_ns, chunk_.size()});
  record(chunk_, McapOp::kMessage, [&] {
    chunk_.u16(channel);
    chunk_.u32(sequence);
    chunk_.u64(log_time_ns);
    chunk_.u64(log_time_ns);
    chunk_.bytes(data);
  });
  return Status::ok();
}

Status McapWriter::end_chunk() {
  if (entries_.empty()) return Status::ok();
  if (chunks_.size() == chunks_.capacity()) {
    return Status::error(StatusCode::kUnavailable, "the file's chunk index is full: finish it");
  }
  const auto [first, last] =
      std::minmax_element(entries_.begin(), entries_.end(),
                          [](const IndexEntry& a, const IndexEntry& b) { return a.time < b.time; });
  ChunkIndex index{first->time, last->time, position_, 0, {}, 0, chunk_.size()};

  scratch_.u8(static_cast<std::uint8_t>(McapOp::kChunk));
  constexpr std::size_t kChunkHead = 8 + 8 + 8 + 4 + 4 + 8;  // up to the records, no compression
  scratch_.u64(kChunkHead + chunk_.size());
  scratch_.u64(index.start_time);
  scratch_.u64(index.end_time);
  scratch_.u64(chunk_.size());
  scratch_.u32(crc32(chunk_.written()));
  scratch_.string("");  // not compressed: JPEG does not shrink
  scratch_.u64(chunk_.size());
  LCDM_RETURN_IF_ERROR(emit());
  LCDM_RETURN_IF_ERROR(sink_->write(chunk_.written()));
  position_ += chunk_.size();
  index.length = position_ - index.offset;

  for (std::size_t i = 0; i < channels_.size(); ++i) {
    const auto count = std::count_if(entries_.begin(), entries_.end(),
                                     [&](const IndexEntry& e) { return e.channel == id_of(i); });
    if (count == 0) continue;
    message_counts_[i] += static_cast<std::uint64_t>(count);
    index.message_index[i] = position_ + scratch_.size();
    write_message_index(scratch_, id_of(i));
  }
  index.message_index_length = scratch_.size();
  LCDM_RETURN_IF_ERROR(emit());

  first_time_ = std::min(first_time_, index.start_time);
  last_time_ = std::max(last_time_, index.end_time);
  chunks_.push_back(index);
  entries_.clear();
  chunk_.clear();
  return sink_->flush();
}

Status McapWriter::finish() {
  LCDM_RETURN_IF_ERROR(end_chunk());
  record(scratch_, McapOp::kDataEnd, [&] { scratch_.u32(0); });
  LCDM_RETURN_IF_ERROR(emit());
  LCDM_RETURN_IF_ERROR(write_summary());
  return sink_->flush();
}

Status McapWriter::emit() {
  LCDM_CHECK(scratch_.ok());
  LCDM_RETURN_IF_ERROR(sink_->write(scratch_.written()));
  position_ += scratch_.size();
  scratch_.clear();
  return Status::ok();
}

void McapWriter::write_schemas_and_channels(ByteWriter& out) const {
  for (std::size_t i = 0; i < channels_.size(); ++i) {
    record(out, McapOp::kSchema, [&] {
      out.u16(id_of(i));
      out.string(channels_[i].schema_name);
      out.string("protobuf");
      out.u32(static_cast<std::uint32_t>(channels_[i].schema.size()));
      out.bytes(channels_[i].schema);
    });
    record(out, McapOp::kChannel, [&] {
      out.u16(id_of(i));
      out.u16(id_of(i));
      out.string(channels_[i].topic);
      out.string("protobuf");
      out.u32(0);  // no metadata
    });
  }
}

void McapWriter::write_message_index(ByteWriter& out, std::uint16_t channel) const {
  record(out, McapOp::kMessageIndex, [&] {
    out.u16(channel);
    const std::size_t at = out.size();
    out.u32(0);
    for (const IndexEntry& entry : entries_) {
      if (entry.channel != channel) continue;
      out.u64(entry.time);
      out.u64(entry.offset);
    }
    out.patch_u32(at, static_cast<std::uint32_t>(out.size() - at - 4));
  });
}

void McapWriter::write_chunk_index(ByteWriter& out, const ChunkIndex& index) const {
  record(out, McapOp::kChunkIndex, [&] {
    out.u64(index.start_time);
    out.u64(index.end_time);
    out.u64(index.offset);
    out.u64(index.length);
    const std::size_t at = out.size();
    out.u32(0);
    for (std::size_t i = 0; i < channels_.size(); ++i) {
      if (index.message_index[i] == 0) continue;
      out.u16(id_of(i));
      out.u64(index.message_index[i]);
    }
    out.patch_u32(at, static_cast<std::uint32_t>(out.size() - at - 4));
    out.u64(index.message_index_length);
    out.string("");
    out.u64(index.records_size);
    out.u64(index.records_size);
  });
}

void McapWriter::write_statistics(ByteWriter& out) const {
  std::uint64_t messages = 0;
  for (const std::uint64_t count : message_counts_) messages += count;
  record(out, McapOp::kStatistics, [&] {
    out.u64(messages);
    out.u16(static_cast<std::uint16_t>(channels_.size()));
    out.u32(static_cast<std::uint32_t>(channels_.size()));
    out.u32(0);  // attachments
    out.u32(1);  // metadata
    out.u32(static_cast<std::uint32_t>(chunks_.size()));
    out.u64(messages == 0 ? 0 : first_time_);
    out.u64(last_time_);
    const std::size_t at = out.size();
    out.u32(0);
    for (std::size_t i = 0; i < channels_.size(); ++i) {
      if (message_counts_[i] == 0) continue;
      out.u16(id_of(i));
      out.u64(message_counts_[i]);
    }
    out.patch_u32(at, static_cast<std::uint32_t>(out.size() - at - 4));
  });
}

Status McapWriter::write_summary() {
  const std::uint64_t summary_start = position_;
  write_schemas_and_channels(scratch_);
  write_statistics(scratch_);
  record(scratch_, McapOp::kMetadataIndex, [&] {
    scratch_.u64(metadata_offset_);
    scratch_.u64(metadata_length_);
    scratch_.string(kMetadataName);
  });
  LCDM_RETURN_IF_ERROR(emit());
  for (const ChunkIndex& index : chunks_) {
    write_chunk_index(scratch_, index);
    LCDM_RETURN_IF_ERROR(emit());
  }
  record(scratch_, McapOp::kFooter, [&] {
    scratch_.u64(summary_start);
    scratch_.u64(0);  // no summary offsets: a reader walks the summary
    scratch_.u32(0);  // no summary checksum
  });
  scratch_.bytes(kMcapMagic);
  return emit();
}

}  // namespace lcdm::wire
