// The JSON reader: what it takes, and that hostile text is an error, not a crash.
#include "firmware/nn/json.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace lcdm {
namespace {

TEST(Json, ReadsEveryKindOfValue) {
  const auto value = parse_json(R"( {"n": null, "t": true, "i": 42, "x": -2.5e-1,
                                     "s": "a\"\\\/\u00e9\ud83d\ude00", "a": [1, [2], {}]} )");
  ASSERT_TRUE(value) << value.status().text();
  EXPECT_EQ(value->find("n")->kind(), JsonValue::Kind::kNull);
  EXPECT_EQ(value->find("t")->kind(), JsonValue::Kind::kBool);
  EXPECT_EQ(value->find("i")->whole(), 42U);
  EXPECT_EQ(value->find("i")->number(), 42.0);
  EXPECT_EQ(value->find("x")->number(), -0.25);
  EXPECT_EQ(value->find("x")->whole(), std::nullopt);
  EXPECT_EQ(value->find("s")->text(), "a\"\\/\xC3\xA9\xF0\x9F\x98\x80");
  ASSERT_EQ(value->find("a")->items().size(), 3U);
  EXPECT_EQ(value->find("a")->items()[1].items()[0].whole(), 2U);
  EXPECT_EQ(value->find("missing"), nullptr);
}

TEST(Json, KeepsWholeNumbersExact) {
  EXPECT_EQ(parse_json("18446744073709551615")->whole(), 18446744073709551615U);
  EXPECT_EQ(parse_json("18446744073709551616")->whole(), std::nullopt);
  EXPECT_EQ(parse_json("-1")->whole(), std::nullopt);
  EXPECT_EQ(parse_json("1.0")->whole(), std::nullopt);
}

TEST(Json, RefusesWhatIsNotJson) {
  for (const char* text : {"",
                           " ",
                           "{",
                           "[1,",
                           "[1 2]",
                           "{\"a\"}",
                           "{\"a\":}",
                           "{a:1}",
                           "{\"a\":1,}",
                           "nul",
                           "tru",
                           "+1",
                           ".5",
                           "-",
                           "1e999",
                           "01",
                           "-01",
                           "[1.]",
                           "1.e5",
                           "\"",
                           "\"\\",
                           "\"\\x\"",
                           "\"\\u12\"",
                           "\"\\u12g4\"",
                           "\"\\ud800\"",
                           "\"\\ud800\\u0041\"",
                           "\"\\udc00\"",
                           "1 2",
                           "inf",
                           "NaN",
                           "{\"a\":1,\"a\":2}"}) {
    const auto value = parse_json(text);
    EXPECT_EQ(value.code(), StatusCode::kCorrupt) << text;
  }
}

// Names and texts of a model file are printed.
TEST(Json, RefusesStringsThatWouldSteerATerminal) {
  for (const char* text : {"\"\x01\"", "\"\x7f\"", R"("\n")", R"("\u001b[2J")", R"("\u007f")",
                           R"("\u0080")", R"("\u009b2J")",
                           "\"\xC2\x9B"
                           "2J\"",
                           R"({"\t": 1})"}) {
    const auto value = parse_json(text);
    EXPECT_EQ(value.code(), StatusCode::kCorrupt) << text;
    EXPECT_THAT(value.status().text(), testing::HasSubstr("control character")) << text;
  }
  EXPECT_EQ(parse_json(R"("\u00a0\u011b")")->text(), "\xC2\xA0\xC4\x9B") << "no control characters";
}

// 0x9B alone steers some terminals too; the other is a line feed in two bytes.
TEST(Json, RefusesStringsThatAreNotUtf8) {
  for (const char* text : {"\"x\x9B"
                           "2J\"",
                           "\"\xC0\x8A\"", "\"\xE2\x82\"", "\"\xED\xA0\x80\"",
                           "\"\xF4\x90\x80\x80\"", "{\"\xFF\": 1}"}) {
    const auto value = parse_json(text);
    EXPECT_EQ(value.code(), StatusCode::kCorrupt) << text;
    EXPECT_THAT(value.status().text(), testing::HasSubstr("UTF-8")) << text;
  }
  const char* fine = "\"d\xC4\x9B \xE2\x82\xAC \xF0\x9F\x98\x80\"";
  EXPECT_TRUE(parse_json(fine)) << fine;
}

TEST(Json, NamesThePlaceOfTheError) {
  EXPECT_STREQ(parse_json("[1, oops]").status().text(), "JSON: expected a value at byte 4");
}

TEST(Json, HoldsItsLimits) {
  const std::string deep(100000, '[');
  EXPECT_EQ(parse_json(deep).code(), StatusCode::kCorrupt);
  EXPECT_TRUE(parse_json("[[[]]]", {.depth = 2}));
  EXPECT_FALSE(parse_json("[[[[]]]]", {.depth = 2}));
  EXPECT_TRUE(parse_json("[1, 2]", {.values = 3}));
  EXPECT_FALSE(parse_json("[1, 2, 3]", {.values = 3}));
  EXPECT_TRUE(parse_json("[1]", {.bytes = 3}));
  EXPECT_FALSE(parse_json("[11]", {.bytes = 3}));
}

}  // namespace
}  // namespace lcdm
