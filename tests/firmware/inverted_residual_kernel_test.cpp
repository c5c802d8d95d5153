// The inverted residual in one pass against its three layers.
#include <cmath>
#include <gtest/gtest.h>

#include "firmware/nn/kernels/inverted_residual.h"
#include "tests/firmware/image.h"

namespace lcdm::kernels {
namespace {

double silu(double x) { return x / (1 + std::exp(-x)); }

Image depthwise(const Image& in, int stride, const std::vector<float>& taps,
                const std::vector<float>& bias) {
  Image out{in.height / stride, in.width / stride, in.channels, {}};
  for (int y = 0; y < out.height; ++y) {
    for (int x = 0; x < out.width; ++x) {
      for (int c = 0; c < in.channels; ++c) {
        double sum = static_cast<double>(bias[static_cast<std::size_t>(c)]);
        for (int t = 0; t < 9; ++t) {
          sum += static_cast<double>(taps[static_cast<std::size_t>(t * in.channels + c)]) *
                 in.padded(y * stride + t / 3 - 1, x * stride + t % 3 - 1, c, Padding::kZero);
        }
        out.values.push_back(sum);
      }
    }
  }
  return out;
}

struct Size {
  int channels;
  int hidden;
  int columns;
  int stride;
  int height;
  int width;
};

// What its three layers give one after the other.
struct Layers {
  Image expanded;
  Image filtered;
  Image projected;
};

// The block in one pass against its three layers one after the other, with borders, over several
// strips, and in slices as several workers would.
void check_inverted_residual(Random& random, const Size& size,
                             Precision precision = Precision::kFloat32,
                             Precision filter = Precision::kFloat32) {
  const auto& [channels, hidden, columns, stride, height, width] = size;
  SCOPED_TRACE(testing::Message() << channels << " -> " << hidden << " -> " << columns
                                  << ", stride " << stride << ", " << width << "x" << height << ", "
                                  << to_string(precision) << ", filter " << to_string(filter));
  const bool narrow = precision != Precision::kFloat32;
  Image in = make_image(random, height, width, channels);
  Filter expand(random, hidden, channels, 1);
  auto taps = random.reals(static_cast<std::size_t>(9 * hidden));
  if (filter != Precision::kFloat32) {
    for (float& tap : taps) tap = std::round(tap * 64) / 64;  // exact in halves
  }
  const auto taps_bias = random.reals(static_cast<std::size_t>(hidden));
  Filter project(random, columns, hidden, 1);
  if (narrow) {
    make_whole(random, in);
    make_whole(random, expand);
    make_whole(random, project);
  }
  Layers want = {expand.of(in), {}, {}};
  for (double& v : want.expanded.values) v = silu(v);
  want.filtered = depthwise(want.expanded, stride, taps, taps_bias);
  for (double& v : want.filtered.values) v = silu(v);
  want.projected = project.of(want.filtered);
  const bool residual = stride == 1 && channels == columns;
  for (std::size_t i = 0; residual && i < want.projected.values.size(); ++i) {
    want.projected.values[i] += in.values[i];
  }

  const auto values = to_floats(in.values);
  std::vector<float> out(want.projected.values.size());
  std::vector<float> seen_expanded(want.expanded.values.size(), kUntouched);
  std::vector<float> seen_filtered(want.filtered.values.size(), kUntouched);
  std::vector<float> narrow_expand;
  std::vector<float> narrow_project;
  InvertedResidual block;
  block.input = values.data();
  block.height = height;
  block.width = width;
  block.channels = channels;
  block.hidden = hidden;
  block.stride = stride;
  block.expand = narrow ? expand.narrow(precision, narrow_expand) : expand.packed;
  block.filter = filter;
  const auto packed_taps = pack_filter_taps(taps, filter);
  block.taps = packed_taps.data();
  block.taps_bias = taps_bias.data();
  block.project = narrow ? project.narrow(precision, narrow_project) : project.packed;
  block.residual = residual ? values.data() : nullptr;
  block.output = out.data();
  block.expanded = seen_expanded.data();
  block.filtered = seen_filtered.data();
  std::vector<float> scratch(inverted_residual_scratch(block));
  const int rows = height / stride;
  inverted_residual_rows(block, rows / 2, rows, scratch.data());
  const auto first = static_cast<std::size_t>(rows / 2);
  const auto step = static_cast<std::size_t>(stride);
  const auto pitch = static_cast<std::size_t>(width * hidden);
  expect_only_rows(seen_expanded, pitch, first * step, static_cast<std::size_t>(height));
  expect_only_rows(seen_filtered, pitch / step, first, static_cast<std::size_t>(rows));
  inverted_residual_rows(block, 0, rows / 2, scratch.data());
  // Beside narrow products activations are rough.
  const double rough = filter == Precision::kFloat32 ? 1e-3 : 3e-3;
  expect_near(seen_expanded, want.expanded,
              narrow ? rough * rounding_of_sum(want.expanded, 1, Precision::kInt8) * 255 : 1e-4);
  expect_near(seen_filtered, want.filtered,
              narrow ? rough * rounding_of_sum(want.filtered, 1, Precision::kInt8) * 255 : 1e-4);
  expect_near(out, want.projected,
              narrow ? rounding_of_sum(want.filtered, hidden, precision) : 1e-5 * hidden);
}

TEST(InvertedResidualKernel, IsItsThreeLayersInOnePass) {
  for_each_isa([] {
    Random random(4);
    for (const int stride : {1, 2}) {
      for (const int hidden : {1, 8, 20, 48}) {
        const int height = stride * random.whole(1, 6);
        check_inverted_residual(random,
                                {5, hidden, 5, stride, height, stride * random.whole(1, 12)});
      }
      check_inverted_residual(random, {16, 640, 24, stride, 6, 84});  // several strips
    }
  });
}

TEST(InvertedResidualKernel, IsItsThreeLayersInNarrowNumbers) {
  for_each_narrow([](Precision precision) {
    Random random(5);
    for (const int stride : {1, 2}) {
      check_inverted_residual(random, {8, 20, 8, stride, 6, 10}, precision);
      check_inverted_residual(random, {16, 640, 24, stride, 6, 84}, precision);
    }
  });
}

// Of every width, odd ones included: the last pixel may be alone in its pair.
TEST(InvertedResidualKernel, FiltersPairsOfPixels) {
  for_each_narrow([](Precision precision) {
    if (support_of(Precision::kBfloat16) == Support::kNone) return;
    Random random(6);
    for (int columns = 1; columns <= 17; ++columns) {
      for (const int stride : {1, 2}) {
        check_inverted_residual(random, {8, 20, 8, stride, 2 * stride, columns * stride}, precision,
                                Precision::kBfloat16);
      }
    }
    for (const int stride : {1, 2}) {
      check_inverted_residual(random, {16, 640, 24, stride, 6, 84}, precision,
                              Precision::kBfloat16);
      check_inverted_residual(random, {16, 48, 16, stride, 4, 86}, precision, Precision::kBfloat16);
    }
  });
}

}  // namespace
}  // namespace lcdm::kernels
