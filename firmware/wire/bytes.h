// Little-endian bytes: a bounded writer over memory the caller owns, and a bounded reader over
// bytes nobody trusts. Neither allocates; both fail for good at the first step over the edge.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <span>
#include <string_view>

namespace lcdm::wire {

inline std::span<const std::byte> as_bytes(std::string_view text) {
  return std::as_bytes(std::span(text.data(), text.size()));
}

// Appends to a fixed block. After an overflow ok() is false and nothing more is written.
class ByteWriter {
 public:
  explicit ByteWriter(std::span<std::byte> block) : block_(block) {}

  bool ok() const { return ok_; }
  std::size_t size() const { return size_; }
  std::span<const std::byte> written() const { return block_.first(size_); }
  void clear() {
    size_ = 0;
    ok_ = true;
  }

  void bytes(std::span<const std::byte> data) {
    if (std::byte* target = take(data.size()); target != nullptr && !data.empty()) {
      std::memcpy(target, data.data(), data.size());
    }
  }
  void u8(std::uint8_t value) { little_endian(value, 1); }
  void u16(std::uint16_t value) { little_endian(value, 2); }
  void u32(std::uint32_t value) { little_endian(value, 4); }
  void u64(std::uint64_t value) { little_endian(value, 8); }
  // A length of 4 bytes, then the text.
  void string(std::string_view text) {
    u32(static_cast<std::uint32_t>(text.size()));
    bytes(as_bytes(text));
  }
  // Overwrites bytes written earlier, for a length known only afterwards.
  void patch_u8(std::size_t at, std::uint8_t value) { patch(at, value, 1); }
  void patch_u32(std::size_t at, std::uint32_t value) { patch(at, value, 4); }
  void patch_u64(std::size_t at, std::uint64_t value) { patch(at, value, 8); }

 private:
  std::byte* take(std::size_t count) {
    if (!ok_ || count > block_.size() - size_) {
      ok_ = false;
      return nullptr;
    }
    std::byte* target = block_.data() + size_;
    size_ += count;
    return target;
  }
  void little_endian(std::uint64_t value, int count) {
    if (take(static_cast<std::size_t>(count)) == nullptr) return;
    patch(size_ - static_cast<std::size_t>(count), value, count);
  }
  void patch(std::size_t at, std::uint64_t value, int count) {
    if (!ok_) return;
    for (int i = 0; i < count; ++i) {
      block_[at + static_cast<std::size_t>(i)] = static_cast<std::byte>(value >> (8 * i));
    }
  }

  std::span<std::byte> block_;
  std::size_t size_ = 0;
  bool ok_ = true;
};

// Reads from the front. After a read over the end ok() is false and everything reads as zero.
class ByteReader {
 public:
  explicit ByteReader(std::span<const std::byte> data) : data_(data) {}

  bool ok() const { return ok_; }
  std::size_t remaining() const { return data_.size(); }

  std::span<const std::byte> bytes(std::uint64_t count) {
    if (!ok_ || count > data_.size()) {
      ok_ = false;
      return {};
    }
    const auto taken = data_.first(static_cast<std::size_t>(count));
    data_ = data_.subspan(static_cast<std::size_t>(count));
    return taken;
  }
  std::uint8_t u8() { return static_cast<std::uint8_t>(little_endian(1)); }
  std::uint16_t u16() { return static_cast<std::uint16_t>(little_endian(2)); }
  std::uint32_t u32() { return static_cast<std::uint32_t>(little_endian(4)); }
  std::uint64_t u64() { return little_endian(8); }
  std::string_view string() {
    const auto text = bytes(u32());
    return {reinterpret_cast<const char*>(text.data()), text.size()};
  }

 private:
  std::uint64_t little_endian(std::size_t count) {
    std::uint64_t value = 0;
    const auto taken = bytes(count);
    for (std::size_t i = 0; i < taken.size(); ++i) {
      value |= std::to_integer<std::uint64_t>(taken[i]) << (8 * i);
    }
    return value;
  }

  std::span<const std::byte> data_;
  bool ok_ = true;
};

}  // namespace lcdm::wire
