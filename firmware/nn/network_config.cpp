#include "firmware/nn/network_config.h"

#include <cmath>
#include <limits>

#include "firmware/base/check.h"
#include "firmware/nn/json.h"

namespace lcdm {
namespace {

constexpr std::size_t kMaxText = 4096;  // of name, licence and card
constexpr std::size_t kMaxSamplerSteps = 16;
constexpr std::size_t kMaxTrainedSizes = 16;
constexpr int kMaxSide = 4096;
constexpr int kMaxTrainedPixels = 1 << 20;  // the file says how large a network the device makes

Status bad_key(const char* key, const char* expected) {
  return Status::error(StatusCode::kInvalidInput,
                       "model metadata: `%s` is missing or not %s: export the model again", key,
                       expected);
}

// The functions below read `key` of `object` into `out`, or say what was expected.

Status read_int(const JsonValue& object, const char* key, int low, int high, int& out) {
  const JsonValue* value = object.find(key);
  const auto whole = value != nullptr ? value->whole() : std::nullopt;
  if (!whole || *whole < static_cast<std::uint64_t>(low) ||
      *whole > static_cast<std::uint64_t>(high)) {
    return bad_key(key, "a whole number in its range");
  }
  out = static_cast<int>(*whole);
  return Status::ok();
}

Status read_double(const JsonValue& object, const char* key, double low, double high, double& out) {
  const JsonValue* value = object.find(key);
  const auto number = value != nullptr ? value->number() : std::nullopt;
  if (!number || !(*number >= low && *number <= high)) {
    return bad_key(key, "a number in its range");
  }
  out = *number;
  return Status::ok();
}

Status read_text(const JsonValue& object, const char* key, std::string& out) {
  const JsonValue* value = object.find(key);
  const auto text = value != nullptr ? value->text() : std::nullopt;
  if (!text || text->size() > kMaxText) return bad_key(key, "a text of at most 4096 bytes");
  out = *text;
  return Status::ok();
}

template <typename Enum, std::size_t N>
Status read_choice(const JsonValue& object, const char* key, const std::array<Enum, N>& choices,
                   const char* expected, Enum& out) {
  const JsonValue* value = object.find(key);
  const auto text = value != nullptr ? value->text() : std::nullopt;
  for (const Enum choice : choices) {
    if (text && *text == to_string(choice)) {
      out = choice;
      return Status::ok();
    }
  }
  return bad_key(key, expected);
}

// An array of whole numbers in [low, high].
Status read_ints(const JsonValue* array, const char* key, int low, int high, std::size_t min_size,
                 std::size_t max_size, std::vector<int>& out) {
  const char* expected = "an array of whole numbers in their range";
  if (array == nullptr || !array->is_array() || array->items().size() < min_size ||
      array->items().size() > max_size) {
    return bad_key(key, expected);
  }
  out.clear();
  for (const JsonValue& item : array->items()) {
    const auto whole = item.whole();
    if (!whole || *whole < static_cast<std::uint64_t>(low) ||
        *whole > static_cast<std::uint64_t>(high)) {
      return bad_key(key, expected);
    }
    out.push_back(static_cast<int>(*whole));
  }
  return Status::ok();
}

Status read_object(const JsonValue& parent, const char* key, const JsonValue*& out) {
  out = parent.find(key);
  if (out == nullptr || !out->is_object()) return bad_key(key, "an object");
  return Status::ok();
}

Status read_architecture(const JsonValue& root, ModelConfig& config) {
  LCDM_RETURN_IF_ERROR(read_choice(root, "encoder",
                                   std::array{EncoderKind::kXxs, EncoderKind::kXs, EncoderKind::kS},
                                   "`xxs`, `xs` or `s`", config.encoder));
  LCDM_RETURN_IF_ERROR(read_choice(root, "preset",
                                   std::array{PresetKind::kLcdm, PresetKind::kPaper},
                                   "`lcdm` or `paper`", config.preset));
  std::vector<int> widths;
  LCDM_RETURN_IF_ERROR(read_ints(root.find("decoder_widths"), "decoder_widths", 1,
                                 ModelConfig::kMaxChannels, config.decoder_widths.size(),
                                 config.decoder_widths.size(), widths));
  for (std::size_t i = 0; i < widths.size(); ++i) config.decoder_widths[i] = widths[i];
  LCDM_RETURN_IF_ERROR(read_int(root, "condition_channels", 4, ModelConfig::kMaxChannels,
                                config.condition_channels));
  if (config.condition_channels % 4 != 0) {
    return bad_key("condition_channels", "a multiple of 4");  // GroupNorm has 4 groups
  }
  return Status::ok();
}

Status read_sampler(const JsonValue& root, ModelConfig& config) {
  const JsonValue* sampler = nullptr;
  LCDM_RETURN_IF_ERROR(read_object(root, "sampler", sampler));
  LCDM_RETURN_IF_ERROR(read_ints(sampler->find("steps"), "sampler.steps", 0,
                                 ModelConfig::kDiffusionSteps - 1, 1, kMaxSamplerSteps,
                                 config.steps));
  for (std::size_t k = 1; k < config.steps.size(); ++k) {
    if (config.steps[k] >= config.steps[k - 1]) {
      return bad_key("sampler.steps", "a strictly falling list");
    }
  }
  LCDM_RETURN_IF_ERROR(read_choice(*sampler, "start",
                                   std::array{StartKind::kNoise, StartKind::kZeros},
                                   "`noise` or `zeros`", config.start));
  const JsonValue* seed = sampler->find("seed");
  if (seed == nullptr || !seed->whole()) return bad_key("sampler.seed", "a whole number");
  config.seed = *seed->whole();
  LCDM_RETURN_IF_ERROR(read_double(*sampler, "variable_mean", -100, 100, config.variable_mean));
  return read_double(*sampler, "variable_std", 1e-6, 100, config.variable_std);
}

Status read_scale(const JsonValue& root, ModelConfig& config) {
  const JsonValue* scale = nullptr;
  LCDM_RETURN_IF_ERROR(read_object(root, "scale", scale));
  LCDM_RETURN_IF_ERROR(read_choice(*scale, "kind",
                                   std::array{ScaleKind::kRelative, ScaleKind::kMetric},
                                   "`relative` or `metric`", config.scale));
  return read_double(*scale, "canonical_focal", 1, 1e5, config.canonical_focal);
}

Status read_trained_sizes(const JsonValue& root, ModelConfig& config) {
  const JsonValue* sizes = root.find("trained_sizes");
  if (sizes == nullptr || !sizes->is_array() || sizes->items().empty() ||
      sizes->items().size() > kMaxTrainedSizes) {
    return bad_key("trained_sizes", "a short array of [width, height], at least one");
  }
  config.trained_sizes.clear();
  for (const JsonValue& item : sizes->items()) {
    std::vector<int> size;
    LCDM_RETURN_IF_ERROR(read_ints(&item, "trained_sizes", 1, kMaxSide, 2, 2, size));
    if (size[0] * size[1] > kMaxTrainedPixels) {
      return bad_key("trained_sizes", "sizes of 1048576 pixels at most");
    }
    config.trained_sizes.push_back({size[0], size[1]});
  }
  return Status::ok();
}

}  // namespace

EncoderTable encoder_table(EncoderKind encoder) {
  switch (encoder) {
    case EncoderKind::kXxs:
      return {2, {16, 24}, {{{48, 64, 2}, {64, 80, 4}, {80, 96, 3}}}, 320};
    case EncoderKind::kXs:
      return {4, {32, 48}, {{{64, 96, 2}, {80, 120, 4}, {96, 144, 3}}}, 384};
    case EncoderKind::kS:
      return {4, {32, 64}, {{{96, 144, 2}, {128, 192, 4}, {160, 240, 3}}}, 640};
  }
  LCDM_CHECK(false);
}

const char* to_string(EncoderKind encoder) {
  switch (encoder) {
    case EncoderKind::kXxs:
      return "xxs";
    case EncoderKind::kXs:
      return "xs";
    case EncoderKind::kS:
      return "s";
  }
  return "unknown";
}

const char* to_string(PresetKind preset) { return preset == PresetKind::kLcdm ? "lcdm" : "paper"; }

const char* to_string(StartKind start) { return start == StartKind::kNoise ? "noise" : "zeros"; }

Result<ModelConfig> parse_model_config(std::string_view json) {
  const Result<JsonValue> root = parse_json(json);
  if (!root) return root.status();
  if (!root->is_object()) return bad_key("lcdm", "an object");
  int version = 0;
  LCDM_RETURN_IF_ERROR(read_int(*root, "version", 0, std::numeric_limits<int>::max(), version));
  if (version != 1) {
    return Status::error(StatusCode::kUnsupported,
                         "model metadata version %d, this program knows 1: update one of the two",
                         version);
  }
  ModelConfig config;
  LCDM_RETURN_IF_ERROR(read_architecture(*root, config));
  LCDM_RETURN_IF_ERROR(read_sampler(*root, config));
  LCDM_RETURN_IF_ERROR(read_scale(*root, config));
  LCDM_RETURN_IF_ERROR(read_trained_sizes(*root, config));
  LCDM_RETURN_IF_ERROR(read_text(*root, "licence", config.licence));
  LCDM_RETURN_IF_ERROR(read_text(*root, "name", config.name));
  LCDM_RETURN_IF_ERROR(read_text(*root, "card", config.card));
  return config;
}

}  // namespace lcdm
