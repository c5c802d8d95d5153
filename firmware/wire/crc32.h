// CRC-32 as in IEEE 802.3 and zlib (reflected, 0xEDB88320): MCAP's checksum.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

namespace lcdm::wire {

// The checksum of `data`, continued from `crc` (0 to begin).
std::uint32_t crc32(std::span<const std::byte> data, std::uint32_t crc = 0);

}  // namespace lcdm::wire
