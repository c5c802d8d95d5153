// What can be configured. systemd/lcdm.toml is the manual: every key, its default (but for the
// source and the addresses, which are an installed device's own), its meaning; a test holds that
// file and this struct to each other.
#pragma once

#include <string>
#include <variant>
#include <vector>

#include "firmware/base/status.h"

namespace lcdm {

// The defaults here are the product's. Immutable once the program runs.
struct Config {
  struct Camera {
    std::string source = "auto";  // for a desktop; the shipped file says v4l2:any
    int width = 640;
    int height = 480;
    double frames_per_second = 30;
    std::string format;
    double field_of_view = 65;
    std::string calibration;
    double exposure_ms = 0;
    double gain = -1;
    int white_balance_kelvin = 0;
    int power_line_hz = 0;
  } camera;
  struct Model {
    std::string file;
    int width = 0;
    int height = 0;
    int threads = 0;
    bool pin_threads = false;
    std::string precision = "fp32";
  } model;
  struct Http {
    std::string listen = "127.0.0.1";  // the shipped file adds the cable's address
    int port = 8080;
    int max_clients = 8;
    std::string token_file;
    bool insecure = false;
  } http;
  struct Record {
    std::string directory = "recordings";
    int segment_megabytes = 256;
    int keep_free_megabytes = 512;
  } record;
  struct Service {
    double least_rate = 0;
  } service;
  struct Gpio {
    std::string light;
    std::string button;
    std::string heartbeat;
  } gpio;
};

// One key, bound to its place in a Config.
struct ConfigField {
  const char* section;
  const char* key;
  std::variant<std::string*, int*, double*, bool*> place;
  double min = 0;  // numbers only, inclusive
  double max = 0;
  // Strings only: what is wrong with a value and how to mend it, or null when it is fine.
  const char* (*objection)(const std::string&) = nullptr;
};

// The addresses of http.listen, which lists them with commas between.
std::vector<std::string> listen_addresses(const std::string& listen);

// Every key of `config`, in the order of the file.
std::vector<ConfigField> config_fields(Config& config);

// One value from the command line.
struct ConfigAssignment {
  std::string text;   // section.key=value
  std::string place;  // what the person typed, for the error
};

// Where a running program gets its values from; later ones win: defaults, file, environment
// (LCDM_SECTION_KEY), assignments.
struct ConfigSources {
  std::string file;                      // empty: none
  std::vector<std::string> environment;  // NAME=VALUE; only names LCDM_SECTION_... are looked at
  std::vector<ConfigAssignment> assignments;
};

// The texts of errors begin with the place: file:line:column, the variable or the assignment.
// kUsage: the assignment; kInvalidInput: the others, or values that do not go together.
Result<Config> load_config(const ConfigSources& sources);

// The process's environment as ConfigSources wants it.
std::vector<std::string> process_environment();

// The installed configuration when there is one, else empty.
std::string default_config_file();

}  // namespace lcdm
