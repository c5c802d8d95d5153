// 3x3 convolutions of narrow numbers, plain and chained, against loops one can check by eye.
#include <gtest/gtest.h>

#include "firmware/nn/kernels/conv.h"
#include "tests/firmware/convolutions.h"
#include "tests/firmware/image.h"

namespace lcdm::kernels {
namespace {

struct WholeConv {
  Image image;
  Filter filter;

  WholeConv(Random& random, int height, int width, int channels, int columns)
      : image(make_image(random, height, width, channels)), filter(random, columns, channels, 3) {
    make_whole(random, image);
    make_whole(random, filter);
  }
};

void check_narrow_conv(const WholeConv& whole, Precision precision, int stride, Padding padding,
                       bool paired = false) {
  SCOPED_TRACE(testing::Message() << to_string(precision) << ", stride " << stride);
  const Image& image = whole.image;
  const Filter& filter = whole.filter;
  const auto values = to_floats(image.values);
  const Image want = filter.of(image, stride, padding);
  std::vector<float> store;
  std::vector<float> out(want.values.size());
  Conv3x3 conv = conv_of(image, values, padding);
  conv.stride = stride;
  conv.weights = filter.narrow(precision, store, 3);
  conv.output = out.data();
  conv.paired = paired;
  convolve_in_two(conv);
  if (paired) return expect_in_pairs(out, want);
  expect_near(out, want, 2e-3);
}

TEST(NarrowConv3x3Kernel, ConvolvesAnySizeStrideAndPadding) {
  for_each_narrow([](Precision precision) {
    Random random(8);
    for (const Padding padding : {Padding::kZero, Padding::kReflect}) {
      for (const int channels : {4, 8, 20, 36}) {
        for (const int columns : {1, 8, 23, 50}) {
          const WholeConv odd(random, random.whole(2, 9), random.whole(2, 19), channels, columns);
          check_narrow_conv(odd, precision, 1, padding);
          const WholeConv even(random, 2 * random.whole(1, 5), 2 * random.whole(1, 9), channels,
                               columns);
          check_narrow_conv(even, precision, 2, padding);
        }
      }
    }
  });
}

// As conv1 of the head's condition is stored; an odd last pixel has no other.
TEST(NarrowConv3x3Kernel, StoresPixelsInPairs) {
  for_each_isa([] {
    if (support_of(Precision::kBfloat16) == Support::kNone) return;
    Random random(12);
    for (const int width : {1, 2, 16, 19, 37}) {
      check_narrow_conv(WholeConv(random, 4, width, 16, vector_lanes()), Precision::kBfloat16, 1,
                        Padding::kZero, true);
    }
  });
}

// Few columns have a tile of their own: 16 windows of three pixels, then 8, 4, 2 and 1.
TEST(NarrowConv3x3Kernel, ConvolvesWideRowsToFewChannels) {
  for_each_narrow([](Precision precision) {
    Random random(7);
    for (const int columns : {1, 8, 16}) {
      for (const int width : {15, 16, 17, 31, 48}) {
        check_narrow_conv(WholeConv(random, 3, width, 12, columns), precision, 1, Padding::kZero);
      }
    }
  });
}

// 18 pixels: a tile of sixteen windows, and what is left.
TEST(NarrowConv3x3Kernel, AddsAnUpsampledShare) {
  for_each_narrow([](Precision precision) {
    Random random(10);
    for (const int columns : {8, 16, 23}) {
      Image low = make_image(random, 4, 9, 20);
      Image second = make_image(random, 8, 18, 12);
      make_whole(random, low);
      make_whole(random, second);
      const Image whole = joined(upsampled(low, Upsampling::kBilinear), second);
      Filter filter(random, columns, whole.channels, 3);
      make_whole(random, filter);
      const auto low_values = to_floats(low.values);
      const auto second_values = to_floats(second.values);
      std::vector<float> taps_store;
      std::vector<float> store;
      std::vector<float> out(static_cast<std::size_t>(8 * 18 * columns));
      Conv3x3 conv;
      conv.upsampled = {low_values.data(), 4, 9, 20, taps_of(filter, 20, taps_store, precision)};
      conv.inputs[0] = as_input(second, second_values, Upsampling::kNone);
      conv.height = 8;
      conv.width = 18;
      conv.channels = 12;
      conv.weights = without(filter, 20, store, precision);
      conv.output = out.data();
      const ConvChain chain = {{conv}, 1};
      std::vector<float> scratch(conv3x3_scratch(chain));
      conv3x3_rows(chain, 3, 8, scratch.data());
      conv3x3_rows(chain, 0, 3, scratch.data());
      expect_near(out, filter.of(whole), 5e-3);
    }
  });
}

TEST(NarrowConv3x3Kernel, Chains) {
  for_each_narrow([](Precision precision) {
    Random random(11);
    const WholeConv first(random, 9, 13, 8, 12);
    Filter second(random, 20, 12, 3);
    make_whole(random, second);
    const Image between = first.filter.of(first.image);
    const auto values = to_floats(first.image.values);
    std::vector<float> stores[2];
    std::vector<float> out(std::size_t{9} * 13 * 20);
    ConvChain chain;
    chain.count = 2;
    for (Conv3x3& conv : chain.convs) {
      conv.height = 9;
      conv.width = 13;
    }
    chain.convs[0].inputs[0] = as_input(first.image, values, Upsampling::kNone);
    chain.convs[0].channels = 8;
    chain.convs[0].weights = first.filter.narrow(precision, stores[0], 3);
    chain.convs[1].channels = 12;
    chain.convs[1].weights = second.narrow(precision, stores[1], 3);
    chain.convs[1].output = out.data();
    std::vector<float> scratch(conv3x3_scratch(chain));
    conv3x3_rows(chain, 4, 9, scratch.data());
    conv3x3_rows(chain, 0, 4, scratch.data());
    expect_near(out, second.of(between), rounding_of_sum(between, 9 * 12, precision));
  });
}

}  // namespace
}  // namespace lcdm::kernels
