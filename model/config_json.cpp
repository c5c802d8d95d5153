#include "model/config_json.h"

#include <iomanip>
#include <sstream>

#include "firmware/base/printable.h"
#include "model/safetensors.h"

namespace lcdm::model {
namespace {

template <typename T>
std::string array(const T& values) {
  std::string out = "[";
  for (const auto& value : values) out += (out.size() > 1 ? ", " : "") + std::to_string(value);
  return out + "]";
}

Status check_text(const char* key, const std::string& text) {
  if (find_control(text) == std::string::npos) return Status::ok();
  return Status::error(StatusCode::kInvalidInput,
                       "`%s` must be one line of text without control characters", key);
}

}  // namespace

Result<std::string> config_json(const ModelConfig& config) {
  LCDM_RETURN_IF_ERROR(check_text("licence", config.licence));
  LCDM_RETURN_IF_ERROR(check_text("name", config.name));
  LCDM_RETURN_IF_ERROR(check_text("card", config.card));
  std::string sizes = "[";
  for (const auto& size : config.trained_sizes)
    sizes += (sizes.size() > 1 ? ", " : "") + array(size);
  sizes += "]";
  std::ostringstream out;
  out << std::setprecision(17);
  out << R"({"version": 1, "encoder": ")" << to_string(config.encoder) << R"(", "preset": ")"
      << to_string(config.preset) << R"(", "decoder_widths": )" << array(config.decoder_widths)
      << R"(, "condition_channels": )" << config.condition_channels << R"(, "sampler": {"steps": )"
      << array(config.steps) << R"(, "start": ")" << to_string(config.start) << R"(", "seed": )"
      << config.seed << R"(, "variable_mean": )" << config.variable_mean << R"(, "variable_std": )"
      << config.variable_std << R"(}, "scale": {"kind": ")" << to_string(config.scale)
      << R"(", "canonical_focal": )" << config.canonical_focal << R"(}, "trained_sizes": )" << sizes
      << R"(, "licence": )" << json_quoted(config.licence) << R"(, "name": )"
      << json_quoted(config.name) << R"(, "card": )" << json_quoted(config.card) << "}";
  const std::string json = out.str();
  LCDM_RETURN_IF_ERROR(parse_model_config(json).status());
  return json;
}

}  // namespace lcdm::model
