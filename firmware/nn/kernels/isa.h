// Which instruction set the kernels run with: the processor's best, unless told otherwise.
#pragma once

#include <string>
#include <vector>

#include "firmware/base/status.h"

namespace lcdm::kernels {

// Highway's name of the one in use: AVX3 (which is AVX-512), AVX2, SSE4, NEON, ...
const char* isa_name();

// Those that this processor has and the kernels are compiled for, the best first.
std::vector<std::string> isa_names();

// From now on all kernels run with the one called so, in any case; what was packed for another is
// useless then. AVX3_DL, on x86, is AVX-512 without products of bfloat16, as Intel's Ice Lake has
// it. To be called while none of them runs.
// kInvalidInput: this processor or this program has none of that name; the text says which there
// are.
Status force_isa(const std::string& name);
// The same with what LCDM_ISA in the environment says, if it says anything. To be called while
// there is one thread.
Status force_isa_of_environment();

}  // namespace lcdm::kernels
