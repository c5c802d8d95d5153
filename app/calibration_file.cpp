#include "app/calibration_file.h"

#include <cstdio>
#include <variant>
#include <vector>

#include "app/toml_file.h"
#include "firmware/base/file.h"

namespace lcdm {
namespace {

constexpr int kVersion = 1;

// One key, bound to its place.
struct Field {
  const char* section;  // "": before the first one
  const char* key;
  std::variant<std::string*, int*, float*, double*> place;
  double min = 0;  // numbers only, inclusive
  double max = 0;
};

// Every key, in the order of the file.
std::vector<Field> fields_of(Calibration& c, int& version) {
  constexpr double kMaxSide = 8192;
  constexpr double kMaxLens = 1000;  // far beyond any lens
  CameraModel& m = c.model;
  std::vector<Field> fields = {
      {"", "version", &version, kVersion, kVersion},
      {"", "camera", &c.camera},
      {"", "date", &c.date},
      {"", "views", &c.views, 1, 1e6},
      {"", "rms_error", &c.rms_error, 0, 1000},
      {"picture", "width", &m.width, 32, kMaxSide},
      {"picture", "height", &m.height, 32, kMaxSide},
      {"intrinsics", "fx", &m.fx, 1, 1e6},
      {"intrinsics", "fy", &m.fy, 1, 1e6},
      {"intrinsics", "cx", &m.cx, -kMaxSide, 2 * kMaxSide},
      {"intrinsics", "cy", &m.cy, -kMaxSide, 2 * kMaxSide},
  };
  constexpr const char* kLens[] = {"k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"};
  for (std::size_t i = 0; i < std::size(kLens); ++i) {
    fields.push_back({"lens", kLens[i], &m.distortion[i], -kMaxLens, kMaxLens});
  }
  return fields;
}

std::string name_of(const std::string& section, const std::string& key) {
  return section.empty() ? key : section + "." + key;
}

std::string name_of(const Field& field) { return name_of(field.section, field.key); }

Status read_text(const Field& field, const std::string& place, const toml::value& value,
                 std::string& out) {
  if (!value.is_string()) return config_error(place, name_of(field) + " must be a text in quotes");
  out = value.as_string().str;
  return Status::ok();
}

Status read_number(const Field& field, const std::string& place, const toml::value& value) {
  const bool whole = std::holds_alternative<int*>(field.place);
  double number = NAN;
  if (value.is_integer()) number = static_cast<double>(value.as_integer());
  if (value.is_floating() && !whole) number = value.as_floating();
  if (!(number >= field.min && number <= field.max)) {
    char range[64];
    std::snprintf(range, sizeof(range), "%g to %g", field.min, field.max);
    return config_error(
        place, name_of(field) + " must be a " + (whole ? "whole " : "") + "number from " + range);
  }
  if (auto* const* place_of_int = std::get_if<int*>(&field.place)) {
    **place_of_int = static_cast<int>(number);
  } else if (auto* const* place_of_float = std::get_if<float*>(&field.place)) {
    **place_of_float = static_cast<float>(number);
  } else {
    **std::get_if<double*>(&field.place) = number;
  }
  return Status::ok();
}

// Reads one table's keys and says which of them it had.
Status read_table(const std::string& file, const std::string& section, const toml::value& table,
                  const std::vector<Field>& fields, std::vector<bool>& seen) {
  for (const auto& [key, value] : table.as_table()) {
    if (section.empty() && value.is_table()) {
      LCDM_RETURN_IF_ERROR(read_table(file, key, value, fields, seen));
      continue;
    }
    const std::string place = place_of(file, value.location());
    std::size_t i = 0;
    while (i < fields.size() && (fields[i].section != section || fields[i].key != key)) ++i;
    if (i == fields.size()) {
      return config_error(
          place, "no key " + name_of(section, key) + " belongs into a calibration: remove it");
    }
    auto* const* text = std::get_if<std::string*>(&fields[i].place);
    LCDM_RETURN_IF_ERROR(text != nullptr ? read_text(fields[i], place, value, **text)
                                         : read_number(fields[i], place, value));
    seen[i] = true;
  }
  return Status::ok();
}

std::string toml_text(const std::string& text) {
  std::string out = "\"";
  for (const char c : text) {
    if (c == '"' || c == '\\') out += '\\';
    out += static_cast<unsigned char>(c) < 0x20 ? ' ' : c;
  }
  return out + '"';
}

std::string text_of(const Field& field) {
  if (auto* const* text = std::get_if<std::string*>(&field.place)) return toml_text(**text);
  if (auto* const* whole = std::get_if<int*>(&field.place)) return std::to_string(**whole);
  auto* const* single = std::get_if<float*>(&field.place);
  char number[32];
  std::snprintf(
      number, sizeof(number), "%.9g",
      single != nullptr ? static_cast<double>(**single) : **std::get_if<double*>(&field.place));
  return number;
}

}  // namespace

Result<Calibration> read_calibration(const std::string& file) {
  Calibration calibration;
  int version = 0;
  const std::vector<Field> fields = fields_of(calibration, version);
  std::vector<bool> seen(fields.size());
  LCDM_RETURN_IF_ERROR(read_toml(file, "calibration", [&](const toml::value& root) {
    return read_table(file, "", root, fields, seen);
  }));
  for (std::size_t i = 0; i < fields.size(); ++i) {
    if (seen[i]) continue;
    return config_error(file,
                        name_of(fields[i]) + " is missing: make the file with lcdm calibrate");
  }
  calibration.model.calibrated = true;
  return calibration;
}

Status write_calibration(const std::string& file, const Calibration& calibration) {
  Calibration copy = calibration;
  int version = kVersion;
  std::string text =
      "# Written by lcdm calibrate. Use it as camera.calibration. Pixels; the centre of the\n"
      "# picture's first pixel is (0, 0). The lens in OpenCV's coefficients.\n";
  std::string section;
  for (const Field& field : fields_of(copy, version)) {
    if (field.section != section) {
      section = field.section;
      text += "\n[" + section + "]\n";
    }
    text += field.key + (" = " + text_of(field)) + "\n";
  }
  return replace_file(file, text);
}

Result<CameraModel> model_for(const Calibration& calibration, int width, int height) {
  const CameraModel& model = calibration.model;
  if (model.has_shape(width, height)) return model.resized(width, height);
  return Status::error(
      StatusCode::kInvalidInput,
      "the calibration is of %dx%d, pictures of %dx%d show another cut of the view: "
      "calibrate at this size, set camera.width and height to the other, or leave "
      "camera.calibration empty",
      model.width, model.height, width, height);
}

}  // namespace lcdm
