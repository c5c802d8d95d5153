// Where a picture lies in the buffers of libcamera, as its pipeline handlers describe them.
#include <gtest/gtest.h>
#include <unistd.h>
#include <vector>

#include "drivers/libcamera/session.h"

namespace lcdm {
namespace {

using Plane = libcamera::FrameBuffer::Plane;

constexpr FrameFormat kNv12{PixelFormat::kNv12, 64, 48, 80};
constexpr unsigned kRows = 80 * 48;  // bytes of luma
constexpr FrameFormat kRgb{PixelFormat::kRgb24, 64, 48, 192};

// A plane of the file behind `fd`.
Plane plane(const libcamera::SharedFD& fd, unsigned offset, unsigned length) {
  Plane plane;
  plane.fd = fd;
  plane.offset = offset;
  plane.length = length;
  return plane;
}

std::optional<PictureMemory> memory_of(const std::vector<Plane>& planes,
                                       const FrameFormat& format) {
  return picture_memory(planes, format);
}

class LibcameraMemory : public ::testing::Test {
 protected:
  const int open_ = STDERR_FILENO;  // named, so that libcamera duplicates it and takes none away
  const libcamera::SharedFD file_{open_};
  const libcamera::SharedFD other_{open_};
};

TEST_F(LibcameraMemory, APlaneThatFollowsTheRowsIsOnePictureWithThem) {
  const auto whole = memory_of({plane(file_, 0, kRows), plane(file_, kRows, kRows / 2)}, kNv12);
  ASSERT_TRUE(whole);
  EXPECT_EQ(whole->offset, 0U);
  EXPECT_EQ(whole->length, kRows * 3 / 2);
  const auto later =
      memory_of({plane(file_, 4096, kRows), plane(file_, 4096 + kRows, kRows / 2)}, kNv12);
  ASSERT_TRUE(later);
  EXPECT_EQ(later->offset, 4096U);
  EXPECT_EQ(later->length, kRows * 3 / 2);
}

TEST_F(LibcameraMemory, APlaneWithoutAnOffsetFollowsTheOneBefore) {
  EXPECT_TRUE(memory_of(
      {plane(file_, Plane::kInvalidOffset, kRows), plane(file_, Plane::kInvalidOffset, kRows / 2)},
      kNv12));
}

TEST_F(LibcameraMemory, APlaneThatBeginsElsewhereIsNotReadAsIfItFollowed) {
  const unsigned padded = kRows + 80 * 8;  // rows of luma to a multiple of 16, as encoders like it
  EXPECT_FALSE(memory_of({plane(file_, 0, padded), plane(file_, padded, kRows / 2)}, kNv12));
  EXPECT_FALSE(
      memory_of({plane(file_, 0, padded), plane(file_, Plane::kInvalidOffset, kRows / 2)}, kNv12));
  EXPECT_FALSE(memory_of({plane(file_, 0, kRows), plane(file_, 0, kRows / 2)}, kNv12));
}

TEST_F(LibcameraMemory, PlanesOfSeparateFilesAreRefused) {
  EXPECT_FALSE(memory_of({plane(file_, 0, kRows), plane(other_, kRows, kRows / 2)}, kNv12));
}

TEST_F(LibcameraMemory, APackedFormatHasOnePlane) {
  EXPECT_TRUE(memory_of({plane(file_, 0, 192 * 48)}, kRgb));
  EXPECT_FALSE(memory_of({plane(file_, 0, 96 * 48), plane(file_, 96 * 48, 96 * 48)}, kRgb));
  EXPECT_FALSE(memory_of({plane(file_, 0, 0)}, kRgb));
  EXPECT_FALSE(memory_of({}, kRgb));
}

}  // namespace
}  // namespace lcdm
