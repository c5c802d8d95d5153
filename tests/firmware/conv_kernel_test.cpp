// 3x3 convolutions, plain, chained and by Winograd's algorithm, against loops one can check by eye.
#include <algorithm>
#include <cmath>
#include <gtest/gtest.h>

#include "firmware/nn/kernels/conv.h"
#include "firmware/nn/kernels/winograd.h"
#include "tests/firmware/convolutions.h"
#include "tests/firmware/image.h"

namespace lcdm::kernels {
namespace {

// The same by Winograd's algorithm.
void check_winograd(const Conv3x3& conv, const Image& whole, const Filter& filter, int skipped) {
  const int used = whole.channels - skipped;
  std::vector<float> panels(winograd_floats(used, filter.columns));
  pack_winograd(
      used, filter.columns, [&](int c, int n, int tap) { return filter.at(n, skipped + c, tap); },
      panels);
  WinogradConv winograd{{}, conv, panels.data()};
  std::vector<float> out(static_cast<std::size_t>(whole.height * whole.width * filter.columns));
  winograd.conv.output = out.data();
  std::vector<float> scratch(winograd_scratch(winograd));
  const int cut = whole.height / 2 / kWinogradTile * kWinogradTile;
  winograd_rows(winograd, cut, whole.height, scratch.data());
  if (cut > 0) winograd_rows(winograd, 0, cut, scratch.data());
  expect_convolved(whole, filter, conv, out);
}

// One or two random inputs through a random filter, in three slices as three workers would.
void check_conv(Random& random, const Image& first, Upsampling upsampling, int second_channels,
                int stride, Padding padding, int columns) {
  const auto first_values = to_floats(first.values);
  Image whole = upsampled(first, upsampling);
  Conv3x3 conv;
  const bool bilinear = upsampling == Upsampling::kBilinear;
  conv.input_count = 0;
  if (!bilinear) conv.inputs[0] = as_input(first, first_values, upsampling);
  if (!bilinear) ++conv.input_count;
  Image second;
  std::vector<float> second_values;
  if (second_channels > 0) {
    second = make_image(random, whole.height, whole.width, second_channels);
    second_values = to_floats(second.values);
    conv.inputs[static_cast<std::size_t>(conv.input_count++)] =
        as_input(second, second_values, Upsampling::kNone);
    whole = joined(whole, second);
  }
  const Filter filter(random, columns, whole.channels, 3);
  const int skipped = bilinear ? first.channels : 0;
  std::vector<float> taps_store;
  if (bilinear) {
    conv.upsampled = {first_values.data(), first.height, first.width, first.channels,
                      taps_of(filter, first.channels, taps_store)};
  }
  std::vector<float> direct_store;
  std::vector<float> out(
      static_cast<std::size_t>(whole.height / stride * (whole.width / stride) * columns));
  conv.height = whole.height;
  conv.width = whole.width;
  conv.channels = whole.channels - skipped;
  conv.stride = stride;
  conv.padding = padding;
  conv.weights = without(filter, skipped, direct_store);
  conv.output = out.data();
  const ConvChain chain = {{conv}, 1};
  std::vector<float> scratch(conv3x3_scratch(chain));
  const int rows = whole.height / stride;
  conv3x3_rows(chain, rows / 2, rows, scratch.data());
  conv3x3_rows(chain, 0, rows / 3, scratch.data());
  conv3x3_rows(chain, rows / 3, rows / 2, scratch.data());
  expect_convolved(whole, filter, conv, out);
  if (stride == 1 && conv.input_count > 0) check_winograd(conv, whole, filter, skipped);
}

TEST(Conv3x3Kernel, ConvolvesAnySizeStrideAndPadding) {
  for_each_isa([] {
    Random random(1);
    for (const Padding padding : {Padding::kZero, Padding::kReflect}) {
      for (const int channels : {1, 3, 8, 20}) {
        for (const int columns : {1, 8, 24, 50}) {
          const Image image = make_image(random, random.whole(2, 9), random.whole(2, 19), channels);
          check_conv(random, image, Upsampling::kNone, 0, 1, padding, columns);
          const Image even =
              make_image(random, 2 * random.whole(1, 5), 2 * random.whole(1, 9), channels);
          check_conv(random, even, Upsampling::kNone, 0, 2, padding, columns);
        }
      }
    }
  });
}

TEST(Conv3x3Kernel, UpsamplesAndConcatenatesWhileReading) {
  for_each_isa([] {
    Random random(2);
    for (const Upsampling how : {Upsampling::kNone, Upsampling::kNearest, Upsampling::kBilinear}) {
      for (const Padding padding : {Padding::kZero, Padding::kReflect}) {
        for (const int second : {0, 5, 16}) {
          const Image image =
              make_image(random, random.whole(2, 5), random.whole(2, 9), random.whole(1, 20));
          if (how == Upsampling::kBilinear && padding == Padding::kReflect) continue;  // no preset
          for (const int columns : {1, 8, 23}) {
            check_conv(random, image, how, second, 1, padding, columns);
          }
        }
      }
    }
  });
}

// Few columns have a tile of their own: 16 windows of three pixels, then 8, 4, 2 and 1.
TEST(Conv3x3Kernel, ConvolvesWideRowsToFewChannels) {
  for_each_isa([] {
    Random random(7);
    for (const int columns : {1, 8, 16}) {
      for (const int width : {15, 16, 17, 31, 48}) {
        check_conv(random, make_image(random, 3, width, 12), Upsampling::kNone, 0, 1,
                   Padding::kZero, columns);
      }
    }
  });
}

// Upsampled, then three convolutions, in slices: the same as one after the other in memory.
TEST(Conv3x3Kernel, ChainsWithoutStoringWhatIsBetween) {
  for_each_isa([] {
    Random random(3);
    const Image image = make_image(random, 4, 7, 8);
    const auto values = to_floats(image.values);
    const Filter filters[3] = {{random, 8, 8, 3}, {random, 16, 8, 3}, {random, 20, 16, 3}};
    std::vector<float> taps_store;
    ConvChain chain;
    chain.count = 3;
    std::vector<float> outputs[3];
    for (std::size_t i = 0; i < 3; ++i) {
      Conv3x3& conv = chain.convs[i];
      conv.height = 8;
      conv.width = 14;
      conv.channels = filters[i].channels;
      conv.weights = filters[i].packed;
      outputs[i].resize(8U * 14U * static_cast<std::size_t>(filters[i].columns));
      conv.output = outputs[i].data();
    }
    Conv3x3& first = chain.convs[0];
    first.upsampled = {values.data(), 4, 7, 8, taps_of(filters[0], 8, taps_store)};
    first.input_count = 0;
    first.channels = 0;
    std::vector<float> scratch(conv3x3_scratch(chain));
    for (const bool kept : {true, false}) {
      if (!kept) chain.convs[0].output = chain.convs[1].output = nullptr;
      std::fill(outputs[2].begin(), outputs[2].end(), 0.0F);
      conv3x3_rows(chain, 3, 8, scratch.data());
      conv3x3_rows(chain, 0, 3, scratch.data());
      Image in = upsampled(image, Upsampling::kBilinear);
      for (std::size_t i = 0; i < 3; ++i) {
        expect_convolved(in, filters[i], chain.convs[i], outputs[i]);
        in = {8, 14, filters[i].columns, {outputs[i].begin(), outputs[i].end()}};
      }
    }
    // The last one by Winograd's algorithm, fed by the first two.
    std::vector<float> panels(winograd_floats(16, 20));
    const auto weight = [&](int c, int n, int tap) { return filters[2].at(n, c, tap); };
    pack_winograd(16, 20, weight, panels);
    WinogradConv winograd{chain, chain.convs[2], panels.data()};
    winograd.before.count = 2;
    const std::vector<float> direct = outputs[2];
    std::fill(outputs[2].begin(), outputs[2].end(), 0.0F);
    std::vector<float> more(winograd_scratch(winograd));
    winograd_rows(winograd, 4, 8, more.data());
    winograd_rows(winograd, 0, 4, more.data());
    for (std::size_t i = 0; i < direct.size(); ++i) ASSERT_NEAR(outputs[2][i], direct[i], 2e-3);
  });
}

// The convolution before it fills one input, an upsampled image the other: each has scratch of its
// own.
TEST(Conv3x3Kernel, WinogradTakesAnUpsampledShareBesideAChain) {
  for_each_isa([] {
    Random random(12);
    const Image low = make_image(random, 16, 7, 8);
    const Image image = make_image(random, 32, 14, 3);
    const Filter first(random, 16, 3, 3);
    const Filter filter(random, 20, 8 + 16, 3);
    const Image whole = joined(upsampled(low, Upsampling::kBilinear), first.of(image));
    const auto low_values = to_floats(low.values);
    const auto values = to_floats(image.values);
    std::vector<float> taps_store;
    std::vector<float> direct_store;
    std::vector<float> panels(winograd_floats(16, 20));
    pack_winograd(
        16, 20, [&](int c, int n, int tap) { return filter.at(n, 8 + c, tap); }, panels);
    std::vector<float> out(std::size_t{32} * 14 * 20);
    WinogradConv winograd;
    winograd.panels = panels.data();
    winograd.before.count = 1;
    Conv3x3& before = winograd.before.convs[0];
    before.inputs[0] = as_input(image, values, Upsampling::kNone);
    before.channels = 3;
    before.weights = first.packed;
    winograd.conv.upsampled = {low_values.data(), 16, 7, 8, taps_of(filter, 8, taps_store)};
    winograd.conv.channels = 16;
    winograd.conv.weights = without(filter, 8, direct_store);
    winograd.conv.output = out.data();
    for (Conv3x3* conv : {&before, &winograd.conv}) {
      conv->height = 32;
      conv->width = 14;
    }
    std::vector<float> scratch(winograd_scratch(winograd));
    winograd_rows(winograd, 28, 32, scratch.data());
    winograd_rows(winograd, 0, 28, scratch.data());  // more than it takes at a time
    expect_near(out, filter.of(whole), 4e-3);
  });
}

// A slice makes rows around its own on the way; another slice may store them at this moment.
TEST(Conv3x3Kernel, ASliceOfAChainStoresItsOwnRowsAlone) {
  for_each_isa([] {
    Random random(7);
    for (const int stride : {1, 2}) {
      const int rows = 6;
      const Image image = make_image(random, stride * rows, 2 * 5, 3);
      const auto values = to_floats(image.values);
      const Filter first(random, 8, 3, 3);
      const Filter second(random, 7, 8, 3);
      const Image between = first.of(image);
      std::vector<float> kept(between.values.size(), kUntouched);
      const int columns = image.width / stride;
      std::vector<float> out(static_cast<std::size_t>(rows * columns * 7), kUntouched);
      ConvChain chain;
      chain.count = 2;
      for (Conv3x3& conv : chain.convs) {
        conv.height = image.height;
        conv.width = image.width;
      }
      chain.convs[0].inputs[0] = as_input(image, values, Upsampling::kNone);
      chain.convs[0].channels = 3;
      chain.convs[0].weights = first.packed;
      chain.convs[0].output = kept.data();
      chain.convs[1].channels = 8;
      chain.convs[1].stride = stride;
      chain.convs[1].weights = second.packed;
      chain.convs[1].output = out.data();
      std::vector<float> scratch(conv3x3_scratch(chain));
      const auto step = static_cast<std::size_t>(stride);
      conv3x3_rows(chain, 2, 4, scratch.data());
      expect_only_rows(kept, static_cast<std::size_t>(image.width) * 8, 2 * step, 4 * step);
      expect_only_rows(out, static_cast<std::size_t>(columns) * 7, 2, 4);
      conv3x3_rows(chain, 4, 6, scratch.data());
      conv3x3_rows(chain, 0, 2, scratch.data());
      expect_convolved(image, first, chain.convs[0], kept);
      expect_near(out, second.of(between, stride), 1e-3);
    }
  });
}

// An upsampled share alone, in up to three slices, each with nothing of another's in its scratch.
void check_every_cut(Random& random, int low_height, int low_width) {
  SCOPED_TRACE(testing::Message() << low_width << "x" << low_height);
  constexpr int kChannels = 8;
  constexpr int kColumns = 20;
  const Image low = make_image(random, low_height, low_width, kChannels);
  const auto values = to_floats(low.values);
  const Filter filter(random, kColumns, kChannels, 3);
  std::vector<float> store;
  Conv3x3 conv;
  conv.upsampled = {values.data(), low_height, low_width, kChannels,
                    taps_of(filter, kChannels, store)};
  conv.input_count = 0;
  conv.height = 2 * low_height;
  conv.width = 2 * low_width;
  conv.weights = filter.packed;
  std::vector<float> out(static_cast<std::size_t>(conv.height * conv.width * kColumns));
  conv.output = out.data();
  const ConvChain chain = {{conv}, 1};
  const auto compute = [&](int begin, int end) {
    std::vector<float> scratch(conv3x3_scratch(chain), std::nanf(""));
    if (begin < end) conv3x3_rows(chain, begin, end, scratch.data());
  };
  compute(0, conv.height);
  expect_convolved(upsampled(low, Upsampling::kBilinear), filter, conv, out);
  const std::vector<float> whole = out;
  for (int first = 0; first <= conv.height; ++first) {
    for (int second = first; second <= conv.height; ++second) {
      compute(second, conv.height);
      compute(first, second);
      compute(0, first);
      ASSERT_EQ(out, whole) << "cut before rows " << first << " and " << second;
    }
  }
}

// Down to one row or column, where all is border; slices may begin at odd rows.
TEST(Conv3x3Kernel, SharesOfSmallImagesAreTheSameWhateverTheSlices) {
  for_each_isa([] {
    Random random(21);
    for (int height = 1; height <= 4; ++height) {
      for (int width = 1; width <= 4; ++width) {
        check_every_cut(random, height, width);
        for (const int columns : {1, 16, 50}) {
          check_conv(random, make_image(random, height, width, 9), Upsampling::kBilinear, 5, 1,
                     Padding::kZero, columns);
        }
      }
    }
  });
}

}  // namespace
}  // namespace lcdm::kernels
