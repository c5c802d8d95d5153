#include "firmware/wire/foxglove.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <iterator>
#include <string>

#include "firmware/wire/protobuf.h"

namespace lcdm::wire {
namespace {

constexpr std::int64_t kNanosPerSecond = 1'000'000'000;

// Field types and labels of descriptor.proto.
enum FieldType : std::uint8_t {
  kDouble = 1,
  kInt64 = 3,
  kInt32 = 5,
  kFixed32 = 7,
  kString = 9,
  kMessage = 11,
  kBytes = 12
};
constexpr std::string_view kTimestampType = ".google.protobuf.Timestamp";

struct FieldSpec {
  std::string_view name;
  int number;
  FieldType type;
  bool repeated = false;
};

constexpr FieldSpec kTimestampFields[] = {{"seconds", 1, kInt64}, {"nanos", 2, kInt32}};
constexpr FieldSpec kCompressedImageFields[] = {{"timestamp", 1, kMessage},
                                                {"data", 2, kBytes},
                                                {"format", 3, kString},
                                                {"frame_id", 4, kString}};
constexpr FieldSpec kCameraCalibrationFields[] = {
    {"timestamp", 1, kMessage},       {"width", 2, kFixed32},  {"height", 3, kFixed32},
    {"distortion_model", 4, kString}, {"D", 5, kDouble, true}, {"K", 6, kDouble, true},
    {"R", 7, kDouble, true},          {"P", 8, kDouble, true}, {"frame_id", 9, kString}};

// FileDescriptorProto: name 1, package 2, dependency 3, message_type 4, syntax 12;
// DescriptorProto: name 1, field 2; FieldDescriptorProto: name 1, number 3, label 4, type 5,
// type_name 6.
void write_file(ProtobufWriter& out, std::string_view file, std::string_view package,
                std::string_view message, std::span<const FieldSpec> fields, bool uses_timestamp) {
  out.message_field(1, [&] {
    out.string_field(1, file);
    out.string_field(2, package);
    if (uses_timestamp) out.string_field(3, "google/protobuf/timestamp.proto");
    out.message_field(4, [&] {
      out.string_field(1, message);
      for (const FieldSpec& field : fields) {
        out.message_field(2, [&] {
          out.string_field(1, field.name);
          out.varint_field(3, static_cast<std::uint64_t>(field.number));
          out.varint_field(4, field.repeated ? 3 : 1);
          out.varint_field(5, field.type);
          if (field.type == kMessage) out.string_field(6, kTimestampType);
        });
      }
    });
    out.string_field(12, "proto3");
  });
}

struct Descriptor {
  std::array<std::byte, 1024> bytes{};
  std::size_t size = 0;

  Descriptor(std::string_view file, std::string_view message, std::span<const FieldSpec> fields) {
    ByteWriter writer(bytes);
    ProtobufWriter out(writer);
    write_file(out, "google/protobuf/timestamp.proto", "google.protobuf", "Timestamp",
               kTimestampFields, false);
    write_file(out, file, "foxglove", message, fields, true);
    LCDM_CHECK(writer.ok());
    size = writer.size();
  }
};

void write_timestamp(ProtobufWriter& out, int number, std::int64_t unix_ns) {
  out.message_field(number, [&] {
    out.varint_field(1, static_cast<std::uint64_t>(unix_ns / kNanosPerSecond));
    out.varint_field(2, static_cast<std::uint64_t>(unix_ns % kNanosPerSecond));
  });
}

std::int64_t read_timestamp(std::span<const std::byte> message) {
  ProtobufReader reader(message);
  std::uint64_t seconds = 0;
  std::uint64_t nanos = 0;
  while (const auto field = reader.next()) {
    if (field->number == 1) seconds = field->value;
    if (field->number == 2) nanos = field->value;
  }
  constexpr std::uint64_t kMaxSeconds = INT64_MAX / kNanosPerSecond - 1;
  if (seconds > kMaxSeconds || nanos >= kNanosPerSecond) return 0;
  return static_cast<std::int64_t>(seconds) * kNanosPerSecond + static_cast<std::int64_t>(nanos);
}

// Reads up to out.size() packed doubles.
void read_doubles(std::span<const std::byte> packed, std::span<double> out) {
  ByteReader reader(packed);
  for (double& value : out) {
    const std::uint64_t bits = reader.u64();
    std::memcpy(&value, &bits, sizeof(value));
  }
}

// Names of distortion models and how many coefficients each has, all in OpenCV's order.
constexpr std::string_view kPlumbBob = "plumb_bob";
constexpr std::size_t kPlumbBobSize = 5;
constexpr std::string_view kRational = "rational_polynomial";

Status malformed(std::string_view schema) {
  return Status::error(StatusCode::kCorrupt, "malformed %.*s message",
                       static_cast<int>(schema.size()), schema.data());
}

}  // namespace

std::span<const std::byte> foxglove_descriptor(std::string_view schema) {
  static const Descriptor image("foxglove/CompressedImage.proto", "CompressedImage",
                                kCompressedImageFields);
  static const Descriptor calibration("foxglove/CameraCalibration.proto", "CameraCalibration",
                                      kCameraCalibrationFields);
  if (schema == kCompressedImageSchema) return std::span(image.bytes).first(image.size);
  if (schema == kCameraCalibrationSchema) {
    return std::span(calibration.bytes).first(calibration.size);
  }
  return {};
}

void encode(const CompressedImage& image, ByteWriter& writer) {
  ProtobufWriter out(writer);
  write_timestamp(out, 1, image.unix_ns);
  out.bytes_field(2, image.bytes);
  out.string_field(3, image.format);
  out.string_field(4, kOpticalFrame);
}

Result<CompressedImage> decode_compressed_image(std::span<const std::byte> message) {
  CompressedImage image;
  ProtobufReader reader(message);
  while (const auto field = reader.next()) {
    if (field->number == 1) image.unix_ns = read_timestamp(field->bytes);
    if (field->number == 2) image.bytes = field->bytes;
    if (field->number == 3) image.format = field->text();
  }
  if (!reader.ok()) return malformed(kCompressedImageSchema);
  return image;
}

void encode(const CameraCalibration& calibration, ByteWriter& writer) {
  const CameraModel& m = calibration.model;
  const double known = m.calibrated ? 1 : 0;
  const double k[9] = {known * m.fx, 0, known * m.cx, 0, known * m.fy, known * m.cy, 0, 0, known};
  const double r[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
  const double p[12] = {m.fx, 0, m.cx, 0, 0, m.fy, m.cy, 0, 0, 0, 1, 0};
  const std::array<double, 8> d = [&m] {
    std::array<double, 8> wide{};
    std::copy(m.distortion.begin(), m.distortion.end(), wide.begin());
    return wide;
  }();
  const bool rational =
      std::any_of(d.begin() + kPlumbBobSize, d.end(), [](double value) { return value != 0; });
  ProtobufWriter out(writer);
  write_timestamp(out, 1, calibration.unix_ns);
  out.fixed32_field(2, static_cast<std::uint32_t>(m.width));
  out.fixed32_field(3, static_cast<std::uint32_t>(m.height));
  out.string_field(4, rational ? kRational : kPlumbBob);
  out.doubles_field(5, std::span(d).first(rational ? d.size() : kPlumbBobSize));
  out.doubles_field(6, k);
  out.doubles_field(7, r);
  out.doubles_field(8, p);
  out.string_field(9, kOpticalFrame);
}

Result<CameraCalibration> decode_camera_calibration(std::span<const std::byte> message) {
  constexpr std::uint64_t kMaxSide = 16384;
  CameraCalibration calibration;
  CameraModel& m = calibration.model;
  double d[8] = {};
  double k[9] = {};
  double p[12] = {};
  std::string_view distortion_model;
  std::uint64_t width = 0;
  std::uint64_t height = 0;
  ProtobufReader reader(message);
  while (const auto field = reader.next()) {
    if (field->number == 1) calibration.unix_ns = read_timestamp(field->bytes);
    if (field->number == 2) width = field->value;
    if (field->number == 3) height = field->value;
    if (field->number == 4) distortion_model = field->text();
    if (field->number == 5) read_doubles(field->bytes, d);
    if (field->number == 6) read_doubles(field->bytes, k);
    if (field->number == 8) read_doubles(field->bytes, p);
  }
  if (!reader.ok() || width == 0 || height == 0 || width > kMaxSide || height > kMaxSide) {
    return malformed(kCameraCalibrationSchema);
  }
  m.width = static_cast<int>(width);
  m.height = static_cast<int>(height);
  m.calibrated = k[0] != 0;
  m.fx = static_cast<float>(m.calibrated ? k[0] : p[0]);
  m.fy = static_cast<float>(m.calibrated ? k[4] : p[5]);
  m.cx = static_cast<float>(m.calibrated ? k[2] : p[2]);
  m.cy = static_cast<float>(m.calibrated ? k[5] : p[6]);
  std::transform(std::begin(d), std::end(d), m.distortion.begin(),
                 [](double value) { return static_cast<float>(value); });
  if (m.distorted() && distortion_model != kPlumbBob && distortion_model != kRational) {
    return Status::error(StatusCode::kUnsupported,
                         "%s with lens model \"%.40s\": only plumb_bob and rational_polynomial are "
                         "understood",
                         kCameraCalibrationSchema.data(), std::string(distortion_model).c_str());
  }
  const bool lens_sane = std::all_of(m.distortion.begin(), m.distortion.end(),
                                     [](float value) { return std::isfinite(value); });
  const bool sane = lens_sane && m.fx > 0 && m.fy > 0 && std::isfinite(m.fx) &&
                    std::isfinite(m.fy) && std::isfinite(m.cx) && std::isfinite(m.cy);
  if (!sane) return malformed(kCameraCalibrationSchema);
  return calibration;
}

}  // namespace lcdm::wire
