// Model files: good ones are read exactly, hostile ones are refused with a reason.
#include "firmware/nn/model_file.h"

#include <cmath>
#include <cstring>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <limits>
#include <random>
#include <sys/stat.h>

#include "firmware/nn/network.h"
#include "tests/support/random_model.h"
#include "tests/support/temporary_folder.h"

namespace lcdm {
namespace {

using testing::HasSubstr;

const ModelConfig kConfig = test::make_config(EncoderKind::kXxs, PresetKind::kLcdm);

std::vector<std::byte> tiny_model(test::WeightType type = test::WeightType::kF32) {
  return test::make_model_image(test::metadata_json(kConfig),
                                {{"a", {2, 3}, {1, 2, 3, 4, 5, -6.5F}}, {"b", {1}, {0.25F}}}, type);
}

// A file from a header written by hand and `data_bytes` zeros.
std::vector<std::byte> file_with(const std::string& header, std::size_t data_bytes) {
  std::vector<std::byte> bytes(8 + header.size() + data_bytes);
  for (std::size_t i = 0; i < 8; ++i) bytes[i] = static_cast<std::byte>(header.size() >> (8 * i));
  std::memcpy(bytes.data() + 8, header.data(), header.size());
  return bytes;
}

std::string metadata_entry() {
  std::string quoted;
  for (const char c : test::metadata_json(kConfig)) quoted += c == '"' ? "\\\"" : std::string(1, c);
  return "\"__metadata__\":{\"lcdm\":\"" + quoted + "\"}";
}

// A file whose one tensor `w` has this entry.
std::vector<std::byte> file_with_entry(const std::string& entry, std::size_t data_bytes) {
  return file_with("{" + metadata_entry() + ",\"w\":" + entry + "}", data_bytes);
}

std::string refusal(std::vector<std::byte> bytes) {
  const auto model = ModelFile::parse(std::move(bytes));
  return model ? "accepted" : model.status().text();
}

TEST(ModelFile, ReadsTensorsAndConfiguration) {
  for (const auto type : {test::WeightType::kF32, test::WeightType::kF16}) {
    const auto model = ModelFile::parse(tiny_model(type));
    ASSERT_TRUE(model) << model.status().text();
    const auto a = model->tensors().find("a");
    ASSERT_NE(a, model->tensors().end());
    EXPECT_EQ(a->second.shape, (std::vector<std::int64_t>{2, 3}));
    std::vector<float> values(6);
    model->read(a->second, values);
    EXPECT_EQ(values, (std::vector<float>{1, 2, 3, 4, 5, -6.5F}));
    EXPECT_EQ(model->config().encoder, EncoderKind::kXxs);
    EXPECT_EQ(model->config().steps, (std::vector<int>{149, 74}));
    EXPECT_EQ(model->config().trained_sizes[1], (std::array<int, 2>{384, 288}));
    EXPECT_EQ(model->config().licence, "Apache-2.0");
  }
}

TEST(ModelFile, HashNamesTheBytes) {
  auto bytes = tiny_model();
  const auto first = ModelFile::parse(bytes)->hash();
  EXPECT_EQ(ModelFile::parse(bytes)->hash(), first);
  bytes.back() ^= std::byte{1};
  EXPECT_NE(ModelFile::parse(bytes)->hash(), first);
}

TEST(ModelFile, HalfPrecisionIsExact) {
  EXPECT_EQ(half_to_float(0x0000), 0.0F);
  EXPECT_TRUE(std::signbit(half_to_float(0x8000)));
  EXPECT_EQ(half_to_float(0x3C00), 1.0F);
  EXPECT_EQ(half_to_float(0xC500), -5.0F);
  EXPECT_EQ(half_to_float(0x7BFF), 65504.0F);
  EXPECT_EQ(half_to_float(0x0001), 0x1p-24F);
  EXPECT_EQ(half_to_float(0x83FF), -1023 * 0x1p-24F);
  EXPECT_EQ(half_to_float(0x7C00), std::numeric_limits<float>::infinity());
  EXPECT_TRUE(std::isnan(half_to_float(0x7E00)));
}

TEST(ModelFile, EveryTruncationIsRefused) {
  const auto whole = tiny_model();
  for (std::size_t size = 0; size < whole.size(); ++size) {
    const std::vector<std::byte> cut(whole.begin(),
                                     whole.begin() + static_cast<std::ptrdiff_t>(size));
    ASSERT_FALSE(ModelFile::parse(cut)) << size << " of " << whole.size() << " bytes";
  }
}

TEST(ModelFile, RefusesEntriesThatDoNotFitTheirBytes) {
  const auto entry = [](const char* type, const char* shape, const char* offsets) {
    return std::string("{\"dtype\":\"") + type + "\",\"shape\":" + shape +
           ",\"data_offsets\":" + offsets + "}";
  };
  EXPECT_EQ(refusal(file_with_entry(entry("F32", "[2]", "[0,8]"), 8)), "accepted");
  EXPECT_THAT(refusal(file_with_entry(entry("F32", "[2]", "[0,8]"), 4)), HasSubstr("range"));
  EXPECT_THAT(refusal(file_with_entry(entry("F32", "[2]", "[8,0]"), 8)), HasSubstr("range"));
  EXPECT_THAT(refusal(file_with_entry(entry("F32", "[3]", "[0,8]"), 8)), HasSubstr("shape"));
  EXPECT_THAT(refusal(file_with_entry(entry("F32", "[2]", "[4,12]"), 12)), HasSubstr("gap"));
  EXPECT_THAT(refusal(file_with_entry(entry("F32", "[2]", "[0,8]"), 12)), HasSubstr("after"));
  EXPECT_THAT(refusal(file_with_entry(entry("F32", "[1]", "[2,6]"), 8)), HasSubstr("aligned"));
  EXPECT_THAT(refusal(file_with_entry(entry("F64", "[1]", "[0,8]"), 8)), HasSubstr("dtype"));
  EXPECT_THAT(refusal(file_with_entry(entry("F32", "[0]", "[0,0]"), 0)), HasSubstr("extent"));
  EXPECT_THAT(refusal(file_with_entry(entry("F32", "[-2]", "[0,8]"), 8)), HasSubstr("extent"));
  EXPECT_THAT(refusal(file_with_entry(entry("F32", "[4294967296,4294967296]", "[0,8]"), 8)),
              HasSubstr("extent"));
  EXPECT_THAT(refusal(file_with_entry(entry("F32", "[16777216,16777216]", "[0,8]"), 8)),
              HasSubstr("too large"));
  EXPECT_THAT(refusal(file_with_entry(entry("F32", "[1,1,1,1,2]", "[0,8]"), 8)),
              HasSubstr("too many axes"));
  EXPECT_THAT(refusal(file_with_entry("[]", 8)), HasSubstr("object"));
  EXPECT_THAT(refusal(file_with_entry("{\"dtype\":\"F32\"}", 8)), HasSubstr("shape"));
}

TEST(ModelFile, RefusesOverlappingTensors) {
  const std::string header = "{" + metadata_entry() +
                             ",\"a\":{\"dtype\":\"F32\",\"shape\":[2],\"data_offsets\":[0,8]}"
                             ",\"b\":{\"dtype\":\"F32\",\"shape\":[2],\"data_offsets\":[4,12]}}";
  EXPECT_THAT(refusal(file_with(header, 12)), HasSubstr("overlap"));
}

TEST(ModelFile, RefusesHeadersThatAreNotOurs) {
  EXPECT_THAT(refusal({}), HasSubstr("no header"));
  EXPECT_THAT(refusal(file_with("[]", 0)), HasSubstr("object"));
  EXPECT_THAT(refusal(file_with("{", 0)), HasSubstr("JSON"));
  EXPECT_THAT(refusal(file_with("{}", 0)), HasSubstr("__metadata__"));
  EXPECT_THAT(refusal(file_with("{\"__metadata__\":{\"format\":\"pt\"}}", 0)), HasSubstr("lcdm"));
  auto huge = file_with("{}", 0);
  for (std::size_t i = 0; i < 8; ++i) huge[i] = std::byte{0xFF};
  EXPECT_THAT(refusal(huge), HasSubstr("header length"));
}

TEST(ModelFile, RefusesWeightsThatAreNotFinite) {
  for (const float bad :
       {std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity()}) {
    const auto image =
        test::make_model_image(test::metadata_json(kConfig), {{"w", {2}, {1.0F, bad}}});
    EXPECT_THAT(refusal(image), HasSubstr("not finite in `w`"));
  }
}

TEST(ModelFile, NamesTheMetadataKeyThatIsWrong) {
  const auto with = [](const std::string& from, const std::string& to) {
    std::string text = test::metadata_json(kConfig);
    const std::size_t at = text.find(from);
    EXPECT_NE(at, std::string::npos) << from;
    return refusal(test::make_model_image(text.replace(at, from.size(), to), {}));
  };
  EXPECT_THAT(with("\"version\":1", "\"version\":2"), HasSubstr("version 2"));
  EXPECT_THAT(with("\"xxs\"", "\"xxl\""), HasSubstr("`encoder`"));
  EXPECT_THAT(with("\"preset\":\"lcdm\"", "\"preset\":7"), HasSubstr("`preset`"));
  EXPECT_THAT(with("[8,16,32,64,128]", "[8,16,32,64]"), HasSubstr("`decoder_widths`"));
  EXPECT_THAT(with("[8,16,32,64,128]", "[8,16,32,64,100000]"), HasSubstr("`decoder_widths`"));
  EXPECT_THAT(with("\"condition_channels\":16", "\"condition_channels\":6"),
              HasSubstr("`condition_channels`"));
  EXPECT_THAT(with("[149,74]", "[]"), HasSubstr("`sampler.steps`"));
  EXPECT_THAT(with("[149,74]", "[150,74]"), HasSubstr("`sampler.steps`"));
  EXPECT_THAT(with("[149,74]", "[74,149]"), HasSubstr("`sampler.steps`"));
  EXPECT_THAT(with("\"noise\"", "\"nose\""), HasSubstr("`start`"));
  EXPECT_THAT(with("\"seed\":1", "\"seed\":-1"), HasSubstr("`sampler.seed`"));
  EXPECT_THAT(with("\"variable_std\":1.0", "\"variable_std\":0.0"), HasSubstr("`variable_std`"));
  EXPECT_THAT(with("\"canonical_focal\":320", "\"canonical_focal\":0"),
              HasSubstr("`canonical_focal`"));
  EXPECT_THAT(with("[640,192]", "[640]"), HasSubstr("`trained_sizes`"));
  EXPECT_THAT(with("[[640,192],[384,288]]", "[]"), HasSubstr("at least one"));
  EXPECT_THAT(with("[640,192]", "[2048,2048]"), HasSubstr("1048576 pixels"));
  EXPECT_THAT(with("\"licence\"", "\"license\""), HasSubstr("`licence`"));
  EXPECT_THAT(with("\"Apache-2.0\"", "\"\\u001b[2J\""), HasSubstr("control character"));
}

TEST(ModelFile, MissingFileSaysWhichAndWhatToDo) {
  const auto model = ModelFile::load("/nowhere/model.safetensors");
  EXPECT_EQ(model.code(), StatusCode::kInvalidInput);
  EXPECT_THAT(model.status().text(), HasSubstr("/nowhere/model.safetensors"));
  EXPECT_EQ(ModelFile::load("/").code(), StatusCode::kInvalidInput);
}

// To open it waits until somebody writes to it.
TEST(ModelFile, APipeIsNone) {
  const test::TemporaryFolder folder;
  ASSERT_EQ(mkfifo(folder.file("pipe").c_str(), 0600), 0);
  EXPECT_EQ(ModelFile::load(folder.file("pipe")).code(), StatusCode::kInvalidInput);
}

TEST(ModelFile, LoadReadsWhatParseReads) {
  const test::TemporaryFolder folder;
  const auto bytes = tiny_model();
  const auto model = ModelFile::load(folder.write("tiny.safetensors", bytes));
  ASSERT_TRUE(model) << model.status().text();
  EXPECT_EQ(model->hash(), ModelFile::parse(bytes)->hash());
  EXPECT_EQ(model->file_bytes(), bytes.size());
}

// One random change: a flipped byte, a digit, a cut, a doubled or a removed piece.
void mutate(std::vector<std::byte>& bytes, std::mt19937& random) {
  const auto place = [&] { return random() % bytes.size(); };
  const auto at = [&](std::size_t i) { return bytes.begin() + static_cast<std::ptrdiff_t>(i); };
  const std::size_t begin = place();
  const std::size_t end = std::min(bytes.size(), begin + 1 + random() % 16);
  switch (random() % 5) {
    case 0:
      bytes[begin] = static_cast<std::byte>(random());
      break;
    case 1:
      bytes[begin] = static_cast<std::byte>('0' + random() % 10);
      break;
    case 2:
      bytes.resize(begin + 1);
      break;
    case 3: {
      const std::vector<std::byte> piece(at(begin), at(end));
      bytes.insert(at(place()), piece.begin(), piece.end());
      break;
    }
    default:
      if (end - begin < bytes.size()) bytes.erase(at(begin), at(end));
  }
}

TEST(ModelFile, RandomDamageNeverDoesMoreThanFail) {
  const auto network = Network::build(kConfig, 64, 64);
  ASSERT_TRUE(network);
  const auto whole = tiny_model();
  std::mt19937 random(1);
  int refused = 0;
  for (int i = 0; i < 20000; ++i) {
    std::vector<std::byte> bytes = whole;
    for (unsigned n = 1 + random() % 4; n > 0; --n) mutate(bytes, random);
    const auto model = ModelFile::parse(std::move(bytes));
    if (!model) {
      ++refused;
      EXPECT_STRNE(model.status().text(), "");
    } else {
      EXPECT_FALSE(
          network->check_weights(*model));  // not this network's tensors, whatever they are
    }
  }
  EXPECT_GT(refused, 10000);
}

// All began with an encoder whose licence asks that its notice stays.
TEST(ReleasedWeights, NameWhomTheirEncoderIsOf) {
  for (const char* name : {"xs", "xxs", "xs-open", "xxs-open"}) {
    const auto model = ModelFile::load(std::string("model/weights/lcdm-") + name + ".safetensors");
    ASSERT_TRUE(model) << model.status().text();
    EXPECT_THAT(model->config().licence,
                testing::HasSubstr("METER's (MIT, Copyright (c) 2022 lorenzopapa5)"))
        << name;
  }
}

}  // namespace
}  // namespace lcdm
