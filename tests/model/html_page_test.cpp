// What a report's page holds, read back from its text.
#include "model/html_page.h"

#include <cerrno>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <gtest/gtest.h>
#include <iterator>
#include <limits>
#include <opencv2/imgcodecs.hpp>
#include <string>
#include <utility>
#include <vector>

#include "tests/model/page_text.h"
#include "tests/support/file_size_limit.h"
#include "tests/support/temporary_folder.h"

namespace lcdm::model {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr double kInfinity = std::numeric_limits<double>::infinity();

// --- The page ------------------------------------------------------------------------------------

TEST(HtmlPage, HoldsWhatWasWrittenInItsOrder) {
  HtmlPage page("Training");
  page.heading("Losses");
  page.paragraph("They fell.");
  page.note("Mean of 25 steps.");
  EXPECT_EQ(body_of(page),
            "<body>\n<h1>Training</h1>\n<h2>Losses</h2>\n<p>They fell.</p>\n"
            "<p class=\"note\">Mean of 25 steps.</p>\n</body>\n</html>\n");
  EXPECT_EQ(page.html().rfind("<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=", 0),
            0U);
}

TEST(HtmlPage, NeedsNothingFromOutside) {
  HtmlPage page("Training");
  page.line_chart(chart_of({1, 2}, {3, 4}));
  page.gallery({{cv::Mat(200, 300, CV_8UC3, cv::Scalar(1, 2, 3)), "frame"}});
  const std::string html = page.html();
  for (const char* outside : {"<script", "<link", "http:", "https:", "@import", "url("}) {
    EXPECT_EQ(html.find(outside), std::string::npos) << outside;
  }
}

TEST(HtmlPage, TextStaysText) {
  HtmlPage page("<b>&\"'");
  page.line_chart(
      {.title = "a<b", .x_label = "\"x\"", .y_label = "y&z", .series = {{"<s>", {}, {}}}});
  page.table({"<th>"}, {{"</table>"}});
  page.gallery({{cv::Mat(), "<img>"}});
  const std::string body = body_of(page);
  EXPECT_NE(body.find("<h1>&lt;b&gt;&amp;&quot;&#39;</h1>"), std::string::npos);
  EXPECT_NE(page.html().find("<title>&lt;b&gt;&amp;&quot;&#39;</title>"), std::string::npos);
  for (const char* kept : {"a&lt;b", "&quot;x&quot;", "y&amp;z", "&lt;s&gt;", "&lt;th&gt;",
                           "&lt;/table&gt;", "&lt;img&gt;"}) {
    EXPECT_NE(body.find(kept), std::string::npos) << kept;
  }
}

// U+FFFD for each byte that begins no character.
TEST(HtmlPage, BytesThatAreNoTextAreReplaced) {
  const std::string kBad = "\xEF\xBF\xBD";
  const std::vector<std::pair<std::string, std::string>> cases = {
      {"caf\xC3\xA9 \xE2\x82\xAC \xF0\x9F\x98\x80", "caf\xC3\xA9 \xE2\x82\xAC \xF0\x9F\x98\x80"},
      {"caf\xE9!", "caf" + kBad + "!"},                 // Latin-1
      {"cut\xE2\x82", "cut" + kBad + kBad},             // ends within a character
      {"\xC0\xBC", kBad + kBad},                        // '<', longer than it may be
      {"\xED\xA0\x80", kBad + kBad + kBad},             // half of a pair
      {"\xF4\x90\x80\x80", kBad + kBad + kBad + kBad},  // beyond the last character
      {std::string("a\0b\x1B", 4), "a" + kBad + "b" + kBad},
  };
  for (const auto& [given, shown] : cases) {
    HtmlPage page("");
    page.paragraph(given);
    EXPECT_NE(body_of(page).find("<p>" + shown + "</p>"), std::string::npos) << shown;
  }
}

TEST(HtmlPage, TablesHaveAHeadAndARowPerLineAndShortRowsAreFilled) {
  HtmlPage page("");
  page.table({"pack", "AbsRel"}, {{"indoor", "0.1"}, {"scene"}});
  EXPECT_NE(body_of(page).find("<thead><tr><th scope=\"col\">pack</th>"
                               "<th scope=\"col\">AbsRel</th></tr></thead>\n<tbody>\n"
                               "<tr><th scope=\"row\">indoor</th><td>0.1</td></tr>\n"
                               "<tr><th scope=\"row\">scene</th><td></td></tr>\n</tbody>"),
            std::string::npos);
}

// --- Numbers -------------------------------------------------------------------------------------

TEST(NumberText, ShowsTheDigitsThatMatter) {
  const std::string thin = "\xE2\x80\xAF";
  EXPECT_EQ(number_text(0.1 + 0.2), "0.3");
  EXPECT_EQ(number_text(0.123456), "0.1235");
  EXPECT_EQ(number_text(0.123456, 2), "0.12");
  EXPECT_EQ(number_text(9.99996), "10");
  EXPECT_EQ(number_text(100), "100");
  EXPECT_EQ(number_text(-1.5), "-1.5");
  EXPECT_EQ(number_text(-0.0), "0");
  EXPECT_EQ(number_text(12300.4), "12" + thin + "300");
  EXPECT_EQ(number_text(-123456), "-123" + thin + "456");
  EXPECT_EQ(number_text(1234567), "1" + thin + "234" + thin + "567");
  EXPECT_EQ(number_text(2e-5), "2e-5");
  EXPECT_EQ(number_text(0.0001), "0.0001");
  EXPECT_EQ(number_text(-3.25e12), "-3.25e12");
  EXPECT_EQ(number_text(1e300), "1e300");
  EXPECT_EQ(number_text(kNaN), "\xE2\x80\x93");
  EXPECT_EQ(number_text(-kInfinity), "\xE2\x80\x93");
}

// --- Pictures ------------------------------------------------------------------------------------

std::vector<std::uint8_t> decoded(const std::string& text) {
  static const std::string kDigits =
      "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::vector<std::uint8_t> bytes;
  unsigned bits = 0;
  int count = 0;
  for (const char c : text) {
    if (c == '=') break;
    bits = bits << 6 | static_cast<unsigned>(kDigits.find(c));
    count += 6;
    if (count < 8) continue;
    count -= 8;
    bytes.push_back(static_cast<std::uint8_t>(bits >> count & 255U));
  }
  return bytes;
}

Texts images_of(const HtmlPage& page, const std::string& type) {
  return all(body_of(page), "src=\"data:image/" + type + ";base64,([^\"]*)\"");
}

TEST(Gallery, SmallPicturesAreEmbeddedBitByBit) {
  for (const int width : {1, 2, 3, 17}) {  // base64 pads each differently
    cv::Mat picture(2, width, CV_8UC3);
    cv::randu(picture, 0, 256);
    HtmlPage page("");
    page.gallery({{picture, "pixels"}});
    const Texts images = images_of(page, "png");
    ASSERT_EQ(images.size(), 1U);
    EXPECT_EQ(images[0].size() % 4, 0U);
    EXPECT_EQ(cv::norm(cv::imdecode(decoded(images[0]), cv::IMREAD_COLOR), picture), 0);
  }
}

TEST(Gallery, OthersAreJpegWithTheirSizeAndCaption) {
  HtmlPage page("");
  const cv::Mat picture(200, 300, CV_8UC3, cv::Scalar(10, 100, 200));
  page.gallery({{picture, "frame \"1\""}, {picture, "frame 2"}});
  const Texts images = images_of(page, "jpeg");
  ASSERT_EQ(images.size(), 2U);
  const cv::Mat shown = cv::imdecode(decoded(images[0]), cv::IMREAD_COLOR);
  EXPECT_LT(cv::norm(shown, picture, cv::NORM_INF), 4);
  const std::string body = body_of(page);
  EXPECT_NE(body.find("<img width=\"300\" height=\"200\" alt=\"frame &quot;1&quot;\""),
            std::string::npos);
  EXPECT_NE(body.find("<figcaption>frame &quot;1&quot;</figcaption>"), std::string::npos);
}

TEST(Gallery, AWidePictureOrOneAloneHasARowOfItsOwn) {
  const cv::Mat wide(150, 450, CV_8UC3, cv::Scalar(0));
  const cv::Mat plain(150, 200, CV_8UC3, cv::Scalar(0));
  HtmlPage page("");
  page.gallery({{wide, ""}, {plain, ""}});
  EXPECT_EQ(all(body_of(page), R"(<figure([^>]*)>)"), (Texts{" class=\"wide\"", ""}));
  HtmlPage single("");
  single.gallery({{plain, ""}});
  EXPECT_EQ(all(body_of(single), R"(<figure([^>]*)>)"), (Texts{" class=\"wide\""}));
}

TEST(Gallery, WhatIsNoPictureIsNamedByItsCaption) {
  HtmlPage page("");
  page.gallery({{cv::Mat(), "missing"}, {cv::Mat(4, 4, CV_32F, cv::Scalar(1)), "depth"}});
  EXPECT_EQ(body_of(page).find("<img"), std::string::npos);
  EXPECT_EQ(all(body_of(page), "<figcaption>([^<]*)<"), (Texts{"missing", "depth"}));
}

// --- The file ------------------------------------------------------------------------------------

std::string content_of(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
}

TEST(HtmlPageFile, IsThePageAndNothingIsLeftBesideIt) {
  const test::TemporaryFolder folder;
  const std::string path = folder.write("report.html", "yesterday's");
  const HtmlPage page("Training");
  const Status written = page.write(path);
  ASSERT_TRUE(written) << written.text();
  EXPECT_EQ(content_of(path), page.html());
  EXPECT_FALSE(std::filesystem::exists(path + ".new"));
}

TEST(HtmlPageFile, OnAFullDiskLeavesTheOldOne) {
  const test::TemporaryFolder folder;
  const std::string path = folder.write("report.html", "yesterday's");
  const test::FileSizeLimit limit(100);
  EXPECT_EQ(HtmlPage("Training").write(path).code(), StatusCode::kIoError);
  EXPECT_EQ(content_of(path), "yesterday's");
}

}  // namespace
}  // namespace lcdm::model
