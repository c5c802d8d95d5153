#include "model/bfloat16_silu.h"

#include "model/bfloat16_silu_kernel.h"

namespace lcdm::model {
namespace {

// The numbers in the order of memory, which is that of every tensor made by empty_like.
std::span<const std::uint16_t> bits_of(const torch::Tensor& dense) {
  return {static_cast<const std::uint16_t*>(dense.data_ptr()),
          static_cast<std::size_t>(dense.numel())};
}

std::span<std::uint16_t> writable_bits_of(const torch::Tensor& dense) {
  return {static_cast<std::uint16_t*>(dense.data_ptr()), static_cast<std::size_t>(dense.numel())};
}

struct Bfloat16Silu : torch::autograd::Function<Bfloat16Silu> {
  static torch::Tensor forward(torch::autograd::AutogradContext* context,
                               const torch::Tensor& input) {
    const torch::Tensor x = input.is_non_overlapping_and_dense() ? input : input.contiguous();
    context->save_for_backward({x});
    torch::Tensor y = torch::empty_like(x);
    bfloat16_silu(bits_of(x), writable_bits_of(y));
    return y;
  }

  static torch::autograd::variable_list backward(torch::autograd::AutogradContext* context,
                                                 const torch::autograd::variable_list& gradients) {
    const torch::Tensor x = context->get_saved_variables().front();
    torch::Tensor gradient = gradients.front();
    if (gradient.strides() != x.strides() || gradient.scalar_type() != torch::kBFloat16) {
      gradient = torch::empty_like(x).copy_(gradient);
    }
    torch::Tensor change = torch::empty_like(x);
    bfloat16_silu_gradient(bits_of(x), bits_of(gradient), writable_bits_of(change));
    return {change};
  }
};

}  // namespace

torch::Tensor silu_of(const torch::Tensor& x) {
  if (x.is_cpu() && x.scalar_type() == torch::kBFloat16) return Bfloat16Silu::apply(x);
  return torch::silu(x);
}

}  // namespace lcdm::model
