// What the recorder writes: read back by the container's reference implementation (npm's
// @mcap/core, with protobufjs for the messages), and by our own reader under damage.
#include <cstdio>
#include <filesystem>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <random>
#include <string>
#include <sys/wait.h>
#include <vector>

#include "firmware/wire/crc32.h"
#include "firmware/wire/foxglove.h"
#include "firmware/wire/mcap_reader.h"
#include "firmware/wire/mcap_writer.h"
#include "tests/support/temporary_folder.h"

namespace lcdm::wire {
namespace {

constexpr std::int64_t kFirstStamp = 1'700'000'000'123'456'789;
constexpr std::int64_t kPeriod = 33'333'333;
constexpr McapChannel kNoChannels[] = {{}, {}};

class MemorySink final : public ByteSink {
 public:
  Status write(std::span<const std::byte> bytes) override {
    data.insert(data.end(), bytes.begin(), bytes.end());
    return Status::ok();
  }
  Status flush() override {
    flushed_at.push_back(data.size());
    return Status::ok();
  }
  std::vector<std::byte> data;
  std::vector<std::size_t> flushed_at;
};

CameraModel kitti_like() { return {1242, 375, 721.5F, 721.5F, 609.5F, 172.75F, true}; }

std::vector<std::byte> picture(int number) {
  std::vector<std::byte> jpeg(200 + static_cast<std::size_t>(number), std::byte{0x5A});
  jpeg[0] = std::byte{0xFF};
  jpeg[1] = std::byte{0xD8};
  jpeg[2] = static_cast<std::byte>(number);
  return jpeg;
}

// A recording of `count` pictures, a calibration at the start of each chunk of four.
MemorySink record_pictures(int count, bool finish = true) {
  const McapChannel channels[] = {
      {"/camera/image", kCompressedImageSchema, foxglove_descriptor(kCompressedImageSchema)},
      {"/camera/calibration", kCameraCalibrationSchema,
       foxglove_descriptor(kCameraCalibrationSchema)}};
  const std::string_view metadata[] = {"source", "scene:1", "version", "1"};
  MemorySink sink;
  McapWriter writer(8192, 64, 64);
  EXPECT_TRUE(writer.begin(sink, channels, metadata));
  std::vector<std::byte> block(4096);
  for (int i = 0; i < count; ++i) {
    const std::int64_t stamp = kFirstStamp + i * kPeriod;
    ByteWriter out(block);
    if (i % 4 == 0) {
      EXPECT_TRUE(writer.end_chunk());
      encode(CameraCalibration{stamp, kitti_like()}, out);
      EXPECT_TRUE(writer.write_message(2, static_cast<std::uint32_t>(i),
                                       static_cast<std::uint64_t>(stamp), out.written()));
      out.clear();
    }
    const auto jpeg = picture(i);
    encode(CompressedImage{stamp, "jpeg", jpeg}, out);
    EXPECT_TRUE(out.ok());
    EXPECT_TRUE(writer.write_message(1, static_cast<std::uint32_t>(i),
                                     static_cast<std::uint64_t>(stamp), out.written()));
  }
  EXPECT_TRUE(finish ? writer.finish() : writer.end_chunk());
  return sink;
}

ReadBytes from_memory(std::span<const std::byte> data) {
  return [data, at = std::size_t{0}](std::span<std::byte> out) mutable -> Result<std::size_t> {
    const std::size_t count = std::min(out.size(), data.size() - at);
    std::copy_n(data.begin() + static_cast<std::ptrdiff_t>(at), count, out.begin());
    at += count;
    return count;
  };
}

struct Reading {
  std::vector<std::uint32_t> pictures;
  int errors = 0;
  bool truncated = false;
};

Reading read_all(std::span<const std::byte> data) {
  Reading reading;
  McapReader reader(from_memory(data));
  if (!reader.open()) {
    reading.errors = 1;
    return reading;
  }
  while (reading.errors < 1000) {
    const auto message = reader.next();
    if (message.code() == StatusCode::kEndOfStream) break;
    if (!message) {
      ++reading.errors;
    } else if (message->topic == "/camera/image") {
      reading.pictures.push_back(message->sequence);
    }
  }
  reading.truncated = reader.truncated();
  return reading;
}

// Runs the reference reader over `data`; empty when Node.js or its packages are not installed.
nlohmann::json read_with_peer(std::span<const std::byte> data, const std::string& mode) {
  if (!std::filesystem::exists("tests/peers/node_modules/@mcap/core")) return {};
  const test::TemporaryFolder folder;
  const std::string command =
      "node tests/peers/read_mcap.mjs " + folder.write("test.mcap", data) + " " + mode;
  std::string output;
  FILE* pipe = popen(command.c_str(), "r");
  for (char block[4096]; const std::size_t n = std::fread(block, 1, sizeof(block), pipe);) {
    output.append(block, n);
  }
  const int status = pclose(pipe);
  EXPECT_EQ(WEXITSTATUS(status), 0) << "the reference reader refused the file";
  return nlohmann::json::parse(output, nullptr, false);
}

constexpr const char* kNoPeer = "run `npm install` in tests/peers first";

TEST(Crc32, AgreesWithThePublishedCheckValue) {
  EXPECT_EQ(crc32(as_bytes("123456789")), 0xCBF43926U);
  EXPECT_EQ(crc32(as_bytes("6789"), crc32(as_bytes("12345"))), 0xCBF43926U);
}

TEST(McapWriter, AFinishedFileIsReadByTheReferenceReaderThroughItsIndex) {
  const auto json = read_with_peer(record_pictures(10).data, "");
  if (json.is_null()) GTEST_SKIP() << kNoPeer;
  EXPECT_EQ(json["statistics"]["messages"], "13");
  EXPECT_EQ(json["chunks"], 3);
  EXPECT_EQ(json["metadata"]["lcdm"]["source"], "scene:1");
  EXPECT_EQ(json["schemas"]["1"], "foxglove.CompressedImage");
  int pictures = 0;
  for (const auto& message : json["messages"]) {
    if (message["topic"] != "/camera/image") continue;
    const std::string stamp = std::to_string(kFirstStamp + pictures * kPeriod);
    EXPECT_EQ(message["stamp"], stamp);
    EXPECT_EQ(message["logTime"], stamp);
    EXPECT_EQ(message["format"], "jpeg");
    EXPECT_EQ(message["bytes"], 200 + pictures);
    EXPECT_EQ(message["begins"].get<std::string>().substr(0, 4), "ffd8");
    ++pictures;
  }
  EXPECT_EQ(pictures, 10);
}

TEST(McapWriter, TheCalibrationIsReadByTheReferenceReader) {
  const auto json = read_with_peer(record_pictures(1).data, "");
  if (json.is_null()) GTEST_SKIP() << kNoPeer;
  const auto& calibration = json["messages"][0];
  EXPECT_EQ(calibration["topic"], "/camera/calibration");
  EXPECT_EQ(calibration["width"], 1242);
  EXPECT_EQ(calibration["K"], nlohmann::json({721.5, 0, 609.5, 0, 721.5, 172.75, 0, 0, 1}));
  EXPECT_EQ(calibration["P"].size(), 12);
}

TEST(McapWriter, AFileCutByAPowerFailureGivesItsWholeChunksToTheReferenceReader) {
  const MemorySink sink = record_pictures(12, /*finish=*/false);
  ASSERT_EQ(sink.flushed_at.size(), 3);
  const std::span whole(sink.data);
  const auto json = read_with_peer(whole.first(sink.flushed_at[1] + 100), "--stream");
  if (json.is_null()) GTEST_SKIP() << kNoPeer;
  EXPECT_EQ(json["messages"].size(), 10);  // two chunks of four pictures and one calibration
}

TEST(McapWriter, RefusesAMessageLargerThanAChunkAndSaysWhenAChunkIsFull) {
  MemorySink sink;
  McapWriter writer(1024, 4, 4);
  ASSERT_TRUE(writer.begin(sink, kNoChannels, {}));
  const std::vector<std::byte> huge(1024);
  const std::vector<std::byte> half(600);
  EXPECT_EQ(writer.write_message(1, 0, 0, huge).code(), StatusCode::kInvalidInput);
  EXPECT_TRUE(writer.write_message(1, 0, 0, half));
  EXPECT_EQ(writer.write_message(1, 1, 1, half).code(), StatusCode::kUnavailable);
  EXPECT_TRUE(writer.end_chunk());
  EXPECT_TRUE(writer.write_message(1, 1, 1, half));
}

TEST(McapWriter, AFullIndexIsToldWhileTheOpenChunkStillHasItsPlace) {
  MemorySink sink;
  McapWriter writer(1024, 4, 3);
  ASSERT_TRUE(writer.begin(sink, kNoChannels, {}));
  const std::vector<std::byte> message(100);
  std::uint32_t chunks = 0;
  for (; writer.has_room_for_chunk(); ++chunks) {
    ASSERT_TRUE(writer.write_message(1, chunks, chunks, message));
    ASSERT_TRUE(writer.end_chunk());
  }
  EXPECT_EQ(chunks, 2U);
  ASSERT_TRUE(writer.write_message(1, chunks, chunks, message));
  EXPECT_TRUE(writer.finish());
  McapWriter over(1024, 4, 1);
  ASSERT_TRUE(over.begin(sink, kNoChannels, {}));
  ASSERT_TRUE(over.write_message(1, 0, 0, message));
  ASSERT_TRUE(over.end_chunk());
  ASSERT_TRUE(over.write_message(1, 1, 1, message));
  EXPECT_EQ(over.end_chunk().code(), StatusCode::kUnavailable);
}

TEST(McapReader, ReadsWhatTheWriterWrote) {
  const Reading reading = read_all(record_pictures(9).data);
  EXPECT_EQ(reading.pictures, (std::vector<std::uint32_t>{0, 1, 2, 3, 4, 5, 6, 7, 8}));
  EXPECT_EQ(reading.errors, 0);
  EXPECT_FALSE(reading.truncated);
}

TEST(McapReader, AFileCutAnywhereGivesEveryWholeChunkAndNothingElse) {
  const MemorySink sink = record_pictures(8);
  const std::span whole(sink.data);
  for (std::size_t length = 8; length < whole.size(); length += 7) {
    const Reading reading = read_all(whole.first(length));
    const std::size_t chunks = (length >= sink.flushed_at[0]) + (length >= sink.flushed_at[1]);
    // A chunk is whole a little before its flush: its message index follows it.
    EXPECT_GE(reading.pictures.size(), chunks * 4) << "cut at " << length;
    EXPECT_EQ(reading.pictures.size() % 4, 0U) << "cut at " << length;
  }
}

TEST(McapReader, AFlippedBitInAChunkCostsThatChunkOnly) {
  MemorySink sink = record_pictures(12);
  sink.data[sink.flushed_at[0] + 300] ^= std::byte{0x10};
  const Reading reading = read_all(sink.data);
  EXPECT_EQ(reading.pictures, (std::vector<std::uint32_t>{0, 1, 2, 3, 8, 9, 10, 11}));
  EXPECT_EQ(reading.errors, 1);
}

TEST(McapReader, RefusesWhatIsNoMcapFile) {
  EXPECT_EQ(read_all(as_bytes("RIFF....AVI LIST")).errors, 1);
  EXPECT_EQ(read_all({}).errors, 1);
}

// Each of many channels would keep a copy of its schema's name.
TEST(McapReader, RefusesANameThatIsLongerThanNames) {
  const std::string name(2000, 'x');
  const McapChannel channels[] = {{"/camera/image", name, {}}, {}};
  MemorySink sink;
  McapWriter writer(8192, 64, 64);
  ASSERT_TRUE(writer.begin(sink, channels, {}));
  ASSERT_TRUE(writer.finish());
  const Reading reading = read_all(sink.data);
  EXPECT_GT(reading.errors, 0);
}

// Whoever waits for a picture looks at the clock between calls.
TEST(McapReader, DoesNotReadOnForEverWhereThereIsNoMessage) {
  MemorySink sink = record_pictures(1, false);
  const std::size_t aside = McapReader::kMaxAside / 4;
  for (int i = 0; i < 8; ++i) {
    std::vector<std::byte> attachment(9 + aside, std::byte{0});
    attachment[0] = std::byte{0x09};
    std::memcpy(&attachment[1], &aside, sizeof(aside));  // little-endian, as all of our targets
    sink.data.insert(sink.data.end(), attachment.begin(), attachment.end());
  }
  McapReader reader(from_memory(sink.data));
  ASSERT_TRUE(reader.open());
  std::vector<StatusCode> codes;
  do {
    codes.push_back(reader.next().code());
  } while (codes.back() != StatusCode::kEndOfStream && codes.size() < 20);
  EXPECT_GT(std::count(codes.begin(), codes.end(), StatusCode::kUnavailable), 0);
  EXPECT_EQ(codes.back(), StatusCode::kEndOfStream);
}

TEST(McapReader, SurvivesTenThousandDamagedFiles) {
  const MemorySink sink = record_pictures(4);
  std::mt19937 random(7);
  for (int round = 0; round < 10'000; ++round) {
    auto damaged = sink.data;
    for (int i = 0; i < 4; ++i) damaged[random() % damaged.size()] = std::byte(random());
    const Reading reading = read_all(damaged);
    EXPECT_LE(reading.pictures.size(), 1000U);
  }
}

TEST(Foxglove, ACalibrationSurvivesTheRoundTripAndKeepsWhetherItIsOne) {
  std::vector<std::byte> block(1024);
  for (const bool calibrated : {true, false}) {
    ByteWriter out(block);
    CameraModel model = kitti_like();
    model.calibrated = calibrated;
    encode(CameraCalibration{kFirstStamp, model}, out);
    const auto back = decode_camera_calibration(out.written());
    ASSERT_TRUE(back);
    EXPECT_EQ(back->unix_ns, kFirstStamp);
    EXPECT_EQ(back->model.calibrated, calibrated);
    EXPECT_FLOAT_EQ(back->model.fx, model.fx);
    EXPECT_FLOAT_EQ(back->model.cy, model.cy);
  }
}

TEST(Foxglove, TheLensIsPartOfTheCalibration) {
  for (const std::array<float, 8>& distortion :
       {std::array<float, 8>{-0.28F, 0.09F, 0.001F, -0.002F, -0.01F},
        std::array<float, 8>{0.3F, 0.05F, 0, 0, 0, 0.6F, 0.1F, 0.01F}}) {
    CameraModel model = kitti_like();
    model.distortion = distortion;
    std::vector<std::byte> block(1024);
    ByteWriter out(block);
    encode(CameraCalibration{kFirstStamp, model}, out);
    const auto back = decode_camera_calibration(out.written());
    ASSERT_TRUE(back) << back.status().text();
    EXPECT_EQ(back->model, model);
  }
}

TEST(Foxglove, ALensModelWeDoNotKnowIsRefusedByName) {
  CameraModel model = kitti_like();
  model.distortion[0] = 0.1F;
  std::vector<std::byte> block(1024);
  ByteWriter out(block);
  encode(CameraCalibration{kFirstStamp, model}, out);
  std::string message(reinterpret_cast<const char*>(block.data()), out.size());
  message.replace(message.find("plumb_bob"), 9, "fish_eyes");
  const auto back = decode_camera_calibration(as_bytes(message));
  EXPECT_EQ(back.code(), StatusCode::kUnsupported);
  EXPECT_NE(std::string(back.status().text()).find("fish_eyes"), std::string::npos);
}

TEST(Foxglove, AMalformedCalibrationIsRefused) {
  EXPECT_EQ(decode_camera_calibration(as_bytes("\xFF\xFF\xFF")).code(), StatusCode::kCorrupt);
  EXPECT_EQ(decode_camera_calibration({}).code(), StatusCode::kCorrupt);
}

}  // namespace
}  // namespace lcdm::wire
