// The encoder of METER (Papa, Russo and Amerini 2023, arXiv 2403.08368), size XXS: MobileViT-XXS
// with ReLU and one transformer layer a stage. Trained on NYU Depth V2 or KITTI, it knows more of
// the world than our packs show.
#pragma once

#include <array>
#include <string>

#include "firmware/base/status.h"
#include "model/pixel_scale.h"
#include "model/torch.h"

namespace lcdm::model {

// Batch norms folded in; its two convolutions in a row without an activation are one.
struct MeterConvolution {
  torch::Tensor weight;  // [out, in, k, k]
  torch::Tensor bias;    // [out]
};

struct MeterInvertedResidual {
  MeterConvolution expand, depthwise, project;
};

struct MeterNorm {
  torch::Tensor weight, bias;  // [dim]
};

struct MeterVitBlock {
  static constexpr std::int64_t kHeads = 4;
  static constexpr std::int64_t kHeadDim = 8;

  MeterConvolution conv_kxk, conv_1x1;
  MeterNorm norm1, norm2;
  torch::Tensor qkv;                   // [dim, 3 * kHeads * kHeadDim]
  torch::Tensor proj, proj_bias;       // [kHeads * kHeadDim, dim], [dim]
  torch::Tensor fc1, fc1_bias;         // [dim, hidden], [hidden]
  torch::Tensor fc2, fc2_bias;         // [hidden, dim], [dim]
  MeterConvolution conv_proj, fusion;  // fusion of (transformed, input)
};

struct MeterFeatures {
  std::array<torch::Tensor, 5> taps;   // where MobileVit has its own, finest (1/2) first
  std::array<torch::Tensor, 3> skips;  // what METER's decoder reads besides the last, 1/4 first
};

struct MeterEncoder {
  // rgb [B, 3, H, W] in [0, 1], sides multiples of 64.
  MeterFeatures forward(const torch::Tensor& rgb) const;

  PixelScale pixels;  // that it was trained with
  MeterConvolution stem;
  std::array<MeterInvertedResidual, 7> residuals;  // 1, 3, 1, 1 and 1 of the stages
  std::array<MeterVitBlock, 3> blocks;
  MeterConvolution final_conv;
};

// From an ONNX file of METER-XXS, exported with operators' names. kInvalidInput: errors as
// read_onnx_weights, or the file holds another network; names the first operator that is missing
// or has another shape.
Result<MeterEncoder> read_meter_encoder(const std::string& path, const PixelScale& pixels);

}  // namespace lcdm::model
