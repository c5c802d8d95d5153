// What a report's page holds, read back from its text.
#include "model/html_page.h"

#include <algorithm>
#include <array>
#include <cerrno>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <gtest/gtest.h>
#include <iterator>
#include <limits>
#include <opencv2/imgcodecs.hpp>
#include <regex>
#include <string>
#include <utility>
#include <vector>

#include "tests/drivers/temporary_folder.h"

namespace lcdm::model {
namespace {

using Texts = std::vector<std::string>;
constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kTenth = 0.11;  // places are written to a tenth

// What `page` holds after its style sheet.
std::string body_of(const HtmlPage& page) {
  const std::string html = page.html();
  return html.substr(html.find("<body>"));
}

// The first group of every match.
Texts all(const std::string& text, const std::string& pattern) {
  const std::regex regex(pattern);
  Texts found;
  for (std::sregex_iterator match(text.begin(), text.end(), regex), end; match != end; ++match) {
    found.push_back((*match)[1]);
  }
  return found;
}

struct Point {
  double x;
  double y;
};

// The places in text such as "M1 2L3 4" or "translate(1 2)".
std::vector<Point> places(const std::string& text) {
  static const std::regex kPlace(R"((-?[\d.]+) (-?[\d.]+))");
  std::vector<Point> found;
  for (std::sregex_iterator match(text.begin(), text.end(), kPlace), end; match != end; ++match) {
    found.push_back({std::stod((*match)[1]), std::stod((*match)[2])});
  }
  return found;
}

// A chart, as drawn.
class Drawn {
 public:
  static Drawn lines(const Chart& chart) {
    HtmlPage page("");
    page.line_chart(chart);
    return Drawn(body_of(page));
  }
  static Drawn points(const Chart& chart) {
    HtmlPage page("");
    page.scatter_chart(chart);
    return Drawn(body_of(page));
  }

  const std::string& html() const { return html_; }
  double left() const { return frame_[0]; }
  double top() const { return frame_[1]; }
  double right() const { return frame_[0] + frame_[2]; }
  double bottom() const { return frame_[1] + frame_[3]; }
  // Every series' path within the chart, not those of the legend.
  Texts paths() const { return all(svg_, R"re(<path class="line[^>]* d="([^"]*)")re"); }
  std::vector<Point> marks() const {
    std::vector<Point> found;
    for (const std::string& text : all(svg_, R"re(class="mark[^>]*translate\(([^)]*)\))re")) {
      found.push_back(places(text).at(0));
    }
    return found;
  }
  Texts x_ticks() const { return all(svg_, R"re(class="tick"[^>]*"middle">([^<]*)<)re"); }
  Texts y_ticks() const { return all(svg_, R"re(class="tick"[^>]*"end">([^<]*)<)re"); }
  Texts axis_texts() const { return all(svg_, R"re(class="axis"[^>]*>([^<]*)<)re"); }

 private:
  explicit Drawn(std::string html) : html_(std::move(html)) {
    svg_ = html_.substr(html_.find("<svg role=\"img\""));
    static const std::regex kFrame(
        R"re(class="frame" x="([\d.]+)" y="([\d.]+)" width="([\d.]+)" height="([\d.]+)")re");
    std::smatch match;
    EXPECT_TRUE(std::regex_search(svg_, match, kFrame));
    for (std::size_t i = 0; i < frame_.size(); ++i) frame_[i] = std::stod(match[i + 1]);
  }

  std::string html_;
  std::string svg_;
  std::array<double, 4> frame_{};  // left, top, width, height
};

Chart chart_of(std::vector<double> x, std::vector<double> y) {
  Chart chart{.title = "Loss", .x_label = "step", .y_label = "loss", .series = {}};
  chart.series.push_back({"total", std::move(x), std::move(y)});
  return chart;
}

void expect_at(const Point& point, double x, double y) {
  EXPECT_NEAR(point.x, x, kTenth);
  EXPECT_NEAR(point.y, y, kTenth);
}

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

// --- Line charts ---------------------------------------------------------------------------------

TEST(LineChart, SpansTheFrameBetweenNiceTicks) {
  const Drawn drawn = Drawn::lines(chart_of({0, 50, 100}, {0, 1, 5}));
  const std::vector<Point> points = places(drawn.paths().at(0));
  ASSERT_EQ(points.size(), 3U);
  expect_at(points[0], drawn.left(), drawn.bottom());
  expect_at(points[1], (drawn.left() + drawn.right()) / 2,
            drawn.bottom() - (drawn.bottom() - drawn.top()) / 5);
  expect_at(points[2], drawn.right(), drawn.top());
  EXPECT_EQ(drawn.x_ticks(), (Texts{"0", "20", "40", "60", "80", "100"}));
  EXPECT_EQ(drawn.y_ticks(), (Texts{"0", "1", "2", "3", "4", "5"}));
  EXPECT_EQ(drawn.axis_texts(), (Texts{"loss", "step"}));
}

TEST(LineChart, TicksAreRoundAndTheirTextsAlike) {
  EXPECT_EQ(Drawn::lines(chart_of({0, 1}, {0.31, 0.17})).y_ticks(),
            (Texts{"0.15", "0.20", "0.25", "0.30", "0.35"}));
  EXPECT_EQ(Drawn::lines(chart_of({0, 1}, {-0.1, 0.2})).y_ticks(),
            (Texts{"-0.10", "-0.05", "0", "0.05", "0.10", "0.15", "0.20"}));
  EXPECT_EQ(Drawn::lines(chart_of({0, 1}, {0, 3e-4})).y_ticks(),
            (Texts{"0", "5e-5", "1e-4", "1.5e-4", "2e-4", "2.5e-4", "3e-4"}));
  EXPECT_EQ(Drawn::lines(chart_of({0, 1}, {1e8, 3e8})).y_ticks(),
            (Texts{"1e8", "1.5e8", "2e8", "2.5e8", "3e8"}));
}

TEST(LineChart, LongTickTextsHaveRoomBesideEachOther) {
  for (const double seconds : {0.1, 0.7, 3.0, 40.0, 600.0}) {
    const Drawn drawn = Drawn::lines(chart_of({1.7e9 + 0.1, 1.7e9 + 0.1 + seconds}, {1, 2}));
    const Texts ticks = drawn.x_ticks();
    ASSERT_FALSE(ticks.empty());
    double width = 0;
    for (const std::string& tick : ticks) width += 7.5 * static_cast<double>(tick.size());
    EXPECT_LT(width, drawn.right() - drawn.left()) << seconds;
  }
}

TEST(LineChart, ALogarithmicAxisGivesEqualFactorsEqualRoom) {
  Chart chart = chart_of({0, 1, 2}, {100, 1, 0.01});
  chart.log_y = true;
  const Drawn drawn = Drawn::lines(chart);
  const std::vector<Point> points = places(drawn.paths().at(0));
  ASSERT_EQ(points.size(), 3U);
  EXPECT_NEAR(points[1].y - points[0].y, points[2].y - points[1].y, 2 * kTenth);
  EXPECT_EQ(drawn.y_ticks(), (Texts{"0.01", "0.1", "1", "10", "100"}));

  chart.series[0].y = {1, 2, 10};
  EXPECT_EQ(Drawn::lines(chart).y_ticks(), (Texts{"1", "2", "5", "10"}));
  chart.series[0].y = {3.1, 3.2, 3.4};  // no power of ten between: ticks as on a linear axis
  EXPECT_GE(Drawn::lines(chart).y_ticks().size(), 3U);
}

TEST(LineChart, BreaksWhereAValueIsNotFinite) {
  const Drawn drawn =
      Drawn::lines(chart_of({0, 1, 2, 3, 4, 5, 6}, {1, 2, kNaN, 3, kInfinity, 4, 5}));
  EXPECT_EQ(all(drawn.paths().at(0), "([ML])"), (Texts{"M", "L", "M", "M", "L"}));
  EXPECT_EQ(drawn.html().find("nan"), std::string::npos);
  EXPECT_EQ(drawn.html().find("inf"), std::string::npos);
}

TEST(LineChart, BreaksWhereALogarithmicAxisHasNoPlace) {
  Chart chart = chart_of({0, 1, 2, 3}, {1, 0, -1, 2});
  chart.log_y = true;
  EXPECT_EQ(all(Drawn::lines(chart).paths().at(0), "([ML])"), (Texts{"M", "M"}));
}

TEST(LineChart, AValueAloneIsAMark) {
  std::vector<double> x(100);
  std::vector<double> y(100, 1.0);
  for (std::size_t i = 0; i < x.size(); ++i) x[i] = static_cast<double>(i);
  y[49] = y[51] = kNaN;
  const Drawn drawn = Drawn::lines(chart_of(x, y));
  ASSERT_EQ(drawn.marks().size(), 1U);
  EXPECT_NEAR(drawn.marks()[0].x, drawn.left() + (drawn.right() - drawn.left()) * 50 / 99, kTenth);
}

TEST(LineChart, ThinsManyPointsAndKeepsTheExtremesAndTheEnds) {
  constexpr std::size_t kMany = 100'000;
  std::vector<double> x(kMany);
  std::vector<double> y(kMany);
  for (std::size_t i = 0; i < kMany; ++i) {
    x[i] = static_cast<double>(i);
    y[i] = 5 + std::sin(static_cast<double>(i));
  }
  y[31'234] = 10;
  y[77'777] = 0;
  const Drawn drawn = Drawn::lines(chart_of(x, y));
  const std::vector<Point> points = places(drawn.paths().at(0));
  EXPECT_LE(points.size(), 502U);
  EXPECT_GE(points.size(), 400U);
  const auto [high, low] = std::minmax_element(
      points.begin(), points.end(), [](const Point& a, const Point& b) { return a.y < b.y; });
  const double width = drawn.right() - drawn.left();
  expect_at(*high, drawn.left() + width * 0.31234, drawn.top());
  expect_at(*low, drawn.left() + width * 0.77777, drawn.bottom());
  EXPECT_NEAR(points.front().x, drawn.left(), kTenth);
  EXPECT_NEAR(points.back().x, drawn.right(), kTenth);
}

TEST(LineChart, NamesEverySeriesThatHasAName) {
  Chart chart = chart_of({0, 1}, {0, 1});
  chart.series.push_back({"", {0, 1}, {1, 0}});
  chart.series.push_back({"denoising", {0, 1}, {1, 1}});
  const Drawn drawn = Drawn::lines(chart);
  EXPECT_EQ(all(drawn.html(), R"re(</svg>([^<]+)</span>)re"), (Texts{"total", "denoising"}));
  EXPECT_EQ(drawn.paths().size(), 3U);
}

// --- Charts of little data -----------------------------------------------------------------------

TEST(Charts, WithoutDataSaySo) {
  const Chart none{.title = "t", .x_label = "step", .y_label = "loss", .series = {}};
  for (const Drawn& drawn :
       {Drawn::lines(none), Drawn::points(none), Drawn::lines(chart_of({}, {})),
        Drawn::lines(chart_of({0, 1}, {kNaN, kInfinity}))}) {
    EXPECT_EQ(drawn.axis_texts(), (Texts{"loss", "step", "no data"}));
    EXPECT_TRUE(drawn.paths().empty());
    EXPECT_TRUE(drawn.marks().empty());
  }
}

TEST(Charts, OfOnePointShowItInTheMiddle) {
  for (const bool log : {false, true}) {
    Chart chart = chart_of({7}, {0.3});
    chart.log_x = chart.log_y = log;
    for (const Drawn& drawn : {Drawn::lines(chart), Drawn::points(chart)}) {
      ASSERT_EQ(drawn.marks().size(), 1U);
      EXPECT_GT(drawn.marks()[0].x, drawn.left() + 100);
      EXPECT_LT(drawn.marks()[0].x, drawn.right() - 100);
      EXPECT_GT(drawn.marks()[0].y, drawn.top() + 50);
      EXPECT_LT(drawn.marks()[0].y, drawn.bottom() - 50);
      EXPECT_FALSE(drawn.x_ticks().empty());
      EXPECT_FALSE(drawn.y_ticks().empty());
    }
  }
}

TEST(Charts, OfValuesAllEqualOrExtremeStayWithinTheFrame) {
  for (const std::vector<double>& y : std::vector<std::vector<double>>{
           {0, 0, 0},
           {-3, -3, -3},
           {1e9, 1e9 + 1e-6, 1e9},
           {-1e99, 0, 1e99},
           {1e-90, 2e-90, 3e-90},
           {std::numeric_limits<double>::max(), std::numeric_limits<double>::lowest(), 1}}) {
    const Drawn drawn = Drawn::lines(chart_of({1, 2, 3}, y));
    for (const Point& mark : drawn.marks()) {
      EXPECT_GE(mark.x, drawn.left() - kTenth);
      EXPECT_LE(mark.x, drawn.right() + kTenth);
      EXPECT_GE(mark.y, drawn.top() - kTenth);
      EXPECT_LE(mark.y, drawn.bottom() + kTenth);
    }
    EXPECT_FALSE(drawn.marks().empty());
    EXPECT_LE(drawn.y_ticks().size(), 12U);
  }
}

TEST(Charts, OfUnevenColumnsShowThePairs) {
  EXPECT_EQ(Drawn::points(chart_of({1, 2, 3}, {1, 2})).marks().size(), 2U);
}

// --- Scatter charts ------------------------------------------------------------------------------

struct Label {
  double left;
  double baseline;
  double right;
};

std::vector<Label> labels_of(const Drawn& drawn) {
  static const std::regex kLabel(
      R"re(class="name" x="([\d.]+)" y="([\d.]+)" text-anchor="(\w+)">([^<]*)<)re");
  std::vector<Label> found;
  const std::string& html = drawn.html();
  for (std::sregex_iterator match(html.begin(), html.end(), kLabel), end; match != end; ++match) {
    const double width = 6.5 * static_cast<double>((*match)[4].length());
    const double x = std::stod((*match)[1]);
    const double left = (*match)[3] == "start" ? x
                        : (*match)[3] == "end" ? x - width
                                               : x - width / 2;
    found.push_back({left, std::stod((*match)[2]), left + width});
  }
  return found;
}

TEST(ScatterChart, SetsALabelBesideItsPoint) {
  Chart chart = chart_of({1, 2, 3}, {1, 2, 3});
  chart.series[0].labels = {"", "small & fast", ""};
  const Drawn drawn = Drawn::points(chart);
  ASSERT_EQ(labels_of(drawn).size(), 1U);
  EXPECT_NEAR(labels_of(drawn)[0].left, drawn.marks()[1].x + 8, kTenth);
  EXPECT_NEAR(labels_of(drawn)[0].baseline, drawn.marks()[1].y + 4, kTenth);
  EXPECT_NE(drawn.html().find(">small &amp; fast</text>"), std::string::npos);
  EXPECT_NE(drawn.html().find("<title>small &amp; fast: 2; 2</title>"), std::string::npos);
}

TEST(ScatterChart, LabelsOfPointsCloseTogetherDoNotCoverEachOther) {
  Chart chart = chart_of({1.4, 1.45, 3, 3.1, 25, 25.2, 97, 335, 330},
                         {.19, .187, .165, .163, .065, .064, .06, .056, .057});
  chart.log_x = true;
  chart.series[0].labels = {"METER XS",         "METER XXS",        "METER S",
                            "METER S again",    "Depth Anything S", "Depth Anything V2 S",
                            "Depth Anything B", "Depth Anything L", "Depth Anything V2 L"};
  const Drawn drawn = Drawn::points(chart);
  const std::vector<Label> labels = labels_of(drawn);
  ASSERT_EQ(labels.size(), 9U);
  for (std::size_t i = 0; i < labels.size(); ++i) {
    EXPECT_GE(labels[i].left, drawn.left());
    EXPECT_LE(labels[i].right, drawn.right());
    for (std::size_t k = 0; k < i; ++k) {
      const bool beside = labels[i].right < labels[k].left || labels[k].right < labels[i].left;
      EXPECT_TRUE(beside || std::abs(labels[i].baseline - labels[k].baseline) > 11)
          << i << " " << k;
    }
  }
}

TEST(ScatterChart, ALogarithmicAxisGivesEqualFactorsEqualRoom) {
  Chart chart = chart_of({1, 10, 100}, {1, 2, 3});
  chart.log_x = true;
  const Drawn drawn = Drawn::points(chart);
  const std::vector<Point> marks = drawn.marks();
  EXPECT_NEAR(marks[1].x - marks[0].x, marks[2].x - marks[1].x, 2 * kTenth);
  EXPECT_EQ(drawn.x_ticks(), (Texts{"1", "2", "5", "10", "20", "50", "100"}));
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
  EXPECT_FALSE(std::filesystem::exists(path + ".partial"));
}

TEST(HtmlPageFile, OnAFullDiskLeavesTheOldOneAndSaysWhatToDo) {
  const test::TemporaryFolder folder;
  const std::string path = folder.write("report.html", "yesterday's");
  std::filesystem::create_symlink("/dev/full", path + ".partial");  // where the bytes go first
  const Status written = HtmlPage("Training").write(path);
  ASSERT_FALSE(written);
  EXPECT_EQ(written.code(), StatusCode::kIoError);
  EXPECT_EQ(written.sys_errno(), ENOSPC);
  EXPECT_NE(std::string(written.text()).find(path + " could not be written; free space"),
            std::string::npos);
  EXPECT_EQ(content_of(path), "yesterday's");
  EXPECT_FALSE(std::filesystem::is_symlink(path + ".partial"));
}

TEST(HtmlPageFile, InAFolderThatIsNotThereIsAnError) {
  const test::TemporaryFolder folder;
  EXPECT_EQ(HtmlPage("").write(folder.file("none/report.html")).sys_errno(), ENOENT);
}

}  // namespace
}  // namespace lcdm::model
