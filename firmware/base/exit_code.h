// What our programs' exit statuses mean. Scripts and the service manager rely on them.
#pragma once

#include "firmware/base/status.h"

namespace lcdm {

constexpr int kExitOk = 0;
constexpr int kExitFailure = 1;  // a fault that may pass: no camera, port in use, disk full
constexpr int kExitUsage = 2;    // the command line is not understood, or asks for what cannot be
constexpr int kExitConfig = 78;  // configuration or model: a restart cannot cure it (EX_CONFIG)

inline int exit_code_of(const Status& status) {
  switch (status.code()) {
    case StatusCode::kOk:
      return kExitOk;
    case StatusCode::kUsage:
      return kExitUsage;
    case StatusCode::kInvalidInput:
      return kExitConfig;
    default:
      return kExitFailure;
  }
}

}  // namespace lcdm
