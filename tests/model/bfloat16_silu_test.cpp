// SiLU of bfloat16 tensors, held to LibTorch's own of the same numbers in double precision.
#include "model/bfloat16_silu.h"

#include <gtest/gtest.h>
#include <limits>

#include "tests/firmware/isa.h"

namespace lcdm::model {
namespace {

// Half a unit of bfloat16's last place, and what the floats before it lose.
constexpr double kRounding = 1.01 / 256;

struct WithGradient {
  torch::Tensor value;
  torch::Tensor gradient;
};

template <typename Function>
WithGradient through(const Function& function, const torch::Tensor& numbers,
                     const torch::Tensor& gradient) {
  const torch::Tensor x = numbers.detach().clone().requires_grad_();
  const torch::Tensor y = function(x);
  y.backward(gradient);
  return {y.detach().to(torch::kFloat64), x.grad().to(torch::kFloat64)};
}

void expect_rounded(const torch::Tensor& actual, const torch::Tensor& expected) {
  const torch::Tensor error = (actual - expected).abs() / (expected.abs() + 1e-30);
  EXPECT_LT(error.max().item<double>(), kRounding) << actual << expected;
}

void expect_silu_now(const torch::Tensor& x, const torch::Tensor& gradient) {
  const WithGradient actual = through(silu_of, x, gradient);
  const WithGradient expected = through([](const torch::Tensor& v) { return torch::silu(v); },
                                        x.to(torch::kFloat64), gradient.to(torch::kFloat64));
  expect_rounded(actual.value, expected.value);
  // Where the derivative passes through zero, what counts is the size of its terms.
  const torch::Tensor allowed =
      expected.gradient.abs() * kRounding + gradient.to(torch::kFloat64).abs() * 1e-6;
  EXPECT_TRUE(((actual.gradient - expected.gradient).abs() <= allowed).all().item<bool>());
}

void expect_silu_of(const torch::Tensor& x, const torch::Tensor& gradient) {
  test::for_each_isa([&] { expect_silu_now(x, gradient); });
}

TEST(Bfloat16Silu, IsTheRoundedOneForEverySizeOfNumber) {
  torch::manual_seed(1);
  const torch::Tensor x = torch::linspace(-80, 80, 20011).to(torch::kBFloat16);
  expect_silu_of(x, torch::randn_like(x));
}

TEST(Bfloat16Silu, OfRowsThatEndWithinAVector) {
  torch::manual_seed(2);
  for (int count = 1; count < 70; ++count) {
    const torch::Tensor x = torch::randn({count}).to(torch::kBFloat16);
    expect_silu_of(x, torch::randn_like(x));
  }
}

// The gradient need not lie in memory as the input does.
TEST(Bfloat16Silu, OfAnyOrderInMemory) {
  torch::manual_seed(3);
  const torch::Tensor plain = torch::randn({2, 5, 3, 7}).to(torch::kBFloat16);
  const torch::Tensor last = plain.contiguous(torch::MemoryFormat::ChannelsLast);
  expect_silu_of(plain, torch::randn_like(last));
  expect_silu_of(last, torch::randn_like(plain));
  expect_silu_of(last.slice(3, 0, 7, 2), torch::randn({2, 5, 3, 4}).to(torch::kBFloat16));
  EXPECT_TRUE(torch::equal(silu_of(plain), silu_of(last)));
}

TEST(Bfloat16Silu, KeepsWhatIsNoNumber) {
  for (const double none :
       {std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity()}) {
    const torch::Tensor x = torch::full({17}, none).to(torch::kBFloat16);
    const WithGradient got = through(silu_of, x, torch::ones_like(x));
    EXPECT_FALSE(got.value.isfinite().any().item<bool>());
    EXPECT_TRUE(got.gradient.isnan().all().item<bool>());
  }
}

TEST(Bfloat16Silu, LeavesFloatsToLibTorch) {
  const torch::Tensor x = torch::randn({9});
  EXPECT_TRUE(torch::equal(silu_of(x), torch::silu(x)));
}

}  // namespace
}  // namespace lcdm::model
