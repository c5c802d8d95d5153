#include "tests/support/random_model.h"

#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <string_view>

#include "firmware/nn/noise.h"

namespace lcdm::test {
namespace {

struct Stage {
  int channels;
  int transformer_dim;
  int depth;
};

struct EncoderTable {
  int ratio;
  std::array<int, 2> early;   // stages 0 and 1
  std::array<Stage, 3> late;  // stages 2 to 4
  int final_channels;
};

EncoderTable table_of(EncoderKind encoder) {
  switch (encoder) {
    case EncoderKind::kXxs:
      return {2, {16, 24}, {{{48, 64, 2}, {64, 80, 4}, {80, 96, 3}}}, 320};
    case EncoderKind::kXs:
      return {4, {32, 48}, {{{64, 96, 2}, {80, 120, 4}, {96, 144, 3}}}, 384};
    case EncoderKind::kS:
      break;
  }
  return {4, {32, 64}, {{{96, 144, 2}, {128, 192, 4}, {160, 240, 3}}}, 640};
}

class Builder {
 public:
  explicit Builder(std::uint64_t seed) : seed_(seed) {}

  // Weight [out, in, k, k] with deviation gain / sqrt(fan-in), and a small bias.
  void conv(const std::string& name, int in, int out, int k, double gain, bool bias = true) {
    const double deviation = gain / std::sqrt(static_cast<double>(in) * k * k);
    add(name + ".weight", {out, in, k, k}, 0, deviation);
    if (bias) add(name + ".bias", {out}, 0, 0.1);
  }
  void linear(const std::string& name, int in, int out, double gain) {
    add(name + ".weight", {out, in}, 0, gain / std::sqrt(static_cast<double>(in)));
    add(name + ".bias", {out}, 0, 0.1);
  }
  void norm(const std::string& name, int channels) {
    add(name + ".weight", {channels}, 1, 0.1);
    add(name + ".bias", {channels}, 0, 0.1);
  }
  void add(const std::string& name, std::vector<std::int64_t> shape, double mean,
           double deviation) {
    std::int64_t count = 1;
    for (const std::int64_t extent : shape) count *= extent;
    std::vector<float> values(static_cast<std::size_t>(count));
    fill_gaussian(seed_ * 1000003 + tensors_.size(), values);
    for (float& v : values) v = static_cast<float>(mean + deviation * static_cast<double>(v));
    tensors_.push_back({name, std::move(shape), std::move(values)});
  }
  // The same values under another name.
  void repeat(const std::string& name, const std::string& original) {
    for (std::size_t i = 0; i < tensors_.size(); ++i) {
      if (tensors_[i].name != original) continue;
      RandomTensor copy = tensors_[i];
      copy.name = name;
      tensors_.push_back(std::move(copy));
      return;
    }
  }
  std::vector<RandomTensor> take() { return std::move(tensors_); }

 private:
  std::uint64_t seed_;
  std::vector<RandomTensor> tensors_;
};

constexpr double kSiluGain = 1.6;
constexpr double kEluGain = 1.3;
constexpr double kLinearGain = 0.7;

void mv2(Builder& b, const std::string& name, int in, int out, int ratio) {
  const int hidden = in * ratio;  // all are multiples of 8 already
  b.conv(name + ".conv1_1x1", in, hidden, 1, kSiluGain);
  b.conv(name + ".conv2_kxk", 1, hidden, 3, kSiluGain);
  b.conv(name + ".conv3_1x1", hidden, out, 1, kLinearGain);
}

void mobilevit(Builder& b, const std::string& name, const Stage& s) {
  b.conv(name + ".conv_kxk", s.channels, s.channels, 3, kSiluGain);
  b.conv(name + ".conv_1x1", s.channels, s.transformer_dim, 1, 1, false);
  for (int j = 0; j < s.depth; ++j) {
    const std::string t = name + ".transformer." + std::to_string(j);
    b.norm(t + ".norm1", s.transformer_dim);
    b.linear(t + ".attn.qkv", s.transformer_dim, 3 * s.transformer_dim, 1.2);
    b.linear(t + ".attn.proj", s.transformer_dim, s.transformer_dim, kLinearGain);
    b.norm(t + ".norm2", s.transformer_dim);
    b.linear(t + ".mlp.fc1", s.transformer_dim, 2 * s.transformer_dim, kSiluGain);
    b.linear(t + ".mlp.fc2", 2 * s.transformer_dim, s.transformer_dim, kLinearGain);
  }
  b.norm(name + ".norm", s.transformer_dim);
  b.conv(name + ".conv_proj", s.transformer_dim, s.channels, 1, kSiluGain);
  b.conv(name + ".conv_fusion", 2 * s.channels, s.channels, 3, kSiluGain);
}

// Returns the channels of the five taps, finest first.
std::array<int, 5> encoder(Builder& b, const EncoderTable& table) {
  b.conv("encoder.stem", 3, 16, 3, kSiluGain);
  mv2(b, "encoder.stages.0.0", 16, table.early[0], table.ratio);
  for (int j = 0; j < 3; ++j) {
    mv2(b, "encoder.stages.1." + std::to_string(j), table.early[j == 0 ? 0 : 1], table.early[1],
        table.ratio);
  }
  int channels = table.early[1];
  for (int i = 2; i < 5; ++i) {
    const Stage& s = table.late[static_cast<std::size_t>(i) - 2];
    const std::string stage = "encoder.stages." + std::to_string(i);
    mv2(b, stage + ".0", channels, s.channels, table.ratio);
    mobilevit(b, stage + ".1", s);
    channels = s.channels;
  }
  b.conv("encoder.final_conv", channels, table.final_channels, 1, kSiluGain);
  return {table.early[0], table.early[1], table.late[0].channels, table.late[1].channels,
          table.final_channels};
}

void decoder(Builder& b, const ModelConfig& config, const std::array<int, 5>& taps) {
  int channels = taps[4];
  for (int i = 4; i >= 0; --i) {
    const auto level = static_cast<std::size_t>(i);
    const int width = config.decoder_widths[level];
    const std::string name = "decoder.upconv_" + std::to_string(i);
    b.conv(name + "_0", channels, width, 3, kEluGain);
    b.conv(name + "_1", width + (i > 0 ? taps[level - 1] : 0), width, 3, kEluGain);
    channels = width;
  }
  b.conv("decoder.condition", channels, config.condition_channels, 3, kEluGain);
}

void head(Builder& b, const ModelConfig& config) {
  const int c = config.condition_channels;
  b.add("head.embed.weight", {c, 1, 3, 3}, 0, 1.0 / 3);
  b.conv("head.conv1", c, c, 3, kEluGain, false);
  for (std::size_t k = 0; k < config.steps.size(); ++k) {
    const std::string step = "head.steps." + std::to_string(k);
    b.add(step + ".embed.bias", {c}, 0, 0.3);
    if (config.preset == PresetKind::kPaper && k > 0) {
      b.repeat(step + ".conv1.bias", "head.steps.0.conv1.bias");
    } else {
      b.add(step + ".conv1.bias", {c}, 0, 0.1);
    }
    b.add(step + ".conv1.scale", {c}, 1, config.preset == PresetKind::kPaper ? 0 : 0.2);
  }
  if (config.preset == PresetKind::kPaper) b.norm("head.norm", c);
  b.conv("head.conv2", c, 1, 3, kEluGain);
}

// Round to nearest even; the values here are finite and far below 65504.
std::uint16_t to_half(float value) {
  const auto bits = std::bit_cast<std::uint32_t>(value);
  const auto sign = static_cast<std::uint16_t>((bits >> 16) & 0x8000U);
  const float magnitude = std::fabs(value);
  if (magnitude < 0x1p-14F) {
    return static_cast<std::uint16_t>(sign | std::lrint(magnitude * 0x1p24F));
  }
  const std::uint32_t m = bits & 0x7FFFFFFFU;
  const std::uint32_t rounded = m + 0xFFFU + ((m >> 13) & 1U);
  return static_cast<std::uint16_t>(sign | ((rounded - (112U << 23)) >> 13));
}

std::string quoted(std::string_view text) {
  std::string out = "\"";
  for (const char c : text) {
    if (c == '"' || c == '\\') out += '\\';
    out += c;
  }
  return out + "\"";
}

template <typename T>
std::string joined(const T& values) {
  std::string out = "[";
  for (const auto& value : values) out += (out.size() > 1 ? "," : "") + std::to_string(value);
  return out + "]";
}

}  // namespace

std::vector<RandomTensor> make_random_weights(const ModelConfig& config, std::uint64_t seed) {
  Builder builder(seed);
  decoder(builder, config, encoder(builder, table_of(config.encoder)));
  head(builder, config);
  return builder.take();
}

std::string metadata_json(const ModelConfig& config) {
  std::string sizes = "[";
  for (const auto& size : config.trained_sizes) {
    sizes += (sizes.size() > 1 ? "," : "") + joined(size);
  }
  sizes += "]";
  return std::string("{\"version\":1,\"encoder\":") + quoted(to_string(config.encoder)) +
         ",\"preset\":" + quoted(to_string(config.preset)) +
         ",\"decoder_widths\":" + joined(config.decoder_widths) +
         ",\"condition_channels\":" + std::to_string(config.condition_channels) +
         ",\"sampler\":{\"steps\":" + joined(config.steps) +
         ",\"start\":" + quoted(to_string(config.start)) +
         ",\"seed\":" + std::to_string(config.seed) +
         ",\"variable_mean\":" + std::to_string(config.variable_mean) +
         ",\"variable_std\":" + std::to_string(config.variable_std) +
         "},\"scale\":{\"kind\":" + quoted(to_string(config.scale)) +
         ",\"canonical_focal\":" + std::to_string(config.canonical_focal) +
         "},\"trained_sizes\":" + sizes + ",\"licence\":" + quoted(config.licence) +
         ",\"name\":" + quoted(config.name) + ",\"card\":" + quoted(config.card) + "}";
}

std::vector<std::byte> make_model_image(const std::string& metadata,
                                        const std::vector<RandomTensor>& tensors, WeightType type) {
  const std::size_t width = type == WeightType::kF32 ? 4 : 2;
  std::string header = "{\"__metadata__\":{\"lcdm\":" + quoted(metadata) + "}";
  std::size_t offset = 0;
  for (const RandomTensor& t : tensors) {
    const std::size_t end = offset + t.values.size() * width;
    header += "," + quoted(t.name) + ":{\"dtype\":\"" + (type == WeightType::kF32 ? "F32" : "F16") +
              "\",\"shape\":" + joined(t.shape) + ",\"data_offsets\":[" + std::to_string(offset) +
              "," + std::to_string(end) + "]}";
    offset = end;
  }
  header += "}";
  while (header.size() % 8 != 0) header += ' ';

  std::vector<std::byte> image(8 + header.size() + offset);
  for (std::size_t i = 0; i < 8; ++i) image[i] = static_cast<std::byte>(header.size() >> (8 * i));
  std::memcpy(image.data() + 8, header.data(), header.size());
  std::byte* out = image.data() + 8 + header.size();
  for (const RandomTensor& t : tensors) {
    for (const float value : t.values) {
      if (type == WeightType::kF32) {
        std::memcpy(out, &value, 4);
      } else {
        const std::uint16_t half = to_half(value);
        std::memcpy(out, &half, 2);
      }
      out += width;
    }
  }
  return image;
}

std::vector<std::byte> make_random_model(const ModelConfig& config, std::uint64_t seed,
                                         WeightType type) {
  return make_model_image(metadata_json(config), make_random_weights(config, seed), type);
}

ModelConfig make_config(EncoderKind encoder, PresetKind preset) {
  ModelConfig config;
  config.encoder = encoder;
  config.preset = preset;
  if (preset == PresetKind::kPaper) config.steps = {75, 0};
  config.trained_sizes = {{640, 192}, {384, 288}};
  config.licence = "Apache-2.0";
  config.name = std::string("random-") + to_string(encoder) + "-" + to_string(preset);
  config.card = "random weights for tests";
  return config;
}

}  // namespace lcdm::test
