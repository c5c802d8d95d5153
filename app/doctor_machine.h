// Does the machine give what the service needs: memory, disk, files, port, clock, watchdog, lines?
// `root` stands before the system's own paths; what may be opened is judged for `account`, whom the
// texts name.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "app/config.h"
#include "app/doctor_account.h"
#include "app/finding.h"

namespace lcdm {

Finding check_memory_lock(const std::string& root, const Account& account,
                          std::uint64_t engine_bytes);
Finding check_disk(const std::string& directory, int keep_free_megabytes, const Account& account);
// The configured files that cannot be used.
std::vector<Finding> check_files(const Config& config, const Account& account);
// Whether the account may, and nobody else does, listen there.
Finding check_port(const std::string& listen, int port, const Account& account);
Finding check_clock(bool synchronised);
Finding check_hardware_watchdog(const std::string& root);
// One for each configured line; none where none is configured.
std::vector<Finding> check_gpio(const Config::Gpio& lines, const std::string& root,
                                const Account& account);

}  // namespace lcdm
