#include "model/dataset_files.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <fstream>
#include <hdf5.h>
#include <map>
#include <matio.h>
#include <mutex>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <system_error>

#include "drivers/codec/codec.h"
#include "drivers/replay/files.h"
#include "firmware/base/folder.h"

namespace lcdm::model::dataset {
namespace {

namespace fs = std::filesystem;

constexpr float kFarthest = 1000;                   // metres
constexpr std::size_t kMostInDimension = 1U << 16;  // of a MATLAB array
constexpr std::size_t kMostInPlane = 1U << 22;      // numbers; published planes have 307,200

Status not_found(const fs::path& file) {
  return Status::error(StatusCode::kNotFound, "%s: no such file", file.c_str());
}

bool is_file(const fs::path& file) {
  std::error_code error;
  return fs::is_regular_file(file, error);
}

// Held around every call of libmatio. HDF5, below it, is told not to print what it meets.
class MatioLock {
 public:
  MatioLock() : guard_(mutex()) { H5Eset_auto2(H5E_DEFAULT, nullptr, nullptr); }

 private:
  static std::mutex& mutex() {
    static std::mutex mutex;
    return mutex;
  }
  std::lock_guard<std::mutex> guard_;
};

struct CloseMat {
  void operator()(mat_t* file) const { Mat_Close(file); }
};
struct FreeVariable {
  void operator()(matvar_t* variable) const { Mat_VarFree(variable); }
};
using Variable = std::unique_ptr<matvar_t, FreeVariable>;

// Whether the elements of a version 5 file (128 bytes, then tags of type and length) end where it
// does: what a file lacks, libmatio leaves out without a word.
bool is_whole(const fs::path& path) {
  std::error_code error;
  const std::uintmax_t size = fs::file_size(path, error);
  std::ifstream file(path, std::ios::binary);
  std::array<unsigned char, 128> header{};
  file.read(reinterpret_cast<char*>(header.data()), header.size());
  const bool little = header[126] == 'I';
  std::uintmax_t at = header.size();
  while (file && !error && at < size) {
    std::array<unsigned char, 8> tag{};
    file.seekg(static_cast<std::streamoff>(at));
    file.read(reinterpret_cast<char*>(tag.data()), tag.size());
    std::uint32_t length = 0;
    for (std::size_t i = 4; i < 8; ++i) length = length << 8 | tag[little ? 11 - i : i];
    at += tag.size() + length;
  }
  return file && !error && at == size;
}

// OpenCV's type for a MATLAB class; -1 where there is none.
int type_of(const matvar_t& variable) {
  switch (variable.class_type) {
    case MAT_C_DOUBLE:
      return CV_64F;
    case MAT_C_SINGLE:
      return CV_32F;
    case MAT_C_UINT8:
      return CV_8U;
    case MAT_C_INT8:
      return CV_8S;
    case MAT_C_UINT16:
      return CV_16U;
    case MAT_C_INT16:
      return CV_16S;
    case MAT_C_INT32:
      return CV_32S;
    default:
      return -1;
  }
}

// What keeps planes of `variable` from being read; null for nothing.
const char* fault_of(const matvar_t& variable) {
  if (type_of(variable) < 0 || variable.isComplex != 0) return "is no array of real numbers";
  if (variable.rank < 2 || variable.rank > 4 || variable.dims == nullptr) {
    return "has not 2 to 4 dimensions";
  }
  for (int i = 0; i < variable.rank; ++i) {
    if (variable.dims[i] < 1 || variable.dims[i] > kMostInDimension) {
      return "is empty or too large to be believed";
    }
  }
  if (variable.dims[0] * variable.dims[1] > kMostInPlane) return "is too large to be believed";
  return nullptr;
}

}  // namespace

Result<std::string> read_bytes(const fs::path& file, std::size_t most_bytes) {
  if (!is_file(file)) return not_found(file);
  std::error_code error;
  const std::uintmax_t size = fs::file_size(file, error);
  if (error) return Status::system(error.value(), "%s: cannot read", file.c_str());
  if (size == 0 || size > most_bytes) {
    return Status::error(StatusCode::kCorrupt, "%s: %s: fetch it again", file.c_str(),
                         size == 0 ? "it is empty" : "it is far larger than such files are");
  }
  std::string bytes(static_cast<std::size_t>(size), '\0');
  std::ifstream stream(file, std::ios::binary);
  if (!stream.read(bytes.data(), static_cast<std::streamsize>(size))) {
    return Status::error(StatusCode::kIoError, "%s: cannot be read", file.c_str());
  }
  return bytes;
}

Result<cv::Mat> read_rgb(const fs::path& file) {
  if (!is_file(file)) return not_found(file);
  const auto bytes = replay::read_image_file(file.string());
  if (!bytes) return bytes.status();
  const bool jpeg = bytes->size() > 2 && (*bytes)[0] == 0xFF && (*bytes)[1] == 0xD8;
  const bool png = bytes->size() > 4 && (*bytes)[0] == 0x89 && (*bytes)[1] == 'P';
  // As the pixels lie: depth and intrinsics know of no turn that a phone noted in the file.
  const int how = cv::IMREAD_COLOR | cv::IMREAD_IGNORE_ORIENTATION;
  const cv::Mat bgr = jpeg || png ? cv::imdecode(*bytes, how) : cv::Mat();
  if (bgr.empty()) {
    return Status::error(StatusCode::kCorrupt, "%s: not a JPEG or PNG that can be decoded",
                         file.c_str());
  }
  cv::Mat rgb;
  cv::cvtColor(bgr, rgb, cv::COLOR_BGR2RGB);
  return rgb;
}

Result<cv::Mat> read_depth(const fs::path& file, double unit) {
  if (!is_file(file)) return not_found(file);
  Result<DepthImage> image = read_depth_png(file.string());
  if (!image) return image.status();
  cv::Mat depth;
  cv::Mat(image->height, image->width, CV_16UC1, image->values.data())
      .convertTo(depth, CV_32F, unit);
  return depth;
}

std::vector<std::string> names_in(const fs::path& folder) {
  const auto paths = list_folder(folder);
  if (!paths) return {};
  std::vector<std::string> names;
  for (const fs::path& path : *paths) names.push_back(path.filename().string());
  return names;
}

bool matches(std::string_view text, std::string_view pattern) {
  return std::equal(text.begin(), text.end(), pattern.begin(), pattern.end(),
                    [](char c, char p) { return p == '#' ? c >= '0' && c <= '9' : c == p; });
}

std::vector<std::string_view> split(std::string_view text, std::string_view separators) {
  std::vector<std::string_view> parts;
  std::size_t at = 0;
  while ((at = text.find_first_not_of(separators, at)) != std::string_view::npos) {
    const std::size_t end = std::min(text.find_first_of(separators, at), text.size());
    parts.push_back(text.substr(at, end - at));
    at = end;
  }
  return parts;
}

cv::Mat reduced(const cv::Mat& rgb, int max_width) {
  if (rgb.cols <= max_width) return rgb;
  const int height = std::max(1, cvRound(static_cast<double>(rgb.rows) * max_width / rgb.cols));
  cv::Mat out;
  cv::resize(rgb, out, {max_width, height}, 0, 0, cv::INTER_AREA);
  return out;
}

cv::Mat reduce_sparse(const cv::Mat& depth, cv::Size size) {
  if (depth.size() == size) return depth;
  // The pixel of the reduced picture in which the centre of a full one lies.
  const auto place = [](int at, int full, int small) {
    return static_cast<int>((at + 0.5) * small / full);
  };
  cv::Mat out = cv::Mat::zeros(size, CV_32F);
  for (int y = 0; y < depth.rows; ++y) {
    auto* row = out.ptr<float>(place(y, depth.rows, size.height));
    for (int x = 0; x < depth.cols; ++x) {
      const float value = depth.at<float>(y, x);
      float& nearest = row[place(x, depth.cols, size.width)];
      if (value > 0 && (nearest <= 0 || value < nearest)) nearest = value;
    }
  }
  return out;
}

cv::Mat plausible(const cv::Mat& depth) {
  cv::Mat metres;
  depth.convertTo(metres, CV_32F);
  cv::Mat out = cv::Mat::zeros(metres.size(), CV_32F);
  metres.copyTo(out, (metres > 0) & (metres < kFarthest));  // false for NaN
  return out;
}

// ---- MATLAB -------------------------------------------------------------------------------------

struct MatFile::State {
  std::string path;
  std::unique_ptr<mat_t, CloseMat> file;
  std::map<std::string, Variable> variables;  // headers, read once

  // Under the lock. The variable's header, checked.
  Result<matvar_t*> find(const char* name);
};

Result<matvar_t*> MatFile::State::find(const char* name) {
  auto found = variables.find(name);
  if (found == variables.end()) {
    Variable variable(Mat_VarReadInfo(file.get(), name));
    if (variable == nullptr) {
      return Status::error(StatusCode::kCorrupt, "%s: no variable \"%s\": is this the right file?",
                           path.c_str(), name);
    }
    found = variables.emplace(name, std::move(variable)).first;
  }
  if (const char* fault = fault_of(*found->second)) {
    return Status::error(StatusCode::kCorrupt, "%s: \"%s\" %s", path.c_str(), name, fault);
  }
  return found->second.get();
}

MatFile::MatFile() : state_(std::make_unique<State>()) {}

MatFile::~MatFile() {
  const MatioLock lock;
  state_.reset();
}

Result<std::shared_ptr<const MatFile>> MatFile::open(const fs::path& file) {
  if (!is_file(file)) return not_found(file);
  std::shared_ptr<MatFile> opened(new MatFile);  // its constructor is private
  const MatioLock lock;
  State& state = *opened->state_;
  state.path = file.string();
  state.file.reset(Mat_Open(file.c_str(), MAT_ACC_RDONLY));
  const mat_ft version =
      state.file == nullptr ? MAT_FT_UNDEFINED : Mat_GetVersion(state.file.get());
  if (version == MAT_FT_MAT73 || (version == MAT_FT_MAT5 && is_whole(file))) {
    return std::shared_ptr<const MatFile>(std::move(opened));
  }
  state.file.reset();
  return Status::error(StatusCode::kCorrupt,
                       "%s: cut short, or no MATLAB file of version 5 to 7.3: fetch it again",
                       file.c_str());
}

Result<std::vector<int>> MatFile::shape(const char* variable) const {
  const MatioLock lock;
  const Result<matvar_t*> header = state_->find(variable);
  if (!header) return header.status();
  std::vector<int> shape;
  for (int i = 0; i < (*header)->rank; ++i) shape.push_back(static_cast<int>((*header)->dims[i]));
  return shape;
}

Result<cv::Mat> MatFile::plane(const char* variable, int third, int fourth) const {
  const MatioLock lock;
  const Result<matvar_t*> header = state_->find(variable);
  if (!header) return header.status();
  matvar_t& info = **header;
  const int rows = static_cast<int>(info.dims[0]);
  const int columns = static_cast<int>(info.dims[1]);
  std::array<int, 4> start = {0, 0, third, fourth};
  std::array<int, 4> stride = {1, 1, 1, 1};
  std::array<int, 4> edge = {rows, columns, 1, 1};
  for (std::size_t i = 2; i < 4; ++i) {
    const int count = static_cast<int>(i) < info.rank ? static_cast<int>(info.dims[i]) : 1;
    if (start[i] < 0 || start[i] >= count) {
      return Status::error(StatusCode::kInvalidInput, "%s: \"%s\" has no plane %d, %d",
                           state_->path.c_str(), variable, third, fourth);
    }
  }
  cv::Mat by_columns = cv::Mat::zeros(columns, rows, type_of(info));
  if (Mat_VarReadData(state_->file.get(), &info, by_columns.data, start.data(), stride.data(),
                      edge.data()) != 0) {
    return Status::error(StatusCode::kCorrupt, "%s: \"%s\" cannot be read: fetch the file again",
                         state_->path.c_str(), variable);
  }
  cv::Mat out;
  cv::transpose(by_columns, out);
  return out;
}

}  // namespace lcdm::model::dataset
