// What the readers of published data sets share. Every file is a stranger's: sizes are bounded, and
// errors name the file: kNotFound where it is missing, kCorrupt or kUnsupported for its content.
#pragma once

#include <charconv>
#include <cstddef>
#include <exception>
#include <filesystem>
#include <memory>
#include <new>
#include <opencv2/core.hpp>
#include <optional>
#include <string>
#include <string_view>
#include <system_error>
#include <vector>

#include "firmware/base/status.h"

namespace lcdm::model::dataset {

Result<std::string> read_bytes(const std::filesystem::path& file, std::size_t most_bytes);
// A JPEG or PNG as CV_8UC3, RGB.
Result<cv::Mat> read_rgb(const std::filesystem::path& file);
// A 16-bit PNG as CV_32FC1 metres, of `unit` metres a step.
Result<cv::Mat> read_depth(const std::filesystem::path& file, double unit);

// The names of the files or folders in `folder`, sorted; none where it cannot be listed.
std::vector<std::string> names_in(const std::filesystem::path& folder);
// Whether `text` looks like `pattern`, in which '#' stands for a digit.
bool matches(std::string_view text, std::string_view pattern);

// The parts of `text` between any of `separators`; none is empty.
std::vector<std::string_view> split(std::string_view text, std::string_view separators);
// The number that is the whole of `text`.
template <typename Number>
std::optional<Number> number_of(std::string_view text) {
  Number value{};
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size()) return std::nullopt;
  return value;
}

// `rgb` of at most `max_width` columns, reduced by area.
cv::Mat reduced(const cv::Mat& rgb, int max_width);
// Sparse depth at another size: each pixel keeps the nearest of the points that fall into it, so
// that reducing loses no surface to its background. `depth` itself at its own size.
cv::Mat reduce_sparse(const cv::Mat& depth, cv::Size size);
// CV_32FC1 in which whatever is no distance between 0 and 1 km is 0.
cv::Mat plausible(const cv::Mat& depth);

// A MATLAB file, version 5 to 7.3 (which is HDF5: a library that takes damage it was not told of,
// such as a hostile file, badly; take 7.3 files from their authors only). Neither libmatio nor HDF5
// may be entered by two threads: all files share one lock, so any thread may call.
class MatFile {
 public:
  static Result<std::shared_ptr<const MatFile>> open(const std::filesystem::path& file);
  ~MatFile();
  MatFile(const MatFile&) = delete;
  MatFile& operator=(const MatFile&) = delete;

  // Rows, columns and what follows, of a real numeric array of 2 to 4 dimensions.
  Result<std::vector<int>> shape(const char* variable) const;
  // variable(:, :, third, fourth) (counted from 0) in the variable's own type, [rows][columns]:
  // MATLAB stores columns, OpenCV rows. kInvalidInput: no such plane.
  Result<cv::Mat> plane(const char* variable, int third = 0, int fourth = 0) const;

 private:
  MatFile();

  struct State;
  std::unique_ptr<State> state_;
};

// `body`'s result; what it or a library throws becomes a Status that names `what`.
template <typename Body>
auto guarded(const std::string& what, const Body& body) -> decltype(body()) {
  try {
    return body();
  } catch (const std::bad_alloc&) {
    return Status::error(StatusCode::kOutOfMemory, "%s: not enough memory", what.c_str());
  } catch (const std::exception& error) {
    return Status::error(StatusCode::kCorrupt, "%s: %s", what.c_str(), error.what());
  }
}

}  // namespace lcdm::model::dataset
