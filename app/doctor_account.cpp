#include "app/doctor_account.h"

#include <algorithm>
#include <array>
#include <cstdlib>
#include <fstream>
#include <grp.h>
#include <limits>
#include <pwd.h>
#include <sstream>
#include <sys/resource.h>
#include <sys/stat.h>
#include <system_error>
#include <unistd.h>

#include "app/source.h"
#include "firmware/base/folder.h"

namespace lcdm {
namespace {

namespace fs = std::filesystem;

// Where systemd looks, the stronger first.
constexpr std::array<const char*, 4> kUnitFolders = {
    "/etc/systemd/system", "/run/systemd/system", "/usr/lib/systemd/system", "/lib/systemd/system"};
constexpr const char* kGroups = "SupplementaryGroups";
// Of a service whose unit says nothing, as systemd has it since version 251.
constexpr std::uint64_t kDefaultMemoryLock = 8U << 20;

std::string trimmed(const std::string& text) {
  constexpr const char* kBlank = " \t\r";
  const std::size_t begin = text.find_first_not_of(kBlank);
  if (begin == std::string::npos) return "";
  return text.substr(begin, text.find_last_not_of(kBlank) - begin + 1);
}

void read_settings(const fs::path& path, std::map<std::string, std::string>& settings) {
  std::ifstream file(path);
  bool in_service = false;
  for (std::string line; std::getline(file, line);) {
    line = trimmed(line);
    const std::size_t equals = line.find('=');
    if (line.empty() || line[0] == '#' || line[0] == ';') continue;
    if (line[0] == '[') in_service = line == "[Service]";
    if (!in_service || equals == std::string::npos) continue;
    const std::string key = trimmed(line.substr(0, equals));
    const std::string value = trimmed(line.substr(equals + 1));
    const bool adds = key == kGroups && !value.empty() && !settings[key].empty();
    settings[key] = adds ? settings[key] + " " + value : value;
  }
}

// What `systemctl edit` and packages lay over a unit, in the order in which systemd reads it: by
// name; of two of one name the stronger folder's counts.
std::map<std::string, fs::path> drop_ins(const std::string& root) {
  std::map<std::string, fs::path> files;
  for (const char* folder : kUnitFolders) {
    const auto listed = list_folder(root + folder + "/lcdm.service.d");
    for (const fs::path& file : listed ? *listed : std::vector<fs::path>{}) {
      if (file.extension() == ".conf") files.emplace(file.filename().string(), file);
    }
  }
  return files;
}

// "infinity", or bytes with K, M, G or T behind them; of "soft:hard" the soft one.
std::uint64_t memory_lock_of(const std::string& text) {
  if (text.empty()) return kDefaultMemoryLock;
  char* end = nullptr;
  const std::uint64_t count = std::strtoull(text.c_str(), &end, 10);
  if (end == text.c_str()) return std::numeric_limits<std::uint64_t>::max();
  const std::string units = "KMGT";
  const std::size_t unit = *end == '\0' ? std::string::npos : units.find(*end);
  return unit == std::string::npos ? count : count << (10 * (unit + 1));
}

std::vector<gid_t> groups_of(const passwd& user, const std::string& supplementary) {
  int count = 64;
  std::vector<gid_t> groups(static_cast<std::size_t>(count));
  getgrouplist(user.pw_name, user.pw_gid, groups.data(), &count);
  groups.resize(static_cast<std::size_t>(std::clamp(count, 0, 64)));
  std::istringstream names(supplementary);
  for (std::string name; names >> name;) {
    // NOLINTNEXTLINE(concurrency-mt-unsafe): the doctor is one thread
    if (const group* found = getgrnam(name.c_str()); found != nullptr) {
      groups.push_back(found->gr_gid);
    }
  }
  return groups;
}

}  // namespace

std::string ServiceUnit::setting(const std::string& key) const {
  const auto found = settings.find(key);
  return found == settings.end() ? "" : found->second;
}

ServiceUnit read_service_unit(const std::string& root) {
  ServiceUnit unit;
  for (const char* folder : kUnitFolders) {
    std::error_code error;
    const fs::path file = root + folder + "/lcdm.service";
    if (!fs::exists(file, error)) continue;
    unit.file = file.string();
    read_settings(file, unit.settings);
    for (const auto& [name, path] : drop_ins(root)) read_settings(path, unit.settings);
    break;
  }
  return unit;
}

bool Account::may(const fs::path& path, int mode) const {
  if (is_caller) return access(path.c_str(), mode) == 0;
  if (user == 0) return true;
  const auto allows = [this](const fs::path& place, unsigned wanted) {
    struct stat facts {};
    if (stat(place.c_str(), &facts) != 0) return true;
    const bool in_group = std::find(groups.begin(), groups.end(), facts.st_gid) != groups.end();
    const unsigned shift = facts.st_uid == user ? 6 : in_group ? 3 : 0;
    return (facts.st_mode >> shift & wanted) == wanted;
  };
  std::error_code error;
  const fs::path real = fs::weakly_canonical(path, error);
  for (fs::path folder = real; folder.has_relative_path();) {
    folder = folder.parent_path();
    if (!allows(folder, X_OK)) return false;
  }
  return allows(real, static_cast<unsigned>(mode));
}

bool Account::makes_at_start(const fs::path& path) const {
  std::error_code error;
  if (made_at_start.empty() || fs::exists(made_at_start, error)) return false;
  return path == made_at_start || path.string().rfind(made_at_start + "/", 0) == 0;
}

Account calling_account() {
  rlimit limit{};
  getrlimit(RLIMIT_MEMLOCK, &limit);
  Account account;
  account.memory_lock_bytes = limit.rlim_cur;
  return account;
}

Result<Account> service_account(const ServiceUnit& unit) {
  const std::string name = unit.setting("User").empty() ? "root" : unit.setting("User");
  // NOLINTNEXTLINE(concurrency-mt-unsafe): the doctor is one thread
  const passwd* user = getpwnam(name.c_str());
  if (user == nullptr) {
    return Status::error(StatusCode::kNotFound,
                         "%.120s: its User=%.64s is nobody on this machine: install the package, "
                         "or `useradd --system %.64s`",
                         unit.file.c_str(), name.c_str(), name.c_str());
  }
  const std::string state = unit.setting("StateDirectory");
  const std::string directory = unit.setting("WorkingDirectory");
  Account account;
  account.name = "the service's account " + name;
  account.is_caller = false;
  account.user = user->pw_uid;
  account.groups = groups_of(*user, unit.setting(kGroups));
  account.directory = directory.empty() ? "/" : directory;
  account.made_at_start = state.empty() ? "" : "/var/lib/" + state;
  account.memory_lock_bytes = memory_lock_of(unit.setting("LimitMEMLOCK"));
  return account;
}

Config as_seen_by(const Account& account, Config config) {
  const auto place = [&account](std::string& path) {
    if (!path.empty()) path = (fs::path(account.directory) / path).string();
  };
  for (const char* scheme : {"file:", "mcap:"}) {
    std::optional<std::string> path = after_scheme(config.camera.source, scheme);
    if (!path) continue;
    place(*path);
    config.camera.source = scheme + *path;
  }
  place(config.camera.calibration);
  place(config.model.file);
  place(config.http.token_file);
  place(config.record.directory);
  return config;
}

}  // namespace lcdm
