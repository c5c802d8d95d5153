// The MCAP container (mcap.dev/spec): opcodes and magic, shared by writer and reader.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

namespace lcdm::wire {

inline constexpr std::array<std::byte, 8> kMcapMagic = {
    std::byte{0x89}, std::byte{'M'}, std::byte{'C'},  std::byte{'A'},
    std::byte{'P'},  std::byte{'0'}, std::byte{0x0D}, std::byte{0x0A}};

enum class McapOp : std::uint8_t {
  kHeader = 0x01,
  kFooter = 0x02,
  kSchema = 0x03,
  kChannel = 0x04,
  kMessage = 0x05,
  kChunk = 0x06,
  kMessageIndex = 0x07,
  kChunkIndex = 0x08,
  kStatistics = 0x0B,
  kMetadata = 0x0C,
  kMetadataIndex = 0x0D,
  kSummaryOffset = 0x0E,
  kDataEnd = 0x0F,
};

}  // namespace lcdm::wire
