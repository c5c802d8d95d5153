#include "app/config.h"

#include <algorithm>
#include <cctype>
#include <charconv>
#include <cmath>
#include <optional>
#include <unistd.h>

#include "app/address.h"
#include "app/source.h"
#include "app/toml_file.h"
#include "firmware/nn/network.h"

namespace lcdm {
namespace {

const char* source_objection(const std::string& text) {
  static const std::string kObjection = std::string("is no source: use auto, ") + kSourceForms;
  return text == "auto" || is_source_uri(text) ? nullptr : kObjection.c_str();
}

const char* format_objection(const std::string& text) {
  return text.empty() || parse_pixel_format(text)
             ? nullptr
             : "is no format we read: use YUYV, UYVY, NV12, NV21, RGB24, BGR24, GREY or MJPEG, or "
               "leave it empty";
}

const char* precision_objection(const std::string& text) {
  return parse_precision(text) ? nullptr : "is no precision: use fp32, fp16, bf16 or int8";
}

const char* addresses_objection(const std::string& text) {
  const std::vector<std::string> addresses = listen_addresses(text);
  if (!addresses.empty() && std::all_of(addresses.begin(), addresses.end(), is_numeric_address)) {
    return nullptr;
  }
  return "is no numeric address: use 127.0.0.1 (this machine only), 0.0.0.0 (everybody), or "
         "several with commas between";
}

const char* line_objection(const std::string& text) {
  return text == "!" ? "names no line: write its name behind the !, or nothing at all" : nullptr;
}

const char* directory_objection(const std::string& text) {
  return text.empty() ? "is no folder: name one, such as recordings" : nullptr;
}

std::string name_of(const ConfigField& field) {
  return std::string(field.section) + "." + field.key;
}

std::string plain(double number) {
  char text[32];
  std::snprintf(text, sizeof(text), "%g", number);
  return text;
}

// The one way in for every value, whatever it came from.
Status assign(const ConfigField& field, const std::string& place, const std::string& text) {
  if (auto* const* string = std::get_if<std::string*>(&field.place)) {
    if (std::any_of(text.begin(), text.end(),
                    [](char c) { return static_cast<unsigned char>(c) < 0x20; })) {
      return config_error(place, name_of(field) + " holds a control character: take it out");
    }
    const char* objection = field.objection == nullptr ? nullptr : field.objection(text);
    if (objection != nullptr)
      return config_error(place, name_of(field) + " = \"" + text + "\" " + objection);
    **string = text;
    return Status::ok();
  }
  if (auto* const* flag = std::get_if<bool*>(&field.place)) {
    if (text != "true" && text != "false") {
      return config_error(place,
                          name_of(field) + " = " + text + " is not allowed: use true or false");
    }
    **flag = text == "true";
    return Status::ok();
  }
  double number = 0;
  const char* end = text.data() + text.size();
  const auto parsed = std::from_chars(text.data(), end, number);
  const bool whole = std::holds_alternative<int*>(field.place);
  const bool is_number = parsed.ec == std::errc() && parsed.ptr == end && std::isfinite(number) &&
                         (!whole || number == std::floor(number));
  if (!is_number || number < field.min || number > field.max) {
    return config_error(place, name_of(field) + " = " + text + " is not allowed: use a " +
                                   (whole ? "whole number" : "number") + " from " +
                                   plain(field.min) + " to " + plain(field.max));
  }
  if (auto* const* integer = std::get_if<int*>(&field.place)) **integer = static_cast<int>(number);
  if (auto* const* real = std::get_if<double*>(&field.place)) **real = number;
  return Status::ok();
}

std::string known_keys(const std::vector<ConfigField>& fields, const std::string& section) {
  std::string text;
  for (const ConfigField& field : fields) {
    if (field.section == section) text += (text.empty() ? "" : ", ") + std::string(field.key);
  }
  return text;
}

std::string known_sections(const std::vector<ConfigField>& fields) {
  std::string text;
  std::string last;
  for (const ConfigField& field : fields) {
    if (field.section == last) continue;
    last = field.section;
    text += (text.empty() ? "" : ", ") + last;
  }
  return text;
}

Result<const ConfigField*> find(const std::vector<ConfigField>& fields, const std::string& place,
                                const std::string& section, const std::string& key) {
  for (const ConfigField& field : fields) {
    if (field.section == section && field.key == key) return &field;
  }
  const std::string keys = known_keys(fields, section);
  if (keys.empty()) {
    return config_error(place, "no section [" + section + "]: there are " + known_sections(fields));
  }
  return config_error(place, "no key " + section + "." + key + ": [" + section + "] has " + keys);
}

// The value as text for assign(); empty when its type does not fit the field.
std::optional<std::string> text_of(const ConfigField& field, const toml::value& value) {
  const bool wants_string = std::holds_alternative<std::string*>(field.place);
  if (wants_string && value.is_string()) return value.as_string().str;
  if (wants_string) return std::nullopt;
  const bool wants_flag = std::holds_alternative<bool*>(field.place);
  if (wants_flag != value.is_boolean()) return std::nullopt;
  if (wants_flag) return value.as_boolean() ? "true" : "false";
  if (value.is_integer()) return std::to_string(value.as_integer());
  if (!value.is_floating()) return std::nullopt;
  char text[64];
  std::snprintf(text, sizeof(text), "%.17g", value.as_floating());
  return text;
}

const char* kind_of(const ConfigField& field) {
  if (std::holds_alternative<std::string*>(field.place)) return "a text in quotes";
  if (std::holds_alternative<bool*>(field.place)) return "true or false";
  return "a number without quotes";
}

Status read_section(const std::vector<ConfigField>& fields, const std::string& file,
                    const std::string& section, const toml::value& table) {
  if (!table.is_table()) {
    return config_error(
        place_of(file, table.location()),
        "key " + section + " outside a section: there are " + known_sections(fields));
  }
  if (known_keys(fields, section).empty()) {
    return find(fields, place_of(file, table.location()), section, "").status();
  }
  for (const auto& [key, value] : table.as_table()) {
    const std::string place = place_of(file, value.location());
    const auto field = find(fields, place, section, key);
    if (!field) return field.status();
    const std::optional<std::string> text = text_of(**field, value);
    if (!text) {
      return config_error(place, name_of(**field) + " must be " + kind_of(**field));
    }
    LCDM_RETURN_IF_ERROR(assign(**field, place, *text));
  }
  return Status::ok();
}

Status read_file(const std::vector<ConfigField>& fields, const std::string& file) {
  return read_toml(file, "configuration", [&](const toml::value& root) {
    for (const auto& [section, table] : root.as_table()) {
      LCDM_RETURN_IF_ERROR(read_section(fields, file, section, table));
    }
    return Status::ok();
  });
}

std::string upper(std::string text) {
  std::transform(text.begin(), text.end(), text.begin(),
                 [](unsigned char c) { return static_cast<char>(std::toupper(c)); });
  return text;
}

// LCDM_CAMERA_WIDTH=320. Names that belong to no section of ours are none of our business.
Status read_variable(const std::vector<ConfigField>& fields, const std::string& variable) {
  const std::string name = variable.substr(0, variable.find('='));
  if (name.size() == variable.size()) return Status::ok();
  const std::string value = variable.substr(name.size() + 1);
  for (const ConfigField& field : fields) {
    if (name == "LCDM_" + upper(field.section) + "_" + upper(field.key)) {
      return assign(field, name, value);
    }
  }
  for (const ConfigField& field : fields) {
    if (name.rfind("LCDM_" + upper(field.section) + "_", 0) == 0) {
      return config_error(name, std::string("no such key: [") + field.section + "] has " +
                                    known_keys(fields, field.section));
    }
  }
  return Status::ok();
}

Status read_assignment(const std::vector<ConfigField>& fields, const ConfigAssignment& given) {
  const auto& [assignment, place] = given;
  const std::size_t equals = assignment.find('=');
  const std::size_t dot = assignment.find('.');
  if (equals == std::string::npos || dot > equals) {
    return config_error(place, "write it as section.key=value");
  }
  const auto field =
      find(fields, place, assignment.substr(0, dot), assignment.substr(dot + 1, equals - dot - 1));
  if (!field) return field.status();
  return assign(**field, place, assignment.substr(equals + 1));
}

Status check_whole(const Config& config) {
  const int hertz = config.camera.power_line_hz;
  if (hertz != 0 && hertz != 50 && hertz != 60) {
    return config_error("camera.power_line_hz", "give 50 or 60, or 0 for automatic");
  }
  const bool one_missing = (config.model.width == 0) != (config.model.height == 0);
  const bool too_small = config.model.width == 32 || config.model.height == 32;
  if (one_missing || too_small || config.model.width % 32 != 0 || config.model.height % 32 != 0) {
    return config_error(
        "model.width, model.height",
        "give both as multiples of 32 from 64, or both as 0 to follow the camera's shape");
  }
  if (config.http.port == 0 && listen_addresses(config.http.listen).size() > 1) {
    return config_error("http.port",
                        "0 takes a free port of one address; http.listen names several");
  }
  return Status::ok();
}

}  // namespace

std::vector<ConfigField> config_fields(Config& c) {
  return {
      {"camera", "source", &c.camera.source, 0, 0, &source_objection},
      {"camera", "width", &c.camera.width, 32, 8192},
      {"camera", "height", &c.camera.height, 32, 8192},
      {"camera", "frames_per_second", &c.camera.frames_per_second, 0.5, 1000},
      {"camera", "format", &c.camera.format, 0, 0, &format_objection},
      {"camera", "field_of_view", &c.camera.field_of_view, 5, 170},
      {"camera", "calibration", &c.camera.calibration},
      {"camera", "exposure_ms", &c.camera.exposure_ms, 0, 10'000},
      {"camera", "gain", &c.camera.gain, -1, 1e6},
      {"camera", "white_balance_kelvin", &c.camera.white_balance_kelvin, 0, 20'000},
      {"camera", "power_line_hz", &c.camera.power_line_hz, 0, 60},
      {"model", "file", &c.model.file},
      {"model", "width", &c.model.width, 0, 2048},
      {"model", "height", &c.model.height, 0, 2048},
      {"model", "threads", &c.model.threads, 0, 64},
      {"model", "pin_threads", &c.model.pin_threads},
      {"model", "precision", &c.model.precision, 0, 0, &precision_objection},
      {"http", "listen", &c.http.listen, 0, 0, &addresses_objection},
      {"http", "port", &c.http.port, 0, 65535},
      {"http", "max_clients", &c.http.max_clients, 1, 64},
      {"http", "token_file", &c.http.token_file},
      {"http", "insecure", &c.http.insecure},
      {"record", "directory", &c.record.directory, 0, 0, directory_objection},
      {"record", "segment_megabytes", &c.record.segment_megabytes, 1, 65536},
      {"record", "keep_free_megabytes", &c.record.keep_free_megabytes, 0, 1e6},
      {"service", "least_rate", &c.service.least_rate, 0, 1000},
      {"gpio", "light", &c.gpio.light, 0, 0, &line_objection},
      {"gpio", "button", &c.gpio.button, 0, 0, &line_objection},
      {"gpio", "heartbeat", &c.gpio.heartbeat, 0, 0, &line_objection},
  };
}

std::vector<std::string> listen_addresses(const std::string& listen) {
  std::vector<std::string> addresses;
  std::istringstream stream(listen);
  for (std::string each; std::getline(stream, each, ',');) {
    each.erase(std::remove(each.begin(), each.end(), ' '), each.end());
    addresses.push_back(each);
  }
  return addresses;
}

Result<Config> load_config(const ConfigSources& sources) {
  Config config;
  const std::vector<ConfigField> fields = config_fields(config);
  if (!sources.file.empty()) LCDM_RETURN_IF_ERROR(read_file(fields, sources.file));
  for (const std::string& variable : sources.environment) {
    LCDM_RETURN_IF_ERROR(read_variable(fields, variable));
  }
  for (const ConfigAssignment& assignment : sources.assignments) {
    const Status read = read_assignment(fields, assignment);
    if (!read) return Status::error(StatusCode::kUsage, "%s", read.text());
  }
  LCDM_RETURN_IF_ERROR(check_whole(config));
  return config;
}

std::vector<std::string> process_environment() {
  std::vector<std::string> variables;
  for (char** entry = environ; entry != nullptr && *entry != nullptr; ++entry) {
    if (std::string_view(*entry).substr(0, 5) == "LCDM_") variables.emplace_back(*entry);
  }
  return variables;
}

std::string default_config_file() {
  const std::string installed = "/etc/lcdm/lcdm.toml";
  return access(installed.c_str(), F_OK) == 0 ? installed : "";
}

}  // namespace lcdm
