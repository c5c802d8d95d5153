// What the program's exit statuses mean. Scripts and the service manager rely on them.
#pragma once

namespace lcdm {

constexpr int kExitOk = 0;
constexpr int kExitFailure = 1;  // a fault that may pass: no camera, port in use, disk full
constexpr int kExitUsage = 2;    // the command line is not understood
constexpr int kExitConfig = 78;  // configuration or model: a restart cannot cure it (EX_CONFIG)

}  // namespace lcdm
