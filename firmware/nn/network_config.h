// What a model file says about itself: everything the network, sampler and engine are built from.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "firmware/base/status.h"
#include "firmware/vision/depth_frame.h"

namespace lcdm {

enum class EncoderKind : std::uint8_t { kXxs, kXs, kS };
enum class PresetKind : std::uint8_t { kLcdm, kPaper };
enum class StartKind : std::uint8_t { kNoise, kZeros };

const char* to_string(EncoderKind encoder);
const char* to_string(PresetKind preset);
const char* to_string(StartKind start);

// MobileViT's numbers for one of its sizes (NETWORK.md, "Encoder").
struct EncoderTable {
  struct VitStage {
    int channels;
    int dim;
    int depth;
  };
  int ratio;                     // of the inverted residuals
  std::array<int, 2> early;      // output channels of stages 0 and 1
  std::array<VitStage, 3> late;  // stages 2 to 4
  int final_channels;
};
EncoderTable encoder_table(EncoderKind encoder);

// The JSON under `lcdm` in the model file's metadata (NETWORK.md, "The model file").
struct ModelConfig {
  static constexpr int kDiffusionSteps = 150;  // T of the noise schedule
  // Of decoder and condition: as wide as ours. Wider ones could ask for more memory than a board
  // has.
  static constexpr int kMaxChannels = 128;

  EncoderKind encoder = EncoderKind::kXs;
  PresetKind preset = PresetKind::kLcdm;
  std::array<int, 5> decoder_widths = {8, 16, 32, 64, 128};  // d[0], at full size, to d[4]
  int condition_channels = 16;
  std::vector<int> steps = {149, 74};  // t_k, strictly falling; may be fewer or more than two
  StartKind start = StartKind::kNoise;
  std::uint64_t seed = 1;    // of the start's noise
  double variable_mean = 0;  // logit = x * variable_std + variable_mean
  double variable_std = 1;
  ScaleKind scale = ScaleKind::kRelative;
  double canonical_focal = 320;                                  // pixels
  std::vector<std::array<int, 2>> trained_sizes = {{640, 192}};  // width, height; never empty
  std::string licence;
  std::string name;
  std::string card;  // one paragraph: data, steps, metrics
};

// Reads and checks the metadata. kCorrupt: not JSON within our limits. kInvalidInput: a key is
// missing or its value cannot be used; the text names the key. kUnsupported: a version we do not
// know. Unknown keys are ignored.
Result<ModelConfig> parse_model_config(std::string_view json);

}  // namespace lcdm
