#include "model/html_page.h"

#include <algorithm>
#include <cstdint>
#include <opencv2/imgcodecs.hpp>

#include "firmware/base/file.h"
#include "model/html_text.h"

namespace lcdm::model {
namespace {

// Colours: Okabe and Ito's, told apart by readers who see no red, green or blue; darker on white
// and lighter on black. Text in the charts is drawn on the page's ground, so that lines do not
// cross it.
constexpr const char* kStyle = R"css(
:root { color-scheme: light dark; --ground: #fff; --raised: #f4f6f8; --line: #d8dee4;
  --text: #14191f; --quiet: #5b6774; --s0: #0072b2; --s1: #d55e00; --s2: #009e73; --s3: #b8578f;
  --s4: #c98a00; --s5: var(--text); }
@media screen and (prefers-color-scheme: dark) {
  :root { --ground: #0d1014; --raised: #171c22; --line: #2c343e; --text: #e9edf1; --quiet: #9aa6b3;
    --s0: #4fb0ec; --s1: #ff7f3f; --s2: #2cc295; --s3: #e08fbe; --s4: #f0b440; } }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 1.5rem 1rem 3rem; max-width: 60rem; background: var(--ground);
  color: var(--text); font: 16px/1.5 system-ui, "Segoe UI", Roboto, "DejaVu Sans", sans-serif; }
h1 { font-size: 1.6rem; line-height: 1.25; margin: 0 0 1rem; }
h2 { font-size: 1.2rem; margin: 2.2rem 0 .6rem; padding-top: .8rem;
  border-top: 1px solid var(--line); }
h1, h2, p, figcaption { overflow-wrap: anywhere; }
p { margin: .6rem 0; max-width: 44rem; }
.note { color: var(--quiet); font-size: .875rem; }
.scroll { overflow-x: auto; margin: 1rem 0; }
table { border-collapse: collapse; font-size: .9rem; font-variant-numeric: tabular-nums; }
th, td { padding: .3rem .7rem; text-align: right; white-space: nowrap;
  border-bottom: 1px solid var(--line); }
th { font-weight: 600; }
tbody th { font-weight: 400; }
th:first-child { text-align: left; padding-left: .3rem; }
thead th { border-bottom: 2px solid var(--quiet); vertical-align: bottom; }
tbody tr:hover { background: var(--raised); }
figure { margin: 1.2rem 0; }
figcaption { font-weight: 600; }
.legend { display: flex; flex-wrap: wrap; gap: .1rem 1.1rem; font-size: .875rem; }
.legend span { display: inline-flex; align-items: center; gap: .4rem; }
.legend svg { width: 28px; height: 12px; flex: none; }
.chart .scroll { margin: .2rem 0; }
.chart .scroll svg { display: block; width: 100%; min-width: 28rem; max-width: 44rem; }
svg text { font-size: 13px; fill: var(--text); }
svg .tick, svg .axis { fill: var(--quiet); }
svg .name { font-size: 12px; paint-order: stroke; stroke: var(--ground); stroke-width: 3px; }
.grid, .frame { fill: none; stroke: var(--line); }
.grid { stroke-dasharray: 2 3; }
.leader { stroke: var(--quiet); stroke-width: .8; }
.line { fill: none; stroke: var(--colour); stroke-width: 1.5; stroke-linejoin: round; }
.legend .line { stroke-width: 2.5; }
.again { stroke-dasharray: 6 3; }
.mark { fill: var(--colour); stroke: var(--ground); }
.s0 { --colour: var(--s0); } .s1 { --colour: var(--s1); } .s2 { --colour: var(--s2); }
.s3 { --colour: var(--s3); } .s4 { --colour: var(--s4); } .s5 { --colour: var(--s5); }
.gallery { display: grid; gap: 1rem; margin: 1rem 0;
  grid-template-columns: repeat(auto-fill, minmax(min(100%, 18rem), 1fr)); }
.gallery figure { margin: 0; }
.gallery figcaption { font-weight: 400; font-size: .875rem; color: var(--quiet); }
.gallery img { display: block; width: 100%; height: auto; border-radius: 3px; }
.gallery .wide { grid-column: 1 / -1; }
.gallery .wide img { width: auto; max-width: 100%; }
.gallery .small { image-rendering: pixelated; }
@media print {
  body { max-width: none; padding: 0; font-size: 10pt; }
  .scroll { overflow: visible; }
  .chart .scroll svg { min-width: 0; }
  h2 { break-after: avoid; }
  figure, tr { break-inside: avoid; } }
)css";

std::string base64(const std::vector<std::uint8_t>& bytes) {
  static constexpr char kDigits[] =
      "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string out;
  out.reserve((bytes.size() + 2) / 3 * 4);
  for (std::size_t i = 0; i < bytes.size(); i += 3) {
    const std::size_t n = std::min<std::size_t>(3, bytes.size() - i);
    std::uint32_t group = 0;
    for (std::size_t k = 0; k < 3; ++k) group = group << 8 | (k < n ? bytes[i + k] : 0U);
    for (std::size_t k = 0; k < 4; ++k) {
      out += k <= n ? kDigits[group >> (18 - 6 * k) & 63U] : '=';
    }
  }
  return out;
}

std::string image(const Picture& picture) {
  const cv::Mat& bgr = picture.bgr;
  if (bgr.empty() || (bgr.type() != CV_8UC3 && bgr.type() != CV_8UC1)) return {};
  const bool small = bgr.cols <= 128 && bgr.rows <= 128;  // single pixels are to be seen
  std::vector<std::uint8_t> bytes;
  if (!cv::imencode(small ? ".png" : ".jpg", bgr, bytes, {cv::IMWRITE_JPEG_QUALITY, 88})) return {};
  return std::string("<img") + (small ? " class=\"small\"" : "") + " width=\"" +
         std::to_string(bgr.cols) + "\" height=\"" + std::to_string(bgr.rows) + "\" alt=\"" +
         escaped(picture.caption) + "\" src=\"data:image/" + (small ? "png" : "jpeg") + ";base64," +
         base64(bytes) + "\"/>\n";
}

}  // namespace

HtmlPage::HtmlPage(const std::string& title) : title_(escaped(title)) {}

void HtmlPage::element(const char* opening, const std::string& text, const char* closing) {
  body_ += opening + escaped(text) + closing;
}

void HtmlPage::heading(const std::string& text) { element("<h2>", text, "</h2>\n"); }
void HtmlPage::paragraph(const std::string& text) { element("<p>", text, "</p>\n"); }
void HtmlPage::note(const std::string& text) { element("<p class=\"note\">", text, "</p>\n"); }

void HtmlPage::table(const std::vector<std::string>& header,
                     const std::vector<std::vector<std::string>>& rows) {
  body_ += "<div class=\"scroll\"><table>\n<thead><tr>";
  for (const std::string& cell : header) element("<th scope=\"col\">", cell, "</th>");
  body_ += "</tr></thead>\n<tbody>\n";
  for (const auto& row : rows) {
    body_ += "<tr>";
    for (std::size_t i = 0; i < std::max(header.size(), row.size()); ++i) {
      const std::string cell = i < row.size() ? row[i] : "";
      if (i == 0) {
        element("<th scope=\"row\">", cell, "</th>");
      } else {
        element("<td>", cell, "</td>");
      }
    }
    body_ += "</tr>\n";
  }
  body_ += "</tbody></table></div>\n";
}

void HtmlPage::line_chart(const Chart& chart) { body_ += line_chart_figure(chart); }
void HtmlPage::scatter_chart(const Chart& chart) { body_ += scatter_chart_figure(chart); }

void HtmlPage::gallery(const std::vector<Picture>& pictures) {
  constexpr double kWide = 2.2;  // as one third of a row it would be too flat to see
  body_ += "<div class=\"gallery\">\n";
  for (const Picture& picture : pictures) {
    const bool wide = pictures.size() == 1 || picture.bgr.cols > kWide * picture.bgr.rows;
    body_ += wide ? "<figure class=\"wide\">" : "<figure>";
    body_ += image(picture);
    element("<figcaption>", picture.caption, "</figcaption></figure>\n");
  }
  body_ += "</div>\n";
}

std::string HtmlPage::html() const {
  // The policy makes a reader's program hold the page to its promise.
  return "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\"/>\n"
         "<meta http-equiv=\"Content-Security-Policy\" "
         "content=\"default-src 'none'; img-src data:; style-src 'unsafe-inline'\"/>\n"
         "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"/>\n<title>" +
         title_ + "</title>\n<style>" + kStyle + "</style>\n</head>\n<body>\n<h1>" + title_ +
         "</h1>\n" + body_ + "</body>\n</html>\n";
}

Status HtmlPage::write(const std::string& path) const { return replace_file(path, html()); }

}  // namespace lcdm::model
