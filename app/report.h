// How the program tells a person what went wrong: one line on standard error.
#pragma once

#include "firmware/base/status.h"

namespace lcdm {

// Prints the line and gives the exit status that fits.
int report(const Status& status);

}  // namespace lcdm
