// libjpeg-turbo through its classic interface: unlike the short one, it lets us bring the memory.
#include <algorithm>
#include <array>
#include <csetjmp>
#include <cstdio>  // jpeglib.h needs it first
#include <cstring>

// clang-format off
#include <jpeglib.h>
#include <jerror.h>
// clang-format on

#include "drivers/codec/codec.h"

namespace lcdm {
namespace {

constexpr int kMaxSide = 16384;
constexpr std::size_t kAlignment = 64;

// Memory handed out in order and taken back all at once: libjpeg's pools, without malloc.
class Pool {
 public:
  void reserve(std::size_t bytes) {
    block_.resize(bytes + kAlignment);
    used_ = 0;
  }
  void clear() { used_ = 0; }
  // Null when it does not fit.
  void* take(std::size_t bytes) {
    void* at = block_.data() + used_;
    std::size_t left = block_.size() - used_;
    if (std::align(kAlignment, bytes, at, left) == nullptr) return nullptr;
    used_ = block_.size() - left + bytes;
    return at;
  }

 private:
  std::vector<std::byte> block_;
  std::size_t used_ = 0;
};

// Replaces libjpeg's allocator and its way of failing (which would end the process).
struct Surroundings {
  jpeg_error_mgr errors;  // first: libjpeg hands back a pointer to it
  std::jmp_buf failed;
  char message[JMSG_LENGTH_MAX] = {};
  bool damaged = false;
  std::array<Pool, JPOOL_NUMPOOLS> pools;
  void (*original_free_pool)(j_common_ptr, int) = nullptr;
};

Surroundings& surroundings(j_common_ptr info) {
  return *static_cast<Surroundings*>(info->client_data);
}

[[noreturn]] void on_error(j_common_ptr info) {
  Surroundings& s = surroundings(info);
  info->err->format_message(info, s.message);
  std::longjmp(s.failed, 1);  // NOLINT(cert-err52-cpp): C code lies between
}

// Warnings (level -1) mean damage, except stray bytes between markers, which cameras do write.
void on_message(j_common_ptr info, int level) {
  if (level >= 0 || info->err->msg_code == JWRN_EXTRANEOUS_DATA) return;
  Surroundings& s = surroundings(info);
  if (!s.damaged) info->err->format_message(info, s.message);
  s.damaged = true;
}

void* take(j_common_ptr info, int pool, std::size_t bytes) {
  void* memory = surroundings(info).pools[static_cast<std::size_t>(pool)].take(bytes);
  if (memory == nullptr) ERREXIT1(info, JERR_OUT_OF_MEMORY, 0);
  return memory;
}

JSAMPARRAY take_rows(j_common_ptr info, int pool, JDIMENSION columns, JDIMENSION rows) {
  // SIMD code writes whole vectors past a row's end.
  const std::size_t stride = (columns + 2 * kAlignment - 1) / kAlignment * kAlignment + kAlignment;
  auto* array = static_cast<JSAMPARRAY>(take(info, pool, rows * sizeof(JSAMPROW)));
  auto* samples = static_cast<JSAMPLE*>(take(info, pool, rows * stride));
  for (JDIMENSION row = 0; row < rows; ++row) array[row] = samples + row * stride;
  return array;
}

void free_pool(j_common_ptr info, int pool) {
  Surroundings& s = surroundings(info);
  s.pools[static_cast<std::size_t>(pool)].clear();
  s.original_free_pool(info, pool);
}

// Call before jpeg_create_...: from then on errors come back through `failed`.
jpeg_error_mgr* install_errors(Surroundings& s) {
  jpeg_error_mgr* errors = jpeg_std_error(&s.errors);
  errors->error_exit = on_error;
  errors->emit_message = on_message;
  return errors;
}

// Call after jpeg_create_...: from then on nothing is allocated outside the pools.
void install_memory(Surroundings& s, j_common_ptr info, int width) {
  constexpr std::size_t kTables = 128U << 10;
  constexpr std::size_t kPerColumn = 512;  // rows in flight of every stage, at any sampling
  s.pools[JPOOL_PERMANENT].reserve(kTables);
  s.pools[JPOOL_IMAGE].reserve(kTables + static_cast<std::size_t>(width + 64) * kPerColumn);
  s.original_free_pool = info->mem->free_pool;
  info->mem->alloc_small = take;
  info->mem->alloc_large = take;
  info->mem->alloc_sarray = take_rows;
  info->mem->free_pool = free_pool;
}

bool is_size(int width, int height) {
  return width > 0 && height > 0 && width <= kMaxSide && height <= kMaxSide;
}

// Tables from BT.601 video range to the full range that JPEG (JFIF) uses.
struct FullRange {
  std::array<std::uint8_t, 256> luma;
  std::array<std::uint8_t, 256> chroma;

  constexpr FullRange() : luma{}, chroma{} {
    for (int i = 0; i < 256; ++i) {
      const auto k = static_cast<std::size_t>(i);
      luma[k] = clamped(((i - 16) * 255 * 2 / 219 + 1) / 2);
      const int twice = (i - 128) * 255 * 2 / 224;
      chroma[k] = clamped((twice + (twice < 0 ? -1 : 1)) / 2 + 128);
    }
  }
  static constexpr std::uint8_t clamped(int v) {
    return static_cast<std::uint8_t>(v < 0 ? 0 : v > 255 ? 255 : v);
  }
};

}  // namespace

// ---- encoder ------------------------------------------------------------------------------------

struct JpegEncoder::State {
  jpeg_compress_struct info{};
  Surroundings around;
  jpeg_destination_mgr destination{};
  FrameFormat format;
  int quality = 0;
  // YUV only: one row of blocks, its planes apart, padded to whole blocks.
  static constexpr int kBandRows = 8;
  std::array<std::vector<JSAMPLE>, 3> planes;
  std::array<std::array<JSAMPROW, kBandRows>, 3> rows{};

  // What encode() works on; here so that nothing lives across the jump of an error.
  const std::uint8_t* pixels = nullptr;

  State() {
    info.client_data = &around;
    info.err = install_errors(around);
    jpeg_create_compress(&info);
    destination.init_destination = [](j_compress_ptr) {};
    destination.empty_output_buffer = [](j_compress_ptr full) -> boolean {
      ERREXIT(full, JERR_BUFFER_SIZE);
      return FALSE;
    };
    destination.term_destination = [](j_compress_ptr) {};
    info.dest = &destination;
  }
  ~State() { jpeg_destroy_compress(&info); }
  State(const State&) = delete;
  State& operator=(const State&) = delete;

  bool has_yuv() const { return is_yuv(format.pixel); }
  void make_planes();
  void set_parameters();
  void split_band(int first_row);
  void write_band(int first_row);
  bool compress();
};

void JpegEncoder::State::make_planes() {
  const auto luma = (static_cast<std::size_t>(format.width) + 15) / 16 * 16;
  for (std::size_t plane = 0; plane < 3; ++plane) {
    const std::size_t stride = plane == 0 ? luma : luma / 2;
    planes[plane].assign(stride * kBandRows, 128);
    for (std::size_t row = 0; row < kBandRows; ++row) {
      rows[plane][row] = planes[plane].data() + row * stride;
    }
  }
}

void JpegEncoder::State::set_parameters() {
  info.image_width = static_cast<JDIMENSION>(format.width);
  info.image_height = static_cast<JDIMENSION>(format.height);
  const bool grey = format.pixel == PixelFormat::kGrey;
  info.input_components = grey ? 1 : 3;
  info.in_color_space = has_yuv()                             ? JCS_YCbCr
                        : grey                                ? JCS_GRAYSCALE
                        : format.pixel == PixelFormat::kBgr24 ? JCS_EXT_BGR
                                                              : JCS_EXT_RGB;
  jpeg_set_defaults(&info);
  jpeg_set_quality(&info, quality, TRUE);
  if (has_yuv()) {
    info.raw_data_in = TRUE;
    info.comp_info[0].h_samp_factor = 2;
    info.comp_info[0].v_samp_factor = 1;
  }
}

// Takes 8 rows of YUV apart; rows and columns past the picture repeat its last ones.
void JpegEncoder::State::split_band(int first_row) {
  static constexpr FullRange kFull;
  const int pairs = (format.width + 15) / 16 * 8;
  for (int row = 0; row < kBandRows; ++row) {
    const int y = std::min(first_row + row, format.height - 1);
    const YuvRow line = yuv_row({format, {}, pixels, 0}, y);
    const auto k = static_cast<std::size_t>(row);
    JSAMPLE* luma = rows[0][k];
    for (int pair = 0; pair < pairs; ++pair) {
      const std::ptrdiff_t in = std::min(pair, format.width / 2 - 1);
      *luma++ = kFull.luma[line.luma[2 * in * line.luma_step]];
      *luma++ = kFull.luma[line.luma[(2 * in + 1) * line.luma_step]];
      rows[1][k][pair] = kFull.chroma[line.u[in * line.chroma_step]];
      rows[2][k][pair] = kFull.chroma[line.v[in * line.chroma_step]];
    }
  }
}

void JpegEncoder::State::write_band(int first_row) {
  if (has_yuv()) {
    split_band(first_row);
    std::array<JSAMPARRAY, 3> image{rows[0].data(), rows[1].data(), rows[2].data()};
    jpeg_write_raw_data(&info, image.data(), kBandRows);
    return;
  }
  std::array<JSAMPROW, kBandRows> lines{};
  const int count = std::min(kBandRows, format.height - first_row);
  for (int row = 0; row < count; ++row) {
    // libjpeg only reads through it.
    lines[static_cast<std::size_t>(row)] = const_cast<std::uint8_t*>(
        pixels + static_cast<std::ptrdiff_t>(first_row + row) * format.stride);
  }
  jpeg_write_scanlines(&info, lines.data(), static_cast<JDIMENSION>(count));
}

// False when libjpeg failed; its words are then in around.message.
bool JpegEncoder::State::compress() {
  if (setjmp(around.failed) != 0) {  // NOLINT(cert-err52-cpp): libjpeg's way of reporting errors
    jpeg_abort_compress(&info);
    return false;
  }
  jpeg_start_compress(&info, TRUE);
  while (info.next_scanline < info.image_height) {
    write_band(static_cast<int>(info.next_scanline));
  }
  jpeg_finish_compress(&info);
  return true;
}

JpegEncoder::JpegEncoder() = default;
JpegEncoder::~JpegEncoder() = default;
JpegEncoder::JpegEncoder(JpegEncoder&&) noexcept = default;
JpegEncoder& JpegEncoder::operator=(JpegEncoder&&) noexcept = default;

Status JpegEncoder::prepare(const FrameFormat& format, int quality) {
  if (!is_size(format.width, format.height) || !is_picture(format) || quality < 1 ||
      quality > 100) {
    return Status::error(StatusCode::kInvalidInput, "jpeg: cannot encode %s %dx%d at quality %d",
                         to_string(format.pixel), format.width, format.height, quality);
  }
  state_ = std::make_unique<State>();
  state_->format = format;
  state_->quality = quality;
  install_memory(state_->around, reinterpret_cast<j_common_ptr>(&state_->info), format.width);
  if (state_->has_yuv()) state_->make_planes();
  state_->set_parameters();
  return Status::ok();
}

Result<std::size_t> JpegEncoder::encode(const FrameView& frame, std::span<std::byte> out) noexcept {
  if (state_ == nullptr || frame.format != state_->format || frame.data == nullptr ||
      frame.bytes < picture_bytes(frame.format)) {
    return Status::error(StatusCode::kInvalidInput, "jpeg: not a frame as the encoder expects");
  }
  State& s = *state_;
  s.pixels = frame.data;
  s.destination.next_output_byte = reinterpret_cast<JOCTET*>(out.data());
  s.destination.free_in_buffer = out.size();
  if (out.empty() || !s.compress()) {
    return Status::error(StatusCode::kOutOfMemory, "jpeg: does not fit into %zu bytes", out.size());
  }
  return out.size() - s.destination.free_in_buffer;
}

std::size_t jpeg_capacity(const FrameFormat& format) {
  constexpr std::size_t kTables = 65536;
  return static_cast<std::size_t>(format.width) * static_cast<std::size_t>(format.height) * 2 +
         kTables;
}

Result<std::span<const std::byte>> JpegWriter::encode(const FrameView& frame) {
  if (frame.format != format_) {
    format_ = {};
    LCDM_RETURN_IF_ERROR(encoder_.prepare(frame.format, quality_));
    format_ = frame.format;
    bytes_.resize(jpeg_capacity(format_));
  }
  const Result<std::size_t> bytes = encoder_.encode(frame, bytes_);
  if (!bytes) return bytes.status();
  return std::span<const std::byte>(bytes_).first(*bytes);
}

// ---- decoder ------------------------------------------------------------------------------------

struct JpegDecoder::State {
  jpeg_decompress_struct info{};
  Surroundings around;
  int width = 0;
  int height = 0;
  std::span<const std::uint8_t> jpeg;
  std::uint8_t* rgb = nullptr;

  State() {
    info.client_data = &around;
    info.err = install_errors(around);
    jpeg_create_decompress(&info);
  }
  ~State() { jpeg_destroy_decompress(&info); }
  State(const State&) = delete;
  State& operator=(const State&) = delete;

  // Up to the first scan; the size alone.
  Status read_header();
  Status check_header() const;
  Status decompress();
};

Status JpegDecoder::State::read_header() {
  if (setjmp(around.failed) != 0) {  // NOLINT(cert-err52-cpp): libjpeg's way of reporting errors
    return Status::error(StatusCode::kCorrupt, "jpeg: %s", around.message);
  }
  jpeg_mem_src(&info, jpeg.data(), static_cast<unsigned long>(jpeg.size()));
  jpeg_read_header(&info, TRUE);
  return Status::ok();
}

Status JpegDecoder::State::check_header() const {
  if (info.image_width != static_cast<JDIMENSION>(width) ||
      info.image_height != static_cast<JDIMENSION>(height)) {
    return Status::error(StatusCode::kCorrupt, "jpeg: %ux%u where %dx%d was expected",
                         info.image_width, info.image_height, width, height);
  }
  if (jpeg_has_multiple_scans(const_cast<j_decompress_ptr>(&info)) != 0) {
    return Status::error(StatusCode::kUnsupported, "jpeg: progressive: only baseline is decoded");
  }
  if (info.jpeg_color_space != JCS_GRAYSCALE && info.jpeg_color_space != JCS_YCbCr &&
      info.jpeg_color_space != JCS_RGB) {
    return Status::error(StatusCode::kUnsupported, "jpeg: neither grey nor YCbCr nor RGB");
  }
  return Status::ok();
}

Status JpegDecoder::State::decompress() {
  if (setjmp(around.failed) != 0) {  // NOLINT(cert-err52-cpp): libjpeg's way of reporting errors
    jpeg_abort_decompress(&info);
    return Status::error(StatusCode::kCorrupt, "jpeg: %s", around.message);
  }
  jpeg_mem_src(&info, jpeg.data(), static_cast<unsigned long>(jpeg.size()));
  jpeg_read_header(&info, TRUE);
  if (const Status status = check_header(); !status) {
    jpeg_abort_decompress(&info);
    return status;
  }
  info.out_color_space = JCS_EXT_RGB;
  jpeg_start_decompress(&info);
  while (info.output_scanline < info.output_height) {
    JSAMPROW row = rgb + static_cast<std::size_t>(info.output_scanline) * info.output_width * 3;
    jpeg_read_scanlines(&info, &row, 1);
  }
  jpeg_finish_decompress(&info);
  if (around.damaged) return Status::error(StatusCode::kCorrupt, "jpeg: %s", around.message);
  return Status::ok();
}

JpegDecoder::JpegDecoder() = default;
JpegDecoder::~JpegDecoder() = default;
JpegDecoder::JpegDecoder(JpegDecoder&&) noexcept = default;
JpegDecoder& JpegDecoder::operator=(JpegDecoder&&) noexcept = default;

Status JpegDecoder::prepare(int width, int height) {
  if (!is_size(width, height)) {
    return Status::error(StatusCode::kInvalidInput, "jpeg: cannot decode %dx%d: at most %dx%d",
                         width, height, kMaxSide, kMaxSide);
  }
  state_ = std::make_unique<State>();
  state_->width = width;
  state_->height = height;
  install_memory(state_->around, reinterpret_cast<j_common_ptr>(&state_->info), width);
  return Status::ok();
}

Status JpegDecoder::decode(std::span<const std::uint8_t> jpeg,
                           std::span<std::uint8_t> rgb) noexcept {
  if (state_ == nullptr || rgb.size() != static_cast<std::size_t>(state_->width) *
                                             static_cast<std::size_t>(state_->height) * 3) {
    return Status::error(StatusCode::kInvalidInput, "jpeg: the decoder is not prepared for this");
  }
  if (jpeg.empty()) return Status::error(StatusCode::kCorrupt, "jpeg: no bytes");
  state_->jpeg = jpeg;
  state_->rgb = rgb.data();
  state_->around.damaged = false;
  return state_->decompress();
}

Result<FrameFormat> JpegDecoder::format_of(std::span<const std::uint8_t> jpeg) {
  if (jpeg.empty()) return Status::error(StatusCode::kCorrupt, "jpeg: no bytes");
  State state;
  state.jpeg = jpeg;
  LCDM_RETURN_IF_ERROR(state.read_header());
  return FrameFormat{PixelFormat::kMjpeg, static_cast<int>(state.info.image_width),
                     static_cast<int>(state.info.image_height), 0};
}

}  // namespace lcdm
