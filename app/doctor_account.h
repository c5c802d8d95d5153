// For whom the doctor looks: the account that the installed service runs as, else whoever calls.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <sys/types.h>
#include <vector>

#include "app/config.h"
#include "firmware/base/status.h"

namespace lcdm {

// The installed lcdm.service, with what `systemctl edit` laid over it.
struct ServiceUnit {
  std::string file;                             // empty: it is not installed
  std::map<std::string, std::string> settings;  // of [Service]; of one given twice the last counts,
                                                // groups add up
  // Empty: not set.
  std::string setting(const std::string& key) const;
};

// `root` stands before the system's own folders.
ServiceUnit read_service_unit(const std::string& root);

struct Account {
  std::string name = "this user";  // as findings say it
  bool is_caller = true;           // what follows is then the process's own, and not filled in
  uid_t user = 0;
  std::vector<gid_t> groups;
  std::string directory;                // where its relative paths begin; empty: where we are
  std::string made_at_start;            // its folder, which systemd makes when the service starts
  std::uint64_t memory_lock_bytes = 0;  // that it may lock

  // Whether it may use a path as access() would: R_OK, W_OK, X_OK. By owner, groups and mode; a
  // path that the caller cannot look at is none that we know anything against.
  bool may(const std::filesystem::path& path, int mode) const;
  // Whether systemd has yet to make the folder that the path lies in, for this account.
  bool makes_at_start(const std::filesystem::path& path) const;
};

Account calling_account();

// kNotFound: the unit names a user whom this machine does not know.
Result<Account> service_account(const ServiceUnit& unit);

// The configuration with its files where the account would look for them.
Config as_seen_by(const Account& account, Config config);

}  // namespace lcdm
