// The protobuf wire format (protobuf.dev/programming-guides/encoding), as far as our messages go.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string_view>

#include "firmware/wire/bytes.h"

namespace lcdm::wire {

enum class WireType : std::uint8_t { kVarint = 0, kFixed64 = 1, kLength = 2, kFixed32 = 5 };

// Writes fields of one message, and of messages nested in it, into a ByteWriter.
class ProtobufWriter {
 public:
  explicit ProtobufWriter(ByteWriter& out) : out_(out) {}

  void varint_field(int number, std::uint64_t value) {
    tag(number, WireType::kVarint);
    varint(value);
  }
  void fixed32_field(int number, std::uint32_t value) {
    tag(number, WireType::kFixed32);
    out_.u32(value);
  }
  // repeated double, packed.
  void doubles_field(int number, std::span<const double> values) {
    tag(number, WireType::kLength);
    varint(values.size() * 8);
    for (const double value : values) raw_double(value);
  }
  void bytes_field(int number, std::span<const std::byte> data) {
    tag(number, WireType::kLength);
    varint(data.size());
    out_.bytes(data);
  }
  void string_field(int number, std::string_view text) { bytes_field(number, as_bytes(text)); }

  // A nested message: fill() writes its fields through this writer. At most 4 GiB.
  template <typename Fill>
  void message_field(int number, Fill&& fill) {
    tag(number, WireType::kLength);
    const std::size_t at = out_.size();
    for (int i = 0; i < kLengthBytes; ++i) out_.u8(0);
    fill();
    if (!out_.ok()) return;
    // A varint padded to a fixed width is valid and saves a second pass for the length.
    const std::size_t length = out_.size() - at - kLengthBytes;
    std::uint32_t low = 0;
    for (int i = 0; i < 4; ++i) {
      low |= static_cast<std::uint32_t>(((length >> (7 * i)) & 0x7F) | 0x80) << (8 * i);
    }
    out_.patch_u32(at, low);
    out_.patch_u8(at + 4, static_cast<std::uint8_t>(length >> 28));
  }

 private:
  static constexpr int kLengthBytes = 5;

  void tag(int number, WireType type) {
    varint(static_cast<std::uint64_t>(number) << 3 | static_cast<std::uint64_t>(type));
  }
  void varint(std::uint64_t value) {
    for (; value >= 0x80; value >>= 7) out_.u8(static_cast<std::uint8_t>(value | 0x80));
    out_.u8(static_cast<std::uint8_t>(value));
  }
  void raw_double(double value) {
    std::uint64_t bits;
    std::memcpy(&bits, &value, sizeof(bits));
    out_.u64(bits);
  }

  ByteWriter& out_;
};

// One field of a message somebody else wrote.
struct ProtobufField {
  int number = 0;
  WireType type = WireType::kVarint;
  std::uint64_t value = 0;           // kVarint, kFixed32, kFixed64
  std::span<const std::byte> bytes;  // kLength

  std::string_view text() const {
    return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
  }
};

// Walks the fields of one message. next() is empty at the end and at the first malformed field:
// ok() tells which.
class ProtobufReader {
 public:
  explicit ProtobufReader(std::span<const std::byte> message) : in_(message) {}

  bool ok() const { return ok_ && in_.ok(); }

  std::optional<ProtobufField> next() {
    if (!ok() || in_.remaining() == 0) return std::nullopt;
    const std::uint64_t tag = varint();
    ProtobufField field;
    field.number = static_cast<int>(tag >> 3 & 0x1FFFFFFF);
    field.type = static_cast<WireType>(tag & 7);
    switch (field.type) {
      case WireType::kVarint:
        field.value = varint();
        break;
      case WireType::kFixed64:
        field.value = in_.u64();
        break;
      case WireType::kFixed32:
        field.value = in_.u32();
        break;
      case WireType::kLength:
        field.bytes = in_.bytes(varint());
        break;
      default:
        ok_ = false;
    }
    if (field.number == 0) ok_ = false;
    if (!ok()) return std::nullopt;
    return field;
  }

 private:
  std::uint64_t varint() {
    std::uint64_t value = 0;
    for (int shift = 0; shift < 64; shift += 7) {
      const std::uint8_t byte = in_.u8();
      value |= static_cast<std::uint64_t>(byte & 0x7F) << shift;
      if ((byte & 0x80) == 0) return value;
    }
    ok_ = false;
    return 0;
  }

  ByteReader in_;
  bool ok_ = true;
};

}  // namespace lcdm::wire
