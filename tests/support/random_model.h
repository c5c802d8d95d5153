// A model file with weights of the real names and shapes and random values: lets every test run the
// whole engine without a trained model.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "firmware/nn/network_config.h"

namespace lcdm::test {

struct RandomTensor {
  std::string name;
  std::vector<std::int64_t> shape;
  std::vector<float> values;
};

enum class WeightType : std::uint8_t { kF32, kF16 };

// Every tensor NETWORK.md asks for, listed here a second time, independently of
// firmware/nn/network. Scaled by fan-in so that activations stay near unit size. A function of its
// arguments alone.
std::vector<RandomTensor> make_random_weights(const ModelConfig& config, std::uint64_t seed);

// The metadata text of `config`.
std::string metadata_json(const ModelConfig& config);

// A safetensors image of the given tensors with `metadata` under the key `lcdm`.
std::vector<std::byte> make_model_image(const std::string& metadata,
                                        const std::vector<RandomTensor>& tensors,
                                        WeightType type = WeightType::kF32);

// The three together: a valid model file image.
std::vector<std::byte> make_random_model(const ModelConfig& config, std::uint64_t seed,
                                         WeightType type = WeightType::kF32);

// The seed of the models behind tests/fixtures/golden.
constexpr std::uint64_t kGoldenSeed = 7;

// A configuration of real shape, ready for the functions above.
ModelConfig make_config(EncoderKind encoder, PresetKind preset);

}  // namespace lcdm::test
