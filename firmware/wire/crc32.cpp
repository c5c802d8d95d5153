#include "firmware/wire/crc32.h"

#include <array>

namespace lcdm::wire {
namespace {

// Slicing by 4: table[k][b] is the checksum of byte b followed by k zero bytes.
constexpr int kSlices = 4;
using Tables = std::array<std::array<std::uint32_t, 256>, kSlices>;

constexpr Tables make_tables() {
  Tables tables{};
  for (std::uint32_t byte = 0; byte < 256; ++byte) {
    std::uint32_t crc = byte;
    for (int bit = 0; bit < 8; ++bit) crc = (crc >> 1) ^ ((crc & 1) != 0 ? 0xEDB88320U : 0U);
    tables[0][byte] = crc;
  }
  for (int slice = 1; slice < kSlices; ++slice) {
    for (std::size_t byte = 0; byte < 256; ++byte) {
      const std::uint32_t crc = tables[slice - 1][byte];
      tables[slice][byte] = (crc >> 8) ^ tables[0][crc & 0xFF];
    }
  }
  return tables;
}

constexpr Tables kTables = make_tables();

std::uint32_t octet(std::byte byte) { return std::to_integer<std::uint32_t>(byte); }

}  // namespace

std::uint32_t crc32(std::span<const std::byte> data, std::uint32_t crc) {
  crc = ~crc;
  while (data.size() >= kSlices) {
    crc ^= octet(data[0]) | octet(data[1]) << 8 | octet(data[2]) << 16 | octet(data[3]) << 24;
    crc = kTables[3][crc & 0xFF] ^ kTables[2][crc >> 8 & 0xFF] ^ kTables[1][crc >> 16 & 0xFF] ^
          kTables[0][crc >> 24];
    data = data.subspan(kSlices);
  }
  for (const std::byte byte : data) crc = (crc >> 8) ^ kTables[0][(crc ^ octet(byte)) & 0xFF];
  return ~crc;
}

}  // namespace lcdm::wire
