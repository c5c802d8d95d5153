// 3x3 convolutions by F(2, 3) along the rows, against plain sums.
#include <gtest/gtest.h>
#include <vector>

#include "firmware/nn/kernels/conv.h"
#include "firmware/nn/kernels/row_winograd.h"
#include "tests/firmware/convolutions.h"
#include "tests/firmware/image.h"

namespace lcdm::kernels {
namespace {

// The channels after the first `skipped`.
PackedMatrix transformed(const Filter& filter, int skipped, std::vector<float>& store,
                         Precision precision) {
  const int used = filter.channels - skipped;
  store.resize(packed_floats(row_winograd_depth(used), filter.columns, precision, 3));
  return pack_row_winograd(
      used, filter.columns, [&](int c, int n, int tap) { return filter.at(n, skipped + c, tap); },
      filter.bias, store, precision);
}

struct Shape3x3 {
  int height;
  int width;
  int channels;
  int columns;
};

// Calls check(precision, columns) with what each instruction set convolves so.
template <typename Check>
void for_each_row_winograd(Check&& check) {
  int made = 0;
  for_each_isa([&] {
    for (const Precision precision : {Precision::kFloat32, Precision::kBfloat16}) {
      if (support_of(precision) == Support::kNone) continue;
      for (const int columns : {5, 8, 12, 16}) {
        if (!row_winograd_pays(1, 4, columns, precision)) continue;
        SCOPED_TRACE(testing::Message() << to_string(precision) << " to " << columns);
        check(precision, columns);
        ++made;
      }
    }
  });
  EXPECT_GT(made, 0);
}

// Whole numbers, which halves hold exactly and add up exactly, transformed or not.
void check_row_winograd(Random& random, const Shape3x3& shape, Precision precision, Padding padding,
                        bool paired = false) {
  SCOPED_TRACE(testing::Message() << shape.width << " pixels of " << shape.channels);
  Image image = make_image(random, shape.height, shape.width, shape.channels);
  Filter filter(random, shape.columns, shape.channels, 3);
  make_whole(random, image);
  make_whole(random, filter);
  const auto values = to_floats(image.values);
  const Image want = filter.of(image, 1, padding);
  std::vector<float> store;
  std::vector<float> out(want.values.size());
  Conv3x3 conv = conv_of(image, values, padding);
  conv.row_winograd = true;
  conv.weights = transformed(filter, 0, store, precision);
  conv.output = out.data();
  conv.paired = paired;
  convolve_in_two(conv);
  if (paired) return expect_in_pairs(out, want);
  expect_near(out, want, 2e-3);
}

TEST(RowWinogradKernel, ConvolvesAnySizeAndPadding) {
  for_each_row_winograd([](Precision precision, int columns) {
    Random random(21);
    for (const Padding padding : {Padding::kZero, Padding::kReflect}) {
      for (const int channels : {4, 8, 12, 16, 32}) {
        for (const int width : {2, 3, 7, 8, 17, 26}) {
          check_row_winograd(random, {random.whole(2, 5), width, channels, columns}, precision,
                             padding);
        }
      }
    }
    check_row_winograd(random, {1, 1, 8, columns}, precision, Padding::kZero);
  });
}

// As conv1 of the head's condition is stored.
TEST(RowWinogradKernel, StoresPixelsInPairs) {
  for_each_row_winograd([](Precision precision, int columns) {
    if (precision != Precision::kBfloat16 || columns > vector_lanes()) return;
    Random random(24);
    for (const int width : {2, 7, 8, 17, 26}) {
      check_row_winograd(random, {3, width, 16, columns}, precision, Padding::kZero, true);
    }
  });
}

// Random numbers: as exact as plain sums of floats, and of halves where neighbours are alike.
TEST(RowWinogradKernel, IsAsExactAsPlainSums) {
  for_each_row_winograd([](Precision precision, int columns) {
    Random random(22);
    Image image = make_image(random, 4, 18, 16);
    if (precision == Precision::kBfloat16) {
      for (std::size_t i = 0; i < image.values.size(); ++i) {
        image.values[i] = 1 + image.values[i] / 64;
      }
    }
    const Filter filter(random, columns, 16, 3);
    const auto values = to_floats(image.values);
    const Image want = filter.of(image);
    Conv3x3 conv = conv_of(image, values);
    std::vector<float> store;
    std::vector<float> out(want.values.size());
    conv.output = out.data();
    double errors[2] = {};  // squared
    for (const bool by_rows : {false, true}) {
      conv.row_winograd = by_rows;
      conv.weights =
          by_rows ? transformed(filter, 0, store, precision) : filter.narrow(precision, store, 3);
      convolve_in_two(conv);
      for (std::size_t i = 0; i < out.size(); ++i) {
        const double error = static_cast<double>(out[i]) - want.values[i];
        errors[by_rows ? 1 : 0] += error * error;
      }
    }
    EXPECT_GT(errors[0], 0);
    EXPECT_LT(errors[1], 2 * errors[0]);
  });
}

// A row from the convolution before it, and a share that is upsampled after its products.
TEST(RowWinogradKernel, ReadsAChainAndAddsAnUpsampledShare) {
  for_each_row_winograd([](Precision precision, int columns) {
    Random random(23);
    Image low = make_image(random, 3, 9, 8);
    Image second = make_image(random, 6, 18, 4);
    Filter before(random, 12, 4, 3);
    make_whole(random, low);
    make_whole(random, second);
    make_whole(random, before);
    const Image between = before.of(second);
    const Image whole = joined(upsampled(low, Upsampling::kBilinear), between);
    Filter filter(random, columns, whole.channels, 3);
    make_whole(random, filter);
    const auto low_values = to_floats(low.values);
    const auto second_values = to_floats(second.values);
    std::vector<float> stores[3];
    std::vector<float> out(whole.values.size() / static_cast<std::size_t>(whole.channels) *
                           static_cast<std::size_t>(columns));
    ConvChain chain;
    chain.count = 2;
    for (Conv3x3& conv : chain.convs) {
      conv.height = 6;
      conv.width = 18;
    }
    chain.convs[0].inputs[0] = as_input(second, second_values, Upsampling::kNone);
    chain.convs[0].channels = 4;
    chain.convs[0].weights = before.narrow(Precision::kFloat32, stores[0]);
    Conv3x3& last = chain.convs[1];
    last.upsampled = {low_values.data(), 3, 9, 8, taps_of(filter, 8, stores[1])};
    last.channels = 12;
    last.row_winograd = true;
    last.weights = transformed(filter, 8, stores[2], precision);
    last.output = out.data();
    std::vector<float> scratch(conv3x3_scratch(chain));
    conv3x3_rows(chain, 3, 6, scratch.data());
    conv3x3_rows(chain, 0, 3, scratch.data());
    expect_near(out, filter.of(whole), rounding_of_sum(whole, 9 * whole.channels, precision));
  });
}

}  // namespace
}  // namespace lcdm::kernels
