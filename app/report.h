// How the program tells a person what went wrong: one line on standard error.
#pragma once

#include "firmware/base/status.h"

namespace lcdm {

// Both print the line and give the exit status that fits.
int report_unusable(const Status& status);  // configuration or model: no retry can cure it
int report_failure(const Status& status);   // as its code says

}  // namespace lcdm
