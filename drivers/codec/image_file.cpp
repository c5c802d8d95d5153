// Depth as PNG by libpng, floats as TIFF by hand: the format's plainest form is a page of code.
#include <algorithm>
#include <array>
#include <bit>
#include <cerrno>
#include <csetjmp>
#include <cstdio>
#include <new>
#include <png.h>

#include "drivers/codec/codec.h"
#include "firmware/base/file.h"

namespace lcdm {
namespace {

constexpr std::size_t kMaxPixels = 64U << 20;
constexpr std::size_t kMaxKey = 79;  // PNG's limit

using File = std::unique_ptr<std::FILE, int (*)(std::FILE*)>;

bool holds(std::size_t values, int width, int height, std::size_t channels) {
  return width > 0 && height > 0 &&
         values == static_cast<std::size_t>(width) * static_cast<std::size_t>(height) * channels;
}

Status wrong_size(const char* what, int width, int height) {
  return Status::error(StatusCode::kInvalidInput, "%s: the values are not those of %dx%d", what,
                       width, height);
}

// libpng's pair of structures and how its errors come back. Nothing with a destructor may live in
// the functions that call setjmp.
struct PngJob {
  png_structp png = nullptr;
  png_infop info = nullptr;
  std::jmp_buf failed;
  char message[128] = {};

  static void on_error(png_structp png, png_const_charp message) {
    auto& job = *static_cast<PngJob*>(png_get_error_ptr(png));
    std::snprintf(job.message, sizeof(job.message), "%s", message);
    std::longjmp(job.failed, 1);  // NOLINT(cert-err52-cpp): C code lies between
  }
  static void on_warning(png_structp /*png*/, png_const_charp /*message*/) {}
};

// ---- writing PNG --------------------------------------------------------------------------------

struct PngPicture {
  int width = 0;
  int height = 0;
  int depth = 8;  // bits per channel
  int colour = PNG_COLOR_TYPE_RGB;
  const std::uint8_t* pixels = nullptr;
  std::size_t stride = 0;
};

struct PngWriter : PngJob {
  std::vector<std::byte>* out = nullptr;
  std::vector<png_text> texts;

  ~PngWriter() { png_destroy_write_struct(&png, &info); }
  bool write(const PngPicture& picture);

  static void on_write(png_structp png, png_bytep bytes, std::size_t count) {
    auto& out = *static_cast<std::vector<std::byte>*>(png_get_io_ptr(png));
    const auto* begin = reinterpret_cast<const std::byte*>(bytes);
    try {
      out.insert(out.end(), begin, begin + count);
    } catch (const std::bad_alloc&) {
      png_error(png, "out of memory");
    }
  }
};

bool PngWriter::write(const PngPicture& picture) {
  if (setjmp(failed) != 0) return false;  // NOLINT(cert-err52-cpp): libpng's way
  png_set_write_fn(png, out, on_write, nullptr);
  png_set_IHDR(png, info, static_cast<png_uint_32>(picture.width),
               static_cast<png_uint_32>(picture.height), picture.depth, picture.colour,
               PNG_INTERLACE_NONE, PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
  // Depth is smooth: differences along a row, packed fast, cost half of the time of the default
  // and lose little.
  png_set_filter(png, PNG_FILTER_TYPE_BASE, PNG_FILTER_SUB);
  png_set_compression_level(png, 2);
  if (!texts.empty()) png_set_text(png, info, texts.data(), static_cast<int>(texts.size()));
  png_write_info(png, info);
  if (picture.depth == 16 && std::endian::native == std::endian::little) png_set_swap(png);
  for (int y = 0; y < picture.height; ++y) {
    png_write_row(png, picture.pixels + static_cast<std::size_t>(y) * picture.stride);
  }
  png_write_end(png, info);
  return true;
}

Status encode_png(const PngPicture& picture, std::span<const ImageText> texts,
                  std::vector<std::byte>& out) {
  out.clear();
  PngWriter writer;
  writer.out = &out;
  for (const ImageText& text : texts) {
    if (text.key.empty() || text.key.size() > kMaxKey) {
      return Status::error(StatusCode::kInvalidInput, "png: a text key has 1 to 79 characters");
    }
    png_text entry{};
    entry.compression = PNG_TEXT_COMPRESSION_NONE;
    entry.key = const_cast<char*>(text.key.c_str());  // libpng copies both
    entry.text = const_cast<char*>(text.value.c_str());
    entry.text_length = text.value.size();
    writer.texts.push_back(entry);
  }
  writer.png = png_create_write_struct(PNG_LIBPNG_VER_STRING, static_cast<PngJob*>(&writer),
                                       PngJob::on_error, PngJob::on_warning);
  if (writer.png != nullptr) writer.info = png_create_info_struct(writer.png);
  if (writer.info == nullptr) return Status::error(StatusCode::kOutOfMemory, "png: no memory");
  if (writer.write(picture)) return Status::ok();
  return Status::error(StatusCode::kInvalidInput, "png: %s", writer.message);
}

// ---- reading PNG --------------------------------------------------------------------------------

struct PngReader : PngJob {
  File file{nullptr, &std::fclose};
  DepthImage image;
  bool supported = false;

  ~PngReader() { png_destroy_read_struct(&png, &info, nullptr); }
  bool read_header();
  bool read_rows();

  static void on_read(png_structp png, png_bytep bytes, std::size_t count) {
    auto* file = static_cast<std::FILE*>(png_get_io_ptr(png));
    if (std::fread(bytes, 1, count, file) != count) png_error(png, "the file ends too early");
  }
};

bool PngReader::read_header() {
  if (setjmp(failed) != 0) return false;  // NOLINT(cert-err52-cpp): libpng's way
  png_set_read_fn(png, file.get(), on_read);
  png_set_user_limits(png, 32768, 32768);
  png_read_info(png, info);
  image.width = static_cast<int>(png_get_image_width(png, info));
  image.height = static_cast<int>(png_get_image_height(png, info));
  supported =
      png_get_bit_depth(png, info) == 16 && png_get_color_type(png, info) == PNG_COLOR_TYPE_GRAY;
  return true;
}

bool PngReader::read_rows() {
  if (setjmp(failed) != 0) return false;  // NOLINT(cert-err52-cpp): libpng's way
  if (std::endian::native == std::endian::little) png_set_swap(png);
  const int passes = png_set_interlace_handling(png);
  png_read_update_info(png, info);
  const auto width = static_cast<std::size_t>(image.width);
  for (int pass = 0; pass < passes; ++pass) {
    for (int y = 0; y < image.height; ++y) {
      std::uint16_t* row = image.values.data() + static_cast<std::size_t>(y) * width;
      png_read_row(png, reinterpret_cast<png_bytep>(row), nullptr);
    }
  }
  png_read_end(png, nullptr);
  return true;
}

// ---- TIFF ---------------------------------------------------------------------------------------

// Little-endian numbers appended to a file image.
class TiffBytes {
 public:
  void u16(std::uint32_t v) { append(v, 2); }
  void u32(std::uint32_t v) { append(v, 4); }
  void tag(std::uint32_t id, std::uint32_t type, std::uint32_t count, std::uint32_t value) {
    u16(id);
    u16(type);
    u32(count);
    u32(value);
  }
  std::vector<std::byte> bytes;

 private:
  void append(std::uint32_t v, int count) {
    for (int i = 0; i < count; ++i) bytes.push_back(static_cast<std::byte>(v >> (8 * i)));
  }
};

}  // namespace

Status encode_depth_png(std::span<const std::uint16_t> millimetres, int width, int height,
                        std::span<const ImageText> texts, std::vector<std::byte>& out) {
  if (!holds(millimetres.size(), width, height, 1)) return wrong_size("png", width, height);
  return encode_png({width, height, 16, PNG_COLOR_TYPE_GRAY,
                     reinterpret_cast<const std::uint8_t*>(millimetres.data()),
                     static_cast<std::size_t>(width) * 2},
                    texts, out);
}

Status write_depth_png(const std::string& path, std::span<const std::uint16_t> millimetres,
                       int width, int height, std::span<const ImageText> texts) {
  std::vector<std::byte> bytes;
  LCDM_RETURN_IF_ERROR(encode_depth_png(millimetres, width, height, texts, bytes));
  return write_file(path, bytes);
}

Status write_rgb_png(const std::string& path, std::span<const std::uint8_t> rgb, int width,
                     int height) {
  if (!holds(rgb.size(), width, height, 3)) return wrong_size("png", width, height);
  std::vector<std::byte> bytes;
  LCDM_RETURN_IF_ERROR(encode_png(
      {width, height, 8, PNG_COLOR_TYPE_RGB, rgb.data(), static_cast<std::size_t>(width) * 3}, {},
      bytes));
  return write_file(path, bytes);
}

Result<DepthImage> read_depth_png(const std::string& path) {
  PngReader reader;
  reader.file.reset(std::fopen(path.c_str(), "rbe"));
  if (reader.file == nullptr) return Status::system(errno, "%s: cannot open", path.c_str());
  reader.png = png_create_read_struct(PNG_LIBPNG_VER_STRING, static_cast<PngJob*>(&reader),
                                      PngJob::on_error, PngJob::on_warning);
  if (reader.png != nullptr) reader.info = png_create_info_struct(reader.png);
  if (reader.info == nullptr) return Status::error(StatusCode::kOutOfMemory, "png: no memory");
  if (!reader.read_header()) {
    return Status::error(StatusCode::kCorrupt, "%s: not a PNG file (%s)", path.c_str(),
                         reader.message);
  }
  DepthImage& image = reader.image;
  const std::size_t pixels =
      static_cast<std::size_t>(image.width) * static_cast<std::size_t>(image.height);
  if (!reader.supported || pixels > kMaxPixels) {
    return Status::error(StatusCode::kUnsupported,
                         "%s: depth is 16-bit greyscale of at most 64 megapixels", path.c_str());
  }
  image.values.resize(pixels);
  if (!reader.read_rows()) {
    return Status::error(StatusCode::kCorrupt, "%s: damaged PNG (%s)", path.c_str(),
                         reader.message);
  }
  return std::move(image);
}

Status write_float_tiff(const std::string& path, std::span<const float> values, int width,
                        int height, std::span<const ImageText> texts) {
  if (!holds(values.size(), width, height, 1)) return wrong_size("tiff", width, height);
  std::string description;
  for (const ImageText& text : texts) description += text.key + "=" + text.value + "\n";
  description.resize(std::max<std::size_t>(4, description.size() + 1));  // ends in NUL

  // Header, description, picture, directory.
  constexpr std::uint32_t kShort = 3;
  constexpr std::uint32_t kLong = 4;
  constexpr std::uint32_t kAscii = 2;
  constexpr std::uint32_t kHeader = 8;
  while (description.size() % 4 != 0) description.push_back('\0');
  const auto text_bytes = static_cast<std::uint32_t>(description.size());
  const auto picture_bytes = static_cast<std::uint32_t>(values.size_bytes());
  const std::uint32_t picture_at = kHeader + text_bytes;
  TiffBytes file;
  file.bytes.reserve(picture_at + picture_bytes + 256);
  file.u32(0x002A4949);  // "II", 42
  file.u32(picture_at + picture_bytes);
  const auto text = std::as_bytes(std::span(description));
  file.bytes.insert(file.bytes.end(), text.begin(), text.end());
  for (const float value : values) file.u32(std::bit_cast<std::uint32_t>(value));

  constexpr std::uint32_t kTags = 11;
  file.u16(kTags);
  file.tag(256, kLong, 1, static_cast<std::uint32_t>(width));
  file.tag(257, kLong, 1, static_cast<std::uint32_t>(height));
  file.tag(258, kShort, 1, 32);                                     // bits per sample
  file.tag(259, kShort, 1, 1);                                      // not compressed
  file.tag(262, kShort, 1, 1);                                      // 0 is black
  file.tag(270, kAscii, text_bytes, text_bytes > 4 ? kHeader : 0);  // four bytes lie in the tag
  file.tag(273, kLong, 1, picture_at);
  file.tag(277, kShort, 1, 1);                                  // samples per pixel
  file.tag(278, kLong, 1, static_cast<std::uint32_t>(height));  // one strip
  file.tag(279, kLong, 1, picture_bytes);
  file.tag(339, kShort, 1, 3);  // IEEE floating point
  file.u32(0);                  // no further directory
  return write_file(path, file.bytes);
}

}  // namespace lcdm
