// Parameters on their way from the model file to what the kernels read: transposed, packed,
// composed.
#pragma once

#include <functional>
#include <span>
#include <vector>

#include "firmware/base/status.h"
#include "firmware/nn/constant_store.h"
#include "firmware/nn/kernels/head.h"
#include "firmware/nn/kernels/matrix.h"
#include "firmware/nn/kernels/winograd.h"
#include "firmware/nn/model_file.h"
#include "firmware/nn/network.h"

namespace lcdm {

// Borrows the model file, which has passed Network::check_weights, and the constants. Everything
// that writes fails with kOutOfMemory alone.
class WeightStore {
 public:
  WeightStore(const ModelFile& model, ConstantStore& constants, Precision precision)
      : model_(model), constants_(constants), precision_(precision) {}

  // What products of rows of so many numbers, in so many runs, are made in, no narrower than
  // `narrowest`.
  Precision precision_for(int numbers, Precision narrowest = Precision::kInt8, int runs = 1) const;

  // What a head's step of so many channels is made in.
  Precision head_precision(int channels) const;
  // Of an inverted residual's filter beside narrow products: bfloat16 where the processor has it,
  // which needs no range.
  Precision filter_precision() const;

  // A parameter as it is in the file.
  Status store(const Parameter& parameter, const float*& out);
  // The taps of a depthwise filter, [channels, 1, 3, 3], for its precision.
  Status store_taps(const Parameter& parameter, Precision filter, const float*& out);

  // The weight [columns, depth] and, where there is one, the bias of a 1x1 convolution or a linear
  // layer; for products no narrower than `narrowest`.
  Status pack_matrix(const Layer& layer, int depth, kernels::PackedMatrix& out,
                     Precision narrowest = Precision::kInt8);
  // The last out.channels input channels of a 3x3 convolution, with its bias, as is fastest for its
  // shape.
  Status pack3x3(const Layer& layer, Precision precision, kernels::Conv3x3& out);
  // The first `count`, one 1x1 convolution for each tap.
  Status pack_upsampled(const Layer& layer, int count, kernels::PackedMatrix& out);
  // The last conv.channels, transformed, with the bias.
  Status pack_winograd(const Layer& layer, kernels::WinogradConv& out);
  // All weights of a sampler step's hidden layer; composed in double. Its channels are set.
  Status pack_head_step(const Layer& layer, Precision precision, kernels::HeadStep& out);
  // Those of the convolution after it; step.channels and precision are set.
  Status pack_update(const Layer& layer, kernels::HeadUpdate& out);

 private:
  std::vector<float> load(const Parameter& parameter) const;
  // [channels, 1, 3, 3] or [1, channels, 3, 3] becomes [9, channels].
  std::vector<float> load_taps(const Parameter& parameter) const;
  std::vector<float> bias_of(const Layer& layer) const;
  Status store(std::span<const float> values, const float*& out);
  Status pack(int depth, int columns, const std::function<float(int, int)>& weight,
              std::span<const float> bias, Precision precision, kernels::PackedMatrix& out,
              int runs = 1);

  const ModelFile& model_;
  ConstantStore& constants_;
  Precision precision_;
};

}  // namespace lcdm
